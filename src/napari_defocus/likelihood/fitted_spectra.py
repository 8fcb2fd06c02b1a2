"""Blur spectra as exponentials of sums of powers of the scale, (12), and how close they come:

sigma_i^2(r) = exp(alpha_ip r^p + ... + alpha_i0 + ... + alpha_iq r^q).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from napari_defocus.likelihood.exact_spectra import TABLE_STEP, log_blur_spectra, within_window
from napari_defocus.likelihood.gabor import frequencies
from napari_defocus.psf.families import PSFFamily
from napari_defocus.settings import MapSettings

Float64 = NDArray[np.floating]

_FIT_STEP = 0.1
"""px between the samples that are fitted: Delta r of Section III-A."""

_LOWEST_POWERS = (0, -1, -2, -3, -4)
"""The choices for p of (12), which the error between the samples decides. Chosen by hand."""

_AS_GOOD = 1.1
"""How many times the least error is good enough, for the sake of fewer powers. Chosen by hand."""

_INDISTINCT = 1e-6
"""px, and share of the light beside the middle pixel, that count as none: rounding."""


@dataclass(frozen=True)
class LogPolynomial:
    """The fitted log sigma_i^2(r) of (12): a sum of the powers r^p to r^q.

    It is kept as (r / stop)^p times Chebyshev polynomials, which is the same sum in a form that
    rounding does not harm.

    Attributes
    ----------
    coefficients : (q - p + 1, ...) float64 ndarray
        Of the Chebyshev polynomials over [start, stop].
    lowest : int
        p, 0 or negative.
    start, stop : float
        Domain of the fit, in px. Below it the PSF is a point and the logarithm 0.
    """

    coefficients: Float64
    lowest: int
    start: float
    stop: float

    @property
    def highest(self) -> int:
        """The exponent q."""
        return self.lowest + len(self.coefficients) - 1

    def __call__(self, scales: Float64, derivative: int = 0) -> Float64:
        """Evaluate the sums or a derivative in r: (len(scales), ...)."""
        inside = scales > self.start
        r = scales[inside]
        log_blur = np.zeros((len(scales), *self.coefficients.shape[1:]))
        # Leibniz' rule for (r / stop)^p times the series.
        for order in range(derivative + 1):
            falling = math.prod(range(self.lowest, self.lowest - order, -1))
            power = r ** float(self.lowest - order) / self.stop**self.lowest
            factor = math.comb(derivative, order) * falling * power
            series = self._series(r, derivative - order)
            log_blur[inside] += np.moveaxis(factor * series, -1, 0)
        return log_blur

    def _series(self, scales: Float64, derivative: int) -> Float64:
        span = self.stop - self.start
        series = chebyshev.chebder(self.coefficients, derivative, scl=2 / span)
        return chebyshev.chebval(2 * (scales - self.start) / span - 1, series)


def fit_spectra(
    psf: PSFFamily, window: int, row_fraction: float, column_fraction: float
) -> LogPolynomial:
    """Fit (12) to as many samples of a family's spectra as 0.1 px between them would give.

    The domain starts where the PSF stops being a point. The samples are closer to each other at
    the domain's ends, where sums of powers would swing between evenly spaced ones (Runge).
    Half-way between the samples stand those that the exponents are chosen by.
    """
    start, stop = _end_of_point(psf), psf.max_scale
    count = math.ceil((stop - start) / _FIT_STEP)
    angle = np.pi * np.arange(2 * count + 1) / (2 * count)
    scales = start + (stop - start) * (1 - np.cos(angle)) / 2
    log_blur = log_blur_spectra(psf, scales, window, row_fraction, column_fraction)
    return fit_log_spectra(scales[::2], log_blur[::2], scales[1::2], log_blur[1::2])


def fit_log_spectra(
    scales: Float64, log_blur: Float64, held_out: Float64, held_out_log_blur: Float64
) -> LogPolynomial:
    """Fit (12) to sampled spectra; other samples decide on its exponents.

    Parameters
    ----------
    scales : (M,) float64 ndarray
        Increasing, in px; p may be negative if they start above 0.
    log_blur : (M, ...) float64 ndarray
        log sigma_i^2 there, fitted in the least-squares sense.
    held_out, held_out_log_blur : (L,) and (L, ...) float64 ndarray
        Samples between them. Of all fits whose rms error there is at most 10 % above the best
        one's, the one with the fewest powers is taken, and of those the one with the best.

    Returns
    -------
    LogPolynomial
    """
    start, stop = float(scales[0]), float(scales[-1])
    flat = log_blur.reshape(len(scales), -1)
    held_out_flat = held_out_log_blur.reshape(len(held_out), -1)
    fits = []
    for lowest in _LOWEST_POWERS if start > 0 else _LOWEST_POWERS[:1]:
        basis = _powers(scales, start, stop, len(scales), lowest)
        held_out_basis = _powers(held_out, start, stop, len(scales), lowest)
        orthonormal, triangle = np.linalg.qr(basis)
        projected = orthonormal.T @ flat
        coordinates = np.linalg.solve(triangle.T, held_out_basis.T)
        # An orthonormal basis has the fits with fewer powers within that with all.
        fitted = np.cumsum(coordinates[:, :, None] * projected[:, None], axis=0)
        errors = np.sqrt(np.mean((fitted - held_out_flat) ** 2, axis=(1, 2)))
        fits += [(count + 1, error, lowest) for count, error in enumerate(errors)]
    best = min(error for _, error, _ in fits)
    count, _, lowest = min(fit for fit in fits if fit[1] <= _AS_GOOD * best)
    basis = _powers(scales, start, stop, count, lowest)
    coefficients = np.linalg.lstsq(basis, flat, rcond=None)[0]
    return LogPolynomial(coefficients.reshape(-1, *log_blur.shape[1:]), lowest, start, stop)


def _powers(scales: Float64, start: float, stop: float, count: int, lowest: int) -> Float64:
    """Evaluate the functions that `LogPolynomial` sums: (len(scales), count)."""
    place = 2 * (scales - start) / (stop - start) - 1
    power = (scales / stop) ** float(lowest)
    return chebyshev.chebvander(place, count - 1) * power[:, None]


def _end_of_point(psf: PSFFamily) -> float:
    """Return the scale up to which the kernel is a point, in px."""
    low, high = 0.0, psf.max_scale
    while high - low > _INDISTINCT:
        middle = (low + high) / 2
        if psf.kernel(middle).max() > 1 - _INDISTINCT:
            low = middle
        else:
            high = middle
    return low


@dataclass(frozen=True, eq=False)
class FitReport:
    """How close the fit (12) comes to the spectra (6), from `fit_report`.

    Attributes
    ----------
    scales : (M,) float64 ndarray
        The scales that are compared, in px: 0.02 px apart over the domain of the fit.
    frequencies : (F, 2) float64 ndarray
        Of the filters, along rows and columns, in cycles/px.
    log_errors : (M, 2, F) float64 ndarray
        log of the fitted over the exact spectra of the horizontal and the vertical gradient.
    lowest, highest : int
        The exponents p and q that were chosen.
    """

    scales: Float64
    frequencies: Float64
    log_errors: Float64
    lowest: int
    highest: int

    @property
    def rms(self) -> float:
        """The root mean square of the errors."""
        return float(np.sqrt(np.mean(self.log_errors**2)))

    @property
    def maximum(self) -> float:
        """The largest error, without its sign."""
        return float(np.abs(self.log_errors).max())

    def __str__(self) -> str:
        """Write the errors over the scale and over the frequency as two small tables."""
        of_frequency = np.hypot(*self.frequencies.T)
        lines = [
            f"fit (12) with powers {self.lowest} to {self.highest}: "
            f"rms log error {self.rms:.4f}, largest {self.maximum:.3f}"
        ]
        lines += _error_rows("scale (px)", self.scales, 1.0, self.log_errors)
        by_frequency = np.moveaxis(self.log_errors, 2, 0)
        lines += _error_rows("cycles/px", of_frequency, 0.05, by_frequency)
        return "\n".join(lines)


def _error_rows(name: str, values: Float64, width: float, errors: Float64) -> list[str]:
    """Write rms and largest error of the values in each interval."""
    rows = [f"{name:>12} {'rms':>8} {'largest':>8}"]
    interval = (values / width).astype(int)
    for k in np.unique(interval):
        part = errors[interval == k]
        where = f"{k * width:g} to {(k + 1) * width:g}"
        rms = np.sqrt(np.mean(part**2))
        rows.append(f"{where:>12} {rms:8.4f} {np.abs(part).max():8.3f}")
    return rows


def fit_report(
    psf: PSFFamily | Callable[[float], ArrayLike], window: int = MapSettings.window
) -> FitReport:
    r"""Compare the fit (12) of a family's spectra with the spectra (6) themselves.

    .. math:: \tilde{\sigma}_i^2(r) = \exp\left(\sum_{k=p}^{q} \alpha_{i,k} r^k\right) \tag{12}

    .. math:: \sigma_i^2(r) = \sum_{\mathbf{x}} |(h(r) \otimes t_i)[\mathbf{x}]|^2 \tag{6}

    Parameters
    ----------
    psf : PSFFamily or callable
    window : int, optional
        N, the side of the analysis window in px; odd.

    Returns
    -------
    FitReport
        Printing it shows the errors over the scale and over the frequency.

    Raises
    ------
    TypeError, ValueError
        If `psf` is not a family, or `window` is not an odd number from 17 up.

    Examples
    --------
    >>> from napari_defocus import Disc
    >>> fit_report(Disc()).rms < 0.03
    True
    """
    family = within_window(psf, window)
    of_windows = (window, 0.0, 0.0)
    fit = fit_spectra(family, *of_windows)
    scales = np.arange(fit.start + TABLE_STEP, fit.stop, TABLE_STEP)
    log_errors = fit(scales) - log_blur_spectra(family, scales, *of_windows)
    return FitReport(scales, frequencies(window) / window, log_errors, fit.lowest, fit.highest)
