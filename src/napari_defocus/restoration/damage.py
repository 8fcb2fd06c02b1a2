"""Where a restored picture is worse than the one that was given, and is left as it was.

A radius that is too large makes rings. Rings of bright things reach below black, those of dark
things above white, where no light can be. Natural details do so only here and there: of six real
scenes up to 1 % of the pixels, of a photograph with wrong radii a quarter.

A lens, a radius or a depth edge that is not as the model says makes ripples in what the restored
picture, blurred again, leaves of the given one. Where they are strong beside the details of the
given picture, those of the restored one are invented.
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

_NOT_NOISE = 1.5
"""px: standard deviation of the Gaussian that takes noise and fine texture from what is left, and
leaves ripples. Chosen by hand."""

_DETAILS = 12.0
"""px: standard deviation of the Gaussian over which ripples and details are averaged
(docs/decisions.md)."""

_FLAT = np.float32(1e-6)
"""Variance, in units of the squared contrast, below which there are no details. By hand."""

_RIPPLES = (0.1, 0.2)
"""Ripples as a share of the details, up to which a place is restored, and from which it is left
(docs/decisions.md)."""

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


def unexplained_share(
    left_over: Float32, color: Float32, noise_variance: float, contrast: float
) -> Float32:
    """Return how far each place is left because it is not explained: (H, W) from 0 to 1.

    Parameters
    ----------
    left_over : (H, W, C) float32 ndarray
        The given picture less the restored one, blurred again.
    color : (H, W, C) float32 ndarray
        The given picture.
    noise_variance : float
        Of a channel.
    contrast : float
        Of the picture.
    """
    ripples = _around(_around(left_over, _NOT_NOISE) ** 2, _DETAILS).mean(axis=2)
    # White noise keeps so much of its variance.
    noise = np.float32(noise_variance / (4 * np.pi * _NOT_NOISE**2))
    details = (_around(color**2, _DETAILS) - _around(color, _DETAILS) ** 2).mean(axis=2)
    flat = _FLAT * np.float32(contrast**2) + noise
    share = np.sqrt(np.maximum(ripples - noise, 0) / np.maximum(details, flat))
    return np.asarray(gaussian_filter(_rise(share, *_RIPPLES), _SOFT), np.float32)


def _around(picture: Float32, sigma: float) -> Float32:
    return np.asarray(gaussian_filter(picture, (sigma, sigma, 0)), np.float32)
