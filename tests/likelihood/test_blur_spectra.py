"""Blur and noise spectra, (6), (7) and (12), against convolutions written out."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import fftconvolve

from napari_defocus import Disc
from napari_defocus.likelihood.blur_spectra import label_scales, spectrum_table
from napari_defocus.likelihood.exact_spectra import within_window
from napari_defocus.likelihood.fitted_spectra import fit_log_spectra, fit_report
from napari_defocus.likelihood.gabor import frequencies, gradients, local_power
from napari_defocus.psf.families import Annulus, Gaussian, KernelFunction, Polygon
from napari_defocus.psf.measured import MeasuredPSF

FRACTIONS = pytest.mark.parametrize("fraction", [(0.0, 0.0), (0.5, 0.5), (0.0, 0.5)])


@pytest.fixture(scope="module")
def table():
    return spectrum_table(Disc(8.0), 41, 0.0, 0.0, "exact")


def filters(direction, fraction, window=41):
    """The complex filters of one gradient, (F, ...), where its differences lie."""
    offset = (0.0, 0.5) if direction == 0 else (0.5, 0.0)
    y, x = (
        np.arange(-(window // 2) + (part != half) / 2, window // 2 + 0.1)
        for part, half in zip(fraction, offset, strict=True)
    )
    envelope = np.exp(-(y[:, None] ** 2 + x**2) / (2 * (window / 4) ** 2))
    envelope /= np.sqrt(np.sum(envelope**2))
    return [
        envelope * np.exp(-2j * np.pi * (row * y[:, None] + column * x) / window)
        for row, column in frequencies(window)
    ]


@FRACTIONS
def test_point_leaves_every_power_as_it_is(fraction):
    table = spectrum_table(Disc(8.0), 41, *fraction, "exact")
    np.testing.assert_allclose(table.at(np.array([0.0, 0.2, 0.5])), 1, rtol=1e-6)


@FRACTIONS
@pytest.mark.parametrize("radius", [1.0, 3.3, 7.0])
def test_blur_spectrum_is_the_energy_of_the_blurred_filter(radius, fraction):
    at_radius = spectrum_table(Disc(8.0), 41, *fraction, "exact").at(np.array([radius]))[0]
    kernel = Disc(8.0).kernel(radius)
    for direction in (0, 1):
        energy = [np.sum(np.abs(fftconvolve(kernel, t)) ** 2) for t in filters(direction, fraction)]
        # Filters are kept in single precision.
        np.testing.assert_allclose(at_radius[direction], energy, rtol=1e-5)


@FRACTIONS
def test_noise_spectrum_is_the_energy_of_the_differentiated_filter(fraction):
    table = spectrum_table(Disc(8.0), 41, *fraction, "exact")
    for direction, difference in enumerate((np.array([[1, -1]]), np.array([[1], [-1]]))):
        energy = [
            np.sum(np.abs(fftconvolve(difference, t)) ** 2) for t in filters(direction, fraction)
        ]
        np.testing.assert_allclose(table.noise[direction], energy, rtol=1e-5)


def test_noise_spectrum_is_the_power_of_white_noise():
    noise = np.random.default_rng(0).standard_normal((400, 400)).astype(np.float32)
    centers = np.arange(25.0, 375.0, 10)
    power = local_power(gradients(noise, None, 41), centers, centers, 41)
    # 35 x 35 windows overlap: some 80 are independent, each power has a spread of 100 %.
    ratio = power.mean(axis=(0, 1)) / spectrum_table(Disc(8.0), 41, 0.0, 0.0, "exact").noise
    np.testing.assert_allclose(ratio.mean(), 1, rtol=0.03)
    np.testing.assert_allclose(ratio, 1, rtol=0.5)


@pytest.mark.parametrize("order", ["first", "second"])
def test_derivatives_agree_with_differences(table, order):
    scales = np.arange(0.6, 7.95, 0.013)
    # Between the table's scales, the values are those of a spline through their logarithms.
    log_blur = CubicSpline(table.scales, np.log(table.value))
    nearest = np.rint(scales / table.step).astype(int)
    x, h = table.scales[nearest], 1e-4
    low, middle, high = (np.exp(log_blur(x + shift)) for shift in (-h, 0, h))
    expected = {"first": (high - low) / (2 * h), "second": (high - 2 * middle + low) / h**2}
    error = np.abs(getattr(table, order)[nearest] - expected[order])
    assert error.max() < {"first": 1e-6, "second": 3e-2}[order] * np.abs(expected[order]).max()


def test_values_between_the_scales_follow_from_the_derivatives(table):
    # Half a table step, 0.01 px, is the farthest that (13) extrapolates.
    at = np.array([1.0, 2.5, 4.0, 6.0])
    index = np.rint(at / table.step).astype(int)
    taylor = table.value[index] + 0.01 * table.first[index] + 0.5 * 0.01**2 * table.second[index]
    exact = np.exp(CubicSpline(table.scales, np.log(table.value))(at + 0.01))
    np.testing.assert_allclose(taylor, exact, rtol=1e-3)


@pytest.mark.parametrize(
    "psf", [Disc(8.0), Polygon(6, max_radius=8.0), Annulus(0.5, 8.0), Disc(4.7)]
)
def test_fit_of_12_is_within_4_percent_and_half_of_it_within_3_per_mille(psf):
    exact = spectrum_table(psf, 41, 0.0, 0.0, "exact")
    fitted = spectrum_table(psf, 41, 0.0, 0.0, "fitted")
    error = np.abs(np.log(fitted.value / exact.value))
    # The narrow zeros of such spectra are what is hard to follow.
    assert np.sqrt(np.mean(error**2)) < 0.04
    assert np.median(error) < 0.003


def test_fit_of_12_begins_where_the_disc_stops_being_a_point(table):
    fitted = spectrum_table(Disc(8.0), 41, 0.0, 0.0, "fitted")
    point = table.scales <= 0.5
    np.testing.assert_array_equal(fitted.value[point], 1)
    np.testing.assert_array_equal(fitted.first[point], 0)
    assert np.abs(fitted.value[~point] - 1).min() > 0


@pytest.mark.parametrize("lowest", [0, -2])
def test_fit_of_12_finds_a_sum_of_powers_and_its_derivatives(lowest):
    powers = np.arange(lowest, 4)
    weights = np.random.default_rng(0).standard_normal((len(powers), 2, 3))
    scales, between = np.linspace(0.5, 8, 40), np.linspace(0.6, 7.9, 39)

    def log_blur(r):
        return np.tensordot(r[:, None] ** powers.astype(float), weights, 1)

    fit = fit_log_spectra(scales, log_blur(scales), between, log_blur(between))
    assert fit.lowest <= 0 <= fit.highest
    step = 1e-4
    low, middle, high = (log_blur(between + shift) for shift in (-step, 0, step))
    np.testing.assert_allclose(fit(between), middle, atol=1e-7)
    np.testing.assert_allclose(fit(between, 1), (high - low) / (2 * step), atol=1e-4)
    second = (high - 2 * middle + low) / step**2
    np.testing.assert_allclose(fit(between, 2), second, atol=1e-2)
    np.testing.assert_array_equal(fit(np.array([0.0, 0.3])), 0)


def test_report_compares_the_fit_with_the_spectra():
    report = fit_report(Gaussian(8.0))
    assert report.log_errors.shape == (len(report.scales), 2, 60)
    assert report.frequencies.shape == (60, 2)
    assert np.abs(report.frequencies).max() < 0.25
    assert report.rms < 1e-3
    assert report.maximum == np.abs(report.log_errors).max()
    lines = str(report).splitlines()
    assert lines[0].startswith(f"fit (12) with powers {report.lowest} to {report.highest}: rms")
    assert any(line.split()[:3] == ["1", "to", "2"] for line in lines)
    assert any(line.split()[:3] == ["0.1", "to", "0.15"] for line in lines)


def test_report_refuses_what_is_no_family():
    with pytest.raises(TypeError, match="psf is 8; it takes a PSF family"):
        fit_report(8)


def test_windows_are_checked_and_a_function_becomes_a_family():
    def square(side):
        inside = np.clip(side / 2 + 0.5 - np.abs(np.arange(-5, 6)), 0, 1)
        return np.outer(inside, inside)

    assert within_window(square, 41) == KernelFunction(square)
    assert within_window(Disc(8.0), 41) == Disc(8.0)
    for window in (40, 15, 41.0):
        with pytest.raises(ValueError, match=r"window is .*; it takes an odd number of px from 17"):
            within_window(Disc(8.0), window)
    assert within_window(Disc(20), 41) == Disc(20)
    assert within_window(Disc(21), 41) == Disc(8.0)


@pytest.mark.parametrize("spectra", ["exact", "fitted"])
def test_table_of_a_measured_lens_is_close_to_that_of_its_aperture(spectra):
    lens = Polygon(6, max_radius=8.0)
    kernels = [lens.kernel(scale) for scale in range(9)]
    frames = [np.pad(kernel, (19 - len(kernel)) // 2) for kernel in kernels]
    measured = spectrum_table(MeasuredPSF(range(9), frames), 41, 0.0, 0.0, spectra)
    own = spectrum_table(lens, 41, 0.0, 0.0, "exact")
    error = np.abs(np.log(measured.value / own.value))
    assert np.sqrt(np.mean(error**2)) < 0.07
    assert np.median(error) < 0.015


def test_kernels_that_are_larger_at_smaller_scales_are_seen_whole():
    def shrinking(scale):
        kernel = np.zeros((31, 31)) if scale < 1 else np.zeros((3, 3))
        kernel[[0, -1], [0, -1]] = 1
        return kernel

    table = spectrum_table(KernelFunction(shrinking, 1.0), 41, 0.0, 0.0, "exact")
    # Two points 42 px apart in a window with a standard deviation of 10 px hardly interfere.
    np.testing.assert_allclose(table.value[1:-1], 0.5, rtol=0.05)


def test_labels_are_a_tenth_of_a_pixel_apart_up_to_the_largest_radius():
    np.testing.assert_allclose(label_scales(Disc(8.0)), np.arange(81) / 10)
    np.testing.assert_allclose(label_scales(Disc(3.07)), np.arange(31) / 10)


@pytest.mark.parametrize("radius", [1.0, 2.3, 3.07, 7.77, 12.0])
def test_table_reaches_from_0_to_the_largest_radius_and_is_finite(radius):
    table = spectrum_table(Disc(radius), 41, 0.5, 0.5, "exact")
    assert table.scales[0] == 0
    assert table.scales[-1] == radius
    for values in (table.value, table.first, table.second, table.noise):
        assert np.isfinite(values).all()
    assert (table.value > 0).all()
