"""Coarser pictures, whose pixels are means of 2 x 2, with or without what is hidden in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from napari_defocus.core.image import PreparedImage
from napari_defocus.likelihood.exact_spectra import domain_of_window

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_LEAST_SIDES = 4
"""A picture is so many windows of the level before it high and wide, or has no such level: two
windows of its own. Chosen by hand."""

_FADE = 2.0
"""px: standard deviation of the Gaussian by which what is left out fades in; a hard border would
itself look sharp."""

_REACH = 2.0
"""Standard deviations at which that Gaussian ends: tiles see no farther."""


_WHITE_LEVELS = 2
"""So many levels have noise as if it was white. Beyond, it falls half as fast: what a camera's
denoising and JPEG leave is coarser than a pixel. Measured in five photographs of cameras, level 2
has 1.3 to 10 times as much as white noise would leave, and level 3 8 times or more
(docs/decisions.md).
"""


def noise_share(level: int) -> float:
    """Return the variance of the noise at a level, as a share of that of the picture's pixels."""
    coarser = 1.0 if level < _WHITE_LEVELS else 2.0**level
    return 4.0**-level * coarser


def level_count(shape: tuple[int, int], window: int, largest: float) -> int:
    """Return how many levels a picture of a height and width has, for scales up to `largest` px."""
    count = 1
    while domain_of_window(window) * 2 ** (count - 1) < largest and min(
        shape
    ) >= _LEAST_SIDES * window * 2 ** (count - 1):
        count += 1
    return count


def mean_of_four(values: Float32) -> Float32:
    """Return means of 2 x 2 px; an odd last row or column is left out."""
    height, width = (length // 2 * 2 for length in values.shape[:2])
    top, bottom = values[0:height:2], values[1:height:2]
    pairs = (top[:, 0:width:2] + top[:, 1:width:2]) + (bottom[:, 0:width:2] + bottom[:, 1:width:2])
    return np.ascontiguousarray(np.float32(0.25) * pairs)


def halved(picture: PreparedImage) -> PreparedImage:
    """Return a picture whose pixels are means of 2 x 2; an odd last row or column is left out."""
    opaque = None
    if picture.opaque is not None:
        opaque = mean_of_four(picture.opaque.astype(np.float32)) > np.float32(0.5)
    return PreparedImage(
        mean_of_four(picture.color), mean_of_four(picture.luminance), opaque, picture.intensities
    )


def halved_without(picture: PreparedImage, hidden: Mask) -> tuple[PreparedImage, Mask]:
    """Return a picture of means of 2 x 2 px in which what is hidden does not count, and where.

    Parameters
    ----------
    picture : PreparedImage
    hidden : (H, W) bool ndarray

    Returns
    -------
    picture : PreparedImage
        With the weight of its details.
    hidden : (H // 2, W // 2) bool ndarray
        Where half of the pixels or more were.
    """
    coarse = halved(picture)
    shown = (~hidden).astype(np.float32)
    share = mean_of_four(shown)
    light = mean_of_four(picture.luminance * shown) / np.maximum(share, np.float32(0.25))
    luminance = np.where(share > 0, light, coarse.luminance)
    hidden = share < np.float32(0.5)
    near = gaussian_filter(hidden.astype(np.float32), _FADE, truncate=_REACH)
    weight = np.clip(1 - 2 * near, 0, 1)
    weight[hidden] = 0
    return replace(coarse, luminance=luminance, weight=weight), hidden
