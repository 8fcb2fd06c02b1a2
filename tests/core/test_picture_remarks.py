"""A picture that can tell little of its blur is not measured without a word."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import napari_defocus
from napari_defocus import read_picture
from napari_defocus.core.picture_remarks import picture_remarks

SAMPLES = Path(napari_defocus.__file__).parent / "samples"


@pytest.fixture
def noise():
    return np.random.default_rng(2).integers(20, 200, (120, 140, 3), dtype=np.uint8)


def test_an_ordinary_picture_has_no_remark(noise):
    noise[:15, :20] = 255  # a lamp, 2 % of it
    assert picture_remarks(noise, 41) == []


@pytest.mark.parametrize("name", ["dandelion.jpg", "brushes.jpg"])
def test_photographs_have_no_remark(name):
    assert picture_remarks(read_picture(SAMPLES / name), 41) == []


@pytest.mark.parametrize("height", [40, 80])
def test_a_picture_of_less_than_two_windows_says_so(noise, height):
    [remark] = picture_remarks(noise[:height], 41)
    assert f"small (140 x {height} px)" in remark


@pytest.mark.parametrize("mask", [np.eye(120) > 0, np.eye(120, dtype=np.uint8) * 3])
def test_a_mask_is_told_from_a_picture(mask):
    [remark] = picture_remarks(mask, 41)
    assert "only 2 different values, like a mask" in remark


@pytest.mark.parametrize("value", [0, 90, 255])
def test_a_flat_picture_says_so(value):
    [remark] = picture_remarks(np.full((120, 140), value, np.uint8), 41)
    assert "All pixels have the same value" in remark


@pytest.mark.parametrize(
    ("white", "dtype"), [(255, np.uint8), (4095, np.uint16), (0.8, np.float32)]
)
def test_a_saturated_picture_says_how_much_of_it_is(noise, white, dtype):
    picture = (noise / 255 * white).astype(dtype)
    picture[:60] = white
    [remark] = picture_remarks(picture, 41)
    assert remark.startswith("50 % of the pixels are saturated")


def test_one_saturated_colour_is_not_a_saturated_picture(noise):
    noise[..., 0] = 255
    assert picture_remarks(noise, 41) == []


def test_what_is_not_known_does_not_count(noise):
    picture = noise.astype(np.float32)
    picture[:30] = np.nan
    assert picture_remarks(picture, 41) == []
    [remark] = picture_remarks(np.full((120, 140), np.nan), 41)
    assert remark == "No pixel is known: all are transparent, NaN or masked."


def part_of_sample():
    with Image.open(SAMPLES / "dandelion.jpg") as whole:
        return whole.crop((200, 100, 400, 300))


@pytest.mark.parametrize("colors", [32, 256])
def test_a_palette_of_colours_is_told(colors):
    with_palette = part_of_sample().quantize(colors).convert("RGB")
    [remark] = picture_remarks(np.asarray(with_palette), 41)
    assert f"only {colors} different colours" in remark
    assert "radii are often too small" in remark


def test_a_toned_picture_has_no_palette():
    grey = np.asarray(part_of_sample().convert("L")).astype(float)
    sepia = np.stack([grey, 0.8 * grey, 0.5 * grey], axis=2).astype(np.uint8)
    assert picture_remarks(sepia, 41) == []


@pytest.mark.parametrize(("quality", "told"), [(20, True), (75, False)])
def test_strong_compression_is_told(quality, told):
    file = BytesIO()
    part_of_sample().save(file, "JPEG", quality=quality)
    with Image.open(file) as compressed:
        remarks = picture_remarks(np.asarray(compressed), 41)
    assert ["compressed strongly" in remark for remark in remarks] == [True] * told
