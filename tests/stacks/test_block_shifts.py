"""Motion between planes is found to a small part of a pixel, whatever the size of the planes."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift, zoom

from napari_defocus.stacks.block_shifts import block_shifts, block_spectra
from napari_defocus.stacks.registration import Details, motion_between


@pytest.mark.parametrize("side", [32, 33, 128])
def test_shifts_of_blocks_are_found_to_a_fiftieth_of_a_pixel(side):
    rng = np.random.default_rng(0)
    slope = np.hanning(side + 2)[1:-1]
    blocks, truth = [], rng.uniform(-0.02 * side, 0.02 * side, (20, 2))
    for along in truth:
        scene = gaussian_filter(rng.standard_normal((2 * side, 2 * side)), 1)
        inner = np.s_[side // 2 : side // 2 + side, side // 2 : side // 2 + side]
        pair = scene, shift(scene, along, order=5)
        blocks.append([slope[:, None] * slope * picture[inner] for picture in pair])
    first, second = np.array(blocks, np.float32).swapaxes(0, 1)
    found = block_shifts(block_spectra(first), block_spectra(second), side)
    assert np.abs(found - truth).mean() < 0.02
    assert np.abs(found - truth).max() < 0.1


def test_blocks_without_any_detail_have_not_moved():
    flat = block_spectra(np.zeros((2, 16, 16), np.float32))
    np.testing.assert_array_equal(block_shifts(flat, flat, 16), 0)


def test_large_planes_that_move_far_are_found_where_they_are():
    """Planes above 512 px are compared at a smaller size first: 9 px at once are no trouble."""
    scene = zoom(np.random.default_rng(1).standard_normal((310, 410)), 2, order=3)
    scene = gaussian_filter(scene, 1).astype(np.float32)
    first, second = scene[10:-10, 10:-10], scene[1:-19, 16:-4]
    motion = motion_between(Details.of(first), Details.of(second))
    assert abs(motion.shift - complex(9, -6)) < 0.02
    assert abs(motion.factor - 1) < 1e-4


def test_no_blocks_have_no_shifts():
    nothing = np.zeros((0, 16, 9), np.complex64)
    assert block_shifts(nothing, nothing, 16).shape == (0, 2)
