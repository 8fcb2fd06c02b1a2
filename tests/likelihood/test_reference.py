"""The paper's own search, the likelihood without tables, and the fast path against both."""

import numpy as np
import pytest

from napari_defocus import Disc, simulate_defocus
from napari_defocus.core.image import prepare_image
from napari_defocus.likelihood.blur_spectra import label_scales, spectrum_table
from napari_defocus.likelihood.gabor import gradients, local_power
from napari_defocus.likelihood.maxima import local_maxima
from napari_defocus.likelihood.profile_likelihood import (
    noise_power,
    profile_log_likelihood,
    quasi_log_likelihood,
)
from napari_defocus.likelihood.reference import exact_log_likelihood, fixed_point_maxima
from napari_defocus.psf.families import Gaussian

WINDOW = 41
DISCS = [
    (texture, radius, noise)
    for texture in ("grass", "clouds", "astronaut")
    for radius, noise in ((1.5, 1e-5), (3.0, 1e-4), (5.0, 1e-6), (7.0, 1e-5))
]
GAUSSIANS = [("clouds", 1.6, 1e-5), ("grass", 3.0, 1e-6), ("astronaut", 5.0, 1e-4)]


def table_of(psf):
    return spectrum_table(psf, WINDOW, 0.0, 0.0, "exact")


@pytest.fixture
def windows(request):
    """Make the powers of 64 windows of a picture blurred by one scale: (64, 2, 60)."""

    def powers(texture, scale, noise_variance, psf=Disc(8.0)):
        picture = request.getfixturevalue(texture)
        blur_map = np.full(picture.shape[:2], scale)
        blurred = simulate_defocus(picture, blur_map, psf=psf, noise_variance=noise_variance, rng=0)
        centers = np.arange(22.0, 137.0, 16.0)
        gradient = gradients(prepare_image(blurred).luminance, None, WINDOW)
        return local_power(gradient, centers, centers, WINDOW).reshape(-1, 2, 60)

    return powers


def fast_maxima(power, psf, noise_variance):
    scales = label_scales(psf)
    curve = profile_log_likelihood(power, table_of(psf), scales, noise_variance)
    ones = np.ones(power.shape[:2], np.float32)
    return local_maxima(power, curve, table_of(psf), scales, noise_variance, ones)


def reference_maxima(power, psf, noise_variance):
    return fixed_point_maxima(power, table_of(psf), noise_variance)


@pytest.mark.parametrize("fraction", [(0.0, 0.0), (0.5, 0.5), (0.0, 0.5)])
@pytest.mark.parametrize("psf", [Disc(3), Gaussian(4)], ids=repr)
def test_exact_likelihood_is_that_of_the_tables_at_their_scales(windows, fraction, psf):
    power = windows("clouds", 1.5, 1e-5)[::8]
    scales = label_scales(psf)[::3]
    exact = exact_log_likelihood(power, psf, WINDOW, *fraction, scales, 1e-5)
    table = spectrum_table(psf, WINDOW, *fraction, "exact")
    curve = profile_log_likelihood(power, table, scales, 1e-5)
    near = exact > exact.max(axis=1, keepdims=True) - 15
    np.testing.assert_allclose(curve[near], exact[near], rtol=0, atol=0.01)


@pytest.mark.parametrize("scale", [0.0, 2.5, 4.0, 8.0])
def test_no_strength_beats_those_of_the_exact_likelihood(windows, scale):
    power = windows("astronaut", 3.0, 1e-5)[::4]
    exact = exact_log_likelihood(power, Disc(8.0), WINDOW, 0.0, 0.0, np.array([scale]), 1e-5)[:, 0]
    table = table_of(Disc(8.0))
    strength = np.concatenate([[0], np.geomspace(1e-9, 10, 1500)])[:, None, None]
    variance = strength * table.at(np.array([scale])) + noise_power(table, 1e-5)
    tried = -np.einsum("pdf,sdf->psd", power, 1 / variance) - np.log(variance).sum(axis=2)
    np.testing.assert_allclose(exact, tried.max(axis=1).sum(axis=1), rtol=0, atol=0.01)


