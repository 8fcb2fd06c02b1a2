"""Results as files: values keep what they are, drawings show it."""

import io
import json

import numpy as np
import pytest
import tifffile
from PIL import Image

from napari_defocus.files import write_results
from napari_defocus.results import (
    blur_map_png,
    blur_map_tiff,
    confidence_tiff,
    mask_png,
    overlay_png,
)


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
