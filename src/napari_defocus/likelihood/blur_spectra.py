"""Blur and noise spectra of the filter bank, as look-up tables of the scale: (6), (7), (12)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray
from scipy.fft import fft, fft2, next_fast_len
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from napari_defocus.core.checks import Spectra
from napari_defocus.likelihood.gabor import MIN_WINDOW, AxisFilters, axis_filters, frequencies
from napari_defocus.psf.families import PSFFamily, as_family
from napari_defocus.settings import MapSettings

Float64 = NDArray[np.floating]

LABEL_STEP = 0.1
"""Distance between the scales of a curve and of the labels, in px (Section IV)."""

_TABLE_STEP = 0.02
_FIT_STEP = 0.1
_LOWEST_POWERS = (0, -1, -2, -3, -4)
_AS_GOOD = 1.1
_INDISTINCT = 1e-6

_SPREAD, _LEAST_SPREAD = 0.06, 1e-3
"""Standard deviation of the scales within a window: relative, and at least so many px."""

_SHARP_SHARE, _SHARP_BELOW, _SHARP_FALL = 5e-4, 0.625, 6
"""Share of sharp light; from which part of the largest scale it falls, and with which power."""

_WEAK_NOISE, _POINTLIKE, _CENTERS_STEP = 1e-3, 0.1, 5


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


def check_windows(psf: PSFFamily | Callable[[float], ArrayLike], window: int) -> PSFFamily:
    """Return the PSF family, after a check of it and of the windows' side in px."""
    family = as_family(psf)
    if not isinstance(window, (int, np.integer)) or window % 2 == 0 or window < MIN_WINDOW:
        raise ValueError(f"window is {window}; it takes an odd number of px from {MIN_WINDOW} up")
    if 2 * family.max_scale > window:
        raise ValueError(
            f"psf has a largest scale of {family.max_scale} px; "
            f"a window of {window} px takes at most {window / 2} px"
        )
    return family


def label_scales(psf: PSFFamily) -> Float64:
    """Return the scales on which curves and labels are sampled: 0, 0.1, ... px."""
    return LABEL_STEP * np.arange(int(psf.max_scale / LABEL_STEP + 1e-6) + 1)


