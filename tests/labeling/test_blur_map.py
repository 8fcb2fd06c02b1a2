"""The blur map, against blur that is known."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from skimage import data

from napari_defocus import (
    BlurCandidates,
    Cancelled,
    Disc,
    estimate_blur_map,
    estimate_candidates,
    explain_pixel,
    label_blur_map,
    labeling_energy,
    simulate_layered_defocus,
)
from napari_defocus.labeling.data_term import KAPPA, artificial_likelihood, data_term
from napari_defocus.labeling.pairwise_term import Blocks
from napari_defocus.likelihood.evidence import DEPTH
from napari_defocus.likelihood.prior import log_prior

TEXTURES = pytest.mark.parametrize("texture", ["grass", "gravel", "clouds"])


@pytest.fixture(scope="module")
def ramp_map(ramp_picture):
    return estimate_blur_map(ramp_picture)


@TEXTURES
@pytest.mark.parametrize("radius", [3, 5, 7])
def test_uniform_blur_is_mapped_to_a_tenth_of_a_pixel(request, defocused, texture, radius):
    picture = defocused(request.getfixturevalue(texture), radius)
    blur_map = estimate_blur_map(picture)
    assert blur_map.shape == (160, 160)
    assert blur_map.dtype == np.float32
    assert np.abs(blur_map - radius).mean() < 0.1


@TEXTURES
def test_blur_of_1_5_px_is_mapped_where_the_noise_is_known(request, defocused, texture):
    # Where it is not, a texture that is nearly sharp everywhere passes for noise: the error is
    # 0.2 to 0.6 px.
    picture = defocused(request.getfixturevalue(texture), 1.5)
    blur_map = estimate_blur_map(picture, noise_variance=1e-6, camera_softness=0)
    assert np.abs(blur_map - 1.5).mean() < 0.15


@pytest.mark.parametrize("radius", [3, 5, 7])
def test_flat_places_take_their_blur_from_textured_ones(astronaut, defocused, radius):
    assert np.abs(estimate_blur_map(defocused(astronaut, radius)) - radius).mean() < 0.1


def test_leaf_of_4_5_px_is_not_swallowed_by_its_ground_of_20_px():
    # Its outline is blurred, too: between neighbouring pixels there is hardly a step.
    green = np.array([0.5, 0.9, 0.4])
    row, column = np.indices((400, 500))
    along = 0.8 * (row - 200) - 0.6 * (column - 250)
    across = 0.6 * (row - 200) + 0.8 * (column - 250)
    leaf = (np.abs(across) < 40) & (np.abs(along) < 120)
    inside = (0.4 + 0.4 * data.gravel()[:400, :500, None] / 255) * green
    ground = np.hstack([data.astronaut()] * 2)[:400, :500] / 510
    seen, _ = simulate_layered_defocus(
        np.where(leaf[..., None], inside, ground),
        np.where(leaf, 0.0, 1.0),
        np.where(leaf, 4.5, 20.0),
        noise_variance=1e-5,
        rng=0,
    )
    blur_map = estimate_blur_map(seen)
    assert abs(np.median(blur_map[leaf]) - 4.5) < 0.5
    assert abs(np.median(blur_map[~leaf]) - 20) < 2


@TEXTURES
@pytest.mark.parametrize("direction", ["right", "left", "down"])
def test_gentle_ramp_is_mapped_to_a_tenth_of_a_pixel(request, defocused, ramp, texture, direction):
    radius = {"right": ramp, "left": ramp[:, ::-1], "down": ramp.T}[direction]
    error = np.abs(estimate_blur_map(defocused(request.getfixturevalue(texture), radius)) - radius)
    assert error.mean() < 0.1
    # Within half a window of the border, windows are moved inside.
    assert error[20:-20, 20:-20].mean() < 0.075


@TEXTURES
def test_gentle_ramp_has_no_stairs(request, defocused, ramp, texture):
    blur_map = estimate_blur_map(defocused(request.getfixturevalue(texture), ramp))
    # Labels are 0.1 px apart, windows 4 px: three labels between neighbouring windows are
    # 0.075 px a pixel. The ramp itself rises by 0.0126.
    assert np.abs(np.diff(blur_map, axis=1)).max() < 0.08
    assert np.abs(np.diff(blur_map, axis=0)).max() < 0.08


@pytest.mark.parametrize(("blurred", "least"), [("background", 0.65), ("subject", 0.45)])
def test_what_is_sharp_is_found_but_too_large(scene, blurred, least):
    picture, inside = scene(blurred)
    sharp = estimate_blur_map(picture) < 2.5
    found = sharp if blurred == "background" else ~sharp
    # A window that sees anything sharp takes it for all that it sees: the sharp side reaches
    # some 15 px too far, where a boundary follows colours over 6 px.
    assert (found & inside).sum() / (found | inside).sum() > least


@pytest.mark.parametrize("mode", ["curve", "paper"])
def test_flipped_and_transposed_pictures_have_the_flipped_map(ramp_picture, mode):
    upright = estimate_blur_map(ramp_picture, mode=mode)
    for turn in (np.flipud, np.fliplr, np.transpose):
        turned = estimate_blur_map(turn(ramp_picture), mode=mode)
        assert np.abs(turned - turn(upright)).mean() < 0.02


def test_half_the_exposure_has_the_same_map(ramp_picture, ramp_map):
    # Differences of colour are halved as well, and with them what an edge is.
    assert np.abs(estimate_blur_map(ramp_picture * np.float32(0.5)) - ramp_map).mean() < 0.05


def test_grey_given_as_colour_has_the_map_of_grey(ramp_picture):
    # Three equal channels are sqrt(3) as far apart in colour as one.
    grey = estimate_blur_map(ramp_picture, color_sigma=0.1)
    colour = estimate_blur_map(np.dstack([ramp_picture] * 3), color_sigma=0.1 * np.sqrt(3))
    assert np.abs(grey - colour).mean() < 0.002


def test_8_bits_have_the_map_of_floats(clouds, ramp, defocused):
    eight_bits = np.clip(np.rint(255 * defocused(clouds, ramp, 1e-5)), 0, 255).astype(np.uint8)
    expected = estimate_blur_map(eight_bits / 255.0)
    assert np.abs(estimate_blur_map(eight_bits) - expected).mean() < 0.002
    sixteen_bits = eight_bits.astype(np.uint16) * 257
    assert np.abs(estimate_blur_map(sixteen_bits) - expected).mean() < 0.002
    again = estimate_blur_map(eight_bits.astype(np.uint16), intensity_range=(0, 255))
    assert np.abs(again - expected).mean() < 0.002


def test_rounding_to_8_bits_changes_the_map_little(ramp_picture, ramp_map):
    rounded = np.clip(np.rint(255 * ramp_picture), 0, 255).astype(np.uint8)
    assert np.abs(estimate_blur_map(rounded) - ramp_map).mean() < 0.05


def test_two_steps_are_the_one_call(ramp_picture, ramp_map):
    candidates = estimate_candidates(ramp_picture)
    np.testing.assert_array_equal(label_blur_map(candidates, ramp_picture), ramp_map)


def test_same_picture_has_the_same_map(ramp_picture, ramp_map):
    np.testing.assert_array_equal(estimate_blur_map(ramp_picture), ramp_map)


def test_every_pixel_as_a_window_has_the_map_of_every_fourth(ramp_picture, ramp_map):
    every = estimate_blur_map(ramp_picture, stride=1)
    assert np.abs(every - ramp_map).mean() < 0.03


@pytest.mark.parametrize("mode", ["curve", "paper"])
@pytest.mark.parametrize("picture", [np.full((70, 90), 0.4), np.zeros((3, 3)), np.eye(12)])
def test_map_of_a_picture_without_texture_is_finite(picture, mode):
    blur_map = estimate_blur_map(picture, mode=mode)
    assert blur_map.shape == picture.shape
    assert np.isfinite(blur_map).all()
    assert ((blur_map >= 0) & (blur_map <= 8)).all()


def test_map_of_a_transparent_part_is_finite(clouds, defocused):
    rgba = np.dstack([defocused(clouds, 3)] * 3 + [np.ones_like(clouds)])
    rgba[20:90, 60:, 3] = 0
    for mode in ("curve", "paper"):
        blur_map = estimate_blur_map(rgba, mode=mode)
        assert np.isfinite(blur_map).all()
        assert np.abs(blur_map - 3)[rgba[..., 3] > 0].mean() < 0.1


def test_smoothness_0_leaves_every_window_its_best_label(clouds, defocused):
    picture = defocused(clouds[:81, :81], 5)
    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture, smoothness=0.0)
    best = candidates.scales[candidates.curve.argmax(axis=2)]
    # Away from jumps the map goes through the labels of the windows.
    at_windows = blur_map[::4, ::4]
    assert np.mean(np.abs(at_windows - best) < 0.11) > 0.9


def test_more_smoothness_bends_less(ramp_picture):
    candidates = estimate_candidates(ramp_picture)
    maps = [
        label_blur_map(candidates, ramp_picture, smoothness=smoothness)
        for smoothness in (2.0, 20.0, 200.0, 2e5)
    ]
    bends = [np.abs(np.diff(blur_map[::4, ::4], 2)).sum() for blur_map in maps]
    assert bends == sorted(bends, reverse=True)
    assert bends[-1] < 0.1 * bends[1]


def test_ramp_has_no_steps(ramp_picture, ramp_map, ramp):
    # A staircase of labels 0.1 px apart has slopes 0 and, over the 4 px of a block, 0.025.
    slope = np.diff(ramp_map, axis=1)[20:-20, 20:-20]
    assert np.quantile(slope, 0.02) > 0.2 * 2 / 160
    assert np.quantile(slope, 0.98) < 2 * 2 / 160
    paper = estimate_blur_map(ramp_picture, mode="paper")
    assert np.abs(ramp_map - ramp).mean() < 0.8 * np.abs(paper - ramp).mean()


@pytest.mark.parametrize("function", [label_blur_map, estimate_blur_map])
@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"smoothness": -1}, "smoothness is -1"),
        ({"smoothness": np.inf}, "smoothness is inf"),
        ({"smoothness": np.nan}, "smoothness is nan"),
        ({"color_sigma": 0}, "color_sigma is 0"),
        ({"color_sigma": -0.1}, "color_sigma is -0.1"),
        ({"color_sigma": np.inf}, "color_sigma is inf"),
    ],
)
def test_bad_setting_is_a_value_error_that_names_it(function, settings, words):
    picture = np.zeros((60, 60))
    first = [estimate_candidates(picture)] if function is label_blur_map else []
    with pytest.raises(ValueError, match=words):
        function(*first, picture, **settings)


@pytest.mark.parametrize("mode", ["curve", "paper"])
def test_progress_rises_from_0_to_1(ramp_picture, mode):
    told = []
    estimate_blur_map(ramp_picture, mode=mode, progress=lambda step, done: told.append(done))
    assert told[0] == 0
    assert told[-1] == 1
    assert told == sorted(told)


@pytest.mark.parametrize("at", [0.2, 0.45, 0.6, 0.9])
def test_exception_from_progress_ends_the_work(ramp_picture, at):
    def stop(step, done):
        if done >= at:
            raise Cancelled

    with pytest.raises(Cancelled):
        estimate_blur_map(ramp_picture, progress=stop)


def candidates_of_one_window(radii, log_likelihoods):
    scales = np.arange(81) / 10
    return BlurCandidates(
        radii=np.array([[radii]], np.float32),
        log_likelihoods=np.array([[log_likelihoods]], np.float32),
        curve=np.zeros((1, 1, 81), np.float32),
        scales=scales,
        row_centers=np.array([2.0]),
        column_centers=np.array([2.0]),
        image_shape=(4, 4),
        psf=Disc(),
        noise_variance=1e-4,
        window=41,
        stride=4,
        mode="paper",
    )


def test_artificial_likelihood_is_the_scheme_of_the_paper():
    found = artificial_likelihood(
        candidates_of_one_window([3.02, 5.0, np.nan], [-100.0, -102.0, -np.inf])
    )[0, 0]
    expected = np.zeros(81)
    expected[25:36] += KAPPA
    expected[45:56] += np.exp(-2) * KAPPA
    expected = np.maximum(expected, 1e-24)
    np.testing.assert_allclose(found, expected / expected.sum(), rtol=1e-5)
    np.testing.assert_allclose(found.sum(), 1)


def test_kappa_is_cut_off_at_the_ends_of_the_domain():
    found = artificial_likelihood(
        candidates_of_one_window([0.0, 7.96, np.nan], [0.0, 0.0, -np.inf])
    )[0, 0]
    np.testing.assert_allclose(found[:6] / found[0], KAPPA[5:], rtol=1e-5)
    np.testing.assert_allclose(found[:-7:-1] / found[-1], KAPPA[5:], rtol=1e-5)


def test_data_term_of_the_paper_is_minus_the_logarithm():
    candidates = candidates_of_one_window([3.02, 5.0, np.nan], [-100.0, -102.0, -np.inf])
    cost = data_term(candidates)[0, 0]
    np.testing.assert_allclose(cost, -np.log(artificial_likelihood(candidates))[0, 0], rtol=1e-5)
    # Half-way between candidates nothing is likely: 1e-24, but for the sum.
    np.testing.assert_allclose(cost[40], 24 * np.log(10) + np.log(1.2023 * (1 + np.exp(-2))), 0.001)


def test_data_term_of_windows_without_candidates_is_flat():
    cost = data_term(candidates_of_one_window([np.nan] * 3, [-np.inf] * 3))
    assert np.isfinite(cost).all()
    assert np.ptp(cost) == 0


def test_data_term_of_the_curve_is_limited_and_0_at_its_maximum(ramp_picture):
    candidates = estimate_candidates(ramp_picture)
    cost = data_term(candidates)
    posterior = candidates.curve + log_prior(candidates.scales)
    np.testing.assert_array_equal(cost.argmin(axis=2), posterior.argmax(axis=2))
    assert cost.min() == 0
    assert cost.max() <= DEPTH


def test_blur_map_of_an_unknown_mode_is_a_value_error():
    with pytest.raises(ValueError, match="mode is 'fast'"):
        estimate_blur_map(np.zeros((60, 60)), mode="fast")


@pytest.fixture(scope="module")
def small(clouds, defocused):
    picture = np.dstack([defocused(clouds[:45, :62], 3)] * 3)
    return picture.astype(np.float32), estimate_candidates(picture)


@pytest.mark.parametrize("mode", ["curve", "paper"])
def test_energy_is_the_sum_over_pixels_and_their_pairs(clouds, defocused, mode):
    picture = defocused(clouds[:45, :62], 3)
    candidates = estimate_candidates(picture, mode=mode)
    blur_map = np.random.default_rng(0).uniform(0, 8, (45, 62))
    labels = np.rint(10 * blur_map).astype(int)
    blocks = Blocks.around(candidates.row_centers, candidates.column_centers, (45, 62))
    at = np.meshgrid(*blocks.positions, indexing="ij")
    weight = 24 if mode == "curve" else 1
    data = weight * np.moveaxis(data_term(candidates), 2, 0)
    cost = np.stack([map_coordinates(each, at, order=1) for each in data])
    expected = np.take_along_axis(cost, labels[None], 0).sum()
    sigma = 0.2 * np.ptp(picture)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = (slice(0, 45 - down), slice(max(0, -right), 62 - max(0, right)))
        there = (slice(down, 45), slice(max(0, right), 62 + min(0, right)))
        weight = 7 * np.exp(-((picture[here] - picture[there]) ** 2) / (2 * sigma**2))
        expected += np.sum(weight * np.abs(labels[here] - labels[there]))
    found = labeling_energy(blur_map, candidates, picture, smoothness=7, color_sigma=0.2)
    assert isinstance(found, float)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_map_has_less_energy_than_others(small):
    picture, candidates = small
    blur_map = label_blur_map(candidates, picture)
    least = labeling_energy(blur_map, candidates, picture)
    noise = np.random.default_rng(0).normal(0, 0.3, blur_map.shape)
    for other in (blur_map + noise, blur_map + 1, blur_map - 1, blur_map[::-1] + 0.5 * noise):
        assert labeling_energy(other.clip(0, 8), candidates, picture) > least


def test_energy_grows_with_smoothness_unless_the_map_is_flat(small):
    picture, candidates = small
    flat, rough = np.full((45, 62), 3.0), np.tile([2.0, 4.0], (45, 31))
    energies = [
        [labeling_energy(each, candidates, picture, smoothness=20 * factor) for factor in (1, 2)]
        for each in (flat, rough)
    ]
    assert energies[0][0] == energies[0][1]
    assert energies[1][0] < energies[1][1]


@pytest.mark.parametrize(
    ("blur_map", "settings", "words"),
    [
        (np.zeros((45, 61)), {}, r"blur_map has shape \(45, 61\)"),
        (np.zeros((45, 62, 1)), {}, "blur_map has shape"),
        (np.full((45, 62), 8.1), {}, "blur_map holds 8.1 to 8.1"),
        (np.full((45, 62), -0.1), {}, "from 0 to 8 px"),
        (np.full((45, 62), np.nan), {}, "blur_map has NaN"),
        (np.zeros((45, 62)), {"smoothness": -1}, "smoothness is -1"),
        (np.zeros((45, 62)), {"color_sigma": 0}, "color_sigma is 0"),
    ],
)
def test_energy_of_what_is_no_map_is_a_value_error(small, blur_map, settings, words):
    picture, candidates = small
    with pytest.raises(ValueError, match=words):
        labeling_energy(blur_map, candidates, picture, **settings)


@pytest.mark.parametrize("dtype", [complex, str, object])
def test_energy_of_what_holds_no_real_numbers_is_a_type_error(small, dtype):
    picture, candidates = small
    with pytest.raises(TypeError, match="blur_map has dtype"):
        labeling_energy(np.zeros((45, 62)).astype(dtype), candidates, picture)


def test_energy_of_another_picture_is_a_value_error(small):
    with pytest.raises(ValueError, match="these candidates are of a picture of 45 x 62 px"):
        labeling_energy(np.zeros((45, 62)), small[1], np.zeros((50, 62)))


def test_all_smoothness_leaves_one_radius():
    picture = np.random.default_rng(0).integers(0, 2**32, (3, 16, 3)).astype(">u4")
    blur_map = estimate_blur_map(picture, smoothness=1e6)
    assert np.ptp(blur_map) < 0.1


def test_old_names_of_what_is_extrapolated_work_and_warn(grass):
    candidates = estimate_candidates(grass[:60, :60])
    now = label_blur_map(candidates, grass[:60, :60], return_extrapolated=True)[1]
    with pytest.warns(FutureWarning, match="return_extrapolated"):
        then = label_blur_map(candidates, grass[:60, :60], return_carried_in=True)[1]
    np.testing.assert_array_equal(then, now)
    told = explain_pixel(candidates, 30, 30)
    with pytest.warns(FutureWarning, match="extrapolated"):
        assert told.carried_in == told.extrapolated
