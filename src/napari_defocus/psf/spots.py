"""The point spread function from pictures of point sources: every spot is the PSF."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_defocus.psf.cleaning import centered, cleaned

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_SATURATED = 1 - 1e-6
"""Spots of this intensity or more count as clipped: 1, less rounding."""

_DETECTED_NOISE, _DETECTED_SHARE = 6.0, 0.05
"""A spot stands out by so many standard deviations of the noise, and by so much of the brightest
pixel. Chosen by hand.
"""

_FAINT = 0.1
"""Spots with less than this share of the brightest one's light are left out. Chosen by hand."""

_MARGIN = 3
"""px around a spot that have to be dark. Chosen by hand."""


def kernel_of_points(picture: Float32, name: str) -> Float64:
    """Average the spots of all usable point sources: (K, K), sum 1."""
    level = float(np.median(picture))
    light = picture - level
    seen = ndimage.gaussian_filter(light, 1.0)
    threshold = max(_DETECTED_NOISE * _noise(seen), _DETECTED_SHARE * seen.max())
    spots, _ = ndimage.label(seen > threshold, np.ones((3, 3)))
    verdicts = Counter[str]()
    usable = []
    for number, box in enumerate(ndimage.find_objects(spots), 1):
        spot = light[box] * (spots[box] == number)
        corner = np.array([side.start for side in box])
        center = np.rint(corner + ndimage.center_of_mass(spot)).astype(int)
        reach = max(spot.shape) + _MARGIN
        verdict = _verdict(spots, number, center, reach)
        if verdict == "usable" and level + spot.max() >= _SATURATED:
            verdict = "saturated"
        verdicts[verdict] += 1
        if verdict == "usable":
            usable.append((spot.sum(), center, reach))
    if not usable:
        found = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
        raise ValueError(f"{name} shows no usable point source ({found or 'nothing stands out'})")
    least = _FAINT * max(flux for flux, _, _ in usable)
    widest = max(reach for _, _, reach in usable)
    cut_out = [_window(light, center, widest) for flux, center, _ in usable if flux >= least]
    return cleaned(np.sum([centered(spot) for spot in cut_out if spot is not None], axis=0))


def _verdict(spots: NDArray[np.int32], number: int, center: NDArray[np.int64], reach: int) -> str:
    surroundings = _window(spots, center, reach)
    if surroundings is None:
        return "at the border"
    return "usable" if np.isin(surroundings, (0, number)).all() else "too close to another"


def _window(values: NDArray[Any], center: NDArray[np.int64], reach: int) -> NDArray[Any] | None:
    """Return what lies up to `reach` px around a pixel, if all of that is in the picture."""
    if (center < reach).any() or (center + reach >= values.shape).any():
        return None
    row, column = center
    return values[row - reach : row + reach + 1, column - reach : column + reach + 1]


def _noise(values: NDArray[np.floating]) -> float:
    """Return the standard deviation of most values, whatever the few others are."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
