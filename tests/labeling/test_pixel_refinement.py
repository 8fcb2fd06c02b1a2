"""Between the windows: weights of blocks, cuts beside jumps, interpolation."""

import numpy as np
import pytest

from napari_defocus.labeling.multigrid import STEPS
from napari_defocus.labeling.pairwise_term import Blocks
from napari_defocus.labeling.pixel_refinement import cut_pixels, interpolate_labels, label_pixels
from napari_defocus.likelihood.gabor import window_centers


def blocks_of(shape, stride=4):
    centers = [window_centers(length, stride) for length in shape]
    return Blocks.around(*centers, shape)


def explicit_weights(color, blocks, color_sigma, smoothness):
    """(16) over all pixel pairs of 8-neighbours, joined by pairs of blocks."""
    height, width = color.shape[:2]
    joined = np.zeros((4, len(blocks.row_centers), len(blocks.column_centers)))
    for i, j in np.ndindex(height, width):
        for down, right in STEPS:
            y, x = i + down, j + right
            if not (y < height and 0 <= x < width):
                continue
            here = blocks.row_of_pixel[i], blocks.column_of_pixel[j]
            there = blocks.row_of_pixel[y], blocks.column_of_pixel[x]
            if here == there:
                continue
            distance = np.sum((color[i, j].astype(float) - color[y, x]) ** 2)
            weight = smoothness * np.exp(-distance / (2 * color_sigma**2))
            if here > there:
                here, there = there, here
            step = there[0] - here[0], there[1] - here[1]
            joined[STEPS.index(step), here[0], here[1]] += weight
    return joined


@pytest.mark.parametrize(("shape", "stride"), [((13, 18), 4), ((9, 10), 3), ((6, 7), 1)])
@pytest.mark.parametrize("channels", [1, 3])
def test_weights_of_blocks_add_up_those_of_their_pixel_pairs(shape, stride, channels):
    color = np.random.default_rng(0).uniform(0.3, 0.6, (*shape, channels)).astype(np.float32)
    blocks = blocks_of(shape, stride)
    weights = blocks.edge_weights(color, 0.1, 20.0)
    np.testing.assert_allclose(weights, explicit_weights(color, blocks, 0.1, 20.0), rtol=1e-4)


@pytest.mark.parametrize(("shape", "stride"), [((13, 18), 4), ((3, 3), 4), ((100, 41), 7)])
def test_every_pixel_belongs_to_the_nearest_window(shape, stride):
    blocks = blocks_of(shape, stride)
    distance = np.abs(np.arange(shape[0])[:, None] - blocks.row_centers)
    chosen = distance[np.arange(shape[0]), blocks.row_of_pixel]
    np.testing.assert_allclose(chosen, distance.min(axis=1))
    assert blocks.area.sum() == shape[0] * shape[1]
    assert blocks.area.min() > 0


def test_marked_pixels_are_counted_by_block():
    blocks = blocks_of((13, 18))
    marked = np.random.default_rng(0).random((13, 18)) < 0.3
    counts = np.zeros_like(blocks.area)
    for i, j in zip(*np.nonzero(marked), strict=True):
        counts[blocks.row_of_pixel[i], blocks.column_of_pixel[j]] += 1
    np.testing.assert_array_equal(blocks.count(marked), counts)


def two_colours(edge, shape=(64, 64)):
    """Dark up to a column, bright from it on, with faint texture."""
    color = np.where(np.arange(shape[1]) < edge, 0.2, 0.8) * np.ones(shape)
    color += np.random.default_rng(0).normal(0, 0.01, shape)
    return color[..., None].astype(np.float32)


