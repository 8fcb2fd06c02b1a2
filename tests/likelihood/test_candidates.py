"""What single windows say about the blur."""

import numpy as np
import pytest

from napari_defocus import Cancelled, Disc, ShotNoise, estimate_candidates, simulate_defocus

TEXTURES = pytest.mark.parametrize("texture", ["grass", "clouds"])
NOISE = 1e-6


@pytest.fixture(scope="module")
def blurred(clouds, defocused):
    """Blurred by 3 px, with noise of variance 1e-6, odd sides."""
    return defocused(clouds[:121, :101], 3)


@pytest.fixture(scope="module")
def candidates(blurred):
    return estimate_candidates(blurred, noise_variance=NOISE)


@TEXTURES
@pytest.mark.parametrize("radius", [1.5, 3, 5, 7])
def test_uniform_blur_of_a_texture_is_found_to_a_tenth_of_a_pixel(
    request, defocused, texture, radius
):
    picture = defocused(request.getfixturevalue(texture), radius)
    best = estimate_candidates(picture, noise_variance=NOISE, camera_softness=0).radii[..., 0]
    assert abs(np.median(best) - radius) < 0.1


@TEXTURES
@pytest.mark.parametrize("radius", [5, 7])
def test_nearest_of_three_candidates_is_closer_than_the_best(request, defocused, texture, radius):
    picture = defocused(request.getfixturevalue(texture), radius)
    perfect = estimate_candidates(picture, noise_variance=NOISE, camera_softness=0)
    error = np.abs(perfect.radii - radius)
    assert np.nanmin(error, axis=2).mean() < 0.14
    assert np.nanmin(error, axis=2).mean() < 0.8 * error[..., 0].mean()


def test_noise_is_found_where_it_is_not_given(clouds, defocused):
    picture = defocused(clouds, 3)
    found = estimate_candidates(picture)
    assert 0 < found.noise_variance < 1e-4
    assert abs(np.median(found.radii[..., 0]) - 3) < 0.1


def test_at_most_three_candidates_best_first(defocused, grass):
    found = estimate_candidates(defocused(grass, 2), psf=Disc(3), noise_variance=NOISE)
    radii, heights = found.radii, found.log_likelihoods
    assert radii.shape == heights.shape == (40, 40, 3)
    missing = np.isnan(radii)
    assert missing.any()
    np.testing.assert_array_equal(missing, np.isneginf(heights))
    assert not missing[..., 0].any()
    assert (heights[..., :-1] >= heights[..., 1:]).all()
    assert (missing[..., 1:] >= missing[..., :-1]).all()
    assert ((radii >= 0) & (radii <= 3))[~missing].all()


def test_candidates_tell_what_made_them(candidates):
    assert candidates.image_shape == (121, 101)
    assert candidates.psf == Disc(8.0)
    assert candidates.noise_variance == NOISE
    assert (candidates.window, candidates.stride) == (41, 4)
    assert candidates.curve.shape == (31, 26, 81)
    np.testing.assert_allclose(candidates.scales, np.arange(81) / 10)
    assert candidates.row_centers[0] == 0
    assert candidates.row_centers[-1] == 120


def test_curve_at_a_pixel_has_its_maximum_at_the_best_candidate(candidates):
    for row, column in ((60, 50), (0, 0), (120, 100), (33.4, 71)):
        scales, curve = candidates.log_likelihood_at(row, column)
        i = np.argmin(np.abs(candidates.row_centers - row))
        j = np.argmin(np.abs(candidates.column_centers - column))
        assert abs(scales[np.argmax(curve)] - candidates.radii[i, j, 0]) < 0.101
        assert candidates.log_likelihoods[i, j, 0] >= curve.max() - 0.01


@pytest.mark.parametrize("place", [(-1, 0), (0, 101), (121, 0), (np.nan, 0)])
def test_curve_outside_the_picture_is_a_value_error(candidates, place):
    with pytest.raises(ValueError, match="takes a place in the picture of 121 x 101 px"):
        candidates.log_likelihood_at(*place)


@pytest.mark.parametrize("mode", ["curve", "paper"])
def test_windows_of_stride_4_are_those_of_stride_1(blurred, mode):
    # 81 and 61 are odd: the windows of both strides stand on whole pixels.
    picture = blurred[:81, :61]
    every = estimate_candidates(picture, noise_variance=NOISE, mode=mode, stride=1)
    fourth = estimate_candidates(picture, noise_variance=NOISE, mode=mode, stride=4)
    np.testing.assert_array_equal(every.row_centers[::4], fourth.row_centers)
    np.testing.assert_array_equal(every.column_centers[::4], fourth.column_centers)
    np.testing.assert_allclose(every.curve[::4, ::4], fourth.curve, rtol=1e-3, atol=0.01)
    same = np.isclose(every.radii[::4, ::4], fourth.radii, atol=0.002, equal_nan=True)
    assert same.mean() > 0.99


