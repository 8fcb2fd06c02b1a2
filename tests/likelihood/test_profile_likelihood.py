"""The profile likelihood (9) and its maxima (13), against brute force."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from napari_defocus import Disc
from napari_defocus.likelihood.blur_spectra import SpectrumTable, label_scales, spectrum_table
from napari_defocus.likelihood.maxima import local_maxima, refine_maxima
from napari_defocus.likelihood.profile_likelihood import (
    noise_power,
    profile_log_likelihood,
    quasi_log_likelihood,
)

NOISE_VARIANCE = 1e-5
SCALES = label_scales(Disc(8.0))


@pytest.fixture(scope="module")
def table():
    return spectrum_table(Disc(8.0), 41, 0.0, 0.0, "exact")


def powers_of_the_model(table, radius, strength, windows, seed=0):
    """Powers drawn from (5): exponential, of variance s sigma_i^2(r) + sigma_ni^2."""
    expected = strength * table.at(np.array([radius]))[0] + noise_power(table, NOISE_VARIANCE)
    drawn = np.random.default_rng(seed).exponential(size=(windows, *expected.shape))
    return (drawn * expected).astype(np.float32)


def brute_force(power, table, scales):
    """log p(r) of (9), the best of a dense grid of s for each gradient."""
    blur, noise = table.at(scales), noise_power(table, NOISE_VARIANCE)
    best = np.full((len(power), len(scales), 2), -np.inf)
    for strength in np.concatenate([[0.0], np.geomspace(1e-9, 1e3, 1500)]):
        variance = strength * blur + noise
        log_p = -np.einsum("pdf,rdf->prd", power, 1 / variance) - np.log(variance).sum(axis=2)
        best = np.maximum(best, log_p)
    return best.sum(axis=2)


@pytest.mark.parametrize(
    ("radius", "strength"), [(0.0, 1e-2), (1.5, 1e-3), (3.0, 1e-2), (5.0, 1e-4), (7.0, 1.0)]
)
def test_profile_likelihood_is_the_best_over_all_strengths(table, radius, strength):
    power = powers_of_the_model(table, radius, strength, 50)
    curve = profile_log_likelihood(power, table, SCALES[::4], NOISE_VARIANCE)
    best = brute_force(power, table, SCALES[::4])
    # The blur map looks at no more than 15 below the maximum. Further down the fixed point is
    # not always at its end after three rounds: up to 0.4 is missing there.
    close = best > best.max(axis=1, keepdims=True) - 15
    np.testing.assert_allclose(curve[close], best[close], rtol=0, atol=0.01)
    np.testing.assert_allclose(curve, best, rtol=0, atol=1)


@pytest.mark.parametrize("strength", [0.0, 1e-7, 1e-6, 1e-5])
def test_profile_likelihood_holds_at_the_noise_level(table, strength):
    power = powers_of_the_model(table, 3.0, strength, 50)
    curve = profile_log_likelihood(power, table, SCALES[::4], NOISE_VARIANCE)
    best = brute_force(power, table, SCALES[::4])
    # Where s is near 0 the fixed point is slow. Maxima are reached; single points beside them
    # may miss up to 1 of a log-likelihood.
    np.testing.assert_allclose(curve.max(axis=1), best.max(axis=1), rtol=0, atol=0.05)
    assert np.mean(best - curve > 0.01) < 0.05
    np.testing.assert_allclose(curve, best, rtol=0, atol=1)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3])
def test_profile_likelihood_holds_below_the_noise_level(table, share):
    power = share * powers_of_the_model(table, 3.0, 0.0, 50)
    curve = profile_log_likelihood(power, table, SCALES[::4], NOISE_VARIANCE)
    np.testing.assert_allclose(curve, brute_force(power, table, SCALES[::4]), rtol=0, atol=0.01)


def test_window_without_any_power_likes_all_scales_alike(table):
    curve = profile_log_likelihood(np.zeros((3, 2, 60), np.float32), table, SCALES, NOISE_VARIANCE)
    assert np.ptp(curve) < 0.01


def test_radius_of_powers_from_the_model_is_most_likely(table):
    for radius in (1.5, 3.0, 5.0, 7.0):
        power = powers_of_the_model(table, radius, 0.1, 200)
        curve = profile_log_likelihood(power, table, SCALES, NOISE_VARIANCE).sum(axis=0)
        assert abs(SCALES[np.argmax(curve)] - radius) < 0.11


def test_quasi_likelihood_is_the_likelihood_where_powers_follow_the_model(table):
    power = powers_of_the_model(table, 3.0, 1e-2, 300)
    curve, dispersion = quasi_log_likelihood(power, table, SCALES, NOISE_VARIANCE)
    # The mean square of 60 exponential deviations is 1 with a spread of sqrt(8 / 60) = 0.37.
    assert 1 <= np.median(dispersion) < 1.1
    assert dispersion.mean() < 1.3
    assert dispersion.min() == 1
    plain = profile_log_likelihood(power, table, SCALES, NOISE_VARIANCE)
    fits = (dispersion == 1).all(axis=1)
    assert fits.sum() > 50
    np.testing.assert_allclose(curve[fits], plain[fits], rtol=1e-6)


def test_quasi_likelihood_says_less_where_power_is_in_few_frequencies(table):
    power = powers_of_the_model(table, 3.0, 1e-2, 50)
    power[:, :, 2] = 20 * power.mean(axis=(0, 2))
    curve, dispersion = quasi_log_likelihood(power, table, SCALES, NOISE_VARIANCE)
    assert dispersion.min() > 2
    plain = profile_log_likelihood(power, table, SCALES, NOISE_VARIANCE)
    assert (np.ptp(curve, axis=1) < np.ptp(plain, axis=1) / 2).all()


def _finer(table, step):
    log_blur = CubicSpline(table.scales, np.log(table.value))
    scales = np.arange(0, table.scales[-1] + step / 2, step)
    value = np.exp(log_blur(scales))
    return SpectrumTable(scales, value, value * 0, value * 0, table.noise)


def test_refined_maxima_are_those_of_the_continuous_curve(table):
    power = np.concatenate(
        [
            powers_of_the_model(table, radius, 1e-2, 12, seed)
            for seed, radius in enumerate((1.2, 2.0, 3.33, 4.71, 6.05, 7.2))
        ]
    )
    curve = profile_log_likelihood(power, table, SCALES, NOISE_VARIANCE)
    ones = np.ones(power.shape[:2], np.float32)
    radii, _ = local_maxima(power, curve, table, SCALES, NOISE_VARIANCE, ones)
    fine = _finer(table, 0.001)
    error, checked = [], 0
    for window, radius in zip(power, radii[:, 0], strict=True):
        if not 0.7 < radius < 7.8:
            continue
        around = fine.scales[np.abs(fine.scales - radius) < 0.1]
        dense = profile_log_likelihood(window[None], fine, around, NOISE_VARIANCE)[0]
        error.append(abs(around[np.argmax(dense)] - radius))
        checked += 1
    assert checked > 60
    assert np.quantile(error, 0.99) < 0.005


def test_refinement_never_lowers_the_likelihood(table):
    power = powers_of_the_model(table, 4.0, 1e-2, 300)
    start = np.tile(np.array([1.0, 2.5, 4.0, 4.1, 7.9], np.float32), (300, 1))
    ones = np.ones(power.shape[:2], np.float32)
    radii, heights = refine_maxima(power, table, start, 0.1, NOISE_VARIANCE, ones)
    before = profile_log_likelihood(power, table, start[0].astype(float), NOISE_VARIANCE)
    # Both are sums of 120 numbers in single precision.
    assert (heights - before).min() > -0.01
    assert np.abs(radii - start).max() < 0.1 + 1e-6


def test_missing_maxima_stay_missing(table):
    power = powers_of_the_model(table, 4.0, 1e-2, 2)
    start = np.array([[np.nan, 4.0], [4.0, np.nan]], np.float32)
    ones = np.ones(power.shape[:2], np.float32)
    radii, heights = refine_maxima(power, table, start, 0.1, NOISE_VARIANCE, ones)
    np.testing.assert_array_equal(np.isnan(radii), np.isnan(start))
    np.testing.assert_array_equal(np.isneginf(heights), np.isnan(start))
