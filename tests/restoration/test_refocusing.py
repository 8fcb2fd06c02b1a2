"""Another focus and another aperture, afterwards."""

import math

import numpy as np
import pytest
from scipy.ndimage import convolve

from napari_defocus import (
    Annulus,
    Cancelled,
    Disc,
    Gaussian,
    GeneralizedGaussian,
    KernelFunction,
    MeasuredPSF,
    Polygon,
    ThinLens,
    blur_from_depth,
    change_focus,
    restore_all_in_focus,
    simulate_defocus,
    simulate_layered_defocus,
)
from napari_defocus.core.image import decode_srgb
from napari_defocus.restoration.all_in_focus import Restoration
from napari_defocus.settings import RefocusSettings

SIDE = 80
FAR = np.broadcast_to(np.arange(SIDE) >= 40, (SIDE, SIDE))
RADIUS = np.where(FAR, 3.0, 0.0)
LEFT, RIGHT = np.s_[:, 4:32], np.s_[:, 48:76]
"""What no light from the other half gets to."""


def detail(picture):
    """How much neighbours differ."""
    return float(np.abs(np.diff(picture, axis=1)).mean())


def psnr(picture, truth):
    return -10 * math.log10(np.mean((picture - truth) ** 2))


@pytest.fixture(scope="module")
def sharp(astronaut):
    """A face in colour: (80, 80, 3)."""
    return astronaut[20 : 20 + SIDE, 60 : 60 + SIDE]


@pytest.fixture(scope="module")
def taken(sharp):
    """The left half sharp, the right half 3 px beyond, as a camera would see it, with noise."""
    picture, _ = simulate_layered_defocus(
        sharp, RADIUS, RADIUS, linearize="srgb", noise_variance=1e-6, rng=0
    )
    return np.clip(picture, 0, 1)


@pytest.fixture(scope="module")
def restored(taken):
    return restore_all_in_focus(taken, RADIUS, linearize="srgb")


@pytest.fixture
def no_restoration(monkeypatch):
    def restore(*arguments, **settings):
        raise AssertionError("restored")

    monkeypatch.setattr(Restoration, "restored", restore)


# What comes out.


@pytest.mark.parametrize("side", ["far", "near", FAR, ~FAR])
@pytest.mark.usefixtures("no_restoration")
def test_same_focus_and_aperture_give_the_picture_back_at_once(taken, side):
    np.testing.assert_allclose(change_focus(taken, RADIUS, side=side), taken, atol=1e-6)


def test_where_the_radius_stays_the_picture_stays_with_its_noise(taken, restored):
    radius = np.where(FAR, 3.0, 1.0)
    # 1 px beyond the old focus is 1 px before the new one.
    seen = change_focus(taken, radius, focus=2.0, all_in_focus=restored)
    np.testing.assert_allclose(seen[LEFT], taken[LEFT], atol=1e-5)
    assert np.abs(seen - taken)[RIGHT].mean() > 0.01


def test_no_aperture_leaves_the_all_in_focus_picture(taken, restored):
    seen = change_focus(taken, RADIUS, aperture=0)
    assert seen.dtype == np.float32
    np.testing.assert_allclose(seen[FAR], restored[FAR], atol=1e-5)
    # What was sharp keeps what restoration took for noise.
    np.testing.assert_allclose(seen[~FAR], taken[~FAR], atol=1e-5)


def test_all_in_focus_picture_may_be_given(taken, restored, no_restoration):
    seen = change_focus(taken, RADIUS, aperture=0, all_in_focus=restored)
    np.testing.assert_allclose(seen[FAR], restored[FAR], atol=1e-5)


def test_wider_aperture_blurs_what_is_blurred_and_nothing_else(taken, restored):
    details = []
    for aperture in (0.0, 0.5, 1.0, 1.5, 2.0, 4.0):
        seen = change_focus(taken, RADIUS, aperture=aperture, all_in_focus=restored)
        np.testing.assert_allclose(seen[LEFT], taken[LEFT], atol=1e-5)
        details.append(detail(seen[RIGHT]))
    assert (np.diff(details) < 0).all()


@pytest.mark.parametrize("radius", [1.5, 3.0])
@pytest.mark.parametrize("aperture", [1.3, 2.0, 3.0])
def test_magnified_disc_is_the_larger_disc(grass, radius, aperture):
    uniform = np.full(grass.shape, radius)
    picture = simulate_defocus(grass, uniform, noise_variance=1e-6, rng=0)
    wanted = simulate_defocus(grass, aperture * uniform, psf=Disc(16))
    seen = change_focus(picture, uniform, aperture=aperture, linearize=None)
    assert psnr(seen, wanted) > psnr(picture, wanted) + 14


