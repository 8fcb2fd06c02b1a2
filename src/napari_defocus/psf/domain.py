"""PSF families with a smaller domain, and as a picture of averaged pixels shows them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from napari_defocus.psf.families import (
    Annulus,
    Disc,
    Gaussian,
    GeneralizedGaussian,
    Polygon,
    PSFFamily,
)
from napari_defocus.psf.microscope import Microscope

_SCALE_FREE = (Annulus, Disc, Gaussian, GeneralizedGaussian, Polygon)
"""Families with one shape: pixels that are twice as wide see half the radius."""


def limited(psf: PSFFamily, largest: float) -> PSFFamily:
    """Return a family whose scales go no farther than `largest`, in px."""
    if psf.max_scale <= largest:
        return psf
    names: set[str] = {field.name for field in fields(psf)} if is_dataclass(psf) else set()
    for name in ("max_radius", "max_scale"):
        if name in names:
            smaller: Any = replace(cast("Any", psf), **{name: largest})
            return cast("PSFFamily", smaller)
    return Limited(psf, largest)


def seen_with_pixels(psf: PSFFamily, side: int, largest: float) -> PSFFamily:
    """Return a family as a picture shows it whose pixels are means of `side` x `side` px.

    Its scales are in such wide pixels, up to `largest`.
    """
    if isinstance(psf, _SCALE_FREE):
        return replace(psf, max_radius=min(psf.max_radius / side, largest))
    if isinstance(psf, Microscope):
        return psf.with_wider_pixels(side, largest)
    if side == 1:
        return limited(psf, largest)
    return Averaged(psf, side, min(psf.max_scale / side, largest))


def softness_beside(psf: PSFFamily, softness: float) -> float:
    """Return what is left of a camera's softness, in px, if a family has a part of it itself.

    Diffraction is a part of what blurs in focus. So it must not count twice.
    """
    if isinstance(psf, Microscope):
        return math.sqrt(max(softness**2 - psf.softness**2, 0.0))
    return softness


def growth_of_details(psf: PSFFamily) -> float:
    """Return with which power of the frequency the gradients of what a lens sees grow.

    Those of edges do not, and those of points grow as the frequency does, in amplitude.
    """
    return 1.0 if isinstance(psf, Microscope) and psf.specimen == "points" else 0.0


@dataclass(frozen=True)
class Limited:
    """A family of any kind with a smaller domain.

    Attributes
    ----------
    psf : PSFFamily
    max_scale : float
    """

    psf: PSFFamily
    max_scale: float

    @property
    def scale_name(self) -> str:
        """As of the family itself."""
        return self.psf.scale_name

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the kernel of the family itself."""
        return self.psf.kernel(scale)


@dataclass(frozen=True)
class Averaged:
    """A family of any kind, seen with pixels that are means of `side` x `side` px.

    Attributes
    ----------
    psf : PSFFamily
    side : int
    max_scale : float
        In wide pixels.
    """

    psf: PSFFamily
    side: int
    max_scale: float

    @property
    def scale_name(self) -> str:
        """As of the family itself."""
        return self.psf.scale_name

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the kernel of a scale in wide pixels: what falls on each of them."""
        fine = self.psf.kernel(scale * self.side)
        share = self._shares(len(fine))
        return np.einsum("ai,ij,bj->ab", share, fine, share)

    def _shares(self, length: int) -> NDArray[np.float64]:
        """Return how much of each px of a kernel falls on each wide pixel around its centre."""
        reach = -(-length // (2 * self.side))
        edges = (np.arange(-reach, reach + 2) - 0.5) * self.side
        low = np.arange(length) - length / 2
        overlap = np.minimum(edges[1:, None], low + 1) - np.maximum(edges[:-1, None], low)
        return np.clip(overlap, 0, 1)
