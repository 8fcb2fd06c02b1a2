"""Results as files: values keep what they are, drawings show it."""

import io
import json

import numpy as np
import pytest
import tifffile
from PIL import Image

from napari_defocus.core.writing import write_results
from napari_defocus.io.encoders import (
    blur_map_png,
    blur_map_tiff,
    confidence_tiff,
    depth_png,
    depth_tiff,
    description_in_tiff,
    holds,
    mask_png,
    overlay_png,
    picture_png,
    settings_in_tiff,
    values_in_tiff,
)
from napari_defocus.io.pictures import read_picture


@pytest.fixture
def ramp():
    return np.tile(np.linspace(0, 8, 60, dtype=np.float32), (50, 1))


def test_blur_map_tiff_holds_the_values_and_says_what_they_are(tmp_path, ramp):
    path = tmp_path / "map.tif"
    write_results({path: blur_map_tiff(ramp, {"smoothness": 20.0})})
    with tifffile.TiffFile(path) as tiff:
        page = tiff.pages[0]
        np.testing.assert_array_equal(page.asarray(), ramp)
        assert page.dtype == np.float32
        assert page.compression.name == "ADOBE_DEFLATE"
        description = json.loads(page.description)
    assert description["unit"] == "px"
    assert description["version"]
    assert description["settings"] == {"smoothness": 20.0}


def test_blur_map_png_uses_the_same_colours_for_the_same_radius(ramp):
    pictures = [
        np.asarray(Image.open(io.BytesIO(blur_map_png(radius, 8.0)))).astype(int)
        for radius in (ramp, ramp / 2)
    ]
    middle = pictures[0].shape[0] // 2
    left = 20
    width = 480
    np.testing.assert_array_equal(
        pictures[0][middle, left + width // 4], pictures[1][middle, left + width // 2]
    )


@pytest.mark.parametrize("shape", [(3, 3), (3, 4000), (4000, 3), (700, 900), (3000, 2000)])
def test_blur_map_png_has_a_sensible_size(shape):
    drawn = Image.open(io.BytesIO(blur_map_png(np.zeros(shape), 8.0)))
    assert 140 <= min(drawn.size) <= max(drawn.size) <= 1800


def test_what_is_not_trusted_is_grey_and_told():
    blur_map = np.full((300, 400), 4.0)
    blur_map[100:200, 100:200] = np.nan
    drawn = Image.open(io.BytesIO(blur_map_png(blur_map, 8.0, min_confidence=0.5)))
    grey = np.ptp(np.asarray(drawn.convert("RGB"))[150:250, 150:250].astype(int), axis=2)
    assert grey.max() == 0
    silent = Image.open(io.BytesIO(blur_map_png(blur_map, 8.0)))
    assert drawn.height > silent.height, "there is a line about it below"


def test_confidence_tiff_holds_the_values_and_says_what_they_are(tmp_path):
    confidence = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
    path = tmp_path / "sure.tif"
    path.write_bytes(confidence_tiff(confidence, {"psf": "disc"}))
    with tifffile.TiffFile(path) as tiff:
        np.testing.assert_array_equal(tiff.asarray(), confidence)
        description = json.loads(tiff.pages[0].description)
    assert description["quantity"] == "confidence of the blur map"
    assert description["settings"] == {"psf": "disc"}


def test_mask_png_is_black_and_white():
    mask = np.eye(8, dtype=np.uint8)
    drawn = Image.open(io.BytesIO(mask_png(mask)))
    assert drawn.mode == "L"
    np.testing.assert_array_equal(np.asarray(drawn), 255 * mask)


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_overlay_keeps_what_is_in_focus_and_dims_the_rest(channels, dtype):
    full = np.iinfo(dtype).max
    image = np.full((40, 40, *channels), full // 2, dtype)
    mask = np.zeros((40, 40), np.uint8)
    mask[10:30, 10:30] = 1
    drawn = np.asarray(Image.open(io.BytesIO(overlay_png(image, mask)))).astype(int)
    assert drawn.shape == (40, 40, 3)
    assert np.abs(drawn[20, 20] - 127).max() <= 1
    assert drawn[5, 5].max() < 60
    assert np.ptp(drawn[10, 20]) > 100, "the outline has a colour of its own"


# Distances and pictures.


def colors_of(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).reshape(-1, 3)


def test_settings_are_found_again_in_the_file_that_says_them(tmp_path, ramp):
    write_results({tmp_path / "map.tif": blur_map_tiff(ramp, {"psf": "polygon:6"})})
    assert settings_in_tiff(tmp_path / "map.tif") == {"psf": "polygon:6"}
    tifffile.imwrite(tmp_path / "other.tif", ramp, description="anything")
    (tmp_path / "text.tif").write_text("no picture")
    for name in ("other.tif", "text.tif", "none.tif", "."):
        assert settings_in_tiff(tmp_path / name) == {}


@pytest.mark.parametrize("shape", [(6, 7), (1, 6, 7), (3, 6, 4), (2, 3, 6, 7)])
def test_stacks_of_maps_keep_their_values_and_shape(tmp_path, shape):
    values = np.random.default_rng(0).uniform(0, 8, shape).astype(np.float32)
    values.flat[3] = np.nan
    (tmp_path / "map.tif").write_bytes(blur_map_tiff(values, {}))
    again = values_in_tiff(tmp_path / "map.tif")
    assert again.dtype == np.float32
    np.testing.assert_array_equal(again, values)


def test_file_says_what_it_holds(tmp_path, ramp):
    for content, held in [
        (blur_map_tiff(ramp, {}, "length (px)"), "blur map"),
        (confidence_tiff(ramp / 8, {}), "confidence"),
        (depth_tiff(ramp, {}), None),
    ]:
        (tmp_path / "any.tif").write_bytes(content)
        assert holds(description_in_tiff(tmp_path / "any.tif")) == held
    tifffile.imwrite(tmp_path / "any.tif", ramp, description='{"quantity": "defocus blur"}')
    assert holds(description_in_tiff(tmp_path / "any.tif")) is None


def test_what_made_a_map_may_be_numbers_of_numpy(tmp_path, ramp):
    made = {"noise_variance": np.float32(0.5), "rows": np.arange(3)}
    (tmp_path / "map.tif").write_bytes(blur_map_tiff(ramp, {}, made=made))
    described = description_in_tiff(tmp_path / "map.tif")
    assert (described["noise_variance"], described["rows"]) == (0.5, [0, 1, 2])


def test_depth_tiff_keeps_what_is_infinite_or_not_known(tmp_path):
    depth = np.array([[1.5, np.inf], [np.nan, 2.5]], np.float32)
    (tmp_path / "d.tif").write_bytes(depth_tiff(depth, {}))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "d.tif"), depth)


