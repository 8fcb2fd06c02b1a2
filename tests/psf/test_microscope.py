"""The microscope's PSF against theory, and its px against um."""

import numpy as np
import pytest
from scipy.special import j1

from napari_defocus import Microscope, psf_from_text
from napari_defocus.psf.domain import limited, seen_with_pixels, softness_beside
from napari_defocus.psf.families import PSFFamily
from napari_defocus.psf.parsing import psf_text

LENSES = {
    "10x 0.3 air": Microscope(0.3, 0.52, 0.645),
    "40x 0.8 air": Microscope(0.8, 0.52, 0.1625),
    "60x 1.2 water": Microscope(1.2, 0.52, 0.108, 1.333),
    "60x 1.3 oil": Microscope(1.3, 0.52, 0.108, 1.515),
}


@pytest.fixture(params=LENSES)
def lens(request):
    return LENSES[request.param]


def axis_width(kernel):
    """Return twice the standard deviation along an axis, in px."""
    at = np.arange(len(kernel)) - len(kernel) // 2
    return 2 * np.sqrt((kernel.sum(axis=0) * at**2).sum())


@pytest.mark.parametrize("radius", [0.0, 0.7, 3.0, 9.5, 40.0])
def test_kernel_keeps_all_light_and_looks_the_same_from_all_sides(lens, radius):
    kernel = lens.kernel(radius)
    assert kernel.sum() == pytest.approx(1)
    assert kernel.min() >= 0
    assert len(kernel) % 2 == 1
    np.testing.assert_allclose(kernel, kernel.T, atol=1e-12)
    np.testing.assert_allclose(kernel, kernel[::-1, ::-1], atol=1e-12)


def test_in_focus_a_small_aperture_makes_the_airy_disc():
    lens = Microscope(0.1, 0.5, 0.2)
    kernel = lens.kernel(0.0)
    middle = len(kernel) // 2
    profile = kernel[middle, middle:] / kernel[middle, middle]
    v = 2 * np.pi * 0.1 / 0.5 * 0.2 * np.arange(1, len(profile))
    np.testing.assert_allclose(profile[1:30], ((2 * j1(v) / v) ** 2)[:29], atol=3e-3)
    assert lens.airy_radius == pytest.approx(0.61 * 0.5 / 0.1 / 0.2)
    assert profile[15] < 2e-3


def test_on_the_axis_light_falls_with_the_defocus_as_theory_says():
    lens = Microscope(0.2, 0.5, 0.2)
    # Born and Wolf 8.8: (sin(u / 4) / (u / 4))^2 with u = k z NA^2 / n.
    for z in (2.0, 5.0, 9.0):
        quarter = 2 * np.pi / 0.5 * z * 0.2**2 / 4
        seen, focused = lens.kernel(lens.blur_radius(z)), lens.kernel(0.0)
        fall = seen[len(seen) // 2, len(seen) // 2] / focused[len(focused) // 2, len(focused) // 2]
        assert fall == pytest.approx((np.sin(quarter) / quarter) ** 2, abs=0.03)


def test_spots_grow_with_defocus_and_are_at_last_as_wide_as_the_rays_say(lens):
    widths = [axis_width(lens.kernel(r)) for r in (0, 1, 2, 4, 8, 16, 32)]
    assert (np.diff(widths) > 0).all()
    assert axis_width(lens.kernel(40.0)) == pytest.approx(40.0, rel=0.05)


def test_small_steps_of_the_radius_change_little_even_where_kernels_become_larger(lens):
    for radius in np.arange(5.0, 6.0, 0.1):
        one, other = lens.kernel(radius), lens.kernel(radius + 0.02)
        margin = (len(other) - len(one)) // 2
        assert np.abs(np.pad(one, margin) - other).sum() < 0.04


def test_um_become_px_and_um_again(lens):
    z = np.linspace(0, 30, 7)
    radii = lens.blur_radius(z)
    assert (np.diff(radii) > 0).all()
    np.testing.assert_allclose(lens.defocus_um(radii), z, rtol=1e-12)
    np.testing.assert_allclose(lens.blur_radius(-z), radii)


def test_small_apertures_blur_by_z_times_na():
    lens = Microscope(0.1, 0.5, 0.5)
    assert lens.blur_radius(50.0) == pytest.approx(50 * 0.1 / 0.5, rel=0.01)
    assert Microscope(0.5, 0.5, 0.5).depth_of_field_um == pytest.approx(2.0)


def test_wide_pixels_see_the_same_spot(lens):
    wide = seen_with_pixels(lens, 2, 8.0)
    assert wide.max_scale == 8
    assert wide.defocus_um(4.0) == pytest.approx(lens.defocus_um(8.0))
    assert limited(lens, 5.0).max_scale == 5


def test_diffraction_does_not_count_twice():
    assert softness_beside(LENSES["40x 0.8 air"], 0.35) == 0
    coarse = Microscope(0.8, 0.52, 0.8)
    left = softness_beside(coarse, 0.35)
    assert left**2 + coarse.softness**2 == pytest.approx(0.35**2)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"numerical_aperture": 1.2}, "below the refractive index, 1 here"),
        ({"numerical_aperture": 0}, "numerical_aperture is 0"),
        ({"wavelength_um": -0.5}, "wavelength_um is -0.5"),
        ({"wavelength_um": 520}, "wavelength_um is 520; .* 0.52 for 520 nm"),
        ({"pixel_size_um": float("inf")}, "pixel_size_um is inf"),
        ({"refractive_index": 0.9}, "refractive_index is 0.9"),
        ({"specimen": "cells"}, "specimen is 'cells'"),
        ({"max_radius": 0.5}, "max_radius is 0.5"),
    ],
)
def test_impossible_microscopes_are_refused(given, told):
    usual = {"numerical_aperture": 0.8, "wavelength_um": 0.52, "pixel_size_um": 0.1}
    with pytest.raises(ValueError, match=told):
        Microscope(**usual | given)


def test_pixels_of_the_camera_in_place_of_those_of_the_specimen_are_told():
    assert "27 times as wide as the Airy disc" in Microscope(
        1.3, 0.52, 6.5, 1.515
    ).remark_on_pixels(None)
    assert Microscope(1.3, 0.52, 0.1, 1.515).remark_on_pixels(None) is None
    assert Microscope(0.75, 0.55, 4.0).remark_on_pixels(None) is None  # a small level of a slide


@pytest.mark.parametrize(
    "text", ["microscope:0.8:0.52:0.1625:1", "microscope:1.3:0.52:0.108:1.515:points"]
)
def test_text_says_the_whole_microscope(text):
    lens = psf_from_text(text)
    assert isinstance(lens, PSFFamily)
    assert psf_text(lens) == text


@pytest.mark.parametrize("text", ["microscope", "microscope:0.8:0.52", "microscope:a:b:c"])
def test_text_without_the_numbers_is_refused(text):
    with pytest.raises(ValueError, match="microscope:NA:WAVELENGTH:PIXEL"):
        psf_from_text(text)


def test_pixels_much_finer_than_the_airy_disc_make_no_endless_kernels():
    assert len(Microscope(0.1, 0.6, 0.05).kernel(0.0)) < 150