@lru_cache(maxsize=8)
def spectrum_table(
    psf: PSFFamily,
    window: int,
    row_fraction: float,
    column_fraction: float,
    spectra: Spectra,
    mixed: bool = False,
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
    """
    of_windows = (window, row_fraction, column_fraction)
    count = int(np.ceil(psf.max_scale / _TABLE_STEP - 1e-6))
    scales = np.linspace(0, psf.max_scale, count + 1)
    log_blur = (
        CubicSpline(scales, log_blur_spectra(psf, scales, *of_windows))
        if spectra == "exact"
        else fit_spectra(psf, *of_windows)
    )
    if mixed:
        log_blur = CubicSpline(scales, np.log(mixed_spectra(scales, np.exp(log_blur(scales)))))
    value, slope, curvature = np.exp(log_blur(scales)), log_blur(scales, 1), log_blur(scales, 2)
    noise = FilterPower.of_window(*of_windows, largest=2).noise_spectra()
    return SpectrumTable(scales, value, value * slope, value * (curvature + slope**2), noise)


def log_blur_spectra(
    psf: PSFFamily, scales: Float64, window: int, row_fraction: float, column_fraction: float
) -> Float64:
    """Evaluate the logarithm of (6) for every scale: (len(scales), 2, F)."""
    kernels = [psf.kernel(float(scale)) for scale in scales]
    largest = max(len(kernel) for kernel in kernels)
    filters = FilterPower.of_window(window, row_fraction, column_fraction, largest)
    return np.log(filters.blur_spectra(kernels))


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
    share[distance > (scales[-1] - scales)[:, None] + _INDISTINCT] = 0
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
    pointlike = np.abs(blur / blur[0] - 1).max(axis=(1, 2))[::_CENTERS_STEP] < _POINTLIKE
    shift = np.where(pointlike, 0, likeliest - scales[::_CENTERS_STEP])
    shift = gaussian_filter1d(shift, 2, mode="nearest")
    at = np.clip(scales + np.interp(scales, scales[::_CENTERS_STEP], shift), 0, scales[-1])
    return np.exp(CubicSpline(scales, np.log(mixed))(at))


@dataclass(frozen=True)
class FilterPower:
    """|T_i|^2 of the separable Gabor filters, on an FFT grid that holds filter and kernel.

    Attributes
    ----------
    rows, columns : (2, n, M) float64 ndarray
        The two factors of the filters' power, once for each number of cycles a window that they
        have along the axis, for the horizontal and the vertical gradient.
    row_of_filter, column_of_filter : (F,) int ndarray
        Which of them are each filter's.
    """

    rows: Float64
    columns: Float64
    row_of_filter: NDArray[np.intp]
    column_of_filter: NDArray[np.intp]

    @classmethod
    def of_window(
        cls, window: int, row_fraction: float, column_fraction: float, largest: int
    ) -> FilterPower:
        """Transform the filters of a window whose centre lies at these fractions of a px.

        `largest` is the side of the largest kernel, in px.
        """
        size = next_fast_len(window + largest)
        powers: list[Float64] = []
        of_filter: list[NDArray[np.intp]] = []
        for fraction, cycles, offsets in zip(
            (row_fraction, column_fraction),
            frequencies(window).T,
            ((0.0, 0.5), (0.5, 0.0)),
            strict=True,
        ):
            distinct, number = np.unique(cycles, return_inverse=True)
            filters = [axis_filters(window, abs(fraction - offset)) for offset in offsets]
            powers.append(np.stack([_axis_power(one, distinct, size) for one in filters]))
            of_filter.append(number)
        return cls(powers[0], powers[1], of_filter[0], of_filter[1])

    def noise_spectra(self) -> Float64:
        """Evaluate (7), sum |grad * t_i|^2, for both gradients: (2, F)."""
        size = self.rows.shape[2]
        difference = 4 * np.sin(np.pi * np.arange(size) / size) ** 2
        along = np.stack([np.ones(size), difference])
        rows = np.einsum("dri,di->dr", self.rows, along)
        columns = np.einsum("dcj,dj->dc", self.columns, along[::-1])
        return rows[:, self.row_of_filter] * columns[:, self.column_of_filter] / size**2

    def blur_spectra(self, kernels: Sequence[Float64]) -> Float64:
        """Evaluate (6), sum |h * t_i|^2, by Parseval's theorem, for both gradients: (n, 2, F)."""
        size = self.rows.shape[2]
        spectra = np.empty((len(kernels), 2, self.rows.shape[1], self.columns.shape[1]))
        for spectrum, kernel in zip(spectra, kernels, strict=True):
            power = np.abs(fft2(kernel, (size, size))) ** 2
            by_row = np.einsum("dri,ij->drj", self.rows, power)
            spectrum[:] = np.einsum("drj,dcj->drc", by_row, self.columns)
        return spectra[:, :, self.row_of_filter, self.column_of_filter] / size**2


def _axis_power(filters: AxisFilters, cycles: NDArray[np.int64], size: int) -> Float64:
    """Return |T|^2 of the 1-D complex filter of each (signed) number of cycles a window."""
    k = np.abs(cycles) // 2
    sine = np.where(k == 0, 0.0, filters.taps[:, filters.order + np.maximum(k, 1)])
    wave = filters.taps[:, k] - 1j * np.sign(cycles) * sine
    return np.abs(fft(wave.T, size)) ** 2


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
    """How close the fit (12) comes to the spectra (6).

    Attributes
    ----------
    scales : (M,) float64 ndarray
        Where they are compared, in px: over the fit's domain, 0.02 px apart.
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
    """Compare the fit (12) of a family's spectra with the spectra (6) themselves.

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
        If `psf` is no family, or `window` no odd number from 17 up of at least twice the
        family's largest scale.

    Examples
    --------
    >>> from napari_defocus import Disc
    >>> fit_report(Disc()).rms < 0.03
    True
    """
    family = check_windows(psf, window)
    of_windows = (window, 0.0, 0.0)
    fit = fit_spectra(family, *of_windows)
    scales = np.arange(fit.start + _TABLE_STEP, fit.stop, _TABLE_STEP)
    log_errors = fit(scales) - log_blur_spectra(family, scales, *of_windows)
    return FitReport(scales, frequencies(window) / window, log_errors, fit.lowest, fit.highest)
