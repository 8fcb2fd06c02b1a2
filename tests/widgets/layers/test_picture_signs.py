import numpy as np
import pytest
from skimage.data import gravel

from napari_defocus.widgets.layers.picture_signs import signs_of_picture
from napari_defocus.widgets.layers.samples import brushes, dandelion

STONES = gravel()[:120, :140]


def color(channels):
    return np.stack([STONES] * channels, axis=-1)


@pytest.mark.parametrize("picture", [STONES, STONES / 255.0, color(3), color(4)])
def test_plain_pictures_have_no_signs(picture):
    assert signs_of_picture(picture) == []


@pytest.mark.parametrize("sample", [dandelion, brushes])
def test_photographs_have_no_signs(sample):
    [(picture, _, _)] = sample()
    assert signs_of_picture(picture) == []


@pytest.mark.parametrize(
    ("picture", "said"),
    [
        (np.full((120, 140), 0.3), "same value"),
        (np.full((120, 140), np.nan), "unknown (NaN)"),
        (np.ma.masked_all((120, 140)), "unknown (NaN)"),
        (STONES > 100, "only 2 different values"),
        (STONES[:40, :100], "small (100 x 40 px)"),
        (np.minimum(STONES.astype(int) * 2, 255).astype(np.uint8), "saturated (at 255)"),
        (np.minimum(STONES / 100, 1.0), "saturated (at 1)"),
    ],
)
def test_a_sign_is_said_with_what_to_do(picture, said):
    [sign] = signs_of_picture(picture)
    assert said in sign


def test_known_pixels_count():
    picture = np.where(np.arange(140) < 70, np.nan, STONES / 255.0)
    assert signs_of_picture(picture) == []
