"""The filter bank (3) and the local power (4), against sums written out."""

import numpy as np
import pytest

from napari_defocus.likelihood.gabor import (
    frequencies,
    gradients,
    local_power,
    window_centers,
    within_picture,
)


def explicit_power(luminance, row, column, window, direction):
    """|g_i|^2 of one window: differences where they lie, times each complex filter."""
    if direction == 0:
        samples, offset = luminance[:, 1:] - luminance[:, :-1], (0.0, 0.5)
    else:
        samples, offset = luminance[1:] - luminance[:-1], (0.5, 0.0)
    y = np.arange(samples.shape[0])[:, None] + offset[0] - row
    x = np.arange(samples.shape[1])[None, :] + offset[1] - column
    inside = (np.abs(y) <= (window - 1) / 2) & (np.abs(x) <= (window - 1) / 2)
    envelope = np.where(inside, np.exp(-(y**2 + x**2) / (2 * (window / 4) ** 2)), 0)
    envelope /= np.sqrt(np.sum(envelope**2))
    power = []
    for a_row, a_column in frequencies(window):
        wave = np.exp(-2j * np.pi * (a_row * y + a_column * x) / window)
        power.append(np.abs(np.sum(samples * envelope * wave)) ** 2)
    return np.array(power)


@pytest.fixture
def texture():
    return np.random.default_rng(5).uniform(size=(70, 84)).astype(np.float32)


def test_window_of_41_px_has_60_frequencies():
    pairs = frequencies(41)
    assert pairs.shape == (60, 2)
    assert (pairs % 2 == 0).all()
    assert np.abs(pairs).max() == 10


@pytest.mark.parametrize("window", [17, 25, 41, 61])
def test_frequencies_are_one_half_plane_without_dc(window):
    pairs = {tuple(pair) for pair in frequencies(window).tolist()}
    opposite = {(-row, -column) for row, column in pairs}
    assert not pairs & opposite
    largest = 2 * ((window - 1) // 8)
    assert len(pairs | opposite | {(0, 0)}) == (largest + 1) ** 2


@pytest.mark.parametrize("fraction", [(0, 0), (0.5, 0.5), (0, 0.5), (0.5, 0)])
@pytest.mark.parametrize("window", [17, 41])
def test_power_is_the_sum_written_out(texture, window, fraction):
    rows = np.array([24.0, 30.0, 36.0]) + fraction[0]
    columns = np.array([25.0, 40.0]) + fraction[1]
    power = local_power(gradients(texture, None, window), rows, columns, window)
    assert power.shape == (3, 2, 2, len(frequencies(window)))
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            for direction in (0, 1):
                expected = explicit_power(texture.astype(float), row, column, window, direction)
                # Single precision: a power near 0 is a difference of sums of order 1.
                np.testing.assert_allclose(
                    power[i, j, direction], expected, rtol=1e-4, atol=1e-5 * expected.mean()
                )


def test_flipped_picture_has_the_flipped_powers(texture):
    height, width = texture.shape
    rows, columns = np.array([22.5, 27.5, 32.5]), np.array([30.0, 34.0, 38.0])

    def powers(picture, rows, columns):
        return local_power(gradients(picture, None, 41), rows, columns, 41)

    # Left to right, the column frequency changes its sign: |g(a, b)| -> |g(a, -b)|.
    pairs = frequencies(41).tolist()
    mirrored = [
        pairs.index([row, -column]) if [row, -column] in pairs else pairs.index([-row, column])
        for row, column in pairs
    ]
    expected = powers(texture, rows, columns)[..., mirrored]
    tolerance = {"rtol": 1e-3, "atol": 1e-5 * expected.mean()}
    left_right = powers(texture[:, ::-1], rows, (width - 1 - columns)[::-1])[:, ::-1]
    np.testing.assert_allclose(left_right, expected, **tolerance)
    upside_down = powers(texture[::-1], (height - 1 - rows)[::-1], columns)[::-1]
    np.testing.assert_allclose(upside_down, expected, **tolerance)


def test_transposed_picture_has_the_transposed_powers(texture):
    rows, columns = np.array([22.5, 27.5, 32.5]), np.array([30.0, 34.0])
    pairs = frequencies(41).tolist()
    swapped = [
        pairs.index([column, row]) if [column, row] in pairs else pairs.index([-column, -row])
        for row, column in pairs
    ]
    power = local_power(gradients(texture, None, 41), rows, columns, 41)
    turned = local_power(gradients(np.ascontiguousarray(texture.T), None, 41), columns, rows, 41)
    expected = power.transpose(1, 0, 2, 3)[:, :, ::-1][..., swapped]
    np.testing.assert_allclose(turned, expected, rtol=1e-3, atol=1e-5 * expected.mean())


@pytest.mark.parametrize("shape", [(3, 3), (20, 30), (41, 41), (10, 100)])
def test_picture_smaller_than_a_window_is_mirrored_until_it_fits(shape):
    luminance = np.random.default_rng(0).uniform(size=shape).astype(np.float32)
    gradient = gradients(luminance, None, 41)
    padded = np.pad(luminance, [(extra, extra) for extra in gradient.pad], mode="symmetric")
    assert min(padded.shape) >= 42
    middle = [np.array([(length - 1) / 2]) for length in padded.shape]
    power = local_power(gradient, *middle, 41)
    expected = explicit_power(padded.astype(float), middle[0][0], middle[1][0], 41, 0)
    np.testing.assert_allclose(power[0, 0, 0], expected, rtol=1e-3, atol=1e-5 * expected.mean())


def test_differences_beside_transparent_pixels_are_zero(texture):
    opaque = np.ones(texture.shape, bool)
    opaque[30, 40] = False
    whole, holed = gradients(texture, None, 41), gradients(texture, opaque, 41)
    across = holed.along_columns != whole.along_columns
    down = holed.along_rows != whole.along_rows
    assert {tuple(place) for place in np.argwhere(across).tolist()} == {(30, 39), (30, 40)}
    assert {tuple(place) for place in np.argwhere(down).tolist()} == {(29, 40), (30, 40)}
    assert not holed.along_columns[30, 39:41].any()


@pytest.mark.parametrize("stride", [1, 3, 4, 10])
@pytest.mark.parametrize("length", [3, 41, 100, 101])
def test_windows_stand_symmetrically_and_cover_the_picture(length, stride):
    centers = window_centers(length, stride)
    np.testing.assert_allclose(centers, length - 1 - centers[::-1])
    np.testing.assert_allclose(np.diff(centers), stride)
    assert centers[0] <= stride / 2
    assert set(centers % 1) <= {0.0, 0.5}


@pytest.mark.parametrize("length", [41, 42, 100, 101])
def test_window_at_the_border_is_moved_inside(length):
    centers = within_picture(window_centers(length, 4), length, 41)
    assert centers.min() >= 20
    assert centers.max() <= length - 1 - 20
