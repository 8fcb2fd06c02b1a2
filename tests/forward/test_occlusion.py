import numpy as np
import pytest
from scipy.ndimage import convolve

from napari_defocus import Disc, simulate_defocus
from napari_defocus.forward.occlusion import simulate_layered_defocus

COLUMN = np.broadcast_to(np.arange(60), (60, 60))
NEAR = COLUMN >= 30
DEPTH = np.where(NEAR, 1.0, 3.0)


def before_and_behind(near, far):
    return lambda depth: np.where(depth < 2, near, far)


@pytest.mark.parametrize("radius", [0.0, 1.0, 3.3, 8.0])
def test_scene_of_one_depth_is_blurred_uniformly(astronaut, radius):
    shape = astronaut.shape[:2]
    picture, blur_map = simulate_layered_defocus(
        astronaut, np.full(shape, 7.0), np.full(shape, radius)
    )
    expected = simulate_defocus(astronaut, np.full(shape, radius))
    np.testing.assert_allclose(picture, expected, atol=2e-5)
    np.testing.assert_array_equal(blur_map, np.float32(radius))
    assert picture.dtype == blur_map.dtype == np.float32


@pytest.mark.parametrize("layers", [1, 5, 32])
def test_slanted_surface_has_no_seams(clouds, layers):
    row, column = np.indices(clouds.shape)
    picture, _ = simulate_layered_defocus(
        clouds, row + 0.3 * column, np.full(clouds.shape, 4.0), layers=layers
    )
    expected = simulate_defocus(clouds, np.full(clouds.shape, 4.0))
    np.testing.assert_allclose(picture, expected, atol=1e-5)


def test_blur_that_changes_along_a_surface_is_that_of_each_pixel(clouds, ramp):
    picture, blur_map = simulate_layered_defocus(clouds, ramp, lambda depth: depth, layers=64)
    np.testing.assert_array_equal(blur_map, ramp.astype(np.float32))
    # 64 layers are 0.03 px of radius apart. The picture's own contrast is 0.15.
    assert np.abs(picture - simulate_defocus(clouds, ramp)).mean() < 1e-3


@pytest.mark.parametrize("layers", [2, 3, 32])
def test_sharp_foreground_has_no_halo(layers):
    picture, _ = simulate_layered_defocus(
        np.where(NEAR, 1.0, 0.25), DEPTH, before_and_behind(0, 6), layers=layers
    )
    np.testing.assert_allclose(picture, np.where(NEAR, 1.0, 0.25), atol=1e-5)


def test_background_blurs_with_itself_alone(clouds):
    texture = clouds[:60, :60]
    picture, _ = simulate_layered_defocus(
        np.where(NEAR, 1.0, texture), DEPTH, before_and_behind(0, 6)
    )
    # What the foreground hides has the colour of the nearest column that is seen.
    whole = np.where(NEAR, texture[:, 29:30], texture)
    expected = convolve(whole, Disc().kernel(6), mode="reflect")
    np.testing.assert_allclose(picture[:, :30], expected[:, :30], atol=1e-4)
    np.testing.assert_allclose(picture[:, 30:], 1, atol=1e-6)


def test_blurred_foreground_is_half_transparent_at_its_edge(clouds):
    texture = clouds[:60, :60]
    picture, blur_map = simulate_layered_defocus(
        np.where(NEAR, 1.0, texture), DEPTH, before_and_behind(6, 0)
    )
    cover = convolve(NEAR.astype(float), Disc().kernel(6), mode="reflect")
    whole = np.where(NEAR, texture[:, 29:30], texture)
    np.testing.assert_allclose(picture, cover + (1 - cover) * whole, atol=1e-4)
    assert 0.4 < cover[30, 29] < 0.5 < cover[30, 30] < 0.6
    np.testing.assert_array_equal(blur_map, np.where(NEAR, 6, 0))


@pytest.mark.parametrize("layers", [5, 20, 100])
def test_slanted_foreground_hides_as_much_as_an_upright_one(layers):
    slanted = np.where(NEAR, COLUMN.T / 100, 10.0)
    radii = before_and_behind(5, 0)
    picture, _ = simulate_layered_defocus(NEAR * 1.0, slanted, radii, layers=layers)
    upright, _ = simulate_layered_defocus(NEAR * 1.0, DEPTH, radii)
    np.testing.assert_allclose(picture, upright, atol=1e-5)


def test_what_shows_through_is_what_lies_behind_and_not_what_is_beside():
    # Blue far away on the left, red near in the middle, green between them on the right.
    place = np.select([COLUMN < 20, COLUMN < 40], [0, 1], 2)
    color, depth = np.eye(3)[[2, 0, 1]][place], np.array([9.0, 1.0, 5.0])[place]
    picture, _ = simulate_layered_defocus(color, depth, np.array([0.0, 4.0, 0.0])[place])
    red, green, blue = np.moveaxis(picture, 2, 0)
    assert red[:, [19, 20, 39, 40]].min() > 0.4
    np.testing.assert_allclose(green[:, :29], 0, atol=1e-5)
    np.testing.assert_allclose(blue[:, 31:], 0, atol=1e-5)
    np.testing.assert_allclose(red + green + blue, 1, atol=1e-5)


