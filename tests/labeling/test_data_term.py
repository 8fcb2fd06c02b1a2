from dataclasses import replace

import numpy as np
import pytest

from napari_defocus import estimate_blur_map, estimate_candidates, label_blur_map, segment_in_focus
from napari_defocus.core.image import prepare_image
from napari_defocus.forward.occlusion import simulate_layered_defocus
from napari_defocus.likelihood.evidence import evidence_share
from napari_defocus.likelihood.own_side import on_own_side


@pytest.fixture(scope="module")
def halves(grass, gravel):
    """Something sharp on the left, before something blurred by 5 px: picture, true radii."""
    sharp = np.concatenate([grass[:, :80], gravel[:, :80]], axis=1)
    depth = np.where(np.arange(160) < 80, 1.0, 2.0) * np.ones((160, 1))
    return simulate_layered_defocus(
        sharp, depth, np.where(depth == 1, 0.5, 5.0), noise_variance=1e-6, rng=0
    )


def test_sharp_things_do_not_grow_by_half_a_window(halves):
    picture, truth = halves
    candidates = estimate_candidates(picture)
    beside = (truth > 2) & (np.arange(160) < 80 + 14)
    # Nothing but the evidence tells where the edge is: both sides have the same greys.
    for blurred in (
        label_blur_map(candidates, picture) > 2,
        segment_in_focus(candidates, picture) == 0,
    ):
        assert blurred[beside].mean() > 0.5
        assert blurred[truth < 2].mean() < 0.1


def test_windows_beside_something_sharp_ask_their_own_side(halves):
    picture, _ = halves
    candidates = estimate_candidates(picture)
    own = on_own_side(candidates, prepare_image(picture))
    at = np.searchsorted(candidates.column_centers, 88)
    before, after = (
        np.median(each.scales[each.curve[10:30, at].argmax(axis=1)]) for each in (candidates, own)
    )
    assert before < 2
    assert after == pytest.approx(5, abs=0.5)


def test_slopes_and_the_papers_mode_are_left_alone(ramp_picture):
    for mode in ("curve", "paper"):
        candidates = estimate_candidates(ramp_picture, mode=mode)
        own = on_own_side(candidates, prepare_image(ramp_picture))
        assert np.mean(own.curve != candidates.curve) < 0.02


def test_what_has_no_texture_is_extrapolated_and_told(grass, defocused):
    sharp = np.concatenate([grass, np.full((160, 160), grass.mean())], axis=1)
    picture = defocused(sharp, 3, 1e-5)
    candidates = estimate_candidates(picture)
    blur_map, extrapolated = label_blur_map(candidates, picture, return_extrapolated=True)
    assert blur_map.dtype == np.float32
    assert extrapolated.dtype == bool
    assert extrapolated[:, 200:].mean() > 0.95
    assert extrapolated[:, :140].mean() < 0.05
    assert np.abs(blur_map[:, 200:] - 3).mean() < 0.5
    np.testing.assert_array_equal(blur_map, label_blur_map(candidates, picture))


def test_constant_picture_has_no_evidence_anywhere():
    picture = np.full((60, 70), 0.5)
    candidates = estimate_candidates(picture)
    assert evidence_share(candidates).max() == 0
    assert label_blur_map(candidates, picture, return_extrapolated=True)[1].all()


def test_evidence_does_not_depend_on_where_the_curve_lies(ramp_picture):
    candidates = estimate_candidates(ramp_picture)
    lifted = replace(candidates, curve=candidates.curve + np.float32(3))
    np.testing.assert_allclose(evidence_share(lifted), evidence_share(candidates), atol=1e-3)


@pytest.mark.parametrize("shape", [(3, 3), (3, 50), (45, 42)])
def test_small_pictures_have_maps(shape):
    picture = np.random.default_rng(0).random(shape)
    assert estimate_blur_map(picture).shape == shape
