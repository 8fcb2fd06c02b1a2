import numpy as np
import pytest
from skimage.data import camera

from napari_defocus import (
    estimate_candidates,
    focus_threshold,
    known_places,
    segment_in_focus,
    simulate_defocus,
)
from napari_defocus.labeling.focus_threshold import threshold_of_counts

SCALES = np.concatenate([np.arange(0, 8.05, 0.1), np.arange(8.2, 16.1, 0.2)])


def counts_of(*parts):
    """Count places around some radii, each with its number of places."""
    rng = np.random.default_rng(0)
    radii = [abs(rng.normal(radius, 0.08 + 0.03 * radius, number)) for radius, number in parts]
    nearest = np.abs(SCALES - np.concatenate(radii)[:, None]).argmin(axis=1)
    return np.bincount(nearest, minlength=len(SCALES))


@pytest.fixture(scope="module")
def sharp():
    return camera()[80:340, 60:380] / 255


@pytest.mark.parametrize(("subject", "background"), [(0.5, 2.2), (0.5, 8), (1.5, 4), (2, 10)])
@pytest.mark.parametrize("share", [0.15, 0.5, 0.85])
def test_threshold_lies_between_what_is_sharp_and_what_is_not(subject, background, share):
    found = threshold_of_counts(
        counts_of((subject, round(1000 * share)), (background, round(1000 * (1 - share)))), SCALES
    )
    assert subject + 0.3 < found < background - 0.2


@pytest.mark.parametrize("radius", [0, 0.7, 1.3, 2])
def test_what_is_sharp_everywhere_is_in_focus_everywhere(radius):
    assert threshold_of_counts(counts_of((radius, 1000)), SCALES) > radius + 0.3


@pytest.mark.parametrize("radius", [3, 4, 6, 10])
def test_what_is_blurred_everywhere_is_nowhere_in_focus(radius):
    assert threshold_of_counts(counts_of((radius, 1000)), SCALES) < radius - 0.5


def test_pictures_that_say_nothing_and_the_paper_have_2_px():
    assert threshold_of_counts(np.zeros(len(SCALES), int), SCALES) == 2
    assert threshold_of_counts(counts_of((0.5, 1000)), SCALES, "paper") == 2
    assert threshold_of_counts(counts_of((0.5, 1000))[:9], SCALES[:9]) == 0.4, "half of the largest"


def test_mask_takes_the_threshold_of_its_picture(sharp):
    radii = np.where(np.arange(320) < 160, 0.5, 2.2) * np.ones((260, 1))
    picture = simulate_defocus(sharp, radii, noise_variance=1e-6, rng=0)
    candidates = estimate_candidates(picture)
    threshold = focus_threshold(candidates, picture)
    assert 1 <= threshold < 2
    mask = segment_in_focus(candidates, picture)
    np.testing.assert_array_equal(mask, segment_in_focus(candidates, picture, threshold=threshold))
    assert (mask[:, :140].mean(), mask[:, 180:].mean()) == pytest.approx((1, 0), abs=0.06)


def test_blur_of_6_px_everywhere_is_not_in_focus(sharp):
    picture = simulate_defocus(sharp, np.full(sharp.shape, 6.0), noise_variance=1e-6, rng=0)
    assert segment_in_focus(estimate_candidates(picture), picture).mean() < 0.02


def test_sharp_picture_is_in_focus_everywhere(sharp):
    assert segment_in_focus(estimate_candidates(sharp), sharp).mean() > 0.98


def test_what_lies_outside_has_no_say(sharp):
    radii = np.where(np.arange(320) < 160, 0.3, 1.8) * np.ones((260, 1))
    picture = simulate_defocus(sharp, radii, noise_variance=1e-6, rng=0)
    candidates = estimate_candidates(picture)
    tissue = np.zeros(picture.shape, np.int32)
    tissue[:, 190:] = 7
    assert focus_threshold(candidates, picture, within=tissue) > 2
    mask = segment_in_focus(candidates, picture, within=tissue)
    assert mask[:, 190:].mean() > 0.95
    assert not mask[:, :190].any()
    left = segment_in_focus(candidates, picture, within=tissue, unknown="leave")
    assert (left[:, :190] == 2).all()


@pytest.mark.parametrize(
    ("within", "error", "saying"),
    [
        (np.ones((3, 3), bool), ValueError, r"within has shape \(3, 3\); it takes .*\(260, 320\)"),
        (np.ones((260, 320)), TypeError, "within has dtype float64; it takes bool or integers"),
        (np.zeros((260, 320), bool), ValueError, "within is 0 everywhere"),
    ],
)
def test_wrong_marks_are_refused(sharp, within, error, saying):
    candidates = estimate_candidates(sharp)
    for function in (segment_in_focus, focus_threshold):
        with pytest.raises(error, match=saying):
            function(candidates, sharp, within=within)


@pytest.mark.parametrize("what", ["shading", "noise", "empty background"])
def test_what_has_no_texture_is_not_known(what):
    rng, (row, column) = np.random.default_rng(0), np.indices((200, 240))
    picture = {
        "shading": (column / 239).astype(np.float32),
        "noise": rng.normal(0.5, 0.05, (200, 240)),
        "empty background": 0.1 + rng.normal(0, 0.003, (200, 240)),
    }[what]
    if what == "empty background":
        cell = (row - 60) ** 2 + (column - 60) ** 2 < 30**2
        picture += cell * rng.uniform(0.3, 0.7, cell.shape)
    candidates = estimate_candidates(picture)
    mask = segment_in_focus(candidates, picture, unknown="leave")
    assert (mask[120:, 120:] == 2).mean() > 0.97
    np.testing.assert_array_equal(mask == 2, ~known_places(candidates, picture))
    assert set(np.unique(segment_in_focus(candidates, picture))) <= {0, 1}


def test_seeds_make_known_what_the_picture_does_not_say():
    picture = np.random.default_rng(0).normal(0.5, 0.05, (120, 140))
    seeds = np.zeros(picture.shape, np.uint8)
    seeds[10:20, 10:30] = 1
    mask = segment_in_focus(estimate_candidates(picture), picture, seeds=seeds, unknown="leave")
    assert (mask[10:20, 10:30] == 1).all()
    assert (mask[60:] == 2).all()
