"""Noise that grows towards the corners, as that of full-size photographs does."""

import io

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from napari_defocus import (
    estimate_candidates,
    estimate_noise_variance,
    simulate_defocus,
)
from napari_defocus.core.image import prepare_image
from napari_defocus.likelihood.local_noise import noise_of_samples
from napari_defocus.likelihood.noise import NoiseSample

SHAPE = 360, 480
VARIANCE, GROWTH = 1e-4, 1.5


def outward(shape=SHAPE):
    """Square of the distance from the centre, 1 in the corners."""
    rows, columns = (np.linspace(-1, 1, length) * (length - 1) for length in shape)
    return np.add.outer(rows**2, columns**2) / (rows[0] ** 2 + columns[0] ** 2)


def clouds(shape=SHAPE, softness=9.0):
    soft = gaussian_filter(np.random.default_rng(0).normal(size=shape), softness, mode="wrap")
    return 0.5 + 0.1 * soft / soft.std()


def noisy(picture, growth=GROWTH, variance=VARIANCE):
    grown = variance * (1 + growth * outward(picture.shape))
    return picture + np.sqrt(grown) * np.random.default_rng(1).normal(size=picture.shape)


def growth_of(picture):
    return noise_of_samples([NoiseSample.of(prepare_image(picture))])[1]


@pytest.fixture(scope="module")
def shaded():
    return noisy(clouds())


@pytest.mark.parametrize("growth", [1.0, 1.5, 2.5])
def test_growth_towards_the_corners_is_found_to_a_fifth(growth):
    picture = noisy(clouds(), growth)
    assert growth_of(picture) == pytest.approx(growth, rel=0.2)
    assert estimate_noise_variance(picture) == pytest.approx(VARIANCE, rel=0.1)


def test_turned_and_brighter_pictures_have_the_same_growth(shaded):
    expected = growth_of(shaded)
    for same in (shaded[::-1], shaded[:, ::-1], shaded.T):
        assert growth_of(same) == pytest.approx(expected, rel=0.03)
    assert growth_of(np.rint(20000 * shaded).astype(np.uint16)) == pytest.approx(expected, rel=1e-2)


def test_noise_that_grows_outwards_is_no_sharp_texture():
    def sharp_at_border(candidates):
        border = np.ones(candidates.curve.shape[:2], bool)
        border[12:-12, 16:-16] = False
        return (candidates.scales[candidates.curve.argmax(axis=2)] < 2)[border].mean()

    faint = 0.5 + 0.5 * (clouds(softness=1.5) - 0.5)
    blurred = simulate_defocus(faint, np.full(SHAPE, 6.0))
    picture = noisy(blurred, growth=2.5)
    found = estimate_candidates(picture)
    assert found.noise_growth == pytest.approx(2.5, rel=0.2)
    assert sharp_at_border(found) < 0.01
    # What is given is taken as it is.
    even = estimate_candidates(picture, noise_variance=found.noise_variance)
    assert even.noise_growth == 0
    assert sharp_at_border(even) > 0.1


def test_noise_that_is_the_same_everywhere_does_not_grow():
    assert growth_of(noisy(clouds(), 0)) == 0


def test_one_figure_for_a_little_growth():
    assert growth_of(noisy(clouds(), 0.2)) == 0


@pytest.mark.parametrize("softness", [1.0, 2.0, 4.0])
def test_texture_that_is_only_outside_is_no_noise(softness):
    texture = clouds(softness=softness) - 0.5
    assert growth_of(noisy(clouds() + texture * outward(), 0)) == 0
    assert growth_of(noisy(clouds() + texture * (outward() > 0.3), 0)) == 0


def test_noise_that_grows_to_one_side_does_not_grow_outwards():
    slope = np.linspace(1, 3, SHAPE[1])
    noise = np.sqrt(VARIANCE * slope) * np.random.default_rng(0).normal(size=SHAPE)
    assert growth_of(clouds() + noise) == 0


def test_small_jpeg_has_one_figure(shaded):
    encoded = io.BytesIO()
    Image.fromarray(np.clip(np.rint(255 * shaded), 0, 255).astype(np.uint8)).save(
        encoded, "JPEG", quality=90
    )
    assert growth_of(np.asarray(Image.open(encoded))) == 0


def test_growth_with_the_light_and_outwards_are_both_found():
    light = np.clip(clouds(softness=30.0) + np.linspace(-0.35, 0.35, SHAPE[1]), 0.05, 0.95)
    grown = (1e-6 + 2e-4 * light) * (1 + GROWTH * outward())
    picture = light + np.sqrt(grown) * np.random.default_rng(0).normal(size=SHAPE)
    noise, growth = noise_of_samples([NoiseSample.of(prepare_image(picture, (0.0, 1.0)))])
    assert growth == pytest.approx(GROWTH, rel=0.25)
    assert noise.variance_at(np.array(0.5)) == pytest.approx(1e-4, rel=0.15)


def test_pieces_of_a_plane_show_its_growth():
    picture = noisy(clouds((700, 900)))
    pieces = [
        NoiseSample.of(
            prepare_image(picture[row : row + 150, column : column + 150], (0.0, 1.0)),
            start=(row, column),
            whole=picture.shape,
        )
        for row in range(0, 700, 180)
        for column in range(0, 900, 180)
    ]
    assert noise_of_samples(pieces)[1] == pytest.approx(GROWTH, rel=0.2)
