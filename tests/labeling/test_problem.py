import numpy as np
import pytest

from napari_defocus import (
    estimate_candidates,
    label_blur_map,
    segment_in_focus,
    simulate_defocus,
)
from napari_defocus.core.progress import Cancelled
from napari_defocus.labeling import confidence
from napari_defocus.labeling import problem as problems
from napari_defocus.labeling.blur_map import labeled_blur_map, preview_of_blur_map
from napari_defocus.labeling.data_term import Costs
from napari_defocus.labeling.problem import LabelingProblem, UnknownProblemError, with_problem
from napari_defocus.labeling.segmentation import labeled_mask
from napari_defocus.likelihood import own_side
from napari_defocus.settings import MapSettings, MaskSettings


@pytest.fixture(scope="module")
def picture(ramp_picture):
    return ramp_picture[:150, :140]


@pytest.fixture(scope="module")
def candidates(picture):
    return estimate_candidates(picture)


@pytest.fixture(scope="module")
def problem(candidates, picture):
    return LabelingProblem.of(candidates, picture)


def test_problem_is_labelled_like_its_candidates_every_time(problem, candidates, picture):
    for smoothness in (5.0, 50.0, 5.0):
        found = labeled_blur_map(problem, MapSettings(smoothness=smoothness))
        expected = label_blur_map(candidates, picture, smoothness=smoothness)
        np.testing.assert_array_equal(found, expected)
    for threshold in (1.0, 4.0, 1.0):
        found = labeled_mask(problem, MaskSettings(threshold=threshold))
        expected = segment_in_focus(candidates, picture, threshold=threshold)
        np.testing.assert_array_equal(found, expected)


def test_large_picture_has_the_same_bits_in_less_memory(astronaut, monkeypatch):
    sharp = np.tile(astronaut, (2, 3, 1))[:300, :440]
    radius = np.broadcast_to(np.where(np.arange(440) < 220, 0.5, 25), (300, 440))
    picture = simulate_defocus(sharp, radius, noise_variance=1e-5, rng=0).astype(np.float32)
    found = []
    for most in (own_side.AT_ONCE, 0):
        for module in (own_side, problems, confidence):
            monkeypatch.setattr(module, "AT_ONCE", most)
        candidates = estimate_candidates(picture)
        problem = LabelingProblem.of(candidates, picture)
        blur_map, mask = labeled_blur_map(problem), labeled_mask(problem)
        sure = confidence.confidence_and_caution(candidates, blur_map)
        found.append((candidates.curve, blur_map, mask, *sure))
        assert isinstance(problem.costs, Costs) == (most == 0)
        assert isinstance(problem.own.curve, own_side.MovedCurves) == (most == 0)
    assert found[0][1].max() > 10
    for expected, seen in zip(*found, strict=True):
        np.testing.assert_array_equal(seen, expected)


def test_preview_is_near_the_result(problem):
    blur_map, preview = labeled_blur_map(problem), preview_of_blur_map(problem)
    assert preview.shape == blur_map.shape
    assert preview.dtype == np.float32
    assert np.abs(preview - blur_map).mean() < 0.2
    mask = labeled_mask(problem, MaskSettings(threshold=2.5))
    quick = labeled_mask(problem, MaskSettings(threshold=2.5), preview=True)
    assert quick.dtype == mask.dtype
    assert 0.2 < mask.mean() < 0.8
    assert (quick == mask).mean() > 0.95


def test_preview_of_a_mask_keeps_to_the_seeds(problem, picture):
    seeds = np.zeros(picture.shape, np.uint8)
    seeds[3:6, 5:9], seeds[-8:-3, 20:30] = 2, 1
    quick = labeled_mask(problem, MaskSettings(threshold=2.5), seeds=seeds, preview=True)
    assert (quick[seeds == 1] == 1).all()
    assert (quick[seeds == 2] == 0).all()


def test_preview_can_be_cancelled(problem):
    def cancel(step, done):
        raise Cancelled

    with pytest.raises(Cancelled):
        preview_of_blur_map(problem, progress=cancel)


def test_problem_is_remembered_by_its_name_until_two_others_were_used(candidates, picture):
    ingredients = candidates, picture, None
    with pytest.raises(UnknownProblemError):
        with_problem(labeled_mask, "first", None)
    expected = segment_in_focus(candidates, picture, threshold=3.0)
    found = with_problem(labeled_mask, "first", ingredients, settings=MaskSettings(threshold=3.0))
    np.testing.assert_array_equal(found, expected)
    found = with_problem(labeled_mask, "first", None, settings=MaskSettings(threshold=3.0))
    np.testing.assert_array_equal(found, expected)
    for name in ("second", "third"):
        with_problem(labeled_mask, name, ingredients)
    with pytest.raises(UnknownProblemError):
        with_problem(labeled_mask, "first", None)