def test_paper_mode_is_the_plain_likelihood_and_curve_mode_says_less(blurred):
    plain = estimate_candidates(blurred, noise_variance=NOISE, mode="paper")
    quasi = estimate_candidates(blurred, noise_variance=NOISE, mode="curve")
    assert (np.ptp(quasi.curve, axis=2) <= np.ptp(plain.curve, axis=2) * 1.001).all()


def test_fitted_spectra_find_the_same_blur(blurred, candidates):
    fitted = estimate_candidates(blurred, noise_variance=NOISE, spectra="fitted")
    assert abs(np.median(fitted.radii[..., 0]) - 3) < 0.15


def _turns(picture):
    yield picture[::-1], lambda values: values[::-1]
    yield picture[:, ::-1], lambda values: values[:, ::-1]
    yield picture.T, lambda values: values.swapaxes(0, 1)


@pytest.mark.parametrize("side", [120, 121])
def test_flipped_and_transposed_pictures_have_the_flipped_candidates(clouds, defocused, side):
    picture = defocused(clouds[:side, :100], np.linspace(1, 6, 100))
    upright = estimate_candidates(picture, noise_variance=NOISE)
    for turned, turn in _turns(picture):
        found = estimate_candidates(turned, noise_variance=NOISE)
        depth, expected = (
            curve.max(axis=2, keepdims=True) - curve for curve in (found.curve, turn(upright.curve))
        )
        np.testing.assert_allclose(
            np.minimum(depth, 15), np.minimum(expected, 15), rtol=0, atol=0.05
        )
        same = np.isclose(found.radii, turn(upright.radii), atol=0.005, equal_nan=True)
        assert same.mean() > 0.99


def test_half_the_exposure_has_the_same_radii(blurred):
    full, half = estimate_candidates(blurred), estimate_candidates(blurred * np.float32(0.5))
    same = np.isclose(full.radii, half.radii, atol=0.005, equal_nan=True)
    assert same.mean() > 0.99
    np.testing.assert_allclose(half.noise_variance, full.noise_variance / 4, rtol=1e-3)


def test_brighter_picture_has_the_same_radii(blurred):
    brighter = estimate_candidates(blurred + np.float32(0.25), noise_variance=NOISE)
    plain = estimate_candidates(blurred, noise_variance=NOISE)
    assert np.isclose(brighter.radii, plain.radii, atol=0.01, equal_nan=True).mean() > 0.99


def test_transparent_half_carries_no_evidence(clouds, defocused):
    picture = defocused(clouds, 3)
    rgba = np.dstack([picture] * 3 + [np.ones_like(picture)])
    rgba[:, 80:, :3] = np.random.default_rng(0).uniform(size=(160, 80, 3))
    rgba[:, 80:, 3] = 0
    found = estimate_candidates(rgba, noise_variance=NOISE)
    deep = found.column_centers > 80 + 20
    assert np.isnan(found.radii[:, deep]).all()
    assert np.isneginf(found.log_likelihoods[:, deep]).all()
    assert np.ptp(found.curve[:, deep]) == 0
    opaque = found.column_centers < 80
    assert abs(np.median(found.radii[:, opaque, 0]) - 3) < 0.1


def test_what_is_under_transparent_pixels_does_not_matter(clouds, defocused):
    picture = defocused(clouds, 3)
    curves = []
    for hidden in (0.0, 1.0):
        rgba = np.dstack([picture] * 3 + [np.ones_like(picture)])
        rgba[40:90, 50:, :3] = hidden
        rgba[40:90, 50:, 3] = 0
        curves.append(estimate_candidates(rgba, noise_variance=NOISE).curve)
    np.testing.assert_array_equal(*curves)


def test_fully_transparent_picture_is_no_error():
    found = estimate_candidates(np.zeros((150, 150, 4)))
    assert np.isnan(found.radii).all()
    assert np.ptp(found.curve) == 0


@pytest.mark.parametrize("mode", ["curve", "paper"])
def test_constant_picture_likes_all_radii_alike(mode):
    found = estimate_candidates(np.full((70, 90), 0.3), mode=mode)
    assert np.ptp(found.curve, axis=2).max() < 0.01
    assert np.isfinite(found.curve).all()


