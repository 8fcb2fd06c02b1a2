import io

import numpy as np
import pytest
from PIL import Image

from napari_defocus import ShotNoise, estimate_noise_variance, estimate_shot_noise

TEXTURES = pytest.mark.parametrize("texture", ["grass", "gravel", "clouds"])


@TEXTURES
@pytest.mark.parametrize("radius", [2, 3, 5])
@pytest.mark.parametrize("variance", [1e-5, 1e-4, 1e-3])
def test_noise_of_a_blurred_texture_is_found(request, defocused, texture, radius, variance):
    picture = defocused(request.getfixturevalue(texture), radius, variance)
    # At 1e-5 and 2 px the finest texture is of the order of the noise.
    factor = 1.9 if (radius, variance) == (2, 1e-5) else 1.25
    assert 1 / factor < estimate_noise_variance(picture) / variance < factor


@TEXTURES
def test_noise_of_a_picture_that_is_half_sharp_is_found(request, defocused, texture):
    radii = np.broadcast_to(np.where(np.arange(160) < 60, 0.5, 4), (160, 160))
    picture = defocused(request.getfixturevalue(texture), radii, 1e-4)
    assert 1 / 1.25 < estimate_noise_variance(picture) / 1e-4 < 1.25


@TEXTURES
def test_sharp_texture_passes_for_little_noise(request, texture):
    # Nothing tells fine texture from noise. Before its finest details bounded the estimate,
    # this was up to 1e-2.
    assert estimate_noise_variance(request.getfixturevalue(texture)) < 4e-3


@pytest.mark.parametrize("radius", [3, 5])
def test_noise_before_jpeg_is_found_to_a_factor_of_2(clouds, defocused, radius):
    picture = defocused(clouds, radius, 1e-4)
    encoded = io.BytesIO()
    Image.fromarray(np.clip(np.rint(255 * picture), 0, 255).astype(np.uint8)).save(
        encoded, "JPEG", quality=90
    )
    assert 0.5 < estimate_noise_variance(np.asarray(Image.open(encoded))) / 1e-4 < 2


def test_clipped_half_does_not_change_the_noise(clouds, defocused):
    picture = defocused(clouds, 3, 1e-4)
    picture[:, 90:] = 1.0
    assert 1 / 1.3 < estimate_noise_variance(picture) / 1e-4 < 1.3


def test_shot_noise_grows_as_it_did(clouds, defocused):
    sharp = np.clip(clouds + np.linspace(-0.3, 0.3, 160), 0.02, 1)
    rng = np.random.default_rng(0)
    blurred = defocused(np.tile(sharp, (2, 2)), 4, 0)
    noisy = blurred + rng.normal(size=blurred.shape) * np.sqrt(1e-5 + 2e-4 * blurred)
    found = estimate_shot_noise(noisy)
    assert found.gain == pytest.approx(2e-4, rel=0.35)
    assert found.variance_at(np.array([0.5]))[0] == pytest.approx(1.1e-4, rel=0.25)


def test_constant_noise_hardly_grows(clouds, defocused):
    found = estimate_shot_noise(defocused(clouds, 4, 1e-4))
    assert found.variance_at(np.array([0.8]))[0] < 1.6 * found.variance_at(np.array([0.2]))[0]


@pytest.mark.parametrize(
    ("values", "words"),
    [((-1, 1), "read_variance is -1"), ((1, np.nan), "gain is nan"), ((0, 0), "both 0")],
)
def test_impossible_shot_noise_is_a_value_error(values, words):
    with pytest.raises(ValueError, match=words):
        ShotNoise(*values)


def test_shot_noise_of_a_constant_picture_is_a_value_error():
    with pytest.raises(ValueError, match="no noise"):
        estimate_shot_noise(np.zeros((60, 60)))


@pytest.mark.parametrize("variance", [1e-4, 1e-3])
def test_noise_of_a_colour_picture_is_that_of_its_luminance(astronaut, defocused, variance):
    in_luminance = variance * (0.299**2 + 0.587**2 + 0.114**2)
    ratio = estimate_noise_variance(defocused(astronaut, 3, variance)) / in_luminance
    assert 1 / 1.25 < ratio < 1.25


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
