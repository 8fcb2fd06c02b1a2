"""Blur and noise spectra of the filter bank, (6), (7), (12), as look-up tables of the scale."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from napari_defocus.core.checks import Spectra
from napari_defocus.likelihood.exact_spectra import TABLE_STEP, FilterPower, log_blur_spectra
from napari_defocus.likelihood.fitted_spectra import fit_spectra
from napari_defocus.psf.families import PSFFamily

Float64 = NDArray[np.floating]

LABEL_STEP = 0.1
"""Distance between the scales of a curve and of the labels, in px (Section IV)."""

INDISTINCT = 1e-6
"""Scales in px, and shares of a spectrum, that differ by less than this are the same: rounding."""

_SPREAD, _LEAST_SPREAD = 0.06, 1e-3
"""Standard deviation of the scales within a window: relative, and at least so many px. Averages
over 30 to 70 % lost (docs/decisions.md); the least one only keeps it above 0.
"""

_SHARP_SHARE, _SHARP_BELOW, _SHARP_FALL = 5e-4, 0.625, 6
"""Share of sharp light; from which part of the largest scale it falls, 5 px of 8, and with which
power. The share is measured (docs/decisions.md), the power chosen by hand.
"""

_WEAK_NOISE, _POINTLIKE, _CENTERS_STEP = 1e-3, 0.1, 5
"""Of `_centered`: the noise spectrum, a point's blur spectrum being 1; by how much the spectrum of
a scale that stays differs from it at most; and every which scale is looked at. Chosen by hand.
"""


@dataclass(frozen=True, eq=False)
class SpectrumTable:
    """Blur spectra sigma_i^2(r) with two derivatives, and noise spectra, of both gradients.

    Attributes
    ----------
    scales : (M,) float64 ndarray
        Evenly spaced over the domain of the PSF family, in px.
    value, first, second : (M, 2, F) float64 ndarray
        sigma_i^2(r) of (6) and its derivatives in r, for the horizontal and the vertical
        gradient. 1 for a PSF that is one point.
    noise : (2, F) float64 ndarray
        sigma_grad_i^2 of (7): the power that white noise of variance 1 has in each filter.
    """

    scales: Float64
    value: Float64
    first: Float64
    second: Float64
    noise: Float64

    @property
    def step(self) -> float:
        """Distance between neighbouring scales, in px."""
        return float(self.scales[1] - self.scales[0])

    def at(self, scales: Float64) -> Float64:
        """Return sigma_i^2 at the table's scales nearest to `scales`: (len(scales), 2, F)."""
        return self.value[np.rint(scales / self.step).astype(int)]


def is_pointlike(blur: Float64, tolerance: float = INDISTINCT) -> NDArray[np.bool_]:
    """Return which of some scales' spectra, (M, 2, F), are those of a point, the first: (M,)."""
    return np.abs(blur / blur[0] - 1).max(axis=(1, 2)) < tolerance


def label_scales(psf: PSFFamily) -> Float64:
    """Return the scales on which curves and labels are sampled: 0, 0.1, ... px."""
    return LABEL_STEP * np.arange(int(psf.max_scale / LABEL_STEP + 1e-6) + 1)


def nearest_labels(axis: Float64, scales: NDArray[np.floating]) -> NDArray[np.int32]:
    """Return the index of the nearest of increasing scales, for any array of scales in px."""
    between = (axis[1:] + axis[:-1]) / 2
    return np.searchsorted(between, scales).astype(np.int32)