def test_fast_path_finds_what_the_paper_s_search_finds(windows):
    best_agree, found = [], []
    for case in DISCS:
        power, noise = windows(*case), case[2]
        radii, heights = fast_maxima(power, Disc(8.0), noise)
        expected, expected_heights = reference_maxima(power, Disc(8.0), noise)
        best_agree.append(np.abs(radii[:, 0] - expected[:, 0]) < 0.01)
        close = np.abs(radii[:, None] - expected[..., None]) < 0.01
        with np.errstate(invalid="ignore"):
            close &= np.abs(heights[:, None] - expected_heights[..., None]) < 0.02
        below_third = expected_heights < heights[:, 2:] + 0.02
        found.append((close.any(axis=2) | below_third)[np.isfinite(expected)])
    assert np.mean(best_agree) > 0.99
    # Of two maxima less than 0.2 px apart, a lattice of 0.1 px may show one.
    assert np.concatenate(found).mean() > 0.97


@pytest.mark.parametrize("maxima", [fast_maxima, reference_maxima])
@pytest.mark.parametrize(
    ("psf", "cases"), [(Disc(8.0), DISCS), (Gaussian(8.0), GAUSSIANS)], ids=["disc", "gaussian"]
)
def test_maxima_are_those_of_the_exact_likelihood(windows, psf, cases, maxima):
    within, error = [], []
    for case in cases:
        power = windows(*case, psf)[:: 4 * len(cases) // 3]
        for window, scales, heights in zip(power, *maxima(power, psf, case[2]), strict=True):
            # Up to 0.5 px all discs are the same point.
            for scale, height in zip(scales, heights, strict=True):
                if scale > 0.51:
                    around = np.clip(scale + np.array([-0.005, 0, 0.005]), 0, psf.max_scale)
                    exact = exact_log_likelihood(
                        window[None], psf, WINDOW, 0.0, 0.0, around, case[2]
                    )[0]
                    within.append(exact[1] >= exact.max())
                    error.append(abs(height - exact[1]))
    assert len(within) > 75
    # If the likelihood is lower 0.005 px to either side, it has a maximum in between.
    assert np.mean(within) >= 0.99
    assert np.mean(np.array(error) < 0.01) >= 0.99


def test_dispersion_weighs_the_gradients_as_on_the_fast_path(windows):
    power, scales = windows("astronaut", 3.0, 1e-5), label_scales(Disc(8.0))
    curve, dispersion = quasi_log_likelihood(power, table_of(Disc(8.0)), scales, 1e-5)
    fast, heights = local_maxima(power, curve, table_of(Disc(8.0)), scales, 1e-5, dispersion)
    radii, expected = fixed_point_maxima(power, table_of(Disc(8.0)), 1e-5, dispersion)
    same = np.abs(fast[:, 0] - radii[:, 0]) < 0.01
    assert same.mean() > 0.95
    np.testing.assert_allclose(heights[same, 0], expected[same, 0], rtol=0, atol=0.02)


def test_at_most_three_distinct_maxima_best_first(windows):
    power = windows("astronaut", 7.0, 1e-4)
    radii, heights = fixed_point_maxima(power, table_of(Disc(8.0)), 1e-4)
    assert radii.shape == heights.shape == (64, 3)
    assert radii.dtype == heights.dtype == np.float32
    np.testing.assert_array_equal(np.isnan(radii), np.isneginf(heights))
    assert np.isfinite(radii[:, 0]).all()
    assert np.isnan(radii).any()
    assert (heights[:, :-1] >= heights[:, 1:]).all()
    apart = np.abs(radii[:, [0, 0, 1]] - radii[:, [1, 2, 2]])
    assert np.nanmin(apart) >= 0.01


def test_every_start_climbs_to_a_maximum_and_the_same_ends_are_one(windows):
    power, table = windows("clouds", 5.0, 1e-6), table_of(Disc(8.0))
    radii, _ = fixed_point_maxima(power, table, 1e-6)
    near = np.array([4.95, 5.0, 5.05])
    alone, _ = fixed_point_maxima(power, table, 1e-6, starts=near)
    assert np.isnan(alone[:, 1]).mean() > 0.9
    assert (np.abs(radii - alone[:, :1]) < 1e-3).any(axis=1).mean() > 0.99


def test_window_without_any_power_is_no_error():
    radii, heights = fixed_point_maxima(np.zeros((2, 2, 60), np.float32), table_of(Disc(8.0)), 1e-5)
    assert np.isfinite(radii[:, 0]).all()
    np.testing.assert_allclose(heights[np.isfinite(radii)], heights[0, 0], rtol=0, atol=1e-3)
