"""A picture that can tell little of its blur is not measured without a word."""

import numpy as np
import pytest

from napari_defocus.core.picture_remarks import picture_remarks


@pytest.fixture
def noise():
    return np.random.default_rng(2).integers(20, 200, (60, 80, 3), dtype=np.uint8)


def test_an_ordinary_picture_has_no_remark(noise):
    noise[:5, :20] = 255  # a lamp, 2 % of it
    assert picture_remarks(noise, 41) == []


def test_a_picture_smaller_than_a_window_says_so(noise):
    [remark] = picture_remarks(noise[:40], 41)
    assert "smaller than one window (41 x 41 px)" in remark


@pytest.mark.parametrize("value", [0, 90, 255])
def test_a_flat_picture_says_so(value):
    [remark] = picture_remarks(np.full((60, 80), value, np.uint8), 41)
    assert "All pixels have the same value" in remark


@pytest.mark.parametrize(
    ("white", "dtype"), [(255, np.uint8), (4095, np.uint16), (0.8, np.float32)]
)
def test_a_saturated_picture_says_how_much_of_it_is(noise, white, dtype):
    picture = (noise / 255 * white).astype(dtype)
    picture[:30] = white
    [remark] = picture_remarks(picture, 41)
    assert remark.startswith("50 % of the pixels are saturated")


def test_one_saturated_colour_is_not_a_saturated_picture(noise):
    noise[..., 0] = 255
    assert picture_remarks(noise, 41) == []


def test_what_is_not_known_does_not_count(noise):
    picture = noise.astype(np.float32)
    picture[:30] = np.nan
    assert picture_remarks(picture, 41) == []
    [remark] = picture_remarks(np.full((60, 80), np.nan), 41)
    assert remark == "No pixel is known: all are transparent, NaN or masked."
