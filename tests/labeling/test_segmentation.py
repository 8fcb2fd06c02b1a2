import numpy as np
import pytest

from napari_defocus import estimate_candidates, segment_in_focus


@pytest.fixture(scope="module")
def ramp_candidates(ramp_picture):
    return estimate_candidates(ramp_picture)


def overlap(mask, truth):
    return (mask & truth).sum() / (mask | truth).sum()


def test_sharp_subject_before_a_blurred_background_is_found(scene):
    picture, inside = scene(blurred="background")
    mask = segment_in_focus(estimate_candidates(picture), picture)
    assert overlap(mask == 1, inside) > 0.95


@pytest.mark.parametrize("radius", [20, 30])
def test_small_sharp_subject_is_found(scene, radius):
    picture, inside = scene(blurred="background", radius=radius)
    mask = segment_in_focus(estimate_candidates(picture), picture)
    assert overlap(mask == 1, inside) > 0.9


def test_blurred_subject_before_a_sharp_background_is_found(scene):
    picture, inside = scene(blurred="subject")
    mask = segment_in_focus(estimate_candidates(picture), picture)
    assert overlap(mask == 0, inside) > 0.85


SWALLOWING = 1e5
"""A smoothness at which small things are lost."""


@pytest.fixture(scope="module")
def swallowed_subject(scene):
    """A small blurred disc before something sharp, which takes it in, and a stroke on it."""
    picture, inside = scene(blurred="subject", radius=30)
    row, column = np.indices(inside.shape) - 179.5
    stroke = np.abs(np.hypot(row, column) - 20) < 1
    return picture, estimate_candidates(picture), inside, stroke


def test_stroke_draws_its_surroundings_along_up_to_the_edges_of_colour(swallowed_subject):
    picture, candidates, inside, stroke = swallowed_subject
    assert segment_in_focus(candidates, picture, smoothness=SWALLOWING).min() == 1
    seeds = np.where(stroke, 2, 0)
    mask = segment_in_focus(candidates, picture, smoothness=SWALLOWING, seeds=seeds)
    assert overlap(mask == 0, inside) > 0.95


def test_stroke_draws_along_what_is_in_focus_too(scene):
    picture, inside = scene(blurred="background", radius=15)
    row, column = np.indices(inside.shape) - 179.5
    candidates = estimate_candidates(picture)
    swallowing = {"smoothness": SWALLOWING, "color_sigma": 0.2}
    assert segment_in_focus(candidates, picture, **swallowing).max() == 0
    seeds = np.where(np.abs(row + column) < 8, 1, 0) * inside
    mask = segment_in_focus(candidates, picture, **swallowing, seeds=seeds)
    assert overlap(mask == 1, inside) > 0.9


@pytest.mark.parametrize("smoothness", [0.0, 20.0, 1000.0, 1e6])
def test_seeds_hold_pixel_by_pixel_even_where_they_contradict(
    ramp_picture, ramp_candidates, smoothness
):
    seeds = np.zeros(ramp_picture.shape, np.uint8)
    seeds[80, 80] = 1
    seeds[20:60, 20:60] = 1 + np.indices((40, 40)).sum(axis=0) % 2
    seeds[100:140:7, 100:140:5] = 2
    seeds[0, :3], seeds[-1, -3:] = (1, 2, 1), (2, 1, 2)
    mask = segment_in_focus(
        ramp_candidates, ramp_picture, threshold=3, smoothness=smoothness, seeds=seeds
    )
    assert (mask[seeds == 1] == 1).all()
    assert (mask[seeds == 2] == 0).all()


def test_seeds_that_agree_or_say_nothing_change_nothing(ramp_picture, ramp_candidates):
    settings = {"threshold": 3, "smoothness": 20.0}
    plain = segment_in_focus(ramp_candidates, ramp_picture, **settings)
    for seeds in (np.zeros_like(plain), 2 - plain, (2 - plain).astype(np.int64).tolist()):
        mask = segment_in_focus(ramp_candidates, ramp_picture, seeds=seeds, **settings)
        np.testing.assert_array_equal(mask, plain)


@pytest.mark.parametrize(
    ("seeds", "error", "words"),
    [
        (np.zeros((160, 160)), TypeError, "seeds has dtype float64; it takes integers"),
        (np.zeros((160, 160), bool), TypeError, "seeds has dtype bool"),
        (np.zeros((160, 161), int), ValueError, r"seeds has shape \(160, 161\).*\(160, 160\)"),
        (np.zeros((160, 160, 3), int), ValueError, r"seeds has shape \(160, 160, 3\)"),
        (np.full((160, 160), 3), ValueError, "seeds has the value 3; it takes 0 .* 1 .* and 2"),
        (np.full((160, 160), -1), ValueError, "seeds has the value -1"),
        ([[0, 1], [2]], ValueError, "seeds is not an array"),
    ],
)
def test_bad_seeds_are_an_error_that_names_them(ramp_picture, ramp_candidates, seeds, error, words):
    with pytest.raises(error, match=words):
        segment_in_focus(ramp_candidates, ramp_picture, seeds=seeds)


