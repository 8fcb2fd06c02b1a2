"""Where a restored picture is worse than the one that was given, and is left as it was.

A radius that is too large makes rings. Rings of bright things reach below black, those of dark
things above white, where no light can be. Natural details do so only here and there: of six real
scenes up to 1 % of the pixels, of a photograph with wrong radii a quarter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Float32 = NDArray[np.float32]

_BEYOND = np.float32(0.05)
"""Of the contrast: how far beyond black and white a value is impossible. By hand."""

_NEAR, _FAR = 8.0, 16.0
"""px: standard deviation of the Gaussian over which is counted, for any and for wide blur."""

_LEFT_NEAR, _LEFT_FAR = (0.08, 0.25), (0.05, 0.15)
"""Shares of impossible values there, up to which a place is restored, and from which it is left.
By hand, on six real scenes (docs/decisions.md) and on a photograph."""

_WIDE = 10.0
"""px: radius from which blur is wide, and its rings far apart."""

_SOFT = 4.0
"""px: standard deviation of the Gaussian by which one goes over into the other."""


def unrestored_share(sharp: Float32, scales: Float32, contrast: float) -> Float32:
    """Return how far each place is left as it was: (H, W) from 0 to 1.

    Parameters
    ----------
    sharp : (H, W, C) float32 ndarray
        What was restored, before anything is cut off at 0 and 1.
    scales : (H, W) float32 ndarray
        The radii that were taken away, in px.
    contrast : float
        Of the picture.
    """
    margin = _BEYOND * np.float32(contrast)
    impossible = ((sharp < -margin) | (sharp > 1 + margin)).any(axis=2).astype(np.float32)
    if not impossible.any():
        return np.zeros_like(impossible)
    left = _rise(gaussian_filter(impossible, _NEAR), *_LEFT_NEAR)
    if scales.max() >= _WIDE:
        far = _rise(gaussian_filter(impossible, _FAR), *_LEFT_FAR)
        left = np.where(scales < _WIDE, left, np.maximum(left, far))
    return np.asarray(gaussian_filter(left, _SOFT), np.float32)


def _rise(share: Float32, low: float, high: float) -> Float32:
    return np.clip((share - np.float32(low)) / np.float32(high - low), 0, 1)
