"""Pixels that show sharp details themselves, whatever the windows around say."""

import numpy as np
import pytest
from scipy.signal import fftconvolve
from skimage import data

from napari_defocus import Disc
from napari_defocus.core.image import prepare_image
from napari_defocus.likelihood.sharp_details import SharpDetails

NOISE = 1e-5


def seen(picture):
    noise = np.random.default_rng(0).normal(0, NOISE**0.5, picture.shape)
    return (picture + noise).astype(np.float32)


def details(picture):
    return SharpDetails.of(prepare_image(seen(picture), (0, 1)), NOISE)


@pytest.fixture(scope="module")
def sharp():
    """Scaled down, so that it is sharp at the scale of a pixel: (256, 256)."""
    picture = np.asarray(data.camera(), np.float64) / 255
    return (picture[::2, ::2] + picture[1::2, ::2] + picture[::2, 1::2] + picture[1::2, 1::2]) / 4


def blurred(picture, radius):
    kernel = Disc().kernel(radius)
    reach = len(kernel) // 2
    return fftconvolve(np.pad(picture, reach, mode="reflect"), kernel, mode="valid")


@pytest.mark.parametrize("width", [3, 5, 8])
def test_thin_bar_is_marked_and_nothing_beside_it(sharp, width):
    bar = np.zeros(sharp.shape, bool)
    bar[:, 120 : 120 + width] = True
    texture = np.random.default_rng(1).uniform(0, 1, sharp.shape)
    inside = details(np.where(bar, texture, blurred(sharp, 12.0))).inside
    assert np.mean(inside[bar]) > 0.9
    assert np.mean(inside[~bar]) < 0.001


def test_what_is_sharp_is_marked_and_what_is_blurred_is_not(sharp):
    # Half of the picture is sky and coat, without details.
    assert np.mean(details(sharp).around) > 0.4
    for radius in (4.0, 8.0, 16.0):
        assert np.mean(details(blurred(sharp, radius)).around) < 0.02


def test_noise_alone_shows_no_details():
    found = details(np.full((200, 200), 0.5))
    assert not found.inside.any()
    assert np.mean(found.around) < 0.001


def test_flipped_pictures_have_flipped_details(sharp):
    picture = seen(sharp)
    for turn in (np.fliplr, np.flipud, np.transpose):
        there = SharpDetails.of(prepare_image(np.ascontiguousarray(turn(picture)), (0, 1)), NOISE)
        here = SharpDetails.of(prepare_image(picture, (0, 1)), NOISE)
        for name in ("around", "inside"):
            assert np.mean(getattr(there, name) != turn(getattr(here, name))) < 1e-4


def test_what_is_not_known_shows_no_details(sharp):
    picture = seen(blurred(sharp, 6.0))
    picture[60:120, 60:120] = np.nan
    found = SharpDetails.of(prepare_image(picture, (0, 1)), NOISE)
    assert not found.inside[70:110, 70:110].any()
