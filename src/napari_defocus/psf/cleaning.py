"""Measured kernels made ready: background off, centred, and without what noise hides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Float64 = NDArray[np.float64]

_KEPT_SMOOTH, _KEPT, _KEPT_SHARE = 3.0, 2.0, 1e-3
"""A part of a kernel is visible if it stands out by so many standard deviations of the border, once
smoothed and once not, and by so much of the brightest pixel. Chosen by hand.
"""

_OFF_CENTER = 0.02
"""px: kernels whose centroid is closer to the middle are not moved. Chosen by hand."""


def border_of(kernel: Float64) -> Float64:
    """Return the pixels of a frame 2 px wide."""
    inside = np.zeros(kernel.shape, bool)
    inside[2:-2, 2:-2] = True
    return kernel[~inside]


def centered(spot: Float64) -> Float64:
    """Take the background off and move the centroid of what is visible to the middle."""
    spot = spot - np.median(border_of(spot))
    centroid = np.array(ndimage.center_of_mass(spot * _visible(spot)))
    off_center = centroid - len(spot) // 2
    if np.abs(off_center).max() < _OFF_CENTER:
        return spot
    return ndimage.shift(spot, -off_center, mode="nearest")


def _visible(kernel: Float64) -> NDArray[np.bool_]:
    """Return where a kernel stands out from the noise that its border shows."""
    smooth = ndimage.gaussian_filter(kernel, 0.7)
    least = max(_KEPT_SMOOTH * border_of(smooth).std(), _KEPT_SHARE * smooth.max())
    parts, _ = ndimage.label(smooth > min(least, smooth.max() / 2), np.ones((3, 3)))
    brightest = parts == parts.flat[np.argmax(smooth)]
    return brightest & (kernel > min(_KEPT * border_of(kernel).std(), kernel.max() / 2))


def cleaned(kernel: Float64) -> Float64:
    """Leave out what is negative or lost in the noise, and normalise to sum 1."""
    kernel = np.maximum(kernel, 0) * _visible(kernel)
    return kernel / kernel.sum()
