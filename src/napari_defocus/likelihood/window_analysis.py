"""What windows of one level say: from local powers to curves, their maxima, and signs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.checks import Mode
from napari_defocus.likelihood.blur_spectra import SpectrumTable
from napari_defocus.likelihood.maxima import CANDIDATES, local_maxima
from napari_defocus.likelihood.profile_likelihood import (
    profile_log_likelihood,
    quasi_log_likelihood,
)
from napari_defocus.likelihood.reference import fixed_point_maxima
from napari_defocus.likelihood.signs import signs_of

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

Search = Literal["lattice", "fixed-point"]

_LEAST_OPAQUE = 0.05
"""Share of a window that has to be known, for it to say anything. Chosen by hand."""


@dataclass(frozen=True, eq=False)
class Said:
    """What windows say; the first axes are those of the windows.

    Attributes
    ----------
    radii, log_likelihoods : (..., 3) float32 ndarray
    curve : (..., L) float32 ndarray
    signs : (..., 3) float32 ndarray
        See `signs_of`.
    """

    radii: Float32
    log_likelihoods: Float32
    curve: Float32
    signs: Float32

    @classmethod
    def nothing(cls, shape: tuple[int, int], scales: int) -> Said:
        """Return room for what so many rows and columns of windows say."""
        lengths = CANDIDATES, CANDIDATES, scales, 3
        return cls(*(np.empty((*shape, length), np.float32) for length in lengths))

    def arrays(self) -> tuple[Float32, Float32, Float32, Float32]:
        """Return all that is said, in the order of the attributes."""
        return self.radii, self.log_likelihoods, self.curve, self.signs


@dataclass(frozen=True, eq=False)
class WindowAnalysis:
    """How powers of windows become what they say.

    Attributes
    ----------
    table : SpectrumTable
    scales : (L,) float64 ndarray
        Of the curves, in px.
    least_noise : float
        Noise variance, in units of the picture's contrast.
    window : int
    mode : {"curve", "paper"}
    search : {"lattice", "fixed-point"} or None
        See `Estimation`.
    seen : float
        The share of a window that the picture fills; the rest is mirrored, and tells no more.
    """

    table: SpectrumTable
    scales: Float64
    least_noise: float
    window: int
    mode: Mode
    search: Search | None
    seen: float = 1.0

    def said(
        self,
        power: Float32,
        opaque: Float32 | None,
        noisier: Float32 | None,
        *,
        with_signs: bool = True,
    ) -> Said:
        """Return what P windows say, one after the other.

        Parameters
        ----------
        power : (r, c, 2, F) float32 ndarray
            Of windows in r rows and c columns; changed.
        opaque, noisier : (r, c) float32 ndarray or None
            The share of each window that is known, and how many times noisier it is.
        with_signs : bool, optional
            Whether signs are asked for; else they are 0.
        """
        if opaque is not None:
            power /= np.maximum(opaque, _LEAST_OPAQUE)[..., None, None]
        if noisier is not None:
            power /= noisier[..., None, None]
        points = power.reshape(-1, *self.table.noise.shape)
        given = points, self.table, self.scales, self.least_noise
        if self.mode == "paper":
            curve = profile_log_likelihood(*given)
            dispersion = np.ones(points.shape[:2], np.float32)
        else:
            curve, dispersion = quasi_log_likelihood(*given)
        radii, heights = self._maxima(points, curve, dispersion)
        signs = np.zeros((len(points), 3), np.float32)
        if with_signs:
            signs = signs_of(points, self.table, self.least_noise, self.window)
        if self.seen < 1 and self.mode != "paper":
            curve *= np.float32(self.seen)
            heights *= np.float32(self.seen)
        if opaque is not None:
            _silence_transparent(opaque.ravel(), radii, heights, curve)
        return Said(radii, heights, curve, signs)

    def _maxima(
        self, points: Float32, curve: Float32, dispersion: Float32
    ) -> tuple[Float32, Float32]:
        if self.search == "lattice":
            return local_maxima(
                points, curve, self.table, self.scales, self.least_noise, dispersion
            )
        if self.search == "fixed-point":
            return fixed_point_maxima(points, self.table, self.least_noise, dispersion)
        radii = np.full((len(points), CANDIDATES), np.nan, np.float32)
        return radii, np.full_like(radii, -np.inf)


def _silence_transparent(
    opaque: Float32, radii: Float32, log_likelihoods: Float32, curve: Float32
) -> None:
    """Let windows speak in proportion to their opaque share, and the transparent ones not."""
    curve *= opaque[..., None]
    transparent = opaque < _LEAST_OPAQUE
    curve[transparent] = 0
    radii[transparent] = np.nan
    present = np.isfinite(radii)
    share = np.broadcast_to(opaque[..., None], radii.shape)
    log_likelihoods[present] *= share[present]
    log_likelihoods[~present] = -np.inf
