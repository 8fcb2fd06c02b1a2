"""What a picture shows by its size and its values alone: that it can tell little of its blur."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.known_pixels import known_pixels

_WINDOWS = 2
"""A picture of fewer windows along its shorter side is small. Chosen by hand."""

_LOOKED_AT = 200_000
"""Pixels, spread over the picture, whose values are compared."""

_FEW = 8
"""Different values: grey pictures have more. Chosen by hand."""

_MOST_IN_PALETTE = 256
"""Different colours: more do not fit into a palette."""

_PIXELS_A_COLOR = 16
"""Tiny pictures have few colours without a palette. Chosen by hand."""

_LOOKED_AT_FOR_STEPS = 768
"""px: the most rows and columns in the middle that are looked at for JPEG's steps. By hand."""

_STRONG_STEP = 20.0
"""Levels of 8 bits. Four photographs at a quality of 30 (steps of 25) and less: on a third to two
thirds of the trusted pixels of three, the map was off by more than 1 px and 15 %; at a quality of
95 (steps of 1), on a seventh.
"""

SATURATED = 0.05
"""Share of pixels. In 17 photographs with skies and lamps it is 0.03 or less."""


def picture_remarks(picture: NDArray[Any], window: int) -> list[str]:
    """Return a sentence for each reason why a picture tells little of its blur.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) or (H, W, 4) ndarray
    window : int
        Side of the windows that it is measured with, in px.

    Returns
    -------
    list of str
        It is small, flat, or a mask, has a palette, was compressed strongly, or many of its pixels
        are saturated. Empty if nothing is odd.

    Examples
    --------
    >>> picture_remarks(np.full((10, 10), 90, np.uint8), window=41)[1]
    'All pixels have the same value, so there is no blur to see.'
    """
    return [*_of_size(picture, window), *_of_values(picture), *_of_compression(picture)]


def _of_size(picture: NDArray[Any], window: int) -> Iterator[str]:
    height, width = picture.shape[:2]
    if min(height, width) < _WINDOWS * window:
        yield (
            f"The picture is small ({width} x {height} px). Each radius is measured in a window of "
            f"{window} x {window} px, so one place is hardly told from another."
        )


def saturation_remark(share: float) -> str:
    """Return the sentence about a share of pixels that are saturated."""
    return (
        f"{100 * share:.0f} % of the pixels are saturated (as bright as the picture can be), so "
        "there is no blur to see there."
    )


def share_saturated(picture: NDArray[Any]) -> float | None:
    """Return the share of the known pixels that are as bright as the brightest of all.

    All colours of such a pixel are. None where no pixel is known, or all have the same value.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) or (H, W, 4) ndarray

    Examples
    --------
    >>> share_saturated(np.array([[1, 4, 4, 2]] * 2))
    0.5
    """
    values = _known_colors(picture)
    if not len(values) or (values == values[0]).all():
        return None
    return _saturated(values)


def brightest_pixels(picture: NDArray[Any]) -> tuple[float, int, int]:
    """Return the brightest known value of a part of a picture, its pixels, and all known ones.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) or (H, W, 4) ndarray

    Examples
    --------
    >>> brightest_pixels(np.array([[1, 4, 4, 2]] * 2))
    (4.0, 4, 8)
    """
    values = _known_colors(picture)
    if not len(values):
        return -np.inf, 0, 0
    most = values.max()
    return float(most), int((values == most).all(axis=1).sum()), len(values)


def _known_colors(picture: NDArray[Any]) -> NDArray[Any]:
    """Return the colours of the known pixels, (N, C)."""
    colors = np.ma.getdata(picture)
    colors = colors[..., :3] if colors.ndim == 3 else colors[..., None]
    known = known_pixels(picture)
    return colors.reshape(-1, colors.shape[-1]) if known is None else colors[known]


def _some_of(values: NDArray[Any]) -> NDArray[Any]:
    return values[:: max(1, len(values) // _LOOKED_AT)]


def _saturated(values: NDArray[Any]) -> float:
    return float((_some_of(values) == values.max()).all(axis=1).mean())


def _of_values(picture: NDArray[Any]) -> Iterator[str]:
    values = _known_colors(picture)
    if not len(values):
        yield "No pixel is known: all are transparent, NaN or masked."
        return
    if (values == values[0]).all():
        yield "All pixels have the same value, so there is no blur to see."
        return
    some = _some_of(values)
    in_palette = _colors_in_palette(some)
    if in_palette:
        yield (
            f"The picture has only {in_palette} different colours, as GIF and PNG with a palette "
            "do. The steps between them look like sharp edges, so the radii are often too small."
        )
        return
    different = len(np.unique(some))
    if different <= _FEW:
        yield (
            f"The picture has only {different} different values, like a mask or a drawing. Blur is "
            "measured on photographs and micrographs."
        )
        return
    saturated = _saturated(values)
    if saturated > SATURATED:
        yield saturation_remark(saturated)


def _colors_in_palette(colors: NDArray[Any]) -> int:
    """Return how many different colours there are if a palette was chosen for them, else 0.

    A toned picture has few colours, too, but its channels only rise, or only fall, with the light.
    """
    if colors.dtype != np.uint8 or colors.shape[1] < 3:
        return 0
    packed = colors.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    found = np.unique(packed)
    if not _FEW < len(found) <= min(_MOST_IN_PALETTE, len(colors) // _PIXELS_A_COLOR):
        return 0
    palette = np.stack([found >> 16, found >> 8 & 255, found & 255], axis=1).astype(int)
    steps = np.diff(palette[np.argsort(palette.sum(axis=1), kind="stable")], axis=0)
    toned = ((steps >= 0).all(axis=0) | (steps <= 0).all(axis=0)).all()
    return 0 if toned else len(found)


def _of_compression(picture: NDArray[Any]) -> Iterator[str]:
    from napari_defocus.core.jpeg_steps import LEVELS, quantization_step  # it needs SciPy

    if picture.dtype != np.uint8:
        return
    margins = [max(0, (length - _LOOKED_AT_FOR_STEPS) // 2) for length in picture.shape[:2]]
    top, left = margins
    middle = np.ma.getdata(picture)[top : picture.shape[0] - top, left : picture.shape[1] - left]
    grey = middle if middle.ndim == 2 else middle[..., :3].mean(axis=2, dtype=np.float32)
    step = quantization_step((grey / LEVELS).astype(np.float32), 1 / LEVELS)
    if step is not None and step >= _STRONG_STEP:
        yield (
            f"The picture was compressed strongly (JPEG, in steps of {step:.0f} grey levels). Many "
            "radii are wrong then, also where the confidence is high."
        )