def test_new_focus_makes_the_far_half_sharp_and_the_near_half_blurred(sharp, taken):
    seen = change_focus(taken, RADIUS, focus=3.0)
    wanted = np.abs(RADIUS - 3)
    truth, _ = simulate_layered_defocus(sharp, RADIUS, wanted, linearize="srgb")
    assert detail(seen[RIGHT]) > 1.5 * detail(taken[RIGHT])
    assert detail(seen[LEFT]) < 0.75 * detail(taken[LEFT])
    assert psnr(seen, truth) > 25
    assert psnr(seen, truth) > psnr(taken, truth) + 5


def test_ramp_refocused_on_its_middle(clouds, ramp, ramp_picture):
    rows = np.s_[:80]
    seen = change_focus(ramp_picture[rows], ramp[rows], focus=3.0, linearize=None)
    truth = simulate_defocus(clouds, np.abs(ramp - 3))[rows]
    assert psnr(seen, truth) > 27
    assert psnr(seen, truth) > psnr(ramp_picture[rows], truth) + 2


# Sides.


def test_sides_are_mirror_images(taken, restored):
    uniform = np.full((SIDE, SIDE), 3.0)
    for focus in (-1.0, 2.0):
        far, near = (
            change_focus(taken, uniform, focus=focus, side=side, all_in_focus=restored)
            for side in ("far", "near")
        )
        np.testing.assert_allclose(far, near, atol=1e-6)


def test_side_of_each_pixel_counts_from_the_focus_outwards(taken, restored):
    def seen(side, focus):
        return change_focus(taken, RADIUS, side=side, focus=focus, all_in_focus=restored)

    everywhere = np.ones(RADIUS.shape, bool)
    np.testing.assert_array_equal(seen("far", 2.0), seen(everywhere, 2.0))
    np.testing.assert_array_equal(seen("near", 2.0), seen(~everywhere, -2.0))


def test_nearer_things_hide_farther_ones():
    # A wall, white where it is near, beside a black one; the near one comes into focus.
    picture = np.where(FAR, 0.0, 1.0)
    radii = {"far": np.where(FAR, 6.0, 2.0), "near": np.where(FAR, 2.0, 6.0)}
    for side, radius in radii.items():
        seen = change_focus(picture, radius, focus=radius[0, 0], side=side, all_in_focus=picture)
        # What is added is what the picture had and the blurred wall had not.
        assert seen[:, 41:].max() < 0.5
        np.testing.assert_allclose(seen[:, :30], 1, atol=1e-5)


@pytest.mark.parametrize(("focus", "turned"), [(1.0, False), (6.0, True), (-1.0, False)])
@pytest.mark.parametrize("side", ["far", "near"])
def test_aperture_is_upside_down_on_the_other_side_of_the_focus(side, focus, turned):
    psf = Polygon(3, rotation=90)
    point = np.zeros((31, 31))
    point[15, 15] = 1
    radius = np.full(point.shape, 4.0)
    picture = convolve(point, psf.kernel(4.0))
    seen = change_focus(
        picture, radius, focus=focus, side=side, psf=psf, all_in_focus=point, linearize=None
    )
    kernel = psf.kernel(abs(4 - focus))
    np.testing.assert_allclose(
        seen, convolve(point, kernel[::-1, ::-1] if turned else kernel), atol=1e-6
    )


def test_radii_shift_as_those_of_a_lens_that_is_focused_again():
    lens = {"focal_length_mm": 50, "f_number": 2, "pixel_pitch_um": 5}
    taken, again = ThinLens(**lens, focus_distance_m=2), ThinLens(**lens, focus_distance_m=1.2)
    depth = np.array([0.8, 1.2, 1.5, 2.0, 4.0, math.inf])
    signed = np.where(depth > 2, 1, -1) * blur_from_depth(depth, taken)
    focus = -blur_from_depth(1.2, taken)
    larger = (1 - 0.05 / 2) / (1 - 0.05 / 1.2)
    np.testing.assert_allclose(
        blur_from_depth(depth, again), larger * np.abs(signed - focus), atol=1e-3
    )


# Light.


