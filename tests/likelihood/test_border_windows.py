"""A strip of ground between a thing and the border of the picture is seen as ground."""

import numpy as np
import pytest
from skimage.data import gravel

from napari_defocus import (
    estimate_candidates,
    label_blur_map,
    simulate_defocus,
    simulate_layered_defocus,
)

SHARP, BLURRED = 0.7, 4.0
STRIP, BEYOND = 20, 24


@pytest.fixture(scope="module")
def textured():
    """Gravel, 24 px wider on each side than the picture, so that light comes in from outside."""
    height, width = 120 + 2 * BEYOND, 140 + 2 * BEYOND
    whole = gravel()[: 2 * height, : 2 * width] / 255
    return whole.reshape(height, 2, width, 2).mean(axis=(1, 3))


@pytest.fixture(scope="module")
def beside(textured):
    """A sharp thing before a blurred ground, of which 20 px are left beside the right border."""
    ground = np.zeros(textured.shape, bool)
    ground[:, -BEYOND - STRIP :] = True
    radii = np.where(ground, BLURRED, SHARP)
    seen, _ = simulate_layered_defocus(textured, 1.0 * ground, radii, noise_variance=1e-6, rng=0)
    return seen[BEYOND:-BEYOND, BEYOND:-BEYOND]


def test_a_strip_of_ground_at_the_border_is_not_taken_for_the_thing_beside_it(beside):
    found = label_blur_map(estimate_candidates(beside), beside)
    assert np.median(np.abs(found[:, -STRIP // 2 :] - BLURRED)) < 0.5
    assert np.abs(found[:, : -2 * STRIP] - SHARP).mean() < 0.3


def test_windows_over_the_border_are_told(beside):
    candidates = estimate_candidates(beside)
    over = candidates.over_border
    assert over[:, -2:].mean() > 0.8
    assert not over[6:-6, 6:-6].any()
    row, column = candidates.row_centers[15], candidates.column_centers[-1]
    top, left, bottom, right = candidates.window_at(row, column)
    assert (right, bottom - top) == (139.5, 41)
    assert right - left < 25


@pytest.mark.parametrize("turned", [np.s_[::-1], np.s_[:, ::-1]])
def test_a_flipped_picture_has_flipped_windows(beside, turned):
    found, other = (estimate_candidates(np.ascontiguousarray(s)) for s in (beside, beside[turned]))
    assert found.over_border.any()
    assert np.array_equal(found.over_border[turned], other.over_border)
    assert np.allclose(found.curve[turned], other.curve, atol=0.05)


@pytest.mark.parametrize("stride", [1, 3, 4, 8, 16])
def test_the_picture_may_be_turned_at_any_stride(beside, stride):
    found = estimate_candidates(beside, stride=stride).over_border
    turned = estimate_candidates(np.ascontiguousarray(beside.T), stride=stride).over_border
    assert np.array_equal(found.T, turned)


def test_where_the_blur_is_the_same_all_the_way_hardly_any_counts(textured):
    seen = simulate_defocus(textured, np.full(textured.shape, 3.0), noise_variance=1e-6, rng=0)
    candidates = estimate_candidates(seen[BEYOND:-BEYOND, BEYOND:-BEYOND])
    assert candidates.over_border.mean() < 0.01


def test_pixels_at_the_border_may_be_unknown(beside):
    holes = beside.copy()
    holes[50:60, -8:] = np.nan
    candidates = estimate_candidates(holes)
    assert np.isfinite(candidates.curve).all()
    assert candidates.over_border[:8, -2:].mean() > 0.8


def test_the_mode_paper_and_small_pictures_have_none(beside):
    assert estimate_candidates(beside, mode="paper").over_border is None
    assert estimate_candidates(beside[:40]).over_border is None