@pytest.mark.parametrize("shape", [(3, 3), (3, 90), (12, 7), (41, 42)])
def test_picture_smaller_than_a_window_has_finite_curves(shape):
    picture = np.random.default_rng(0).uniform(size=shape)
    found = estimate_candidates(picture)
    assert found.curve.shape[:2] == (-(-shape[0] // 4), -(-shape[1] // 4))
    assert np.isfinite(found.curve).all()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"noise_variance": -1e-6}, "noise_variance is"),
        ({"noise_variance": np.nan}, "noise_variance is"),
        ({"noise_variance": np.inf}, "noise_variance is"),
        ({"noise_variance": 1e300}, "noise_variance is"),
        ({"window": 40}, "window is 40"),
        ({"window": 15}, "window is 15"),
        ({"window": 41.5}, "window is 41.5"),
        ({"window": np.nan}, "window is nan"),
        ({"window": np.inf}, "window is inf"),
        ({"stride": 0}, "stride is 0"),
        ({"stride": 42}, "stride is 42"),
        ({"stride": -1}, "stride is -1"),
        ({"stride": 1.5}, "stride is 1.5"),
        ({"stride": np.nan}, "stride is nan"),
        ({"mode": "fast"}, "mode is 'fast'"),
        ({"spectra": "rough"}, "spectra is 'rough'"),
        ({"search": "long"}, "search is 'long'"),
        ({"linearize": "gamma"}, "linearize is 'gamma'"),
        ({"psf": Disc(8), "window": 15}, "window is 15"),
    ],
)
def test_bad_setting_is_a_value_error_that_names_it(settings, words):
    with pytest.raises(ValueError, match=words):
        estimate_candidates(np.zeros((60, 60)), **settings)


@pytest.mark.parametrize("mode", ["curve", "paper"])
def test_noise_is_not_below_what_single_precision_rounds_away(gravel, mode):
    picture = simulate_defocus(gravel[:60, :60], np.full((60, 60), 2.0))
    large = estimate_candidates(9e8 * picture.astype(float), noise_variance=0, mode=mode)
    assert large.noise_variance == 0
    rounding = estimate_candidates(picture, noise_variance=1.4e-14, mode=mode)
    best = large.radii[3:-3, 3:-3, 0]
    np.testing.assert_allclose(best, rounding.radii[3:-3, 3:-3, 0], atol=0.1)
    np.testing.assert_allclose(np.median(best), 2, atol=0.1)


@pytest.mark.parametrize("psf", [None, 3.0, "disc", Disc])
def test_psf_that_is_no_family_is_a_type_error(psf):
    with pytest.raises(TypeError, match=r"psf is .* takes a PSF family"):
        estimate_candidates(np.zeros((60, 60)), psf=psf)


@pytest.mark.parametrize("setting", ["window", "stride"])
def test_numbers_of_pixels_are_integers(blurred, setting):
    with pytest.raises(ValueError, match=f"{setting} is 41.0"):
        estimate_candidates(blurred, **{setting: 41.0})


def test_progress_rises_from_0_to_1(blurred):
    told = []
    estimate_candidates(blurred, progress=lambda step, done: told.append((step, done)))
    assert all(step for step, _ in told)
    shares = [done for _, done in told]
    assert shares[0] == 0
    assert shares[-1] == 1
    assert shares == sorted(shares)


def test_exception_from_progress_ends_the_work(blurred):
    def stop(step, done):
        if done > 0:
            raise Cancelled

    with pytest.raises(Cancelled):
        estimate_candidates(blurred, progress=stop)


def test_memory_layout_of_the_picture_does_not_matter(blurred, candidates):
    locked = blurred.copy()
    locked.setflags(write=False)
    spaced = np.zeros((242, 303), np.float32)
    spaced[::2, ::3] = blurred
    swapped = blurred.astype(blurred.dtype.newbyteorder())
    layouts = [np.asfortranarray(blurred), locked, spaced[::2, ::3], swapped, blurred.tolist()]
    for layout in layouts:
        found = estimate_candidates(layout, noise_variance=NOISE)
        np.testing.assert_array_equal(found.curve, candidates.curve)


def test_order_of_a_colour_picture_in_memory_does_not_matter(astronaut):
    expected = estimate_candidates(astronaut[:60, :70], noise_variance=NOISE)
    found = estimate_candidates(np.asfortranarray(astronaut[:60, :70]), noise_variance=NOISE)
    np.testing.assert_array_equal(found.curve, expected.curve)


