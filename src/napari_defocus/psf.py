"""PSF families: point-spread functions indexed by one scale, in px of the input picture."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from napari_defocus.settings import MapSettings


@runtime_checkable
class PSFFamily(Hashable, Protocol):
    """What every PSF family offers.

    A family must be hashable and equal to another one that makes the same kernels: spectra
    are kept for the families that were used last.
    """

    @property
    def max_scale(self) -> float:
        """Upper end of the domain [0, max_scale] of scales, in px."""

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the kernel of one scale: (K, K), K odd, non-negative, sum 1."""


@dataclass(frozen=True)
class Disc:
    """Uniform disc, the PSF of an ideal lens with a round aperture; its scale is the radius.

    Each pixel of a kernel holds the exact area that the disc covers of it. A disc of a
    radius up to 0.5 px lies within one pixel: no picture can tell it from a point, so all
    radii in [0, 0.5] have the same likelihood.

    Parameters
    ----------
    max_radius : float
        Largest radius that is looked for, in px.

    Raises
    ------
    ValueError
        If `max_radius` is not finite or below 1 px.

    Examples
    --------
    >>> Disc().kernel(1.0).round(3)
    array([[0.025, 0.145, 0.025],
           [0.145, 0.318, 0.145],
           [0.025, 0.145, 0.025]])
    """

    max_radius: float = MapSettings.max_radius

    def __post_init__(self) -> None:
        if not (np.isfinite(self.max_radius) and self.max_radius >= 1.0):
            raise ValueError(f"max_radius is {self.max_radius}; it takes a number from 1 px up")

    @property
    def max_scale(self) -> float:
        """The largest radius, in px."""
        return self.max_radius

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the area-coverage disc of radius `scale` (px), normalised to sum 1."""
        reach = max(int(np.ceil(scale - 0.5)), 0)
        corners = np.arange(-reach, reach + 2) - 0.5
        below = _disc_quadrant_area(corners[:, None], corners[None, :], max(scale, 0.5))
        covered = np.maximum(np.diff(np.diff(below, axis=0), axis=1), 0)
        return covered / covered.sum()


def _disc_quadrant_area(
    x: NDArray[np.floating], y: NDArray[np.floating], radius: float
) -> NDArray[np.floating]:
    """Signed area of the disc within the rectangle from its centre to (x, y)."""
    a = np.minimum(np.abs(x), radius)
    b = np.minimum(np.abs(y), radius)
    flat = np.minimum(np.sqrt(np.maximum(radius**2 - b**2, 0)), a)

    def under_arc(u: NDArray[np.floating]) -> NDArray[np.floating]:
        angle = np.arcsin(np.minimum(u / radius, 1))
        return 0.5 * (u * np.sqrt(np.maximum(radius**2 - u**2, 0)) + radius**2 * angle)

    return np.sign(x) * np.sign(y) * (b * flat + under_arc(a) - under_arc(flat))
