"""Distances from blur: one thin lens."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from napari_defocus import (
    ThinLens,
    blur_from_depth,
    depth_from_blur,
    estimate_blur_map,
    simulate_defocus,
)

PORTRAIT = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=5)
WIDE = ThinLens(focal_length_mm=25, f_number=4, focus_distance_m=1.6, pixel_pitch_um=5)
LANDSCAPE = ThinLens(focal_length_mm=35, f_number=8, focus_distance_m=math.inf, pixel_pitch_um=4)


def lenses():
    return st.builds(
        lambda f, focus_in_f, **rest: ThinLens(
            focal_length_mm=f, focus_distance_m=focus_in_f * f / 1000, **rest
        ),
        f=st.floats(2, 500),
        focus_in_f=st.floats(1.1, 1000) | st.just(math.inf),
        f_number=st.floats(0.9, 45),
        pixel_pitch_um=st.floats(0.5, 30),
    )


@pytest.mark.parametrize("distance", [0.7, 1.5, 2.0, 4.0, 300.0])
def test_blur_is_that_of_the_lens_equation(distance):
    # Worked out behind the lens, in mm: where a point and the plane in focus are imaged, and
    # how wide the cone of light through an aperture of 50 / 2 mm is on the sensor.
    sensor = 1 / (1 / 50 - 1 / 2000)
    point = 1 / (1 / 50 - 1 / (1000 * distance))
    diameter_mm = 50 / 2 * abs(sensor - point) / point
    expected_px = diameter_mm / 2 / 0.005
    assert blur_from_depth(distance, PORTRAIT) == pytest.approx(expected_px, rel=1e-6)


def test_point_at_4_m_in_front_of_a_portrait_lens():
    # By hand: 51.28205 and 50.63291 mm behind the lens, so 25 x 0.64914 / 50.63291 mm wide.
    assert blur_from_depth(4.0, PORTRAIT) == pytest.approx(32.051, abs=1e-3)
    assert depth_from_blur(32.051, PORTRAIT) == pytest.approx(4.0, abs=1e-3)


@given(lens=lenses(), times=st.floats(1.001, 100))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_distance_beyond_the_focus_comes_back(lens, times):
    assume(lens.focus_distance_m < math.inf)
    distance = times * lens.focus_distance_m
    radius = blur_from_depth(distance, lens)
    assert radius < lens.largest_radius
    assert depth_from_blur(radius, lens, side="far") == pytest.approx(distance, rel=1e-4)


@given(lens=lenses(), times=st.floats(0.01, 0.999))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_distance_before_the_focus_comes_back(lens, times):
    distance = times * min(lens.focus_distance_m, 100)
    radius = blur_from_depth(distance, lens)
    assert depth_from_blur(radius, lens, side="near") == pytest.approx(distance, rel=1e-5)


@given(lens=lenses())
@settings(max_examples=50, deadline=None, derandomize=True)
def test_infinity_and_the_focus_come_back(lens):
    assert blur_from_depth(math.inf, lens) == pytest.approx(lens.largest_radius, rel=1e-6)
    if lens.focus_distance_m < math.inf:
        assert depth_from_blur(blur_from_depth(math.inf, lens), lens) == math.inf
        for side in ("far", "near"):
            in_focus = depth_from_blur(0.0, lens, side=side)
            assert in_focus == pytest.approx(lens.focus_distance_m, rel=1e-6)


def test_with_the_focus_at_infinity_blur_falls_with_the_distance():
    assert LANDSCAPE.largest_radius == 0
    # 35 / 8 mm wide at the lens, seen through 35 mm at 10 m: 15.3 um, half of that in px of 4 um.
    assert blur_from_depth(10.0, LANDSCAPE) == pytest.approx(35 / 8 * 35 / 10000 / 2 / 0.004)
    np.testing.assert_allclose(
        depth_from_blur([1.9140625, 0.0], LANDSCAPE, side="near"), [10, math.inf]
    )


def test_twice_the_aperture_or_half_the_pitch_is_twice_the_blur():
    once = blur_from_depth([1.0, 3.0], PORTRAIT)
    for change in ({"f_number": 1}, {"pixel_pitch_um": 2.5}):
        lens = ThinLens(**{**vars(PORTRAIT), **change})
        np.testing.assert_allclose(blur_from_depth([1.0, 3.0], lens), 2 * once)


def test_more_blur_than_at_infinity_is_infinitely_far_or_near():
    radii = [0.99 * PORTRAIT.largest_radius, PORTRAIT.largest_radius, 1000.0]
    far = depth_from_blur(radii, PORTRAIT)
    assert np.isfinite(far[0])
    np.testing.assert_array_equal(far[1:], math.inf)
    near = depth_from_blur(radii, PORTRAIT, side="near")
    assert (np.diff(near) < 0).all()
    assert near[-1] > 0


def test_side_is_chosen_for_each_pixel():
    depth = np.array([[1.0, 1.5], [3.0, 9.0]])
    blur = blur_from_depth(depth, PORTRAIT)
    np.testing.assert_allclose(depth_from_blur(blur, PORTRAIT, side=depth > 2), depth, rtol=1e-5)
    everywhere = np.ones((2, 2), bool)
    for word, beyond in (("far", everywhere), ("near", ~everywhere)):
        np.testing.assert_array_equal(
            depth_from_blur(blur, PORTRAIT, side=word),
            depth_from_blur(blur, PORTRAIT, side=beyond),
        )


@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3), (2, 3, 4)])
@pytest.mark.parametrize("dtype", [np.float16, np.float64, np.int32, np.uint8])
def test_any_shape_and_real_dtype_gives_float32_of_the_same_shape(shape, dtype):
    values = np.full(shape, 3, dtype)
    for result in (depth_from_blur(values, PORTRAIT), blur_from_depth(values, PORTRAIT)):
        assert result.shape == shape
        assert result.dtype == np.float32


def test_what_is_not_known_stays_so():
    blur = np.array([1.0, np.nan, 100.0])
    for side in ("far", "near", np.array([True, True, False])):
        unknown = np.isnan(depth_from_blur(blur, PORTRAIT, side=side))
        np.testing.assert_array_equal(unknown, [False, True, False])
    np.testing.assert_array_equal(np.isnan(blur_from_depth(blur, PORTRAIT)), np.isnan(blur))


@pytest.mark.parametrize("texture", ["grass", "clouds"])
@pytest.mark.parametrize(
    ("lens", "side", "nearest", "farthest"),
    [
        (WIDE, "far", 1.8, 4.0),
        (ThinLens(**{**vars(WIDE), "focus_distance_m": 4.0}), "near", 1.6, 3.2),
    ],
)
def test_slanted_wall_is_found_to_3_percent(request, texture, lens, side, nearest, farthest):
    wall = np.broadcast_to(np.linspace(nearest, farthest, 160), (160, 160))
    sharp = request.getfixturevalue(texture)
    picture = simulate_defocus(sharp, blur_from_depth(wall, lens), noise_variance=1e-6, rng=0)
    blur_map = estimate_blur_map(picture, camera_softness=0)  # a perfect camera
    found = depth_from_blur(blur_map, lens, side=side)
    error = np.abs(found - wall) / wall
    assert np.median(error) < 0.03
    assert np.mean(error < 0.05) > 0.88


# What distances cannot be made from.


@pytest.mark.parametrize("name", ["focal_length_mm", "f_number", "pixel_pitch_um"])
@pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf])
def test_impossible_lens_is_a_value_error(name, value):
    with pytest.raises(ValueError, match=rf"^{name} is {value}; it takes a finite number above 0"):
        ThinLens(**{**vars(PORTRAIT), name: value})


@pytest.mark.parametrize("value", [0, -1.0, math.nan, 0.03, 0.05, -math.inf])
def test_focus_within_the_focal_length_is_a_value_error(value):
    with pytest.raises(ValueError, match=r"focus_distance_m is .* above the focal length, 0.05 m"):
        ThinLens(**{**vars(PORTRAIT), "focus_distance_m": value})


@pytest.mark.parametrize("name", list(vars(PORTRAIT)))
@pytest.mark.parametrize("value", ["50", None, [50.0], 1j])
def test_lens_of_no_numbers_is_a_type_error(name, value):
    with pytest.raises(TypeError, match=f"^{name} is "):
        ThinLens(**{**vars(PORTRAIT), name: value})


@pytest.mark.parametrize(
    ("blur", "words"),
    [
        ([-0.1, 1], "blur_map has values from -0.1 to 1; it takes finite ones from 0 px up"),
        ([np.nan, np.inf], "blur_map has values from inf to inf"),
        ([[1.0], [1.0, 2.0]], "blur_map is not an array"),
    ],
)
def test_impossible_blur_is_a_value_error(blur, words):
    with pytest.raises(ValueError, match=words):
        depth_from_blur(blur, PORTRAIT)


@pytest.mark.parametrize("depth", [0.0, [1.0, -2.0], -math.inf])
def test_distance_not_above_0_is_a_value_error(depth):
    with pytest.raises(ValueError, match=r"depth has values down to .*; it takes ones above 0"):
        blur_from_depth(depth, PORTRAIT)


@pytest.mark.parametrize("values", ["far", [1j], [None], [True]])
def test_what_is_no_real_number_is_a_type_error(values):
    with pytest.raises(TypeError, match=r"^blur_map has dtype .*; it takes real numbers"):
        depth_from_blur(values, PORTRAIT)
    with pytest.raises(TypeError, match=r"^depth has dtype .*; it takes real numbers"):
        blur_from_depth(values, PORTRAIT)


@pytest.mark.parametrize(
    ("side", "error", "words"),
    [
        ("behind", ValueError, "side is 'behind'; it takes 'far', 'near' or a bool array"),
        ([1, 0], TypeError, "side has dtype int64; it takes 'far', 'near' or bool"),
        ([[True, False]], ValueError, r"side has shape \(1, 2\); it takes that of blur_map"),
        (None, TypeError, "side has dtype object"),
    ],
)
def test_impossible_side_is_an_error(side, error, words):
    with pytest.raises(error, match=words):
        depth_from_blur([1.0, 2.0], PORTRAIT, side=side)


@pytest.mark.parametrize("side", ["far", [True, False]])
def test_nothing_lies_beyond_infinity(side):
    with pytest.raises(ValueError, match="beyond the focus, but it is at infinity"):
        depth_from_blur([1.0, 2.0], LANDSCAPE, side=side)


def test_other_things_for_a_lens_are_type_errors():
    for function in (depth_from_blur, blur_from_depth):
        with pytest.raises(TypeError, match="lens is 50; it takes a ThinLens"):
            function([1.0], 50)
