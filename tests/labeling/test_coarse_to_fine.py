"""Regions that only change as a whole: labels from coarse to fine."""

import numpy as np

from napari_defocus.labeling.coarse_to_fine import minimize_energy, minimize_energy_from
from napari_defocus.labeling.graph_cuts import energy_of
from napari_defocus.labeling.multigrid import STEPS

SIDE, LABELS, DEPTH = 104, 241, 20
WIDE = (110, 190)
"""Labels of wide blur that places of the ground like best, each patch another one."""


def sharp_disc_before_a_ground():
    """Return costs, weights, and where a sharp disc is before a ground of wide, uneven blur."""
    rng = np.random.default_rng(0)
    row, column = np.indices((SIDE, SIDE))
    inside = np.hypot(row - SIDE / 2, column - 0.35 * SIDE) < SIDE / 4
    patches = rng.integers(*WIDE, (-(-SIDE // 6),) * 2)
    best = np.where(inside, 0, patches.repeat(6, 0).repeat(6, 1)[:SIDE, :SIDE])
    away = np.abs(np.arange(LABELS) - best[..., None])
    steepness, weight = (np.where(inside, *each)[..., None] for each in ((3, 0.5), (9, 1)))
    cost = (weight * np.minimum(steepness * away, DEPTH)).astype(np.float32)
    weights = np.ones((2 * len(STEPS), SIDE, SIDE), np.float32)
    for number, (down, right) in enumerate(2 * STEPS):
        weights[number, SIDE - down :] = 0
        weights[number, :, {1: [-1], -1: [0], 0: []}[right]] = 0
    return cost, weights, inside


def test_a_ground_of_wide_blur_does_not_stay_sharp_because_no_single_move_takes_it_there():
    cost, weights, inside = sharp_disc_before_a_ground()
    labels = minimize_energy(cost, weights)
    middle = np.where(inside, 0, np.mean(WIDE)).astype(np.int32)
    assert energy_of(labels, cost, weights) < energy_of(middle, cost, weights)
    assert (labels[inside] == 0).mean() > 0.95
    assert (labels[~inside] >= WIDE[0]).mean() > 0.95


def test_a_part_of_a_picture_finds_it_from_the_coarse_labels_too():
    cost, weights, inside = sharp_disc_before_a_ground()
    sharp_everywhere = np.zeros((SIDE // 4, SIDE // 4), np.int32)
    labels = minimize_energy_from(sharp_everywhere, cost, weights)
    assert (labels[~inside] >= WIDE[0]).mean() > 0.9
