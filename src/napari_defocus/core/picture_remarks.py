"""What a picture shows by its size and its values alone: that it can tell little of its blur."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.known_pixels import known_pixels

_SATURATED = 0.05
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
        It is smaller than one window; it is flat; many of its pixels are saturated.

    Examples
    --------
    >>> picture_remarks(np.full((10, 10), 90, np.uint8), window=41)[1]
    'All pixels have the same value, so there is no blur to see.'
    """
    return [*_of_size(picture, window), *_of_values(picture)]


def _of_size(picture: NDArray[Any], window: int) -> Iterator[str]:
    if min(picture.shape[:2]) < window:
        yield (
            f"The picture is smaller than one window ({window} x {window} px), so its radii are "
            "rough guesses."
        )


def _of_values(picture: NDArray[Any]) -> Iterator[str]:
    colors = np.ma.getdata(picture)
    colors = colors[..., :3] if colors.ndim == 3 else colors[..., None]
    known = known_pixels(picture)
    values = colors.reshape(-1, colors.shape[-1]) if known is None else colors[known]
    if not len(values):
        yield "No pixel is known: all are transparent, NaN or masked."
        return
    if (values == values[0]).all():
        yield "All pixels have the same value, so there is no blur to see."
        return
    saturated = float((values == values.max()).all(axis=1).mean())
    if saturated > _SATURATED and values.dtype != bool:
        yield (
            f"{100 * saturated:.0f} % of the pixels are saturated (as bright as the picture can "
            "be), so there is no blur to see there."
        )
