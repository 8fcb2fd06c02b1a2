import numpy as np
import pytest

from napari_defocus import estimate_candidates, label_blur_map, segment_in_focus
from napari_defocus.core.progress import Cancelled
from napari_defocus.labeling.blur_map import blur_map_of_scene, preview_of_blur_map
from napari_defocus.labeling.problem import Scene, UnknownSceneError, with_scene
from napari_defocus.labeling.segmentation import mask_of_scene


@pytest.fixture(scope="module")
def picture(ramp_picture):
    return ramp_picture[:150, :140]


@pytest.fixture(scope="module")
def candidates(picture):
    return estimate_candidates(picture)


@pytest.fixture(scope="module")
def scene(candidates, picture):
    return Scene.of(candidates, picture)


def test_scene_is_labelled_like_its_candidates_every_time(scene, candidates, picture):
    for smoothness in (5.0, 50.0, 5.0):
        found = blur_map_of_scene(scene, smoothness=smoothness)
        expected = label_blur_map(candidates, picture, smoothness=smoothness)
        np.testing.assert_array_equal(found, expected)
    for threshold in (1.0, 4.0, 1.0):
        found = mask_of_scene(scene, threshold=threshold)
        expected = segment_in_focus(candidates, picture, threshold=threshold)
        np.testing.assert_array_equal(found, expected)


def test_preview_is_near_the_result(scene):
    blur_map, preview = blur_map_of_scene(scene), preview_of_blur_map(scene)
    assert preview.shape == blur_map.shape
    assert preview.dtype == np.float32
    assert np.abs(preview - blur_map).mean() < 0.2
    mask = mask_of_scene(scene, threshold=2.5)
    quick = mask_of_scene(scene, threshold=2.5, preview=True)
    assert quick.dtype == mask.dtype
    assert 0.2 < mask.mean() < 0.8
    assert (quick == mask).mean() > 0.95


def test_preview_of_a_mask_keeps_to_the_seeds(scene, picture):
    seeds = np.zeros(picture.shape, np.uint8)
    seeds[3:6, 5:9], seeds[-8:-3, 20:30] = 2, 1
    quick = mask_of_scene(scene, threshold=2.5, seeds=seeds, preview=True)
    assert (quick[seeds == 1] == 1).all()
    assert (quick[seeds == 2] == 0).all()


def test_preview_can_be_cancelled(scene):
    def cancel(step, done):
        raise Cancelled

    with pytest.raises(Cancelled):
        preview_of_blur_map(scene, progress=cancel)


def test_scene_is_remembered_by_its_name_until_two_others_were_used(candidates, picture):
    ingredients = candidates, picture, None
    with pytest.raises(UnknownSceneError):
        with_scene(mask_of_scene, "first", None)
    expected = segment_in_focus(candidates, picture, threshold=3.0)
    found = with_scene(mask_of_scene, "first", ingredients, threshold=3.0)
    np.testing.assert_array_equal(found, expected)
    found = with_scene(mask_of_scene, "first", None, threshold=3.0)
    np.testing.assert_array_equal(found, expected)
    for name in ("second", "third"):
        with_scene(mask_of_scene, name, ingredients)
    with pytest.raises(UnknownSceneError):
        with_scene(mask_of_scene, "first", None)
