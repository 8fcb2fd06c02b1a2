"""Blur and noise spectra of the filter bank, as look-up tables of the scale: (6), (7), (12)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.fft import fft, fft2, next_fast_len
from scipy.interpolate import CubicSpline

from napari_defocus.gabor import MIN_WINDOW, AxisFilters, axis_filters, frequencies
from napari_defocus.psf import PSFFamily
from napari_defocus.settings import Spectra

Float64 = NDArray[np.floating]

LABEL_STEP = 0.1
"""Distance between the scales of a curve and of the labels, in px (Section IV)."""

_TABLE_STEP = 0.02
_FIT_STEP = 0.1
_FIT_DEGREE = 20


@dataclass(frozen=True)
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


def check_windows(psf: PSFFamily, window: int) -> None:
    """Check a PSF family and the side of the windows that are to see its blur, in px."""
    if not isinstance(psf, PSFFamily) or isinstance(psf, type):
        raise TypeError(f"psf is {psf!r}; it takes a PSF family such as Disc()")
    if not isinstance(window, (int, np.integer)) or window % 2 == 0 or window < MIN_WINDOW:
        raise ValueError(f"window is {window}; it takes an odd number of px from {MIN_WINDOW} up")
    if 2 * psf.max_scale > window:
        raise ValueError(
            f"psf has a largest scale of {psf.max_scale} px; "
            f"a window of {window} px takes at most {window / 2} px"
        )


def label_scales(psf: PSFFamily) -> Float64:
    """Return the scales on which curves and labels are sampled: 0, 0.1, ... px."""
    return LABEL_STEP * np.arange(int(psf.max_scale / LABEL_STEP + 1e-6) + 1)


@lru_cache(maxsize=8)
def spectrum_table(
    psf: PSFFamily, window: int, row_fraction: float, column_fraction: float, spectra: Spectra
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
        (6) evaluated at every scale of the table, or (12) fitted to samples 0.1 px apart.
    """
    size = next_fast_len(window + 1 + psf.kernel(psf.max_scale).shape[0])
    filters = [
        FilterPower.of_window(window, row_fraction, 0.5 - column_fraction, size),
        FilterPower.of_window(window, 0.5 - row_fraction, column_fraction, size),
    ]
    noise = np.stack([filters[0].noise_spectrum(axis=1), filters[1].noise_spectrum(axis=0)])
    count = int(np.ceil(psf.max_scale / _TABLE_STEP - 1e-6))
    dense = np.linspace(0, psf.max_scale, count + 1)
    if spectra == "exact":
        log_blur = CubicSpline(dense, np.log(blur_spectra(psf, dense, filters)))
    else:
        samples = np.linspace(0, psf.max_scale, int(np.ceil(psf.max_scale / _FIT_STEP)) + 1)
        log_blur = fit_log_spectra(samples, blur_spectra(psf, samples, filters))
    value, slope, curvature = np.exp(log_blur(dense)), log_blur(dense, 1), log_blur(dense, 2)
    return SpectrumTable(dense, value, value * slope, value * (curvature + slope**2), noise)


@dataclass(frozen=True)
class FilterPower:
    """|T_i|^2 of the separable Gabor filters, on an FFT grid that holds filter and kernel.

    Attributes
    ----------
    rows, columns : (F, M) float64 ndarray
        The two factors of each filter's power.
    """

    rows: Float64
    columns: Float64

    @classmethod
    def of_window(
        cls, window: int, row_fraction: float, column_fraction: float, size: int
    ) -> FilterPower:
        """Transform the filters of a window whose samples lie at these fractions of a px."""
        row, column = frequencies(window).T
        return cls(
            _axis_power(axis_filters(window, abs(row_fraction)), row, size),
            _axis_power(axis_filters(window, abs(column_fraction)), column, size),
        )

    def noise_spectrum(self, axis: int) -> Float64:
        """Evaluate (7), sum |grad * t_i|^2, for the gradient along one axis: (F,)."""
        size = self.rows.shape[1]
        difference = 4 * np.sin(np.pi * np.arange(size) / size) ** 2
        weights = [difference if axis == i else np.ones(size) for i in (0, 1)]
        return (self.rows @ weights[0]) * (self.columns @ weights[1]) / size**2

    def blur_spectrum(self, kernel: Float64) -> Float64:
        """Evaluate (6), sum |h * t_i|^2, by Parseval's theorem: (F,)."""
        size = self.rows.shape[1]
        kernel_power = np.abs(fft2(kernel, (size, size))) ** 2
        return np.einsum("fi,fi->f", self.rows @ kernel_power, self.columns) / size**2


def _axis_power(filters: AxisFilters, cycles: NDArray[np.int64], size: int) -> Float64:
    """Return |T|^2 of the 1-D complex filter of each (signed) number of cycles a window."""
    k = np.abs(cycles) // 2
    sine = np.where(k == 0, 0.0, filters.taps[:, filters.order + np.maximum(k, 1)])
    wave = filters.taps[:, k] - 1j * np.sign(cycles) * sine
    return np.abs(fft(wave.T, size)) ** 2


def blur_spectra(psf: PSFFamily, scales: Float64, filters: list[FilterPower]) -> Float64:
    """Evaluate (6) for every scale: (len(scales), len(filters), F)."""
    kernels = [psf.kernel(scale) for scale in scales]
    return np.array([[power.blur_spectrum(kernel) for power in filters] for kernel in kernels])


@dataclass(frozen=True)
class LogPolynomial:
    """The fitted log sigma_i^2(r) of (12): a polynomial in r, kept in Chebyshev form.

    The powers p..q of (12) run from p = 0: negative ones diverge at r = 0, which belongs to
    the domain.

    Attributes
    ----------
    coefficients : (q + 1, ...) float64 ndarray
    stop : float
        Upper end of the domain [0, stop], in px.
    """

    coefficients: Float64
    stop: float

    def __call__(self, scales: Float64, derivative: int = 0) -> Float64:
        """Evaluate the polynomials or a derivative in r: (len(scales), ...)."""
        series = chebyshev.chebder(self.coefficients, derivative, scl=2 / self.stop)
        return np.moveaxis(chebyshev.chebval(2 * scales / self.stop - 1, series), -1, 0)


def fit_log_spectra(scales: Float64, spectra: Float64, degree: int = _FIT_DEGREE) -> LogPolynomial:
    """Fit (12) to sampled spectra, (M, ...), in the least-squares sense of their logarithm."""
    stop = float(scales[-1])
    basis = chebyshev.chebvander(2 * scales / stop - 1, min(degree, len(scales) - 1))
    flat = np.log(spectra).reshape(len(scales), -1)
    coefficients = np.linalg.lstsq(basis, flat, rcond=None)[0]
    return LogPolynomial(coefficients.reshape(-1, *spectra.shape[1:]), stop)