@pytest.mark.parametrize("edge", [28, 30, 33, 36])
@pytest.mark.parametrize("turned", [False, True])
def test_misplaced_jump_snaps_to_the_edge_of_colour(edge, turned):
    blocks = blocks_of((64, 64))
    # The labels jump at column 32, 4 px at most from the edge; no label costs more there.
    labels = np.where(np.arange(16) < 8, 10, 40) * np.ones((16, 1), np.int32)
    color = two_colours(edge)
    if turned:
        labels, color = labels.T, color.transpose(1, 0, 2)
    cost = np.zeros((16, 16, 81), np.float32)
    pixels = label_pixels(
        labels.astype(np.int32),
        cost,
        blocks,
        np.ascontiguousarray(color),
        smoothness=20.0,
        color_sigma=0.1,
        jump=4,
        reach=6,
    )
    pixels = pixels.T if turned else pixels
    found = (pixels == 10).sum(axis=1)
    assert set(np.unique(pixels)) == {10, 40}
    assert np.abs(found - edge).max() <= 1


def test_evidence_outweighs_colour_where_it_is_strong():
    blocks = blocks_of((64, 64))
    labels = (np.where(np.arange(16) < 8, 10, 40) * np.ones((16, 1))).astype(np.int32)
    cost = np.full((16, 16, 81), 1e6, np.float32)
    cost[:, :8, 10] = 0
    cost[:, 8:, 40] = 0
    pixels = label_pixels(
        labels, cost, blocks, two_colours(28), smoothness=20.0, color_sigma=0.1, jump=4, reach=6
    )
    np.testing.assert_array_equal((pixels == 10).sum(axis=1), 32)


def test_pixels_away_from_jumps_keep_the_label_of_their_block():
    blocks = blocks_of((64, 64))
    labels = (np.arange(16) * np.ones((16, 1))).astype(np.int32)
    cost = np.zeros((16, 16, 81), np.float32)
    pixels = label_pixels(
        labels, cost, blocks, two_colours(30), smoothness=20.0, color_sigma=0.1, jump=4, reach=6
    )
    np.testing.assert_array_equal(pixels, blocks.spread(labels))


def test_labels_that_rise_evenly_are_interpolated_to_a_plane():
    blocks = blocks_of((40, 60))
    labels = (2 * np.arange(10)[:, None] + np.arange(15)).astype(np.int32)
    found = interpolate_labels(0.1 * labels, labels, blocks.spread(labels), blocks, 4)
    row = (np.arange(40) - blocks.row_centers[0]) / 4
    column = (np.arange(60) - blocks.column_centers[0]) / 4
    expected = 2 * np.clip(row, 0, 9)[:, None] + np.clip(column, 0, 14)
    np.testing.assert_allclose(found, 0.1 * expected, atol=1e-5)


def test_interpolation_does_not_cross_a_jump():
    blocks = blocks_of((40, 40))
    labels = (np.where(np.arange(10) < 5, 10, 40) * np.ones((10, 1))).astype(np.int32)
    found = interpolate_labels(0.1 * labels, labels, blocks.spread(labels), blocks, 4)
    np.testing.assert_allclose(np.unique(found.round(5)), [1, 4])


def test_pixel_with_no_block_alike_around_it_keeps_its_label():
    blocks = blocks_of((40, 40))
    labels = np.full((10, 10), 10, np.int32)
    pixels = blocks.spread(labels)
    pixels[17, 21] = 60
    found = interpolate_labels(0.1 * labels, labels, pixels, blocks, 4)
    assert found[17, 21] == pytest.approx(6)
    np.testing.assert_allclose(np.delete(found.ravel(), 17 * 40 + 21), 1, rtol=1e-6)


def test_thin_things_of_their_own_colour_stay_in_the_cut():
    blocks = blocks_of((64, 64))
    row, column = np.indices((64, 64))
    true = ((row < 24) | (abs(column - 32) < 2)).astype(np.int32)
    labels = np.zeros((16, 16), np.int32)
    labels[:6], labels[:, 8] = 1, 1
    cost = np.zeros((16, 16, 2), np.float32)
    cost[..., 0], cost[..., 1] = 10 * labels, 10 * (1 - labels)
    color = (0.2 + 0.6 * true[..., None]).astype(np.float32)
    found = cut_pixels(labels, cost, blocks, color, smoothness=1000.0, color_sigma=0.04, reach=30)
    np.testing.assert_array_equal(found[:60], true[:60])
