"""Detail that strong things out of focus spread over their surroundings is not taken for focus.

circuit-board.tif: 7 planes of 200 x 150 px, cut from examples/pcb of PetteriAimonen/focus-stack,
under the licence beside it.
"""

from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.ndimage import median_filter, uniform_filter

from napari_defocus import Disc, composite_at, sharpest_plane, simulate_defocus

BOARD = Path(__file__).with_name("circuit-board.tif")


@pytest.fixture(scope="module")
def board():
    return tifffile.imread(BOARD)


@pytest.fixture(scope="module")
def found(board):
    return sharpest_plane(board)


def test_no_islands_lie_between_the_letters_of_a_circuit_board(found):
    away = np.abs(found.position - median_filter(found.position, 41))
    assert np.mean(away > 1.5) < 0.005


def test_letters_of_the_board_are_as_sharp_as_in_their_plane(board, found):
    """Plane 3 shows the letters at the left best; positions of 3.5 do not blur them."""
    letters = np.s_[20:100, :75]

    def detail(picture):
        values = picture[letters].astype(float)
        return np.mean((values - uniform_filter(values, 3)) ** 2)

    assert detail(found.composite) > 0.9 * detail(board[3])


def test_weak_texture_far_from_strong_one_keeps_its_own_position(grass, gravel):
    """Weak texture is not spread light where no strong texture is within reach."""
    sharp = np.concatenate([grass[:100, :100], 0.5 + 0.1 * (gravel[:100, :100] - 0.5)], axis=1)
    focus = np.repeat([[2.0, 6.0]], 100, axis=1).repeat(100, axis=0)
    stack = [
        simulate_defocus(sharp, np.abs(z - focus), psf=Disc(16.0), noise_variance=1e-6, rng=z)
        for z in range(9)
    ]
    position = sharpest_plane(stack).position
    assert np.mean(np.abs(position[:, 150:] - 6) < 0.5) > 0.98
    assert np.mean(np.abs(position[:, :80] - 2) < 0.5) > 0.98


def test_clipped_highlights_before_a_faint_background_leave_no_islands(gravel):
    """Spots ten times white, at plane 2, before a faint background at plane 6."""
    rng = np.random.default_rng(0)
    sharp = 0.3 + 0.1 * (gravel - gravel.mean())
    focus = np.full(sharp.shape, 6.0)
    for row, column in rng.integers(20, 140, (6, 2)):
        spot = np.s_[row : row + 4, column : column + 4]
        sharp[spot], focus[spot] = 10, 2
    stack = [
        simulate_defocus(sharp, np.abs(z - focus), psf=Disc(16.0), noise_variance=1e-5, rng=z)
        for z in range(9)
    ]
    found = sharpest_plane(np.clip(stack, 0, 1))
    far = uniform_filter((focus == 2).astype(float), 31) == 0
    assert np.mean(np.abs(found.position[far] - 6) > 1.5) < 0.005


@pytest.mark.parametrize("dtype", [np.float32, np.uint8])
def test_clipped_highlights_get_no_halo_in_the_blended_composite(gravel, dtype):
    """Spots ten times white, clipped, as far away as what is around them.

    Their spots in blurred planes are larger, and as steep at the edge: no sign of more contrast.
    """
    rng = np.random.default_rng(0)
    sharp = 0.6 * gravel[:160, :160]
    for row, column in rng.integers(15, 140, (8, 2)):
        sharp[row : row + 4, column : column + 4] = 10
    focus = np.broadcast_to(np.linspace(2, 6, 160), (160, 160))
    stack = [
        simulate_defocus(sharp, np.abs(z - focus), psf=Disc(16.0), noise_variance=1e-5, rng=z)
        for z in range(9)
    ]
    white = 1 if dtype == np.float32 else 255
    planes = np.rint(np.clip(stack, 0, 1) * 255).astype(dtype) / dtype(255 / white)

    def error(picture):
        return np.sqrt(np.mean((picture / white - sharp.clip(0, 1)) ** 2))

    position = sharpest_plane(planes).position
    pixels = composite_at(position, planes, blend=False)
    blended = composite_at(position, planes)
    assert error(blended) < 1.12 * error(pixels)
