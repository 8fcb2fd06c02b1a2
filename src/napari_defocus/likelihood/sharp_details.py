"""Pixels that show details which no wide blur leaves.

Windows are wide, and a sharp thing before a blurred ground wins in all that overlap it. But it is
seen pixel by pixel where something is sharp: the finest details, u = (I - G_1)^2 f with a Gaussian
G_s of standard deviation s, have an energy that is above the noise's, and above a share of that of
details an octave coarser, v = (G_1 - G_2) f. Of what is blurred by a disc of 3 px, 1 to 6 % pass
(fences and other periodic things), of what is blurred by 1 px half.

Such details, and a few px around them, are left out of the averaged pictures of coarser levels:
beside a thing that is in front, nothing of it is in the light of the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter, uniform_filter

from napari_defocus.core.image import PreparedImage

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_ABOVE_NOISE = np.float32(6)
"""Times the energy of the noise: less may be chance. 4 was as good."""

_SHARE = np.float32(0.2)
"""Of the energy of coarser details: a step of softness 0.8 px has more, one blurred by 3 px less.
Chosen on pictures of one radius."""

_NARROW, _WIDE, _COARSER = 0.7, 2.0, 2.5
"""px: standard deviations over which energies are averaged: of the finest details, for what is
inside of things and for what is around them, and of the coarser ones."""

_SPREAD, _CLOSED = 2, 1
"""px: how far the marks of a step reach beyond it, and half the gaps within things."""

_AROUND = 1
"""px around sharp details that are left out with them."""

_REACH = 2.0
"""Standard deviations of the widest Gaussians, of the others 3: levels of tiles see no further."""

_LEAST_NOISE = np.float32(4e-6)
"""Variance, for a contrast of 1. With less, what the lens itself leaves passes: singular places at
a distance of r from an edge."""

_LEAST_ENERGY = np.float32(1e-12)


@dataclass(frozen=True, eq=False)
class SharpDetails:
    """Where a picture is sharp beyond doubt.

    Attributes
    ----------
    around : (H, W) bool ndarray
        Sharp details and what is a few px around.
    inside : (H, W) bool ndarray
        Pixels that belong to sharp things themselves: no blurred ground beside them.
    """

    around: Mask
    inside: Mask

    @classmethod
    def none(cls, shape: tuple[int, int]) -> SharpDetails:
        """Return that nothing is sharp beyond doubt, for a picture of a height and width."""
        return cls(np.zeros(shape, bool), np.zeros(shape, bool))

    @classmethod
    def of(cls, picture: PreparedImage, noise_variance: float | Float32) -> SharpDetails:
        """Find them in a prepared picture.

        Parameters
        ----------
        picture : PreparedImage
        noise_variance : float or (H, W) ndarray
            Of the luminance, in units of `picture.evened`.
        """
        smooth = _blurred(picture.evened, 1.0)
        finest = picture.evened - smooth
        finest -= _blurred(finest, 1.0)
        coarser = smooth - _blurred(smooth, np.sqrt(3.0))
        if picture.opaque is not None:
            finest[~picture.opaque] = 0
        limit = gaussian_filter(coarser**2, _COARSER, truncate=_REACH)
        of_finest, of_coarser = _noise_energies()
        noise = np.maximum(np.asarray(noise_variance, np.float32), _LEAST_NOISE)
        limit = _SHARE * np.maximum(limit - of_coarser * noise, _LEAST_ENERGY)
        limit = np.maximum(limit + of_finest * noise, _ABOVE_NOISE * of_finest * noise)
        energy = _blurred(finest**2, _NARROW)
        narrow = energy > limit
        wide = _blurred(energy, np.sqrt(_WIDE**2 - _NARROW**2)) > limit
        return cls(_grown(wide, _AROUND), _inside(narrow))


def share_of_blocks(
    marked: Mask, rows: NDArray[np.floating], columns: NDArray[np.floating], side: int
) -> Float32:
    """Return the share of marked pixels in blocks around some centres: (R, C)."""
    share = uniform_filter(marked.astype(np.float32), side, mode="nearest")
    first, second = (
        np.clip(np.rint(centers + 0.5 * (side % 2 == 0)).astype(int), 0, length - 1)
        for centers, length in zip((rows, columns), marked.shape, strict=True)
    )
    return share[np.ix_(first, second)]


def _blurred(values: Float32, sigma: float) -> Float32:
    return gaussian_filter(values, sigma, truncate=3.0)


@lru_cache(maxsize=1)
def _noise_energies() -> tuple[np.float32, np.float32]:
    """Return the energies of the finest and of the coarser details of noise of variance 1."""
    one = np.zeros((33, 33))
    one[16, 16] = 1
    smooth = gaussian_filter(one, 1.0, truncate=3.0)
    finest = one - smooth
    finest = finest - gaussian_filter(finest, 1.0, truncate=3.0)
    coarser = smooth - gaussian_filter(smooth, np.sqrt(3.0), truncate=3.0)
    return np.float32(np.sum(finest**2)), np.float32(np.sum(coarser**2))


def _grown(marked: Mask, by: int) -> Mask:
    return maximum_filter(marked, 2 * by + 1)


def _inside(marked: Mask) -> Mask:
    """Close gaps, and take off as much of the rim as the marks of a step reach beyond it."""
    closed = maximum_filter(marked, 2 * _CLOSED + 1)
    return minimum_filter(closed, 2 * (_CLOSED + _SPREAD) + 1)