def test_depth_png_shows_what_is_infinite_or_not_known_in_colours_of_their_own():
    depth = np.tile(np.linspace(1, 2, 400, dtype=np.float32), (300, 1))
    plain = depth_png(depth)
    depth[:150, :200] = np.inf
    infinite = depth_png(depth)
    depth[150:, :200] = np.nan
    both = depth_png(depth, min_confidence=0.5)
    light_blue, grey = [153, 204, 242], [89, 89, 89]
    for png, colors in [(plain, []), (infinite, [light_blue]), (both, [light_blue, grey])]:
        for color in (light_blue, grey):
            drawn = (np.abs(colors_of(png).astype(int) - color).max(axis=1) <= 2).mean()
            assert (drawn > 0.1) == (color in colors)
    heights = [Image.open(io.BytesIO(png)).height for png in (plain, infinite, both)]
    assert heights[0] < heights[1] < heights[2], "a line below for each"


def test_few_far_pixels_do_not_change_the_colours_of_the_others():
    depth = np.tile(np.linspace(1, 2, 400, dtype=np.float32), (300, 1))
    far = depth.copy()
    far[:20, :20] = 1e6
    a, b = (np.asarray(Image.open(io.BytesIO(depth_png(d))).convert("RGB")) for d in (depth, far))
    middle = np.s_[150:250, 100:400]
    assert np.abs(a[middle].astype(int) - b[middle].astype(int)).max() < 12


@pytest.mark.parametrize("value", [np.inf, np.nan, 3.0])
def test_depth_png_of_a_single_value(value):
    assert Image.open(io.BytesIO(depth_png(np.full((5, 6), value)))).width > 400


@pytest.mark.parametrize(
    ("dtype", "depth"), [(bool, 8), (np.uint8, 8), (np.uint16, 16), (np.float32, 16)]
)
@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_picture_png_has_the_levels_of_its_source(tmp_path, dtype, depth, channels):
    picture = np.linspace(-0.1, 1.1, 12 * 8 * int(np.prod(channels))).reshape(12, 8, *channels)
    path = tmp_path / "p.png"
    path.write_bytes(picture_png(picture, np.zeros((12, 8, *channels), dtype)))
    read = read_picture(path)
    assert read.dtype.itemsize * 8 == depth
    np.testing.assert_allclose(read / (2**depth - 1), np.clip(picture, 0, 1), atol=0.51 / 2**depth)