def test_light_of_a_clipped_highlight_is_spread_and_not_lost():
    row, column = np.indices((61, 61)) - 30
    picture = np.where(np.hypot(row, column) < 3.5, 1.0, 0.0)
    radius = np.full(picture.shape, 3.0)
    seen = change_focus(picture, radius, aperture=2)
    light, before = decode_srgb(seen), decode_srgb(picture.astype(np.float32))
    assert light.sum() == pytest.approx(before.sum(), rel=0.3)
    # In linear light a disc of 6 px has a third of the light, which is encoded as 0.6.
    assert 0.5 < seen[30, 30] < 0.75


# Pictures.


def test_grey_colour_and_opacity_keep_their_shape(taken, restored):
    grey = change_focus(taken[..., 0], RADIUS, aperture=2, all_in_focus=restored[..., 0])
    assert grey.shape == (SIDE, SIDE)
    color = change_focus(taken, RADIUS, aperture=2, all_in_focus=restored)
    np.testing.assert_allclose(color[..., 0], grey, atol=1e-5)
    opacity = np.linspace(0, 1, SIDE * SIDE).reshape(SIDE, SIDE, 1).astype(np.float32)
    with_opacity = change_focus(
        np.dstack([taken, opacity]), RADIUS, aperture=2, all_in_focus=restored
    )
    np.testing.assert_array_equal(with_opacity[..., 3:], opacity)
    np.testing.assert_allclose(with_opacity[..., :3][RIGHT], color[RIGHT], atol=2e-3)


@pytest.mark.parametrize(
    ("dtype", "whole", "given"),
    [
        (np.uint8, 255, None),
        (np.uint16, 65535, None),
        (np.float64, 1, None),
        (int, 4095, (0, 4095)),
    ],
)
def test_any_dtype_comes_out_as_0_to_1(taken, restored, dtype, whole, given):
    four = np.dstack([taken, np.ones((SIDE, SIDE))])
    picture = (whole * four).round(0 if whole > 1 else 9).astype(dtype)
    seen = change_focus(picture, RADIUS, aperture=2, all_in_focus=restored, intensity_range=given)
    expected = change_focus(taken, RADIUS, aperture=2, all_in_focus=restored)
    assert seen.dtype == np.float32
    np.testing.assert_allclose(seen[..., :3], expected, atol=0.02)


def test_transparent_pixels_do_not_shine_on_others(taken, restored):
    hole = np.zeros((SIDE, SIDE), bool)
    hole[30:50, 55:70] = True
    picture = np.dstack([np.where(hole[..., None], 1.0, taken), ~hole])
    seen = change_focus(picture, RADIUS, aperture=2, all_in_focus=restored)
    whole = change_focus(taken, RADIUS, aperture=2, all_in_focus=restored)
    np.testing.assert_allclose(seen[~hole][:, :3], whole[~hole], atol=0.03)


def test_arguments_are_left_as_they_were(taken, restored):
    arrays = [taken.copy(), RADIUS.copy(), restored.copy(), FAR.copy()]
    picture, radius, sharp, side = arrays
    change_focus(picture, radius, focus=1.0, side=side, all_in_focus=sharp)
    for array, old in zip(arrays, [taken, RADIUS, restored, FAR], strict=True):
        np.testing.assert_array_equal(array, old)


# Families.


@pytest.mark.parametrize(
    "psf",
    [
        Disc(4),
        Annulus(0.3, max_radius=4),
        Polygon(5, max_radius=4),
        Gaussian(4),
        GeneralizedGaussian(4.0, max_radius=4),
        MeasuredPSF([2, 4], [np.pad(Disc().kernel(r), 4 - r) for r in (2, 4)]),
    ],
)
def test_family_may_be_for_smaller_blur_than_comes_out(taken, restored, psf):
    seen = change_focus(taken, RADIUS, aperture=3, psf=psf, all_in_focus=restored)
    small = change_focus(taken, RADIUS, aperture=1.2, psf=psf, all_in_focus=restored)
    assert detail(seen[RIGHT]) < 0.7 * detail(small[RIGHT])


def triangle(scale):
    profile = np.maximum(1 - np.abs(np.arange(-8, 9)) / (scale + 1), 0)
    return np.outer(profile, profile)


