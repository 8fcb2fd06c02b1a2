"""What counts as a picture, and how its numbers become intensities."""

from pathlib import Path

import numpy as np
import pytest

from napari_defocus import (
    estimate_blur_map,
    estimate_candidates,
    estimate_noise_variance,
    label_blur_map,
    segment_in_focus,
    simulate_defocus,
)
from napari_defocus.core.image import prepare_image


def _label(image, **options):
    return label_blur_map(estimate_candidates(np.zeros((30, 40))), image, **options)


def _segment(image, **options):
    return segment_in_focus(estimate_candidates(np.zeros((30, 40))), image, **options)


def _simulate(image, **options):
    return simulate_defocus(image, np.zeros((30, 40)), **options)


TAKES_A_PICTURE = pytest.mark.parametrize(
    "function",
    [
        estimate_candidates,
        estimate_noise_variance,
        estimate_blur_map,
        _label,
        _segment,
        _simulate,
    ],
)


def intensities(image, **options):
    """What a public function sees: a picture that is blurred nowhere is only scaled."""
    return simulate_defocus(image, np.zeros(np.shape(image)[:2]), **options)


@pytest.mark.parametrize(
    ("dtype", "black", "white"),
    [
        (np.uint8, 0, 255),
        (np.int8, -128, 127),
        (np.uint16, 0, 65535),
        (np.int16, -32768, 32767),
        (np.uint32, 0, 2**32 - 1),
        (np.int64, -(2**63), 2**63 - 1),
        (bool, False, True),
        (np.float16, 0, 1),
        (np.float32, 0, 1),
        (np.float64, 0, 1),
    ],
)
def test_range_of_the_dtype_becomes_0_to_1(dtype, black, white):
    image = np.array([[black, white, black]] * 3, dtype)
    np.testing.assert_allclose(intensities(image), [[0, 1, 0]] * 3, atol=1e-7)


def test_middle_grey_of_8_bits_and_16_bits_and_float_is_the_same():
    middle = [
        np.full((3, 3), 51, np.uint8),
        np.full((3, 3), 13107, np.uint16),
        np.full((3, 3), 0.2),
    ]
    for image in middle:
        np.testing.assert_allclose(intensities(image), 0.2, rtol=1e-6)


def test_intensity_range_takes_the_place_of_the_dtype_range():
    twelve_bits = np.array([[0, 2048, 4096]] * 3, np.uint16)
    scaled = intensities(twelve_bits, intensity_range=(0, 4096))
    np.testing.assert_allclose(scaled, [[0, 0.5, 1]] * 3, rtol=1e-6)
    floats = np.array([[-1.0, 0.0, 3.0]] * 3)
    scaled = intensities(floats, intensity_range=(-1, 3))
    np.testing.assert_allclose(scaled, [[0, 0.25, 1]] * 3, rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.uint32, np.int64, np.float64])
def test_narrow_range_far_from_zero_keeps_its_steps(dtype):
    counts = (2**31 + np.arange(100)).reshape(10, 10).astype(dtype)
    scaled = intensities(counts, intensity_range=(2**31, 2**31 + 100))
    np.testing.assert_allclose(scaled, np.arange(100).reshape(10, 10) / 100, atol=1e-6)


def test_luminance_is_that_of_bt_601(astronaut):
    luminance = prepare_image(astronaut).luminance
    expected = 0.299 * astronaut[..., 0] + 0.587 * astronaut[..., 1] + 0.114 * astronaut[..., 2]
    np.testing.assert_allclose(luminance, expected, atol=1e-6)


def test_colour_is_analysed_as_its_luminance(astronaut):
    colour = astronaut[:60, :60]
    grey = colour @ np.array([0.299, 0.587, 0.114])
    of_colour, of_grey = (
        estimate_candidates(picture, noise_variance=1e-5) for picture in (colour, grey)
    )
    # Single precision, on log-likelihoods of some thousands.
    np.testing.assert_allclose(of_colour.curve, of_grey.curve, rtol=1e-4, atol=0.05)


def test_opacity_is_no_colour(astronaut):
    opaque = np.dstack([astronaut, np.full((160, 160), 0.5, np.float32)])
    np.testing.assert_array_equal(prepare_image(opaque).color, prepare_image(astronaut).color)
    assert prepare_image(opaque).opaque is None


def test_zero_opacity_marks_transparent_pixels():
    image = np.full((4, 5, 4), 255, np.uint8)
    image[1, 2, 3] = 0
    image[2, 2, 3] = 1
    opaque = prepare_image(image).opaque
    assert not opaque[1, 2]
    assert opaque.sum() == 19


@TAKES_A_PICTURE
@pytest.mark.parametrize(
    "dtype", [object, np.complex64, "U3", "S3", "datetime64[s]", "timedelta64[s]"]
)
def test_what_is_no_number_is_a_type_error(function, dtype):
    with pytest.raises(TypeError, match=r"image has dtype .* takes a real one"):
        function(np.zeros((30, 40), int).astype(dtype))


@TAKES_A_PICTURE
@pytest.mark.parametrize("path", ["photo.jpg", Path("photo.jpg")])
def test_path_in_place_of_a_picture_is_told_how_to_read_it(function, path):
    with pytest.raises(TypeError, match=r"image has dtype .* read_picture reads a file"):
        function(path)


@TAKES_A_PICTURE
@pytest.mark.parametrize(
    "shape",
    [(40,), (5, 30, 40, 3), (30, 40, 1), (30, 40, 2), (30, 40, 5), (3, 30, 40), ()],
)
def test_another_number_of_axes_or_channels_is_a_value_error(function, shape):
    with pytest.raises(ValueError, match=r"image has shape .* takes \(H, W\)"):
        function(np.zeros(shape))


@TAKES_A_PICTURE
@pytest.mark.parametrize("shape", [(0, 0), (0, 40), (30, 2), (2, 40, 3), (1, 1)])
def test_empty_and_tiny_pictures_are_a_value_error(function, shape):
    with pytest.raises(ValueError, match=r"image is .* takes at least 3 px a side"):
        function(np.zeros(shape))


@TAKES_A_PICTURE
@pytest.mark.parametrize("value", [np.inf, -np.inf])
def test_infinity_is_a_value_error(function, value):
    image = np.zeros((30, 40))
    image[7, 7] = value
    with pytest.raises(ValueError, match="image has infinite values"):
        function(image)


@TAKES_A_PICTURE
@pytest.mark.parametrize(
    "intensity_range",
    [(1, 0), (0, 0), (0, np.nan), (0, np.inf), (1, 2, 3), 5, ("dark", "bright"), (None, None)],
)
def test_intensity_range_is_two_increasing_finite_numbers(function, intensity_range):
    with pytest.raises(
        ValueError, match=r"intensity_range is .* takes two finite .* higher one last"
    ):
        function(np.zeros((30, 40)), intensity_range=intensity_range)


@pytest.mark.parametrize("function", [_label, _segment])
def test_picture_of_another_size_than_its_candidates_is_a_value_error(function):
    with pytest.raises(ValueError, match=r"image is 40 x 30 px; these candidates are of .*30 x 40"):
        function(np.zeros((40, 30)))