@pytest.mark.parametrize("mode", ["curve", "paper"])
def test_mask_is_8_bits_of_0_and_1(ramp_picture, mode):
    candidates = estimate_candidates(ramp_picture, mode=mode)
    # The default smoothness leaves pictures as small as this one in one piece.
    mask = segment_in_focus(candidates, ramp_picture, threshold=3, smoothness=20.0)
    assert mask.dtype == np.uint8
    assert mask.shape == (160, 160)
    assert set(np.unique(mask)) == {0, 1}


@pytest.mark.parametrize("mode", ["curve", "paper"])
def test_higher_threshold_never_shrinks_what_is_in_focus(ramp_picture, mode):
    candidates = estimate_candidates(ramp_picture, mode=mode)
    shares = [
        segment_in_focus(candidates, ramp_picture, threshold=threshold).mean()
        for threshold in (0, 1, 2, 2.5, 3, 3.5, 4, 5, 7.9)
    ]
    assert shares == sorted(shares)
    assert shares[0] == 0
    assert shares[-1] == 1


def test_boundary_on_a_ramp_lies_where_the_blur_is_the_threshold(
    ramp, ramp_picture, ramp_candidates
):
    mask = segment_in_focus(ramp_candidates, ramp_picture, threshold=3, smoothness=20.0)
    assert np.mean(mask == (ramp <= 3)) > 0.93


@pytest.mark.parametrize("texture", ["grass", "gravel", "clouds", "astronaut"])
def test_picture_that_is_blurred_everywhere_has_nothing_in_focus(request, defocused, texture):
    picture = defocused(request.getfixturevalue(texture), 5)
    assert segment_in_focus(estimate_candidates(picture), picture).max() == 0


@pytest.mark.parametrize("texture", ["grass", "gravel", "clouds", "astronaut"])
def test_picture_that_is_sharp_everywhere_is_all_in_focus_at_known_noise(
    request, defocused, texture
):
    picture = defocused(request.getfixturevalue(texture), 0)
    candidates = estimate_candidates(picture, noise_variance=1e-6)
    assert (segment_in_focus(candidates, picture) == 1).mean() > 0.999


def test_portrait_that_is_sharp_everywhere_is_all_in_focus(astronaut, defocused):
    picture = defocused(astronaut, 0)
    assert (segment_in_focus(estimate_candidates(picture), picture) == 1).mean() > 0.999


@pytest.mark.parametrize("texture", ["grass", "gravel", "clouds"])
def test_texture_that_is_sharp_everywhere_is_all_in_focus(request, defocused, texture):
    picture = defocused(request.getfixturevalue(texture), 0)
    assert segment_in_focus(estimate_candidates(picture), picture).min() == 1


def test_flipped_and_transposed_pictures_have_the_flipped_mask(ramp_picture, ramp_candidates):
    upright = segment_in_focus(ramp_candidates, ramp_picture, threshold=3)
    for turn in (np.flipud, np.fliplr, np.transpose):
        turned = turn(ramp_picture)
        mask = segment_in_focus(estimate_candidates(turned), turned, threshold=3)
        assert np.mean(mask != turn(upright)) < 0.02


@pytest.mark.parametrize("threshold", [-0.1, 8, 9, np.nan, np.inf])
def test_threshold_lies_within_the_scales(ramp_picture, ramp_candidates, threshold):
    with pytest.raises(
        ValueError, match=r"threshold is .* takes a blur radius from 0 to below 8 px"
    ):
        segment_in_focus(ramp_candidates, ramp_picture, threshold=threshold)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"smoothness": -1}, "smoothness is -1"),
        ({"smoothness": np.nan}, "smoothness is nan"),
        ({"color_sigma": 0}, "color_sigma is 0"),
    ],
)
def test_bad_setting_is_a_value_error_that_names_it(ramp_picture, ramp_candidates, settings, words):
    with pytest.raises(ValueError, match=words):
        segment_in_focus(ramp_candidates, ramp_picture, **settings)


@pytest.mark.parametrize("shape", [(3, 3), (5, 60), (41, 43)])
def test_constant_and_small_pictures_have_a_mask(shape):
    picture = np.full(shape, 0.5)
    mask = segment_in_focus(estimate_candidates(picture), picture)
    assert mask.shape == shape


def test_progress_rises_to_1(ramp_picture, ramp_candidates):
    told = []
    segment_in_focus(ramp_candidates, ramp_picture, progress=lambda step, done: told.append(done))
    assert told == sorted(told)
    assert told[-1] == 1