def test_what_lies_farther_still_does_not_shine_through_the_next_layer():
    # A dark wall before a dark one, of different blur, and a white one much farther away.
    place = np.select([COLUMN < 20, COLUMN < 55], [0, 1], 2)
    depth = np.array([1.0, 2.0, 9.0])[place]
    for before, behind in ((1.0, 4.0), (4.0, 1.0), (2.0, 3.0)):
        radii = np.array([before, behind, 1.0])[place]
        picture, _ = simulate_layered_defocus(np.where(place == 2, 1.0, 0.1), depth, radii)
        np.testing.assert_allclose(picture[:, :40], 0.1, atol=1e-5)


@pytest.mark.parametrize("linearize", [None, "srgb"])
@pytest.mark.parametrize("layers", [1, 7, 40])
def test_white_scene_stays_white(clouds, ramp, layers, linearize):
    depth = np.where(clouds > 0.5, ramp, 10 * clouds)
    picture, _ = simulate_layered_defocus(
        np.ones(depth.shape), depth, 4 + 4 * np.sin(depth), layers=layers, linearize=linearize
    )
    np.testing.assert_allclose(picture, 1, atol=1e-5)


def test_colours_stay_between_the_darkest_and_the_brightest(astronaut, clouds):
    picture, _ = simulate_layered_defocus(
        astronaut, clouds, lambda depth: 8 * (depth - depth.min()) / np.ptp(depth)
    )
    assert picture.min() >= astronaut.min() - 1e-5
    assert picture.max() <= astronaut.max() + 1e-5


def test_light_is_mixed_and_not_its_encoding():
    scene = NEAR * 1.0, DEPTH, np.full((60, 60), 5.0)
    light, _ = simulate_layered_defocus(*scene)
    encoded, _ = simulate_layered_defocus(*scene, linearize="srgb")
    lit = light > 0.0031308
    np.testing.assert_allclose(encoded[lit], 1.055 * light[lit] ** (1 / 2.4) - 0.055, atol=1e-5)
    np.testing.assert_allclose(encoded[~lit], 12.92 * light[~lit], atol=1e-5)


def test_light_that_is_not_blurred_comes_back_as_it_was(astronaut):
    shape = astronaut.shape[:2]
    picture, _ = simulate_layered_defocus(
        astronaut, np.zeros(shape), np.zeros(shape), linearize="srgb"
    )
    np.testing.assert_allclose(picture, astronaut, atol=1e-5)


def test_unknown_depth_is_that_of_the_farther_neighbour():
    depth = DEPTH.copy()
    depth[5:50, 22:30] = np.nan  # beside the foreground, as one of two cameras leaves it
    depth[20:30, 40:50] = np.nan  # within the foreground
    depth[:, :2] = depth[:2] = np.nan  # a border with its corner
    _, blur_map = simulate_layered_defocus(NEAR * 1.0, depth, before_and_behind(0, 6))
    np.testing.assert_array_equal(blur_map, np.where(NEAR, 0, 6))


def test_noise_has_the_variance_that_was_asked_for_and_its_seed():
    noisy, again = (
        simulate_layered_defocus(
            np.full((60, 60, 3), 0.5), DEPTH, DEPTH, noise_variance=1e-4, rng=1, linearize="srgb"
        )[0]
        for _ in range(2)
    )
    np.testing.assert_array_equal(noisy, again)
    np.testing.assert_allclose((noisy - 0.5).var(), 1e-4, rtol=0.06)


def test_picture_depth_and_radii_are_left_as_they_were():
    arrays = [NEAR * 1.0, np.where(COLUMN == 7, np.nan, DEPTH), DEPTH]
    before = [array.copy() for array in arrays]
    simulate_layered_defocus(*arrays)
    for array, old in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, old)


@pytest.mark.parametrize(
    ("depth", "radii", "message"),
    [
        (DEPTH[1:], DEPTH, "depth has shape"),
        (DEPTH * np.inf, DEPTH, "depth has infinite"),
        (DEPTH * np.nan, DEPTH, "depth has .* only NaN"),
        (DEPTH, DEPTH[1:], "radius_of_depth has shape"),
        (DEPTH, 3.0, "radius_of_depth has shape"),
        (DEPTH, -DEPTH, "radius_of_depth has scales"),
        (DEPTH, DEPTH * np.nan, "radius_of_depth has scales"),
        (DEPTH, lambda depth: 30 * depth, "radius_of_depth returned scales"),
        (DEPTH, lambda depth: 3.0, "radius_of_depth returned shape"),
    ],
)
def test_planes_that_do_not_fit_are_value_errors(depth, radii, message):
    with pytest.raises(ValueError, match=message):
        simulate_layered_defocus(NEAR * 1.0, depth, radii)


@pytest.mark.parametrize("name", ["depth", "radius_of_depth"])
def test_planes_that_are_no_numbers_are_type_errors(name):
    planes = {"depth": DEPTH, "radius_of_depth": DEPTH} | {name: DEPTH.astype(complex)}
    with pytest.raises(TypeError, match=f"{name} has dtype"):
        simulate_layered_defocus(NEAR * 1.0, **planes)


@pytest.mark.parametrize(
    ("setting", "error"),
    [
        ({"layers": 0}, ValueError),
        ({"layers": 2.5}, TypeError),
        ({"noise_variance": -1e-6}, ValueError),
        ({"linearize": "rec709"}, ValueError),
        ({"intensity_range": (1, 0)}, ValueError),
        ({"psf": 3}, TypeError),
    ],
)
def test_settings_out_of_range_name_themselves(setting, error):
    with pytest.raises(error, match=next(iter(setting))):
        simulate_layered_defocus(NEAR * 1.0, DEPTH, DEPTH, **setting)
