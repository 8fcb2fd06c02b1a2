import numpy as np
import pytest

from napari_defocus import Disc, estimate_noise_variance

TEXTURES = pytest.mark.parametrize("texture", ["grass", "gravel", "clouds"])


@TEXTURES
@pytest.mark.parametrize("radius", [2, 3, 5])
@pytest.mark.parametrize("variance", [1e-4, 1e-3])
def test_noise_of_a_blurred_texture_is_found(request, defocused, texture, radius, variance):
    picture = defocused(request.getfixturevalue(texture), radius, variance)
    assert 1 / 1.6 < estimate_noise_variance(picture) / variance < 1.6


@TEXTURES
@pytest.mark.parametrize("radius", [2, 3, 5])
def test_little_noise_of_a_blurred_texture_is_found_to_a_factor_of_3(
    request, defocused, texture, radius
):
    # At 1e-5 the texture's own weakest power is of the order of the noise.
    picture = defocused(request.getfixturevalue(texture), radius, 1e-5)
    assert 1 / 3.1 < estimate_noise_variance(picture) / 1e-5 < 3.1


@pytest.mark.parametrize("variance", [1e-4, 1e-3])
def test_noise_of_a_colour_picture_is_that_of_its_luminance(astronaut, defocused, variance):
    in_luminance = variance * (0.299**2 + 0.587**2 + 0.114**2)
    ratio = estimate_noise_variance(defocused(astronaut, 3, variance)) / in_luminance
    assert 1 / 1.8 < ratio < 1.8


@pytest.mark.parametrize("value", [0, 128, 255])
def test_constant_picture_has_no_noise(value):
    assert estimate_noise_variance(np.full((60, 80), value, np.uint8)) == 0


def test_half_the_exposure_has_a_quarter_of_the_variance(clouds, defocused):
    picture = defocused(clouds, 3, 1e-4)
    full, half = estimate_noise_variance(picture), estimate_noise_variance(0.5 * picture)
    np.testing.assert_allclose(half, full / 4, rtol=1e-3)


def test_flipped_and_turned_pictures_have_the_same_noise(clouds, defocused):
    picture = defocused(clouds, 3, 1e-4)
    expected = estimate_noise_variance(picture)
    for turned in (picture[::-1], picture[:, ::-1], picture.T):
        np.testing.assert_allclose(estimate_noise_variance(turned), expected, rtol=1e-3)


def test_intensity_range_scales_the_variance(clouds, defocused):
    picture = defocused(clouds, 3, 1e-4)
    wide = estimate_noise_variance(picture, intensity_range=(0, 10))
    np.testing.assert_allclose(wide, estimate_noise_variance(picture) / 100, rtol=1e-3)


def test_noise_of_a_tiny_picture_is_a_finite_number():
    picture = np.random.default_rng(0).uniform(size=(3, 3))
    assert np.isfinite(estimate_noise_variance(picture))


def test_transparent_half_hardly_changes_the_noise(clouds, defocused):
    picture = defocused(clouds, 3, 1e-4)
    rgba = np.dstack([picture] * 3 + [np.ones_like(picture)])
    rgba[:, 80:, :3] = np.random.default_rng(0).uniform(size=(160, 80, 3))
    rgba[:, 80:, 3] = 0
    # Windows across the border of the opaque part have less power, which draws it down.
    assert 1 / 2.5 < estimate_noise_variance(rgba) / 1e-4 < 1.6


@pytest.mark.parametrize("window", [40, 5, -1])
def test_window_is_checked(window):
    with pytest.raises(ValueError, match=r"window is .* takes an odd number"):
        estimate_noise_variance(np.zeros((60, 60)), window=window)


def test_psf_is_checked():
    with pytest.raises(ValueError, match="psf has a largest scale of 25"):
        estimate_noise_variance(np.zeros((60, 60)), psf=Disc(25))
    with pytest.raises(TypeError, match="psf is None"):
        estimate_noise_variance(np.zeros((60, 60)), psf=None)