@lru_cache(maxsize=32)
def spectrum_table(
    psf: PSFFamily,
    window: int,
    row_fraction: float,
    column_fraction: float,
    spectra: Spectra,
    mixed: bool = False,
    softness: float = 0.0,
) -> SpectrumTable:
    """Tabulate the spectra of a PSF family for windows of one kind.

    Parameters
    ----------
    psf : PSFFamily
    window : int
        N.
    row_fraction, column_fraction : float
        Fractional part, 0 or 0.5, of the windows' centres in px.
    spectra : {"exact", "fitted"}
        (6) evaluated at every scale of the table, or the fit (12).
    mixed : bool
        Whether windows hold more than one scale, see `mixed_spectra`.
    softness : float
        Standard deviation, in px, of the camera's own blur, a Gaussian behind every PSF. With the
        fit (12), each spectrum falls as that of a point does.
    """
    of_windows = (window, row_fraction, column_fraction)
    count = int(np.ceil(psf.max_scale / TABLE_STEP - 1e-6))
    scales = np.linspace(0, psf.max_scale, count + 1)
    if spectra == "exact":
        log_blur = CubicSpline(scales, log_blur_spectra(psf, scales, *of_windows, softness))
    else:
        fit = fit_spectra(psf, *of_windows)
        soft, sharp = (
            log_blur_spectra(psf, np.zeros(1), *of_windows, one) for one in (softness, 0.0)
        )
        log_blur = CubicSpline(scales, fit(scales) + (soft - sharp)) if softness else fit
    if mixed:
        log_blur = CubicSpline(scales, np.log(mixed_spectra(scales, np.exp(log_blur(scales)))))
    value, slope, curvature = np.exp(log_blur(scales)), log_blur(scales, 1), log_blur(scales, 2)
    noise = FilterPower.of_window(*of_windows, largest=2).noise_spectra()
    return SpectrumTable(scales, value, value * slope, value * (curvature + slope**2), noise)


def mixed_spectra(scales: Float64, blur: Float64) -> Float64:
    """Average blur spectra over the scales that a window around each scale may hold.

    No window has one scale alone: blur varies within it, edges of things are sharper than what
    lies between them, and a camera's processing adds what no lens passed. The spectra (6) have
    deep minima that no picture has, and a window is far too sure of the scale whose minima
    happen to fit. So scales within about 6 % of each are averaged, evenly on both sides, with a
    share of 5e-4 of sharp light, less beyond 5/8 of the largest scale: with it, discs of 8 px
    would measure 5.

    Parameters
    ----------
    scales : (M,) float64 ndarray
    blur : (M, 2, F) float64 ndarray
        sigma_i^2(r) of (6).

    Returns
    -------
    (M, 2, F) float64 ndarray
    """
    distance = np.abs(scales - scales[:, None])
    spread = np.maximum(_SPREAD * scales, _LEAST_SPREAD)[:, None]
    share = np.exp(-((distance / spread) ** 2) / 2)
    share[distance > (scales[-1] - scales)[:, None] + INDISTINCT] = 0
    share /= share.sum(axis=1, keepdims=True)
    wide = np.maximum(scales / scales[-1], _SHARP_BELOW) / _SHARP_BELOW
    sharp = (_SHARP_SHARE / wide**_SHARP_FALL)[:, None, None]
    mixed = (1 - sharp) * np.einsum("ij,jdf->idf", share, blur) + sharp * blur[0]
    return _centered(scales, blur, mixed)


def _centered(scales: Float64, blur: Float64, mixed: Float64) -> Float64:
    """Shift mixtures along the scales, so that blur of one scale is likeliest at this scale.

    Its expected log-likelihood is -mean(log B) - log(mean(A / B)) with A its spectrum, B the
    mixture's, and the best variance; a weak noise stands for the one that all pictures have.
    """
    actual, assumed = (
        (spectra + _WEAK_NOISE).reshape(len(scales), -1) for spectra in (blur, mixed)
    )
    ratio = np.einsum("cf,sf->cs", actual[::_CENTERS_STEP], 1 / assumed) / assumed.shape[1]
    expected = -np.log(assumed).mean(axis=1) - np.log(ratio)
    likeliest = scales[expected.argmax(axis=1)]
    pointlike = is_pointlike(blur, _POINTLIKE)[::_CENTERS_STEP]
    shift = np.where(pointlike, 0, likeliest - scales[::_CENTERS_STEP])
    shift = gaussian_filter1d(shift, 2, mode="nearest")
    at = np.clip(scales + np.interp(scales, scales[::_CENTERS_STEP], shift), 0, scales[-1])
    return np.exp(CubicSpline(scales, np.log(mixed))(at))
