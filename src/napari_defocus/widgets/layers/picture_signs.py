"""What is to be seen of a picture before it is measured, and makes its map say little: no Qt."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.settings import MapSettings

_SMALL = 2 * MapSettings.window
"""In px, of the shorter side: fewer than two frames fit side by side."""

_LOOKED_AT = 200_000
"""Pixels that are looked at, spread over the picture."""

_FEW = 8
"""Different values; grey pictures have more."""

_SATURATED = 0.05
"""Share of the pixels that have the largest value there can be."""


def signs_of_picture(image: NDArray[Any]) -> list[str]:
    """Return a line for each reason, seen in the picture alone, why its map says little.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) ndarray
        NaN and masked pixels are not known.

    Examples
    --------
    >>> import numpy as np
    >>> signs_of_picture(np.full((200, 300), 7, np.uint8))
    ['All pixels have the same value: nothing can be measured. Is this the right layer?']
    """
    return list(_signs(image))


def _signs(image: NDArray[Any]) -> Iterator[str]:
    height, width = image.shape[:2]
    values = _some_of(image)
    different = np.unique(values)
    if not different.size:
        yield "All pixels are unknown (NaN): nothing can be measured."
    elif different.size == 1:
        yield "All pixels have the same value: nothing can be measured. Is this the right layer?"
    elif different.size <= _FEW:
        yield (
            f"This picture has only {different.size} different values, like a mask or a drawing. "
            "Blur is measured on photographs and micrographs: choose one of these."
        )
    else:
        yield from _on_saturation(values, different[-1])
    if min(height, width) < _SMALL:
        yield (
            f"This picture is small ({width} x {height} px). Each answer takes a frame of "
            f"{MapSettings.window} px, so the map hardly tells one place from another. Measure a "
            "larger part if there is one."
        )


def _some_of(image: NDArray[Any]) -> NDArray[Any]:
    """Return known values, of pixels spread over the picture, one channel after the other."""
    colors = image[..., :3] if image.ndim == 3 else image
    step = max(1, round(np.sqrt(np.prod(image.shape[:2]) / _LOOKED_AT)))
    values = np.ma.compressed(np.ma.asarray(colors[::step, ::step]))
    return np.asarray(values[~np.isnan(values)] if values.dtype.kind == "f" else values)


def _on_saturation(values: NDArray[Any], largest: Any) -> Iterator[str]:
    share = float((values == largest).mean())
    if share >= _SATURATED:
        yield (
            f"{share:.0%} of the pixels are saturated (at {largest:g}). Their details are lost, so "
            "the blur there is a guess. Expose less if you can take the picture again."
        )
