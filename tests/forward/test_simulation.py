import numpy as np
import pytest
from scipy.ndimage import convolve

from napari_defocus import Disc, simulate_defocus


@pytest.mark.parametrize("radius", [0.5, 1.0, 3.3, 8.0])
def test_uniform_blur_is_a_convolution(clouds, radius):
    blurred = simulate_defocus(clouds, np.full(clouds.shape, radius))
    # Kernels between two steps of 0.05 px are interpolated; these are steps.
    expected = convolve(clouds.astype(float), Disc().kernel(radius), mode="reflect")
    np.testing.assert_allclose(blurred, expected, atol=1e-5)


@pytest.mark.parametrize("radius", [0.77, 2.02, 4.4444, 7.987])
def test_radius_between_the_steps_is_interpolated(clouds, radius):
    blurred = simulate_defocus(clouds, np.full(clouds.shape, radius))
    expected = convolve(clouds.astype(float), Disc().kernel(radius), mode="reflect")
    np.testing.assert_allclose(blurred, expected, atol=2e-3)


def test_no_blur_changes_nothing(astronaut):
    np.testing.assert_array_equal(simulate_defocus(astronaut, np.zeros((160, 160))), astronaut)


def test_every_pixel_has_the_blur_of_its_own_radius(clouds, ramp):
    varying = simulate_defocus(clouds, ramp)
    for column in (0, 40, 159):
        uniform = simulate_defocus(clouds, np.full(clouds.shape, ramp[0, column]))
        np.testing.assert_allclose(varying[:, column], uniform[:, column], atol=1e-6)


@pytest.mark.parametrize("radius", [1.0, 5.0])
def test_blur_keeps_the_brightness(radius):
    blurred = simulate_defocus(np.full((30, 40), 0.7), np.full((30, 40), radius))
    np.testing.assert_allclose(blurred, 0.7, rtol=1e-5)


def test_flipped_and_transposed_pictures_are_blurred_alike(clouds, ramp):
    upright = simulate_defocus(clouds, ramp)
    for turn in (np.flipud, np.fliplr, np.transpose):
        np.testing.assert_allclose(
            simulate_defocus(turn(clouds), turn(ramp)), turn(upright), atol=1e-6
        )


def test_channels_are_blurred_each_on_its_own(astronaut):
    radius = np.full((160, 160), 3.0)
    colour = simulate_defocus(astronaut, radius)
    assert colour.shape == (160, 160, 3)
    assert colour.dtype == np.float32
    for channel in range(3):
        alone = simulate_defocus(astronaut[..., channel], radius)
        np.testing.assert_allclose(colour[..., channel], alone, atol=1e-6)


def test_opacity_is_left_out(astronaut):
    rgba = np.dstack([astronaut, np.zeros((160, 160), np.float32)])
    radius = np.full((160, 160), 2.0)
    np.testing.assert_array_equal(
        simulate_defocus(rgba, radius), simulate_defocus(astronaut, radius)
    )


class _Comet:
    """A PSF that is no disc: all light goes `scale` px to the right."""

    max_scale = 4.0
    scale_name = "shift (px)"

    def kernel(self, scale):
        kernel = np.zeros((9, 9))
        kernel[4, 4 + round(scale)] = 1.0
        return kernel


def test_psf_is_not_turned_around():
    point = np.zeros((11, 11))
    point[5, 4] = 1.0
    moved = simulate_defocus(point, np.full((11, 11), 3.0), psf=_Comet())
    assert np.argwhere(moved == 1).tolist() == [[5, 7]]


@pytest.mark.parametrize("variance", [1e-6, 1e-3])
def test_noise_has_the_variance_that_was_asked_for(variance):
    grey = np.full((200, 200, 3), 0.5)
    noisy = simulate_defocus(grey, np.zeros((200, 200)), noise_variance=variance, rng=0)
    noise = noisy - 0.5
    # 40,000 samples a channel: the variance's own spread is 0.7 %.
    np.testing.assert_allclose(noise.var(axis=(0, 1)), variance, rtol=0.03)
    assert abs(noise.mean()) < 5 * np.sqrt(variance / noise.size)
    correlation = np.corrcoef(noise.reshape(-1, 3).T) - np.eye(3)
    assert np.abs(correlation).max() < 0.03


def test_noise_is_that_of_its_seed():
    grey, still = np.full((20, 20), 0.5), np.zeros((20, 20))
    first, again, other, drawn = (
        simulate_defocus(grey, still, noise_variance=1e-3, rng=rng)
        for rng in (3, 3, 4, np.random.default_rng(3))
    )
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, drawn)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(
    "blur_map",
    [
        np.zeros((30, 41)),
        np.zeros((40, 30)),
        np.zeros(30),
        3.0,
        np.zeros((30, 40, 1)),
        np.full((30, 40), -0.1),
        np.full((30, 40), 64.01),
        np.full((30, 40), np.nan),
        np.full((30, 40), np.inf),
    ],
)
def test_map_of_another_shape_or_beyond_the_domain_is_a_value_error(blur_map):
    with pytest.raises(ValueError, match="blur_map has"):
        simulate_defocus(np.zeros((30, 40)), blur_map)


@pytest.mark.parametrize("dtype", [complex, object, "U3"])
def test_map_that_is_no_number_is_a_type_error(dtype):
    with pytest.raises(TypeError, match="blur_map has dtype"):
        simulate_defocus(np.zeros((30, 40)), np.zeros((30, 40), int).astype(dtype))


@pytest.mark.parametrize("variance", [-1e-6, np.nan, np.inf])
def test_noise_variance_is_a_finite_number_from_0_up(variance):
    with pytest.raises(ValueError, match="noise_variance is"):
        simulate_defocus(np.zeros((30, 40)), np.zeros((30, 40)), noise_variance=variance)


def test_largest_radius_of_a_family_is_within_its_domain():
    for largest in (3.07, 8.0):
        blurred = simulate_defocus(np.ones((30, 40)), np.full((30, 40), largest), psf=Disc(largest))
        np.testing.assert_allclose(blurred, 1, rtol=1e-5)


def test_picture_and_map_are_left_as_they_were(clouds, ramp):
    picture, radii = clouds.copy(), ramp.copy()
    simulate_defocus(picture, radii, noise_variance=1e-4, rng=0)
    np.testing.assert_array_equal(picture, clouds)
    np.testing.assert_array_equal(radii, ramp)
