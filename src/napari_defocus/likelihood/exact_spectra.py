"""Blur spectra and noise spectra of the filter bank, (6) and (7), from a family's kernels.

For a point spread function h and a filter t_i of (3),

    sigma_hi^2 = sum_x |(h * t_i)[x]|^2,    sigma_ni^2 = sigma_n^2 sum_x |(grad * t_i)[x]|^2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import fft, fft2, fftfreq, next_fast_len

from napari_defocus.likelihood.gabor import MIN_WINDOW, AxisFilters, axis_filters, frequencies
from napari_defocus.psf.domain import growth_of_details, limited
from napari_defocus.psf.families import PSFFamily, as_family

Float64 = NDArray[np.floating]

TABLE_STEP = 0.02
"""px between the scales of a table, at most. Chosen by hand."""


_LEAST_FREQUENCY = 0.05
"""Radians a px below which no scene's details change; windows of 41 px see none. By hand."""

_USUAL_DOMAIN = 8.0
"""px, of windows of 41 px; smaller ones are asked for as much, if they hold such a disc."""


def check_side(window: int) -> int:
    """Return the side of windows, in px, after a check of it."""
    if not isinstance(window, (int, np.integer)) or window % 2 == 0 or window < MIN_WINDOW:
        raise ValueError(f"window is {window}; it takes an odd number of px from {MIN_WINDOW} up")
    return int(window)


def domain_of_window(window: int) -> float:
    """Return the largest scale, in px, that windows can tell with ease: 8 px of 41."""
    return 0.2 * (40 * window // 41)


def within_window(psf: PSFFamily | Callable[[float], ArrayLike], window: int) -> PSFFamily:
    """Return the PSF family; with a smaller domain, if windows, of a side in px, are too small."""
    family, domain = as_family(psf), domain_of_window(check_side(window))
    if 2 * family.max_scale <= window:
        return family
    return limited(family, max(domain, min(_USUAL_DOMAIN, window / 2)))


def log_blur_spectra(
    psf: PSFFamily,
    scales: Float64,
    window: int,
    row_fraction: float,
    column_fraction: float,
    softness: float = 0.0,
) -> Float64:
    """Evaluate the logarithm of (6) for every scale: (len(scales), 2, F).

    `softness` is the standard deviation, in px, of a Gaussian that blurs every kernel.
    """
    kernels = [psf.kernel(float(scale)) for scale in scales]
    largest = max(len(kernel) for kernel in kernels)
    filters = FilterPower.of_window(window, row_fraction, column_fraction, largest)
    return np.log(filters.blur_spectra(kernels, softness, growth_of_details(psf)))


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

    def blur_spectra(
        self, kernels: Sequence[Float64], softness: float = 0.0, growth: float = 0.0
    ) -> Float64:
        """Evaluate (6), sum |h * t_i|^2, by Parseval's theorem, for both gradients: (n, 2, F).

        h is a kernel behind a Gaussian of the standard deviation `softness`, in px, for a scene
        whose gradients grow with so many powers of the frequency.
        """
        size = self.rows.shape[2]
        along = np.exp(-((softness * 2 * np.pi * fftfreq(size)) ** 2))
        gaussian = np.outer(along, along)
        if growth:
            frequency = np.hypot(*np.meshgrid(*2 * [2 * np.sin(np.pi * fftfreq(size))]))
            gaussian *= np.maximum(frequency, _LEAST_FREQUENCY) ** (2 * growth)
        spectra = np.empty((len(kernels), 2, self.rows.shape[1], self.columns.shape[1]))
        for spectrum, kernel in zip(spectra, kernels, strict=True):
            power = np.abs(fft2(kernel, (size, size))) ** 2 * gaussian
            by_row = np.einsum("dri,ij->drj", self.rows, power)
            spectrum[:] = np.einsum("drj,dcj->drc", by_row, self.columns)
        return spectra[:, :, self.row_of_filter, self.column_of_filter] / size**2


def _axis_power(filters: AxisFilters, cycles: NDArray[np.int64], size: int) -> Float64:
    """Return |T|^2 of the 1-D complex filter of each (signed) number of cycles a window."""
    k = np.abs(cycles) // 2
    sine = np.where(k == 0, 0.0, filters.taps[:, filters.order + np.maximum(k, 1)])
    wave = filters.taps[:, k] - 1j * np.sign(cycles) * sine
    return np.abs(fft(wave.T, size)) ** 2
