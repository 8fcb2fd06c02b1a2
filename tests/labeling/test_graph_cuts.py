"""Moves against enumeration, and the labelling against the exact optimum."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from napari_defocus import estimate_candidates
from napari_defocus.labeling import parts
from napari_defocus.labeling.blur_map import CURVE_WEIGHT
from napari_defocus.labeling.coarse_to_fine import minimize_energy
from napari_defocus.labeling.data_term import data_term
from napari_defocus.labeling.fusions import fuse
from napari_defocus.labeling.graph_cuts import (
    energy_of,
    expand,
    expand_until_settled,
    improve,
    solve_exactly,
)
from napari_defocus.labeling.multigrid import HALF, STEPS, WIDE, coarser
from napari_defocus.labeling.pairwise_term import Blocks

seeds = st.integers(0, 2**32 - 1)


def grid_weights(rng, rows, columns, strength=1.0):
    """Random weights of the 8-neighbourhood, 0 where a neighbour would be outside."""
    weights = (strength * rng.uniform(0.2, 1.0, (4, rows, columns))).astype(np.float32)
    for k, (down, right) in enumerate(STEPS):
        weights[k, rows - down :] = 0
        if right > 0:
            weights[k, :, -1] = 0
        if right < 0:
            weights[k, :, 0] = 0
    return weights


def two_sets_of_weights(rng, rows, columns, strength=1.0):
    return np.concatenate([grid_weights(rng, rows, columns, strength) for _ in range(2)])


def tiny_problem(seed, labels=4):
    rng = np.random.default_rng(seed)
    strength = rng.choice([0.1, 1.0, 5.0])
    data = rng.uniform(0, 5, (2, 3, labels)).astype(np.float32)
    return rng, data, grid_weights(rng, 2, 3, strength)


def all_labelings(low, high):
    ranges = [range(a, b + 1) for a, b in zip(low.ravel(), high.ravel(), strict=True)]
    return (np.reshape(labels, low.shape).astype(np.int32) for labels in product(*ranges))


def fused(labels, proposal, data, weights):
    """The fusion, with costs of labels."""
    place = np.flatnonzero(labels != proposal)
    change = [np.take_along_axis(data, each[..., None], 2).ravel() for each in (proposal, labels)]
    return fuse(labels, proposal, place, (change[0] - change[1])[place].astype(float), weights)


def explicit_energy(labels, data, weights, wide=WIDE):
    """(14), pair by pair and threshold by threshold, over (R, C) labels."""
    rows, columns = labels.shape
    energy = sum(float(data[i, j, labels[i, j]]) for i, j in np.ndindex(rows, columns))
    for k, (down, right) in enumerate(STEPS):
        for i, j in np.ndindex(rows, columns):
            if i + down < rows and 0 <= j + right < columns:
                low, high = sorted((int(labels[i, j]), int(labels[i + down, j + right])))
                for threshold in range(low, high):
                    beyond = len(weights) > HALF and threshold >= wide
                    energy += float(weights[k + HALF if beyond else k, i, j])
    return energy


def test_energy_is_the_sum_written_out():
    rng = np.random.default_rng(0)
    data, weights = rng.uniform(size=(4, 5, 6)).astype(np.float32), grid_weights(rng, 4, 5)
    labels = rng.integers(0, 6, (4, 5)).astype(np.int32)
    energy = energy_of(labels, data, weights)
    np.testing.assert_allclose(energy, explicit_energy(labels, data, weights), rtol=1e-6)


def test_energy_has_other_weights_beyond_the_wide_label():
    rng = np.random.default_rng(0)
    data = rng.uniform(size=(4, 5, WIDE + 9)).astype(np.float32)
    weights = two_sets_of_weights(rng, 4, 5)
    labels = rng.integers(WIDE - 9, WIDE + 9, (4, 5)).astype(np.int32)
    energy = energy_of(labels, data, weights)
    np.testing.assert_allclose(energy, explicit_energy(labels, data, weights), rtol=1e-5)


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_few_nodes_with_other_weights_beyond_a_label_are_solved_exactly(seed):
    rng, data, _ = tiny_problem(seed)
    weights = two_sets_of_weights(rng, 2, 3)
    low, high = np.zeros((2, 3), np.int32), np.full((2, 3), 3, np.int32)
    least = min(explicit_energy(labels, data, weights, 2) for labels in all_labelings(low, high))
    found = explicit_energy(solve_exactly(data, weights, 2), data, weights, 2)
    np.testing.assert_allclose(found, least, rtol=1e-6)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_fusion_with_other_weights_beyond_the_wide_label_is_the_best_of_all_mixtures(seed):
    rng = np.random.default_rng(seed)
    data = rng.uniform(0, 5, (2, 3, WIDE + 4)).astype(np.float32)
    weights = two_sets_of_weights(rng, 2, 3, rng.choice([0.1, 1.0, 5.0]))
    labels, proposal = rng.integers(WIDE - 4, WIDE + 4, (2, 2, 3)).astype(np.int32)
    mixture = fused(labels, proposal, data, weights)
    none, both = np.zeros((2, 3), np.int32), np.ones((2, 3), np.int32)
    mixed = (np.where(taken, proposal, labels) for taken in all_labelings(none, both))
    least = min(explicit_energy(mix, data, weights) for mix in mixed)
    np.testing.assert_allclose(explicit_energy(mixture, data, weights), least, rtol=1e-5)


def test_coarser_nodes_keep_other_weights_beyond_the_wide_label_apart():
    rng = np.random.default_rng(0)
    data = rng.uniform(0, 5, (6, 6, WIDE + 4)).astype(np.float32)
    near, beyond = grid_weights(rng, 6, 6), grid_weights(rng, 6, 6)
    _, both = coarser(data, np.concatenate([near, beyond]))
    np.testing.assert_array_equal(both[:HALF], coarser(data, near)[1])
    np.testing.assert_array_equal(both[HALF:], coarser(data, beyond)[1])


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_few_nodes_are_solved_exactly(seed):
    _, data, weights = tiny_problem(seed)
    low, high = np.zeros((2, 3), np.int32), np.full((2, 3), 3, np.int32)
    least = min(energy_of(labels, data, weights) for labels in all_labelings(low, high))
    found = energy_of(solve_exactly(data, weights), data, weights)
    np.testing.assert_allclose(found, least, rtol=1e-6)


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_two_labels_are_solved_exactly(seed):
    _, data, weights = tiny_problem(seed, labels=2)
    low, high = np.zeros((2, 3), np.int32), np.ones((2, 3), np.int32)
    least = min(energy_of(labels, data, weights) for labels in all_labelings(low, high))
    found = energy_of(solve_exactly(data, weights), data, weights)
    np.testing.assert_allclose(found, least, rtol=1e-6)


@given(seeds, st.sampled_from(["constant", "step", "any"]))
@settings(max_examples=60, deadline=None)
def test_fusion_is_the_best_of_all_ways_to_mix_two_labelings(seed, kind):
    rng, data, weights = tiny_problem(seed, labels=8)
    labels = rng.integers(0, 7, (2, 3)).astype(np.int32)
    proposal = {
        "constant": np.full((2, 3), rng.integers(0, 8), np.int32),
        "step": labels + np.int32(1),
        "any": rng.integers(0, 8, (2, 3)).astype(np.int32),
    }[kind]
    mixture = fused(labels, proposal, data, weights)
    assert ((mixture == labels) | (mixture == proposal)).all()
    none, both = np.zeros((2, 3), np.int32), np.ones((2, 3), np.int32)
    mixed = (np.where(taken, proposal, labels) for taken in all_labelings(none, both))
    least = min(energy_of(mix, data, weights) for mix in mixed)
    np.testing.assert_allclose(energy_of(mixture, data, weights), least, rtol=1e-6)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_fusion_of_a_larger_grid_never_raises_the_energy(seed):
    rng = np.random.default_rng(seed)
    data = rng.uniform(0, 5, (9, 13, 8)).astype(np.float32)
    weights = grid_weights(rng, 9, 13, rng.choice([0.1, 1.0, 5.0]))
    labels, proposal = rng.integers(0, 8, (2, 9, 13)).astype(np.int32)
    mixture = fused(labels, proposal, data, weights)
    least = min(energy_of(each, data, weights) for each in (labels, proposal))
    assert energy_of(mixture, data, weights) <= least * (1 + 1e-6)
    again = fused(mixture, proposal, data, weights)
    energies = [energy_of(each, data, weights) for each in (mixture, again)]
    np.testing.assert_allclose(*energies, rtol=1e-6)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_expansion_never_raises_the_energy(seed):
    rng, data, weights = tiny_problem(seed)
    labels = rng.integers(0, 4, (2, 3)).astype(np.int32)
    for alpha in range(4):
        expanded = expand(labels, alpha, data, weights)
        before, after = (energy_of(each, data, weights) for each in (labels, expanded))
        assert after <= before + 1e-5
        labels = expanded


def rough_problem(seed, strength):
    """A smooth field of labels, seen with noise of one label and a tenth of outliers."""
    rng = np.random.default_rng(seed)
    field = gaussian_filter(rng.standard_normal((24, 24)), 4, mode="wrap")
    field = 19 * (field - field.min()) / np.ptp(field) + rng.normal(0, 1, (24, 24))
    outlier = rng.random((24, 24)) < 0.1
    field[outlier] = rng.uniform(0, 19, outlier.sum())
    data = np.minimum((np.arange(20) - field[..., None]) ** 2, 15).astype(np.float32)
    return data, grid_weights(rng, 24, 24, strength)


def excess(labels, data, weights):
    """How far the energy of labels is above the least one, relative to it."""
    least = energy_of(solve_exactly(data, weights), data, weights)
    return energy_of(labels, data, weights) / least - 1


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("strength", [0.1, 1.0, 3.0])
def test_coarse_to_fine_labels_of_rough_data_are_near_the_optimum(seed, strength):
    data, weights = rough_problem(seed, strength)
    assert excess(minimize_energy(data, weights), data, weights) < 0.03


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("strength", [0.1, 1.0, 3.0])
def test_settled_expansions_are_within_3_percent_of_the_optimum(seed, strength):
    data, weights = rough_problem(seed, strength)
    assert excess(expand_until_settled(data, weights), data, weights) < 0.03


@pytest.mark.parametrize("minimize", [minimize_energy, expand_until_settled])
@pytest.mark.parametrize("texture", ["clouds", "astronaut"])
def test_labels_of_a_real_blur_map_are_within_a_thousandth_of_the_optimum(
    request, defocused, ramp, texture, minimize
):
    picture = defocused(request.getfixturevalue(texture), ramp)
    candidates = estimate_candidates(picture, camera_softness=0)
    blocks = Blocks.around(
        candidates.row_centers, candidates.column_centers, candidates.image_shape
    )
    data = CURVE_WEIGHT * data_term(candidates) * blocks.area[..., None]
    weights = blocks.edge_weights(picture.reshape(160, 160, -1), 0.1, 20.0)
    assert excess(minimize(data, weights), data, weights) < 1e-3


@pytest.mark.parametrize("everywhere", [False, True])
@pytest.mark.parametrize("strength", [0.1, 3.0])
def test_improved_labels_have_less_energy_and_what_is_best_stays(strength, everywhere):
    data, weights = rough_problem(1, strength)
    start = np.random.default_rng(0).integers(0, 20, (24, 24)).astype(np.int32)
    found = improve(start, data, weights, everywhere=everywhere)
    assert energy_of(found, data, weights) < 0.8 * energy_of(start, data, weights)
    best = solve_exactly(data, weights)
    found = improve(best, data, weights, everywhere=everywhere)
    energies = [energy_of(each, data, weights) for each in (found, best)]
    np.testing.assert_allclose(*energies, rtol=1e-6)


def test_parts_cover_every_node_and_those_of_a_group_do_not_touch():
    for shape, shifted in product([(20, 500), (127, 300), (700, 190)], [False, True]):
        seen = np.zeros(shape, int)
        for group in parts.groups_of_parts(shape, shifted=shifted):
            in_group = np.zeros(shape, int)
            for part in group:
                top, bottom, left, right = part.free
                own = slice(*part.rows), slice(*part.columns)
                inner = np.zeros(shape, bool)[part.seen]
                inner[top:bottom, left:right] = True
                assert inner.sum() == np.zeros(shape)[own].size
                in_group[own] += 1
                seen[own] += 1
                around = in_group[part.seen] - inner
                assert (around <= 0).all()
            assert in_group.max() == 1
        assert seen.min() == 1


def test_labels_of_many_parts_have_no_more_energy_than_those_of_one(monkeypatch):
    data, weights = rough_problem(1, 1.0)
    one = minimize_energy(data, weights)
    monkeypatch.setattr(parts, "_SIDE", 8)
    monkeypatch.setattr(parts, "_OVERLAP", 2)
    many = minimize_energy(data, weights)
    energies = [energy_of(labels, data, weights) for labels in (many, one)]
    assert energies[0] <= energies[1] * 1.001


def test_settled_expansions_from_given_labels_end_no_higher():
    data, weights = rough_problem(2, 1.0)
    start = minimize_energy(data, weights)
    settled = expand_until_settled(data, weights, start=start)
    assert energy_of(settled, data, weights) <= energy_of(start, data, weights) * (1 + 1e-6)


@pytest.mark.parametrize("minimize", [minimize_energy, expand_until_settled])
def test_without_edges_every_node_has_its_own_best_label(minimize):
    data, weights = rough_problem(0, 0.0)
    costs = np.take_along_axis(data, minimize(data, weights)[..., None], axis=2)[..., 0]
    np.testing.assert_allclose(costs, data.min(axis=2), atol=1e-5)


@pytest.mark.parametrize("minimize", [minimize_energy, expand_until_settled])
def test_endless_weights_leave_one_label(minimize):
    data, weights = rough_problem(0, 1e4)
    assert np.unique(minimize(data, weights)).tolist() == [data.sum(axis=(0, 1)).argmin()]


@pytest.mark.parametrize("minimize", [minimize_energy, expand_until_settled])
@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (23, 1), (21, 45)])
def test_grids_of_any_shape_are_labelled(minimize, shape):
    rng = np.random.default_rng(0)
    labels = minimize(rng.uniform(size=(*shape, 5)).astype(np.float32), grid_weights(rng, *shape))
    assert labels.shape == shape
    assert labels.dtype == np.int32
    assert labels.min() >= 0
    assert labels.max() < 5


@pytest.mark.parametrize("minimize", [minimize_energy, expand_until_settled])
def test_same_input_has_the_same_labels(minimize):
    data, weights = rough_problem(3, 0.5)
    np.testing.assert_array_equal(minimize(data, weights), minimize(data, weights))


@pytest.mark.parametrize("minimize", [minimize_energy, expand_until_settled])
def test_progress_never_falls(minimize):
    data, weights = rough_problem(1, 0.5)
    told = []
    minimize(data, weights, lambda step, done: told.append(done))
    assert told == sorted(told)
    assert min(told) >= 0
    assert max(told) <= 1


def test_input_is_left_as_it_was():
    data, weights = rough_problem(2, 1.0)
    before = data.copy(), weights.copy()
    minimize_energy(data, weights)
    np.testing.assert_array_equal(data, before[0])
    np.testing.assert_array_equal(weights, before[1])
