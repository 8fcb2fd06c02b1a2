"""Kinds of real pictures on which the model was once wrong without knowing it."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from skimage.draw import polygon

from napari_defocus import (
    ShotNoise,
    estimate_blur_map,
    estimate_candidates,
    segment_in_focus,
    simulate_defocus,
)

OFFSET, GAIN, READ = 100.0, 2.17, 3.0
"""Counts, counts an electron, counts: of a scientific camera."""


@pytest.fixture(scope="module")
def nuclei():
    """Where nuclei are, and pictures of them, in focus, out of it and far out of it: uint16."""
    rng = np.random.default_rng(7)
    height, width = 200, 240
    y, x = np.mgrid[:height, :width]
    light = np.zeros((height, width))
    for _ in range(18):
        row, column = rng.uniform(15, height - 15), rng.uniform(15, width - 15)
        a, b, turn = rng.uniform(9, 14), rng.uniform(12, 19), rng.uniform(0, np.pi)
        u = (y - row) * np.cos(turn) + (x - column) * np.sin(turn)
        v = (x - column) * np.cos(turn) - (y - row) * np.sin(turn)
        light = np.maximum(light, rng.uniform(60, 220) * (u**2 / a**2 + v**2 / b**2 < 1))
    light *= 1 + 0.25 * gaussian_filter(rng.normal(0, 6, light.shape), 2.5)

    def seen(sigma):
        electrons = rng.poisson(np.maximum(gaussian_filter(light, sigma), 0))
        counts = OFFSET + GAIN * electrons + rng.normal(0, READ, light.shape)
        return np.clip(counts.round(), 0, 65535).astype(np.uint16)

    return light > 0, {sigma: seen(sigma) for sigma in (1.05, 3.0, 9.0)}


def test_nuclei_read_more_blur_the_farther_they_are_from_focus(nuclei):
    """Photon noise of bright objects is no sharp texture, whatever the camera's offset."""
    where, pictures = nuclei
    radii = [np.median(estimate_blur_map(picture)[where]) for picture in pictures.values()]
    assert radii[0] < 3 < radii[1] < 5.5 < radii[2]


def test_nuclei_far_out_of_focus_are_nowhere_in_focus(nuclei):
    where, pictures = nuclei
    far = pictures[9.0]
    assert segment_in_focus(estimate_candidates(far), far, threshold=3.0)[where].mean() < 0.05


def test_noise_of_a_camera_is_found_with_its_offset(nuclei):
    _, pictures = nuclei
    noise = estimate_candidates(pictures[3.0]).shot_noise
    assert isinstance(noise, ShotNoise)
    assert noise.offset * 65535 == pytest.approx(OFFSET, abs=6)
    assert noise.gain * 65535 == pytest.approx(GAIN, rel=0.35)


def test_stacks_and_dask_arrays_find_the_same_noise(nuclei):
    da = pytest.importorskip("dask.array")
    _, pictures = nuclei
    stack = np.stack([pictures[1.05], pictures[9.0]])
    expected = np.stack([estimate_blur_map(plane) for plane in stack])
    np.testing.assert_array_equal(estimate_blur_map(stack, axes="zyx"), expected)
    lazy = estimate_blur_map(da.from_array(pictures[9.0], chunks=100))
    np.testing.assert_array_equal(lazy.compute(), expected[1])


@pytest.mark.parametrize("variance", [1e-6, 1e-4])
def test_noise_that_does_not_grow_is_found_as_one_number(grass, astronaut, defocused, variance):
    for picture in (grass, astronaut):
        seen = simulate_defocus(
            picture, np.full(picture.shape[:2], 3.0), noise_variance=variance, rng=0
        )
        assert estimate_candidates(seen).shot_noise is None


def diamonds(side=200, oversampling=4):
    """Return printed diamonds: sharp edges, nothing inside."""
    picture = np.full((side * oversampling,) * 2, 0.35)
    for row, column, size in ((60, 60, 42), (60, 140, 38), (140, 60, 38), (140, 140, 42)):
        for share, value in ((1.0, 0.6), (0.5, 0.25)):
            s = size * share
            rows = np.array([row - s, row, row + s, row]) * oversampling
            columns = np.array([column, column + 0.6 * s, column, column - 0.6 * s]) * oversampling
            picture[polygon(rows, columns, picture.shape)] = value
    return picture.reshape(side, oversampling, side, oversampling).mean((1, 3))


@pytest.mark.parametrize("softness", [0.0, 0.7])
@pytest.mark.parametrize("radius", [1.0, 1.5, 3.0, 5.0])
def test_plain_shapes_read_their_own_blur_and_not_the_widest(softness, radius):
    """Lone edges, nothing inside: 0.5 px, and 1 px where a soft camera passes for defocus."""
    sharp = diamonds()
    edges = np.hypot(*np.gradient(gaussian_filter(sharp, 1))) > 0.02
    camera = gaussian_filter(sharp, softness) if softness else sharp
    seen = simulate_defocus(camera, np.full(sharp.shape, radius), noise_variance=1e-6, rng=0)
    error = np.abs(estimate_blur_map(seen)[edges] - radius).mean()
    assert error < (1.0 if softness and radius < 2 else 0.6)


def test_softness_that_is_known_is_taken_off_the_radius():
    sharp = diamonds()
    edges = np.hypot(*np.gradient(gaussian_filter(sharp, 1))) > 0.02
    seen = simulate_defocus(
        gaussian_filter(sharp, 0.7), np.full(sharp.shape, 1.0), noise_variance=1e-6, rng=0
    )
    known = estimate_blur_map(seen, camera_softness=0.75)[edges]
    unknown = estimate_blur_map(seen)[edges]
    assert np.abs(known - 1).mean() < 0.6 < np.abs(unknown - 1).mean()


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (-0.1, ValueError, "camera_softness is -0.1; it takes a number of px from 0 to 5"),
        (np.nan, ValueError, "camera_softness is nan"),
        ("soft", TypeError, "camera_softness is 'soft'"),
    ],
)
def test_impossible_softness_is_refused(grass, given, error, words):
    with pytest.raises(error, match=words):
        estimate_candidates(grass, camera_softness=given)


def test_offset_of_shot_noise_is_where_it_begins():
    noise = ShotNoise(1e-6, 1e-4, offset=0.2)
    np.testing.assert_allclose(noise.variance_at(np.array([0.1, 0.2, 0.7])), [1e-6, 1e-6, 5.1e-5])
    with pytest.raises(ValueError, match="offset is nan; it takes a finite number"):
        ShotNoise(1e-6, 1e-4, offset=np.nan)