@pytest.mark.parametrize("psf", [triangle, KernelFunction(triangle, max_scale=5)])
@pytest.mark.usefixtures("no_restoration")
def test_family_of_ones_own_is_not_asked_for_more_than_it_can(taken, restored, psf):
    change_focus(taken, RADIUS, aperture=1.5, psf=psf, all_in_focus=restored)
    with pytest.raises(ValueError, match=r"focus is -1 and aperture is 3, .* up to 12 px; Kernel"):
        change_focus(taken, RADIUS, focus=-1, aperture=3, psf=psf)


# What cannot be done.


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"image": "picture"}, TypeError, "image has dtype"),
        ({"image": np.ones((SIDE, SIDE, 2))}, ValueError, "image has shape"),
        ({"blur_map": RADIUS[1:]}, ValueError, "blur_map has shape"),
        ({"blur_map": RADIUS * 1j}, TypeError, "blur_map has dtype"),
        ({"blur_map": RADIUS - 1}, ValueError, "blur_map has scales from -1"),
        ({"blur_map": 30 * RADIUS}, ValueError, "blur_map has scales from 0.0 to 90"),
        ({"blur_map": RADIUS * np.nan}, ValueError, "blur_map has scales"),
        ({"focus": math.nan}, ValueError, "focus is nan; it takes a finite number"),
        ({"focus": "3 px"}, TypeError, "focus is '3 px'; it takes a finite number"),
        ({"focus": 100}, ValueError, "focus is 100 and aperture is 2, .* longer side, 80 px"),
        ({"aperture": -0.1}, ValueError, "aperture is -0.1; it takes a finite number from 0 up"),
        ({"aperture": math.inf}, ValueError, "aperture is inf"),
        ({"aperture": None}, TypeError, "aperture is None"),
        ({"aperture": 1e6}, ValueError, r"aperture is 1e\+06, .* longer side"),
        ({"side": "behind"}, ValueError, "side is 'behind'; it takes 'far', 'near' or a bool"),
        ({"side": RADIUS}, TypeError, "side has dtype float64"),
        ({"side": FAR[1:]}, ValueError, r"side has shape \(79, 80\)"),
        ({"psf": "disc"}, TypeError, "psf is 'disc'"),
        ({"all_in_focus": np.ones((SIDE, SIDE))}, ValueError, "all_in_focus has height, width and"),
        ({"all_in_focus": "sharp"}, TypeError, "all_in_focus has dtype"),
        ({"all_in_focus": np.full((9, 9), np.inf)}, ValueError, "all_in_focus has infinite"),
        ({"noise_variance": -1}, ValueError, "noise_variance is -1"),
        ({"tv_weight": 0}, ValueError, "tv_weight is 0"),
        ({"confidence": FAR[1:]}, ValueError, "confidence has shape"),
        ({"linearize": "rec709"}, ValueError, "linearize is 'rec709'"),
        ({"intensity_range": (1, 0)}, ValueError, "intensity_range is"),
    ],
)
def test_bad_argument_is_named_before_any_work(taken, arguments, error, words):
    told = []
    with pytest.raises(error, match=words):
        change_focus(
            **{"image": taken, "blur_map": RADIUS, "aperture": 2, **arguments},
            progress=lambda step, done: told.append(step),
        )
    assert not told


@pytest.mark.parametrize(
    ("setting", "error"),
    [
        ({"focus": math.inf}, ValueError),
        ({"focus": None}, TypeError),
        ({"aperture": -1}, ValueError),
        ({"side": "behind"}, ValueError),
        ({"linearize": "rec709"}, ValueError),
    ],
)
def test_bad_settings_name_themselves(setting, error):
    with pytest.raises(error, match=f"^{next(iter(setting))} is"):
        RefocusSettings(**setting)


# Progress.


@pytest.mark.parametrize("given", [False, True])
def test_progress_rises_from_0_to_1(taken, restored, given):
    told = []
    change_focus(
        taken,
        RADIUS,
        focus=1.0,
        all_in_focus=restored if given else None,
        progress=lambda step, done: told.append((step, done)),
    )
    steps, shares = zip(*told, strict=True)
    assert all(steps)
    assert shares[0] == 0
    assert shares[-1] == 1
    assert list(shares) == sorted(shares)


@pytest.mark.parametrize("at", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("given", [False, True])
def test_exception_from_progress_ends_the_work(taken, restored, at, given):
    def stop(step, done):
        if done >= at:
            raise Cancelled

    with pytest.raises(Cancelled):
        change_focus(
            taken,
            RADIUS,
            focus=1.0,
            all_in_focus=restored if given else None,
            progress=stop,
        )
