"""Why a map says what it says at one pixel."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from napari_defocus import (
    confidence_map,
    draw_explanation,
    estimate_candidates,
    explain_pixel,
    label_blur_map,
)
from napari_defocus.core.image import prepare_image
from napari_defocus.likelihood.evidence import evidence_share
from napari_defocus.likelihood.own_side import on_own_side

RADIUS = 4.0


@pytest.fixture(scope="module")
def picture(gravel, defocused):
    return defocused(gravel[:120, :120], RADIUS)


@pytest.fixture(scope="module")
def candidates(picture):
    return estimate_candidates(picture)


@pytest.fixture(scope="module")
def maps(candidates, picture):
    blur_map = label_blur_map(candidates, picture)
    return {"blur_map": blur_map, "confidence": confidence_map(candidates, blur_map)}


@pytest.fixture(scope="module")
def halves(gravel, grass, defocused):
    """Sharp to the left of column 80, blurred by 5 px from there on."""
    left = np.arange(160) < 80
    return np.where(left, gravel, defocused(grass, 5.0)).astype(np.float32)


@pytest.fixture(scope="module")
def of_halves(halves):
    return estimate_candidates(halves)


def test_curve_candidates_and_map_are_those_of_the_pixel(candidates, maps):
    told = explain_pixel(candidates, 61, 58, **maps)
    scales, curve = candidates.log_likelihood_at(61, 58)
    np.testing.assert_array_equal(told.scales, scales)
    np.testing.assert_allclose(np.diff(told.log_likelihood), np.diff(curve))
    assert told.log_likelihood.max() == pytest.approx(0, abs=0.05)
    assert told.heights[0] <= 0
    assert told.best == told.radii[0] == pytest.approx(RADIUS, abs=0.3)
    assert np.isfinite(told.radii).all()
    assert (told.blur, told.confidence) == tuple(float(m[61, 58]) for m in maps.values())
    assert not told.extrapolated


def test_what_is_not_given_is_not_told(candidates):
    told = explain_pixel(candidates, 61, 58)
    assert told.blur is told.confidence is told.own_log_likelihood is told.own_window is None
    assert str(told).startswith(f"The likeliest blur is {told.best:.1f} px.")


def test_text_starts_with_the_value_and_the_confidence(candidates, maps):
    told = explain_pixel(candidates, 61, 58, **maps)
    sure = f"{told.confidence:.2f}"
    assert str(told).startswith(f"The blur is {told.blur:.1f} px, with a confidence of {sure}")


def test_low_confidence_has_a_reason(candidates, maps):
    told = replace(explain_pixel(candidates, 61, 58, **maps), confidence=0.499)
    assert "0.49 (not trusted)" in told.summary()
    assert told.remarks()


def test_window_is_around_the_pixel_and_moved_inside_at_the_border(candidates):
    top, left, bottom, right = explain_pixel(candidates, 60, 2).window
    assert (bottom - top, right - left) == (41, 41)
    assert abs((top + bottom) / 2 - 60) <= 2
    assert left == pytest.approx(0, abs=0.5)
    assert explain_pixel(candidates, 119, 119).window[2:] == pytest.approx((119, 119), abs=0.5)


def test_windows_lie_as_far_from_their_places_as_candidates_say(candidates):
    away = candidates.displacement()
    for i, j in ((0, 0), (0, 15), (29, 3), (14, 14)):
        place = candidates.row_centers[i], candidates.column_centers[j]
        top, left, bottom, right = candidates.window_at(*place)
        center = (top + bottom) / 2, (left + right) / 2
        assert np.hypot(*np.subtract(center, place)) == pytest.approx(away[i, j])


def test_window_larger_than_the_picture_is_all_of_it(gravel):
    assert estimate_candidates(gravel[:30, :50]).window_at(3, 25)[::2] == (-0.5, 29.5)


@pytest.mark.parametrize("stride", [4, 3])
def test_own_side_and_evidence_are_those_of_the_labelling(halves, stride):
    """They come from a cut-out of the picture."""
    candidates = estimate_candidates(halves, stride=stride)
    own = on_own_side(candidates, prepare_image(halves)).curve
    evidence = evidence_share(candidates)
    moved = 0
    for i, j in np.ndindex(evidence.shape):
        if (i + j) % 3:
            continue
        place = candidates.row_centers[i], candidates.column_centers[j]
        told = explain_pixel(candidates, *place, image=halves)
        assert told.evidence == evidence[i, j]
        if np.array_equal(own[i, j], candidates.curve[i, j]):
            assert told.own_log_likelihood is None
        else:
            moved += 1
            np.testing.assert_array_equal(told.own_log_likelihood, own[i, j] - own[i, j].max())
    assert moved > 3


def test_pixel_beside_sharper_things_is_asked_farther_away_from_them(halves, of_halves):
    told = explain_pixel(of_halves, 80, 88, image=halves)
    assert told.radii[0] < 2
    assert told.best == pytest.approx(5, abs=0.5)
    assert told.own_window[1] > told.window[1] + 4
    column = (told.own_window[1] + told.own_window[3]) / 2
    assert f"column {column:.0f} was asked: its answer is {told.best:.1f} px" in str(told)


def test_place_without_texture_is_said_to_be_carried_in():
    candidates = estimate_candidates(np.full((80, 80), 0.5), noise_variance=1e-5)
    told = explain_pixel(candidates, 40, 40, blur_map=np.full((80, 80), 3.0))
    assert told.extrapolated
    assert "too little texture" in str(told)
    assert "from the surroundings" in str(told)
    assert "Seen alone, its likeliest" not in str(told)
    assert "surroundings" not in str(explain_pixel(candidates, 40, 40))


def test_map_that_follows_its_neighbours_is_told(candidates):
    told = explain_pixel(candidates, 61, 58, blur_map=np.full((120, 120), 1.5))
    assert "because that fits the places around it better" in str(told)
    agrees = explain_pixel(candidates, 61, 58, blur_map=np.full((120, 120), told.best + 0.4))
    assert "Seen alone, its likeliest" not in str(agrees)


@pytest.mark.parametrize(("below", "nearly"), [(0.5, True), (3.0, False)])
def test_second_candidate_is_told_if_it_is_nearly_as_likely(candidates, below, nearly):
    told = explain_pixel(candidates, 61, 58)
    two = replace(told, radii=np.array([4.0, 6.2]), heights=np.array([0.0, -below]))
    assert ("The next best answer, 6.2 px, is 0.61 times as likely" in str(two)) == nearly


def test_broad_curve_is_told(candidates):
    told = explain_pixel(candidates, 61, 58)
    broad = replace(told, log_likelihood=np.where(np.abs(told.scales - 4) <= 2.01, -0.5, -9.0))
    assert "this place may have any blur from 2.0 to 6.0 px" in str(broad)


def test_largest_radius_that_was_looked_for_may_be_more(candidates):
    full = np.full((120, 120), 8.0)
    assert "it may be wider" in str(explain_pixel(candidates, 61, 58, blur_map=full))
    assert "it may be wider" not in str(explain_pixel(candidates, 61, 58, blur_map=full - 1))


def test_value_that_a_map_does_not_have_is_not_told(candidates):
    told = explain_pixel(candidates, 61, 58, blur_map=np.full((120, 120), np.nan))
    assert told.blur is None


@pytest.mark.parametrize(
    ("place", "given", "saying"),
    [
        ((120, 3), {}, r"\(row, column\) is \(120, 3\)"),
        ((3, -1), {}, r"120 x 120 px"),
        ((3, 3), {"blur_map": np.ones((4, 5))}, r"blur_map has shape \(4, 5\)"),
        ((3, 3), {"confidence": np.ones((4, 5))}, r"confidence has shape \(4, 5\)"),
        ((3, 3), {"image": np.ones((4, 5))}, r"image has shape \(4, 5\)"),
    ],
)
def test_what_does_not_fit_is_named(candidates, place, given, saying):
    with pytest.raises(ValueError, match=saying):
        explain_pixel(candidates, *place, **given)


def test_drawing_shows_curve_candidates_and_the_map_with_units(candidates, maps):
    told = explain_pixel(candidates, 61, 58, **maps)
    axes = Figure().subplots()
    draw_explanation(told, axes)
    lines = {line.get_label(): line for line in axes.lines}
    np.testing.assert_array_equal(lines["log p(r)"].get_ydata(), told.log_likelihood)
    assert told.radii[0] in lines["candidates"].get_xdata()
    assert lines["map"].get_xdata()[0] == told.blur
    assert axes.patches[0].get_width() == pytest.approx(1.0)
    assert axes.get_xlabel() == "blur radius (px)"
    assert f"confidence {told.confidence:.2f}" in axes.get_title()
    assert axes.get_ylim() == (-20, 1)


def test_drawing_shows_the_curve_that_was_taken_instead(halves, of_halves):
    told = explain_pixel(of_halves, 80, 88, image=halves)
    axes = Figure().subplots()
    draw_explanation(told, axes)
    drawn = [line.get_ydata() for line in axes.lines]
    assert any(np.array_equal(curve, told.own_log_likelihood) for curve in drawn)
