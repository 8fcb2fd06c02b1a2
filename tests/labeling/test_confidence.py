"""How sure the blur map is: that it means what it says, and says nothing where nothing is seen."""

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from napari_defocus import (
    cautious_blur_map,
    confidence_map,
    estimate_candidates,
    label_blur_map,
)


def confidence_of(picture):
    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture)
    return confidence_map(candidates, blur_map), blur_map


@pytest.mark.parametrize("texture", ["grass", "gravel", "clouds"])
def test_ramp_on_texture_is_right_and_known_to_be(request, defocused, ramp, texture):
    confidence, blur_map = confidence_of(defocused(request.getfixturevalue(texture), ramp))
    right = np.abs(blur_map - ramp) <= 0.5
    assert right.mean() > 0.95
    assert 0.8 < confidence.mean() <= 1


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
def test_constant_picture_has_no_confidence(value):
    confidence, _ = confidence_of(np.full((90, 70), value))
    assert confidence.shape == (90, 70)
    assert confidence.dtype == np.float32
    assert confidence.max() < 0.15


@pytest.mark.parametrize("variance", [1e-6, 1e-4])
def test_noise_alone_has_no_confidence(variance):
    noise = np.random.default_rng(0).normal(0.5, np.sqrt(variance), (160, 160))
    confidence, _ = confidence_of(noise)
    assert np.median(confidence) < 0.2


def test_constant_region_of_a_picture_has_no_confidence(clouds, defocused):
    picture = defocused(clouds, 3, noise_variance=0)
    picture[:, 90:] = picture[:, :90].mean()
    confidence, _ = confidence_of(picture)
    assert confidence[:, 135:].max() < 0.15
    assert confidence[:, :60].mean() > 0.8


def test_picture_smaller_than_a_window_is_no_surer_than_it_is_right(clouds, grass, defocused):
    stated, right = [], []
    for sharp in (clouds, grass):
        for radius in (1, 3, 5):
            blurred = defocused(sharp, radius, noise_variance=1e-5)
            for top, left in ((20, 30), (70, 90), (110, 50), (50, 120)):
                confidence, blur_map = confidence_of(blurred[top : top + 15, left : left + 15])
                stated.append(confidence.mean())
                right.append(abs(np.median(blur_map) - radius) <= 0.5)
    assert np.mean(stated) <= np.mean(right) + 0.05
    assert max(stated) < 0.8


def test_transparent_half_has_no_confidence(clouds, defocused):
    picture = defocused(clouds, 3)
    rgba = np.dstack([picture] * 3 + [np.ones_like(picture)])
    rgba[:, 80:, 3] = 0
    confidence, _ = confidence_of(rgba)
    assert confidence[:, 125:].max() < 0.15


def test_wrong_map_is_found_out(clouds, defocused):
    picture = defocused(clouds, 3)
    candidates = estimate_candidates(picture)
    right = confidence_map(candidates, np.full((160, 160), 3.0))
    wrong = confidence_map(candidates, np.full((160, 160), 5.5))
    assert right.mean() > 0.85
    assert wrong.mean() < 0.2


@pytest.mark.parametrize("texture", ["clouds", "gravel"])
def test_motion_has_little_confidence(request, texture):
    moving = uniform_filter1d(request.getfixturevalue(texture), 13, axis=1, mode="mirror")
    moving = moving + np.random.default_rng(0).normal(0, 1e-3, moving.shape)
    confidence, _ = confidence_of(moving)
    assert confidence.mean() < 0.5


def test_a_tenth_is_right_beyond_5_px(clouds, defocused):
    candidates = estimate_candidates(defocused(clouds, 6))
    at, within, beyond = (
        confidence_map(candidates, np.full(clouds.shape, radius)).mean()
        for radius in (6.0, 6.5, 7.8)
    )
    assert at > 0.8
    assert within > 0.5 > beyond


def test_jump_of_the_map_is_less_sure(scene):
    picture, inside = scene("background")
    confidence, _ = confidence_of(picture)
    row, column = np.indices(inside.shape) - 179.5
    beside = np.abs(np.hypot(row, column) - 85) < 10
    far = np.abs(np.hypot(row, column) - 85) > 40
    assert confidence[beside].mean() < confidence[far].mean() - 0.03


def test_flipped_picture_has_the_flipped_confidence(clouds, defocused):
    picture = defocused(clouds, 3)
    blur_map = np.full((160, 160), 3.0)
    upright = confidence_map(estimate_candidates(picture, noise_variance=1e-6), blur_map)
    for turn in (np.flipud, np.fliplr, np.transpose):
        turned = confidence_map(estimate_candidates(turn(picture), noise_variance=1e-6), blur_map)
        np.testing.assert_allclose(turned, turn(upright), atol=0.02)


@pytest.mark.parametrize(
    ("blur_map", "error", "words"),
    [
        (np.zeros((3, 4)), ValueError, "blur_map has shape"),
        (np.full((160, 160), np.nan), ValueError, "blur_map has NaN"),
        (np.full((160, 160), "a"), TypeError, "blur_map has dtype"),
    ],
)
def test_bad_map_is_an_error_that_names_it(clouds, blur_map, error, words):
    with pytest.raises(error, match=words):
        confidence_map(estimate_candidates(clouds), blur_map)


def test_cautious_map_is_never_above_the_map_and_keeps_what_is_sure(clouds, defocused):
    picture = defocused(clouds, 3.0)
    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture)
    safe = cautious_blur_map(candidates, blur_map)
    assert safe.dtype == np.float32
    assert (safe <= blur_map).all()
    assert np.median(blur_map - safe) < 0.1
    np.testing.assert_allclose(cautious_blur_map(candidates, blur_map, risk=1.0), blur_map)


def test_cautious_map_trusts_no_wrong_map(clouds, defocused):
    candidates = estimate_candidates(defocused(clouds, 3.0))
    wrong = np.full(clouds.shape, 6.0)
    assert np.median(cautious_blur_map(candidates, wrong)) < 3.7


def test_lower_risk_takes_less_away(clouds, defocused):
    picture = defocused(clouds, 3.0, noise_variance=1e-3)
    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture)
    safe = [cautious_blur_map(candidates, blur_map, risk=risk).mean() for risk in (0, 0.1, 0.5)]
    assert safe[0] < 0.5
    assert safe == sorted(safe)


@pytest.mark.parametrize("risk", [-0.1, 1.1, np.nan])
def test_impossible_risk_is_refused(clouds, risk):
    candidates = estimate_candidates(clouds)
    with pytest.raises(ValueError, match="risk"):
        cautious_blur_map(candidates, np.ones(clouds.shape), risk=risk)
