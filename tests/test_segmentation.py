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


@pytest.mark.xfail(reason="what is sharp around it reaches half a window into the subject")
def test_blurred_subject_before_a_sharp_background_is_found(scene):
    picture, inside = scene(blurred="subject")
    mask = segment_in_focus(estimate_candidates(picture), picture)
    assert overlap(mask == 0, inside) > 0.85


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
    assert segment_in_focus(estimate_candidates(picture, noise_variance=1e-6), picture).min() == 1


def test_portrait_that_is_sharp_everywhere_is_all_in_focus(astronaut, defocused):
    picture = defocused(astronaut, 0)
    assert segment_in_focus(estimate_candidates(picture), picture).min() == 1


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
    with pytest.raises(ValueError, match=r"threshold is .* takes a scale from 0 to below 8 px"):
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
