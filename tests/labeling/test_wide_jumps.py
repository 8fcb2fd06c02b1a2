"""Jumps from what is sharp to what is blurred by much."""

import numpy as np
import pytest

from napari_defocus.labeling.graph_cuts import minimize_energy
from napari_defocus.labeling.wide_jumps import less_at_wide_jumps

ROWS, COLUMNS, LABELS, GROUND = 40, 60, 161, 150


def flower_in_a_corner(depth):
    """Costs and weights of a sharp thing, and of a ground whose windows say little each."""
    flower = np.zeros((ROWS, COLUMNS), bool)
    flower[5:35, 5:35] = True
    labels = np.arange(LABELS)
    data = np.where(
        flower[..., None], np.minimum(2.0 * labels, 300), np.minimum(abs(labels - GROUND), depth)
    )
    weights = np.zeros((8, ROWS, COLUMNS), np.float32)
    weights[[0, 4], :, :-1] = 1
    weights[[1, 5], :-1] = 1
    return data.astype(np.float32), weights, flower


def test_a_flower_does_not_take_its_ground_along():
    data, weights, flower = flower_in_a_corner(depth=20)
    before = minimize_energy(data, weights)
    labels = minimize_energy(data, less_at_wide_jumps(weights, data))
    assert (before[:5, :30] == 0).all()
    assert (labels[flower] == 0).all()
    assert (labels[~flower] == GROUND).all()


def test_weights_are_less_at_the_jump_alone():
    data, weights, _ = flower_in_a_corner(depth=20)
    lessened = less_at_wide_jumps(weights, data)
    changed = lessened != weights
    assert changed[[0, 4]].sum() == 2 * 2 * 30
    np.testing.assert_array_equal(changed[:4], changed[4:])
    assert not changed[:, 10:30, 10:30].any()


@pytest.mark.parametrize("ground", [60, 79])
def test_jumps_to_a_medium_blur_keep_their_price(ground):
    data, weights, _ = flower_in_a_corner(depth=20)
    shifted = np.roll(data, ground - GROUND, axis=2)
    np.testing.assert_array_equal(less_at_wide_jumps(weights, shifted), weights)


def test_labels_up_to_8_px_have_no_wide_jumps():
    data, weights, _ = flower_in_a_corner(depth=20)
    few = np.ascontiguousarray(data[..., :81])
    assert less_at_wide_jumps(weights, few) is weights