def test_dask_array_is_a_picture(blurred, candidates):
    dask_array = pytest.importorskip("dask.array")
    lazy = dask_array.from_array(blurred, chunks=40)
    found = estimate_candidates(lazy, noise_variance=NOISE)
    np.testing.assert_array_equal(found.curve, candidates.curve)


def test_picture_is_left_as_it_was(blurred):
    picture = blurred.copy()
    estimate_candidates(picture, noise_variance=NOISE)
    np.testing.assert_array_equal(picture, blurred)


def test_larger_domain_finds_larger_blur(clouds):
    picture = simulate_defocus(clouds, np.full((160, 160), 8.5), psf=Disc(10))
    found = estimate_candidates(picture, psf=Disc(10), noise_variance=NOISE)
    assert abs(np.median(found.radii[..., 0]) - 8.5) < 0.1


@pytest.mark.parametrize("shape", [(121, 101), (30, 100), (3, 3)])
def test_places_that_share_a_window_are_counted(shape):
    picture = np.random.default_rng(0).random(shape)
    found = estimate_candidates(picture, noise_variance=NOISE)
    distinct = len(np.unique(found.curve.reshape(-1, len(found.scales)), axis=0))
    assert np.sum(1 / found.places_of_window()) == pytest.approx(distinct)
    if min(shape) > 100:
        assert found.places_of_window()[12, 12] == 1


def test_noise_that_grows_with_the_intensity_is_taken_as_it_is(clouds, defocused):
    bright = np.clip(clouds + np.linspace(-0.4, 0.4, 160), 0.01, 1)
    blurred = defocused(bright, 3, 0)
    noise = ShotNoise(1e-7, 2e-3)
    spread = np.sqrt(noise.variance_at(blurred))
    noisy = blurred + np.random.default_rng(0).normal(size=blurred.shape) * spread
    errors = [
        np.abs(estimate_candidates(noisy, noise_variance=variance).radii[..., 0] - 3).mean()
        for variance in (noise, 2e-5)
    ]
    assert errors[0] < 0.8 * errors[1]
    found = estimate_candidates(noisy, noise_variance=noise)
    assert found.shot_noise == noise
    assert found.noise_variance == pytest.approx(np.mean(spread**2), rel=1e-3)


def test_constant_shot_noise_is_constant_noise(blurred, candidates):
    found = estimate_candidates(blurred, noise_variance=ShotNoise(NOISE, 0))
    np.testing.assert_allclose(found.curve, candidates.curve, atol=0.05)


def test_fixed_point_search_finds_the_same_blur(blurred, candidates):
    picture = blurred[:60, :60]
    found = estimate_candidates(picture, noise_variance=NOISE, search="fixed-point")
    fast = estimate_candidates(picture, noise_variance=NOISE)
    assert found.radii.shape == fast.radii.shape
    assert np.isclose(found.radii[..., 0], fast.radii[..., 0], atol=0.01).mean() > 0.95


def _encoded(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def test_picture_for_a_display_is_decoded_into_linear_light(clouds, defocused):
    linear = defocused(clouds, 4, 0).clip(0, 1)
    found = estimate_candidates(_encoded(linear), noise_variance=NOISE, linearize="srgb")
    plain = estimate_candidates(linear, noise_variance=NOISE)
    same = np.isclose(found.radii[..., 0], plain.radii[..., 0], atol=0.02)
    assert same.mean() > 0.97


def test_function_is_a_psf_family(blurred, candidates):
    found = estimate_candidates(blurred, psf=Disc(8.0).kernel, noise_variance=NOISE)
    np.testing.assert_allclose(found.curve, candidates.curve, atol=0.01)


@pytest.mark.parametrize(("height", "width"), [(240, 260), (239, 262)])
def test_part_of_a_picture_has_exactly_its_candidates(clouds, defocused, height, width):
    blurred = defocused(np.pad(clouds, 60, mode="reflect")[:height, :width], 3)
    picture = np.stack([blurred, blurred[::-1], np.flip(blurred)], axis=2)
    one_level = {"psf": Disc(8.0), "noise_variance": NOISE}
    whole = estimate_candidates(picture, **one_level)
    stop = (180 - -height % 4, 200 - -width % 4)
    part = estimate_candidates(picture[12 : stop[0], 32 : stop[1]], **one_level)
    inside = slice(7, -7)  # of windows that are not moved from a border
    of_whole = np.s_[3 + 7 : 45 - 7, 8 + 7 : 50 - 7]
    for name in ("curve", "radii", "log_likelihoods"):
        np.testing.assert_array_equal(
            getattr(part, name)[inside, inside], getattr(whole, name)[of_whole], err_msg=name
        )
