"""Every numba kernel on tiny arrays, against the formula in numpy; also run without numba.

`test_without_jit` runs them as plain Python, where an index out of bounds is an error.
"""

import ast
import sys
from itertools import product
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import napari_defocus
from napari_defocus import Disc, simulate_defocus
from napari_defocus.core.progress import silent
from napari_defocus.forward.blur_operator import BlurOperator
from napari_defocus.labeling.confidence import _compare_rows, tolerance
from napari_defocus.labeling.continuous_refinement import _around
from napari_defocus.labeling.continuous_refinement import _smoothness_form as _bend_form
from napari_defocus.labeling.data_term import Costs, _find_tops, _limited, least_of_both
from napari_defocus.labeling.fusions import _flow, _fusion_graph, _push, change_of, fuse
from napari_defocus.labeling.graph_cuts import (
    Edges,
    _near,
    energy_of,
    expand,
    improve,
    solve_exactly,
)
from napari_defocus.labeling.minimum_cuts import sink_side, sink_side_of_one
from napari_defocus.labeling.multigrid import _RELAXATION, STEPS, _joined_weights, coarser
from napari_defocus.labeling.pairwise_term import Blocks, pixel_weights
from napari_defocus.labeling.pixel_refinement import (
    _interpolated_change,
    energy_of_pixels,
    interpolate_labels,
)
from napari_defocus.likelihood.between_windows import _interpolate
from napari_defocus.likelihood.blur_spectra import SpectrumTable
from napari_defocus.likelihood.evidence import limited_below_top
from napari_defocus.likelihood.gabor import _filtered, axis_filters, window_centers
from napari_defocus.likelihood.ground_beside import _add_between
from napari_defocus.likelihood.maxima import _pick_maxima, refine_maxima
from napari_defocus.likelihood.prior import log_prior
from napari_defocus.likelihood.profile_likelihood import (
    noise_power,
    profile_log_likelihood,
    quasi_log_likelihood,
)
from napari_defocus.likelihood.scale_space import (
    _add_level,
    _on_axis,
    _share_below,
    joined_scales,
)
from napari_defocus.restoration.deconvolution import _graph_laplacian, _irls_weights
from napari_defocus.stacks.block_shifts import block_shifts, block_spectra
from napari_defocus.stacks.depth_from_focus import _LEAST_DISPERSION, _MOST_DEVIANCE, _deviances
from napari_defocus.stacks.fusion import blended
from napari_defocus.stacks.plane_weights import Shares
from napari_defocus.stacks.pyramids import assembled, pyramid
from napari_defocus.stacks.shown_detail import ShownDetail

pytestmark = pytest.mark.kernel

PACKAGE = Path(napari_defocus.__file__).parent
DECORATORS = {"compiled", "compiled_inline"}
NOISE = 1e-5


@pytest.fixture(scope="module", autouse=True)
def called():
    """Collect (file, function) of what runs, as far as it is Python."""
    functions = set()

    def note(frame, event, _):
        if event == "call":
            functions.add((frame.f_code.co_filename, frame.f_code.co_name))

    if numba.config.DISABLE_JIT:
        sys.setprofile(note)
    yield functions
    sys.setprofile(None)


class Smear:
    """A lopsided PSF that is linear in its scale, so that interpolated kernels are exact."""

    max_scale = 1.0
    scale_name = "share"
    point = np.array([[0, 0, 0], [0, 1, 0], [0, 0, 0]])
    smeared = np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9]]) / 45

    def kernel(self, scale):
        return (1 - scale) * self.point + scale * self.smeared


@pytest.mark.parametrize("channels", [1, 3])
def test_gather_is_1(channels):
    rng = np.random.default_rng(0)
    picture, scales = rng.random((5, 6, channels)), rng.integers(0, 81, (5, 6)) / 80
    padded = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="symmetric")
    expected = np.zeros_like(picture)
    for i, j in np.ndindex(3, 3):
        share = np.array([[Smear().kernel(scale)[i, j] for scale in row] for row in scales])
        expected += share[..., None] * padded[2 - i : 7 - i, 2 - j : 8 - j]
    blurred = simulate_defocus(picture.squeeze(), scales, psf=Smear())
    np.testing.assert_allclose(blurred.reshape(expected.shape), expected, atol=1e-6)


@pytest.mark.parametrize("channels", [1, 3])
def test_spread_is_the_adjoint_of_gather(channels):
    rng = np.random.default_rng(1)
    scales = (rng.integers(0, 81, (35, 4)) / 80).astype(np.float32)
    blur = BlurOperator(scales, Smear(), channels)
    f = rng.standard_normal((3, *blur.domain, channels)).astype(np.float32)
    y = rng.standard_normal((3, 35, 4, channels)).astype(np.float32)
    there = np.tensordot([blur.apply(one) for one in f], y, ((1, 2, 3), (1, 2, 3)))
    back = np.tensordot(f, [blur.adjoint(one) for one in y], ((1, 2, 3), (1, 2, 3)))
    np.testing.assert_allclose(back, there, atol=1e-4)


@pytest.mark.parametrize("window", [17, 25, 41])
@pytest.mark.parametrize("fraction", [0.0, 0.5])
def test_filtered_samples_are_sums_of_products_with_the_taps(window, fraction):
    filters = axis_filters(window, fraction)
    samples = np.random.default_rng(0).normal(size=(60, 3)).astype(np.float32)
    first = np.array([0, 3, 60 - len(filters.taps)])
    found = _filtered(samples, first, filters)
    for at, sums in zip(first, found, strict=True):
        expected = filters.taps.T.astype(float) @ samples[at : at + len(filters.taps)]
        np.testing.assert_allclose(sums, expected, atol=1e-5)


def test_irls_weights_are_those_of_the_joint_variation():
    picture = np.random.default_rng(2).random((4, 5, 3)).astype(np.float32)
    down = np.diff(picture, axis=0, append=picture[-1:])
    right = np.diff(picture, axis=1, append=picture[:, -1:])
    square = np.sum(down**2 + right**2, axis=2) + 0.1**2
    weights = _irls_weights(picture, np.float32(0.3), np.float32(0.1))
    np.testing.assert_allclose(weights, 0.3 / 2 / np.sqrt(square), rtol=1e-5)


def test_graph_laplacian_is_that_of_the_weighted_sum_of_squares():
    rng = np.random.default_rng(3)
    picture, other = rng.random((2, 4, 5, 3)).astype(np.float32)
    weights = rng.random((4, 5)).astype(np.float32)
    products = sum(
        np.sum(weights[at][..., None] * np.diff(picture, axis=axis) * np.diff(other, axis=axis))
        for axis, at in ((0, np.s_[:-1]), (1, np.s_[:, :-1]))
    )
    laplacian = _graph_laplacian(weights, picture)
    assert np.vdot(other, laplacian) == pytest.approx(products, rel=1e-5)


def small_table(step=0.02):
    """Spectra exp(-w r^2) of 5 frequencies, over 0 to 2 px."""
    scales = np.arange(0, 2 + step / 2, step)
    r, width = scales[:, None, None], np.linspace(0.2, 3, 10).reshape(2, 5)
    value = np.exp(-width * r**2)
    first, second = -2 * width * r * value, (4 * width**2 * r**2 - 2 * width) * value
    return SpectrumTable(scales, value, first, second, np.linspace(1, 2, 10).reshape(2, 5))


def drawn_powers(windows=3):
    """Powers drawn from (5) at r = 1 px, s = 1e-3."""
    table = small_table()
    expected = 1e-3 * table.at(np.array([1.0]))[0] + noise_power(table, NOISE)
    drawn = np.random.default_rng(2).exponential(size=(windows, 2, 5))
    return (drawn * expected).astype(np.float32)


def best_strengths(power, table, scales):
    """Of each gradient: max_s log p(r, s), and the mean square of q / (1 + s a) - 1 there."""
    noise = noise_power(table, NOISE)
    strength = np.concatenate([[0], np.geomspace(1e-7, 1e3, 1500)])[:, None, None, None]
    variance = strength * table.at(scales) + noise
    ratio = power[:, None, None] / variance
    log_p = -np.sum(ratio + np.log(variance), axis=-1)
    best = log_p.argmax(axis=1)[:, None]
    misfit = np.mean((ratio - 1) ** 2, axis=-1)
    return tuple(np.take_along_axis(values, best, 1)[:, 0] for values in (log_p, misfit))


def test_profile_likelihood_is_9():
    table, scales = small_table(), np.arange(0, 2.01, 0.2)
    curve = profile_log_likelihood(drawn_powers(), table, scales, NOISE)
    log_p, _ = best_strengths(drawn_powers(), table, scales)
    near = log_p.sum(axis=2) > log_p.sum(axis=2).max(axis=1, keepdims=True) - 5
    np.testing.assert_allclose(curve[near], log_p.sum(axis=2)[near], rtol=0, atol=0.02)


def test_dispersion_is_the_mean_square_deviation():
    table, scales = small_table(), np.arange(0, 2.01, 0.2)
    power = drawn_powers()
    power[:, :, 1] *= 30
    curve, dispersion = quasi_log_likelihood(power, table, scales, NOISE)
    log_p, misfit = best_strengths(power, table, scales)
    total = log_p.sum(axis=2)
    best = total.argmax(axis=1)
    weight = np.exp(total - total.max(axis=1, keepdims=True))[..., None]
    expected = np.maximum((weight * misfit).sum(axis=1) / weight.sum(axis=1), 1)
    assert expected.max() > 1.5
    np.testing.assert_allclose(dispersion, expected, rtol=0.03)
    np.testing.assert_allclose(
        curve.max(axis=1), (log_p[np.arange(3), best] / expected).sum(axis=1), rtol=0.03
    )


def test_refined_maximum_is_that_of_the_formula():
    table, power = small_table(), drawn_powers()
    scales = np.arange(0.5, 1.7, 0.004)
    log_p = best_strengths(power, small_table(step=0.004), scales)[0].sum(axis=2)
    expected = scales[log_p.argmax(axis=1)]
    start = (np.round(expected, 1)[:, None] + [0, np.nan]).astype(np.float32)
    radii, heights = refine_maxima(power, table, start, 0.1, NOISE, np.ones((3, 2), np.float32))
    np.testing.assert_allclose(radii[:, 0], expected, rtol=0, atol=0.005)
    np.testing.assert_allclose(heights[:, 0], log_p.max(axis=1), rtol=0, atol=0.01)
    assert np.isnan(radii[:, 1]).all()
    assert np.isneginf(heights[:, 1]).all()


@pytest.mark.parametrize("first", [0, 3])
def test_picked_maxima_are_the_highest_that_no_neighbour_exceeds(first):
    curve = np.random.default_rng(0).integers(0, 6, (20, 12)).astype(np.float32)
    scales = np.arange(12, dtype=np.float32)
    picked = _pick_maxima(curve, scales, first)
    for values, found in zip(curve, picked, strict=True):
        around = np.concatenate([[-np.inf], values[first:], [-np.inf]])
        tops = first + np.flatnonzero((around[1:-1] > around[:-2]) & (around[1:-1] >= around[2:]))
        best = sorted(tops, key=lambda k: (-values[k], k))[:3]
        np.testing.assert_array_equal(found, np.append(best, [np.nan] * (3 - len(best))))


def random_weights(rows, columns, seed=0):
    """Weights of a grid's 8-neighbourhood, (4, rows, columns)."""
    weights = np.random.default_rng(seed).uniform(0.1, 1, (4, rows, columns)).astype(np.float32)
    for k, (down, right) in enumerate(STEPS):
        weights[k, rows - down :] = 0
        weights[k, :, columns - max(0, right) :] = 0
        weights[k, :, : max(0, -right)] = 0
    return weights


def matrix(edges, nodes):
    """The weights of all pairs of nodes, (nodes, nodes)."""
    weights = np.zeros((nodes, nodes))
    np.add.at(weights, (edges.first, edges.second), edges.weight)
    return weights + weights.T


def color_matrix(color, color_sigma, smoothness):
    """(16) for all pairs of pixels that are 8-neighbours."""
    pixels = color.reshape(-1, color.shape[-1]).astype(float)
    place = np.indices(color.shape[:2]).reshape(2, -1)
    distance = np.abs(place[:, :, None] - place[:, None]).max(axis=0)
    difference = np.sum((pixels[:, None] - pixels) ** 2, axis=2)
    return smoothness * np.exp(-difference / (2 * color_sigma**2)) * (distance == 1)


def joined(weights, block, blocks):
    """Sums of the weights between the members of different blocks, (blocks, blocks)."""
    member = np.equal.outer(np.arange(blocks), block).astype(float)
    sums = member @ weights @ member.T
    return sums * (1 - np.eye(blocks))


@pytest.mark.parametrize(("shape", "stride"), [((7, 5), 3), ((4, 6), 1)])
def test_block_weights_are_sums_of_16(shape, stride):
    color = np.random.default_rng(0).uniform(0.4, 0.6, (*shape, 3)).astype(np.float32)
    blocks = Blocks.around(*(window_centers(side, stride) for side in shape), shape)
    rows, columns = len(blocks.row_centers), len(blocks.column_centers)
    number = blocks.row_of_pixel[:, None] * columns + blocks.column_of_pixel
    expected = joined(color_matrix(color, 0.1, 20.0), number.ravel(), rows * columns)
    edges = Edges.of_grid(blocks.edge_weights(color, 0.1, 20.0))
    np.testing.assert_allclose(matrix(edges, rows * columns), expected, rtol=1e-5)


def test_pixel_weights_are_16_where_a_pixel_is_given():
    color = np.random.default_rng(0).uniform(0.4, 0.6, (4, 5, 2)).astype(np.float32)
    near = np.zeros((4, 5), bool)
    near[1:3, 2:4] = True
    expected = color_matrix(color, 0.1, 20.0) * np.logical_or.outer(near.ravel(), near.ravel())
    weights = pixel_weights(color, near, 0.1, 20.0)
    np.testing.assert_allclose(matrix(Edges.of_grid(weights), 20), expected, rtol=1e-5)


def test_energy_of_pixels_is_14():
    rng = np.random.default_rng(0)
    blocks = Blocks.around(window_centers(6, 3), window_centers(7, 3), (6, 7))
    rows, columns = len(blocks.row_centers), len(blocks.column_centers)
    cost = rng.random((rows, columns, 4)).astype(np.float32)
    color = rng.uniform(0.4, 0.6, (6, 7, 3)).astype(np.float32)
    labels = rng.integers(0, 4, (6, 7)).astype(np.int32)
    at = np.meshgrid(*blocks.positions, indexing="ij")
    expected = sum(
        map_coordinates(cost[..., label], at, order=1)[labels == label].sum() for label in range(4)
    )
    jumps = np.abs(np.subtract.outer(labels.ravel(), labels.ravel()))
    expected += np.sum(color_matrix(color, 0.1, 20.0) * jumps) / 2
    found = energy_of_pixels(labels, cost, blocks, color, smoothness=20.0, color_sigma=0.1)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_weights_of_coarser_nodes_are_sums():
    weights = random_weights(4, 5)
    number = (np.arange(4) // 2)[:, None] * 3 + np.arange(5) // 2
    expected = joined(matrix(Edges.of_grid(weights), 20), number.ravel(), 6)
    coarse = _joined_weights(weights, np.arange(4) // 2, np.arange(5) // 2)
    np.testing.assert_allclose(matrix(Edges.of_grid(coarse), 6), expected, rtol=1e-5)


def test_coarser_costs_are_sums_of_the_least_with_a_price_for_the_distance():
    data = np.random.default_rng(0).uniform(0, 5, (3, 4, 4)).astype(np.float32)
    weights = random_weights(3, 4)
    price = _RELAXATION * weights.sum(axis=0)[..., None, None]
    distance = np.abs(np.subtract.outer(np.arange(4), np.arange(4)))
    relaxed = np.min(data[:, :, None] + price * distance, axis=3)
    for agreed, cost in {False: relaxed, True: data}.items():
        padded = np.pad(cost, [(0, 1), (0, 0), (0, 0)])
        expected = padded.reshape(2, 2, 2, 2, 4).sum(axis=(1, 3))
        found, _ = coarser(data, weights, agreed=agreed)
        np.testing.assert_allclose(found, expected, rtol=1e-5)


def costs_and_weights(labels):
    data = np.random.default_rng(1).uniform(0, 3, (2, 2, labels)).astype(np.float32)
    return data, random_weights(2, 2)


def test_thresholds_give_the_best_of_all_labelings():
    data, weights = costs_and_weights(4)
    labelings = (np.reshape(some, (2, 2)).astype(np.int32) for some in product(range(4), repeat=4))
    least = min(energy_of(labels, data, weights) for labels in labelings)
    found = solve_exactly(data, weights)
    np.testing.assert_allclose(energy_of(found, data, weights), least, rtol=1e-6)


@pytest.mark.parametrize("proposal", [[1, 1, 1, 1], [2, 0, 3, 3]])
def test_fusion_is_the_best_of_all_mixtures(proposal):
    data, weights = costs_and_weights(4)
    labels, proposal = np.array([[0, 3], [2, 1]], np.int32), np.array(proposal, np.int32)
    proposal = proposal.reshape(2, 2)
    place = np.flatnonzero(labels != proposal)
    mixtures = (
        np.where(np.reshape(taken, (2, 2)), proposal, labels)
        for taken in product([False, True], repeat=4)
    )
    least = min(energy_of(some, data, weights) for some in mixtures)
    change = change_of(labels, proposal, place, data)
    found = fuse(labels, proposal, place, change, weights)
    np.testing.assert_allclose(energy_of(found, data, weights), least, rtol=1e-6)


def test_flow_leaves_the_value_of_every_cut():
    rng = np.random.default_rng(2)
    labels, proposal = rng.permuted(np.arange(8).reshape(2, 2, 2), axis=0).astype(np.int32)
    place, weights = np.arange(4), random_weights(2, 2)
    change = rng.normal(0, 2, 4)
    cost, tail, head, capacity = _fusion_graph(labels, proposal, place, change, weights)
    assert (tail < head).all()
    assert (np.diff(tail) >= 0).all()
    left = cost.copy()
    forth, back = _flow(left, tail, head, capacity)
    for step in (lambda *_: None, _push):
        step(left, tail, head, forth, back)
        assert min(forth.min(), back.min()) >= 0
        for upper in product([0, 1], repeat=4):
            side = np.array(upper)
            rises = side[head] - side[tail]
            before = cost @ side + capacity @ np.abs(rises)
            after = left @ side + forth @ (rises > 0) + back @ (rises < 0)
            np.testing.assert_allclose(after, before, atol=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_sink_side_is_the_smallest_of_the_least_cuts(seed):
    rng = np.random.default_rng(seed)
    tail, head = np.triu_indices(6, 1)
    kept = rng.random(len(tail)) < 0.6
    tail, head = tail[kept].astype(np.int32), head[kept].astype(np.int32)
    cost = rng.integers(-6, 7, 6).astype(float)
    forth, back = rng.integers(0, 4, (2, len(tail))).astype(float)
    costs = {}
    for chosen in product([0, 1], repeat=6):
        side = np.array(chosen)
        rises = side[head] - side[tail]
        costs[chosen] = cost @ side + forth @ (rises > 0) + back @ (rises < 0)
    best = [side for side, value in costs.items() if value == min(costs.values())]
    found = sink_side(cost, tail, head, forth, back)
    assert tuple(found.astype(int)) == min(best, key=sum)


@pytest.mark.parametrize("seed", range(5))
def test_our_own_cuts_are_those_of_pymaxflow(seed):
    pytest.importorskip("maxflow", reason="Python 3.14 has no wheel of PyMaxflow")
    rng = np.random.default_rng(seed)
    tail, head = rng.integers(0, 60, (2, 400)).astype(np.int32)
    tail, head = tail[tail != head], head[tail != head]
    cost = rng.normal(0, 12, 60)
    forth, back = rng.exponential(1, (2, len(tail)))
    graph = cost, tail, head, forth, back
    np.testing.assert_array_equal(sink_side(*graph), sink_side_of_one(*graph))
    assert 0 < sink_side(*graph).sum() < 60


def test_nodes_near_a_label_are_those_around_nodes_that_have_about_it():
    labels = np.array([[0, 0, 0, 0, 0], [0, 0, 0, 0, 0], [4, 5, 0, 0, 9]], np.int32)
    everywhere = (0, 3, 0, 5)
    assert _near(labels, 5, 0, 1, everywhere).tolist() == [5, 6, 7, 10, 12]
    assert _near(labels, 5, 1, 1, everywhere).tolist() == [5, 6, 7, 10, 12]
    assert _near(labels, 8, 1, 1, everywhere).tolist() == [8, 9, 13, 14]
    assert _near(labels, 8, 1, 2, everywhere).tolist() == [2, 3, 4, 7, 8, 9, 12, 13, 14]
    assert _near(labels, 8, 1, 2, (1, 3, 0, 4)).tolist() == [7, 8, 12, 13]


@pytest.mark.parametrize("everywhere", [False, True])
def test_moves_lower_the_energy_to_the_least_of_few_labelings(everywhere):
    data, weights = costs_and_weights(4)
    labelings = [np.reshape(some, (2, 2)).astype(np.int32) for some in product(range(4), repeat=4)]
    least = min(energy_of(labels, data, weights) for labels in labelings)
    found = improve(labelings[7], data, weights, everywhere=everywhere)
    np.testing.assert_allclose(energy_of(found, data, weights), least, rtol=1e-6)
    expanded = expand(labelings[7], 2, data, weights)
    assert energy_of(expanded, data, weights) <= energy_of(labelings[7], data, weights)


def test_curves_are_limited_below_their_tops():
    curve = np.random.default_rng(0).normal(0, 10, (3, 4, 7)).astype(np.float32)
    expected = np.maximum(curve - curve.max(axis=2, keepdims=True), -15)
    np.testing.assert_allclose(limited_below_top(curve), expected, rtol=1e-5)


@pytest.mark.parametrize("prior", [False, True])
def test_share_below_a_scale_compares_the_best_on_both_sides(prior):
    curve = np.random.default_rng(0).normal(0, 2, (3, 4, 81)).astype(np.float32)
    scales = 0.1 * np.arange(81)
    likely = curve + log_prior(scales) if prior else curve
    rise = likely[..., :31].max(axis=2) - likely[..., 31:].max(axis=2)
    found = _share_below(curve, scales, 3.0, prior=prior)
    np.testing.assert_allclose(found, np.clip(0.5 + rise / 6, 0, 1), atol=1e-5)


def test_a_level_is_put_on_the_axis_of_all():
    curve = np.random.default_rng(0).normal(0, 2, (2, 3, 81)).astype(np.float32)
    own, scales = 0.1 * np.arange(81), joined_scales(32.0, 41, 3)
    found = _on_axis(curve, 2, scales, own, 3.0, 2.0)
    little = curve[..., :21].max(axis=2)
    plain = np.apply_along_axis(lambda line: np.interp(scales / 2, own, line), 2, curve)
    for k, scale in enumerate(scales):
        if scale > 16:
            expected = curve[..., 30:].max(axis=2)
        else:
            expected = little if scale <= 4 else plain[..., k]
        if not 4 < scale < 4.2:  # between the last one of the class and the next
            np.testing.assert_allclose(found[..., k], expected, atol=1e-5)


def test_limited_depth_is_weighted_and_0_at_the_top():
    rng = np.random.default_rng(0)
    curve = rng.normal(0, 10, (3, 4, 7)).astype(np.float32)
    weight = rng.random((3, 4)).astype(np.float32)
    prior = rng.normal(0, 1, 7).astype(np.float32)
    likely = curve + prior
    depth = np.minimum(likely.max(axis=2, keepdims=True) - likely, 15)
    found = _limited(curve, prior, weight, np.float32(15))
    np.testing.assert_allclose(found, weight[..., None] * depth, rtol=1e-5)


def test_least_costs_beyond_and_among_the_first_labels():
    data = np.random.default_rng(0).random((3, 4, 7)).astype(np.float32)
    expected = np.stack([data[..., 3:].min(axis=2), data[..., :3].min(axis=2)], axis=2)
    np.testing.assert_array_equal(least_of_both(data, 3), expected)


def test_curves_are_held_against_a_map():
    rng = np.random.default_rng(0)
    curve = rng.normal(0, 2, (3, 4, 30)).astype(np.float32)
    scales = np.linspace(0, 6, 30).astype(np.float32)
    spacing = rng.uniform(0.5, 2, 30).astype(np.float32)
    radius = rng.uniform(0, 6, (3, 4)).astype(np.float32)
    likely = curve + log_prior(scales)
    share = spacing * np.exp(0.7 * (likely - likely.max(axis=2, keepdims=True)))
    agrees = np.abs(scales - radius[..., None]) <= tolerance(radius)[..., None]
    expected = (
        np.ptp(curve, axis=2),
        scales[likely.argmax(axis=2)],
        np.sum(share * agrees, axis=2) / share.sum(axis=2),
        np.sum(spacing * agrees, axis=2) / spacing.sum(),
    )
    found = np.empty((4, 3, 4), np.float32)
    given = curve, log_prior(scales), scales, spacing, radius, tolerance(radius)
    _compare_rows(0, 3, *given, found)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_mean_and_variance_are_those_of_the_tempered_likelihood_nearby():
    curve = np.random.default_rng(0).normal(0, 2, (5, 40)).astype(np.float32)
    scales, scale = np.arange(40) / 10, np.array([0.0, 0.3, 1.98, 3.6, 3.9])
    given = curve[None], np.zeros(len(curve), np.int32), np.arange(len(curve), dtype=np.int32)
    mean, variance = _around(given, scales, scale)
    for place, first in enumerate([0, 0, 6, 11, 11]):
        near = scales[first : first + 29]
        share = np.exp(0.8 * curve[place, first : first + 29])
        share /= share.sum()
        np.testing.assert_allclose(mean[place], share @ near, rtol=1e-5)
        spread = share @ (near - share @ near) ** 2
        np.testing.assert_allclose(variance[place], spread + 4e-4, rtol=1e-5)


def test_smoothness_form_is_the_sum_of_weighted_squares():
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 6, (4, 5)).astype(np.int32)
    weights = random_weights(4, 5)
    values = rng.normal(size=(4, 5))
    expected = 0.0
    for axis, weight in ((1, weights[0][:, :-1]), (0, weights[1][:-1])):
        alike = np.maximum(weight, 0.02) * (np.abs(np.diff(labels, axis=axis)) < 4)
        first, last = (np.delete(alike, end, axis) for end in (-1, 0))
        expected += np.sum(alike * np.diff(values, axis=axis) ** 2)
        bends = np.diff(values, 2, axis=axis) ** 2
        expected += 3e4 / 1.5**2 * np.sum(np.minimum(first, last) * bends)
    upper = _bend_form(labels, weights, 4, 1.5).toarray()
    form = upper + np.triu(upper, 1).T
    np.testing.assert_allclose(values.ravel() @ (form @ values.ravel()), expected, rtol=1e-6)


def test_interpolated_change_is_bilinear():
    rng = np.random.default_rng(0)
    cost = rng.random((3, 4, 5)).astype(np.float32)
    rows, columns = np.linspace(0, 2, 7), np.linspace(0, 3, 8)
    place = np.arange(0, 56, 3)
    now, new = rng.integers(0, 5, (2, 7, 8)).astype(np.int32)
    at = np.meshgrid(rows, columns, indexing="ij")
    at_label = [map_coordinates(cost[..., label], at, order=1) for label in range(5)]
    expected = np.choose(new, at_label) - np.choose(now, at_label)
    change = _interpolated_change(cost, now, new, place, rows, columns)
    np.testing.assert_allclose(change, expected.ravel()[place], atol=1e-6)


def test_costs_of_a_large_picture_are_those_of_an_array_wherever_they_are_asked_for():
    rng = np.random.default_rng(0)
    curve = rng.normal(0, 8, (40, 4, 7)).astype(np.float32)
    row, column = rng.integers(0, (40, 4), (40, 4, 2)).astype(np.int32).transpose(2, 0, 1).copy()
    prior = rng.normal(0, 1, 7).astype(np.float32)
    say, factor = rng.random((2, 40, 4), np.float32)
    own = curve[row, column]
    top = np.empty((40, 4), np.float32)
    _find_tops(0, 40, curve, row, column, prior, top)
    costs = Costs(curve, row, column, prior, top, say, factor)
    array = _limited(own, prior, say, np.float32(15)) * factor[..., None]
    np.testing.assert_array_equal(np.asarray(costs), array)
    np.testing.assert_array_equal(costs[3:5, 1:3], array[3:5, 1:3])
    np.testing.assert_array_equal(least_of_both(costs, 3), least_of_both(array, 3))
    now, new = rng.integers(0, 7, (2, 40, 4)).astype(np.int32)
    place = np.flatnonzero(now != new)
    np.testing.assert_array_equal(costs.change(now, new, place), change_of(now, new, place, array))
    now, new = rng.integers(0, 7, (2, 79, 8)).astype(np.int32)
    places = np.arange(0, 632, 3), np.linspace(0, 39, 79), np.linspace(0, 3, 8)
    np.testing.assert_array_equal(
        costs.change_between(now, new, *places), _interpolated_change(array, now, new, *places)
    )


def test_interpolated_labels_are_bilinear_among_those_alike():
    labels = np.array([[3, 4, 9], [5, 3, 8]], np.int32)
    blocks = Blocks.around(window_centers(6, 3), window_centers(9, 3), (6, 9))
    pixels = blocks.spread(labels)
    pixels[0, 0] = 20
    rows, columns = blocks.positions
    near_rows = np.maximum(0, 1 - np.abs(rows[:, None] - np.arange(2)))
    near_columns = np.maximum(0, 1 - np.abs(columns[:, None] - np.arange(3)))
    share = near_rows[:, None, :, None] * near_columns[:, None]
    share *= np.abs(labels - pixels[..., None, None]) < 4
    total = share.sum(axis=(2, 3))
    scales = np.float32(0.1) * labels + np.float32(0.03)
    mean = np.sum(share * scales, axis=(2, 3)) / np.maximum(total, 1e-9)
    expected = np.where(total > 0, mean, 0.1 * pixels)
    found = interpolate_labels(scales, labels, pixels, blocks, 4)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_deviance_of_a_focus_is_that_of_the_best_power_that_planes_have_in_common():
    rng = np.random.default_rng(7)
    members = np.array([4, 9], np.float32)
    blur = rng.uniform(0.1, 2, (3, 2, 5)).astype(np.float32)  # positions, rings, planes
    power = (1 + np.array([20, 5])[:, None] * blur[1]) * rng.uniform(0.8, 1.25, (4, 2, 5))
    heard = np.ones((4, 5), bool)
    heard[3, 0] = False  # whatever it shows
    power[3, :, 0] = 1e6
    deviance, dispersion = _deviances(power.astype(np.float32), heard, blur, members)
    strength = np.geomspace(1e-2, 1e3, 1500)
    for window, position in product(range(4), range(3)):
        expected = 1 + strength[:, None, None] * blur[position]
        ratio = (power[window] / expected)[..., heard[window]]
        of_planes = np.minimum(ratio - 1 - np.log(ratio), _MOST_DEVIANCE)
        of_rings = members * of_planes.sum(axis=2)
        least = of_rings.min(axis=0).sum()
        # A few rounds of scoring reach the best power where the position fits.
        assert deviance[window, position] > least - 1e-2
        assert deviance[window, position] < (1.01 if position == 1 else 1.3) * least + 0.01
    assert (deviance.argmin(axis=1) == 1).all(), "the focus that the planes were made with"
    degrees = heard.sum(axis=1) * members.sum()
    fitted = np.maximum(2 * deviance.min(axis=1) / degrees, _LEAST_DISPERSION)
    np.testing.assert_allclose(dispersion, fitted, rtol=1e-5)


def test_curves_between_windows_are_interpolated_and_added():
    curve = np.random.default_rng(0).uniform(-15, 0, (4, 5, 7)).astype(np.float32)
    rows, columns = np.array([0.0, 0.25, 3.0]), np.array([0.0, 1.5, 4.0])
    places = np.meshgrid(rows, columns, indexing="ij")
    expected = np.stack(
        [map_coordinates(curve[..., k].astype(float), places, order=1) for k in range(7)], axis=2
    )
    found = np.empty((3, 3, 7), np.float32)
    _interpolate(0, 3, curve, rows, columns, found)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    total = np.ones((3, 3, 7), np.float32)
    keep = np.full((3, 3), 0.5, np.float32)
    gain = np.full((3, 3), 2.0, np.float32)
    keep[0, 0], gain[0, 0] = 1, 0
    _add_level(0, 3, curve, 0, 4, rows, columns, keep, gain, total)
    some = np.ones((3, 7), np.float32)
    shares = np.array([1, 0, 2], np.float32)
    _add_between(0, 3, curve, 0, 4, rows, columns, shares, some)
    at_places = expected[np.arange(3), np.arange(3)]
    np.testing.assert_allclose(some, 1 + shares[:, None] * at_places, rtol=1e-5)
    expected = 0.5 + 2 * expected
    expected[0, 0] = 1
    np.testing.assert_allclose(total, expected, rtol=1e-5)


@pytest.mark.parametrize("shape", [(1, 5, 1), (18, 17, 2)])
def test_a_picture_is_the_sum_of_its_sizes_of_detail(shape):
    picture = np.random.default_rng(0).random(shape)
    np.testing.assert_allclose(assembled(pyramid(picture, 2)), picture, atol=1e-15)


def test_blocks_that_move_round_their_border_have_moved_by_that():
    block = np.random.default_rng(0).standard_normal((12, 12)).astype(np.float32)
    pair = [block_spectra(one[None]) for one in (block, np.roll(block, (1, -2), axis=(0, 1)))]
    np.testing.assert_allclose(block_shifts(*pair, 12), [[1, -2]], atol=1e-3)


def test_planes_are_put_together_from_the_sharper_one():
    rng = np.random.default_rng(0)
    sharp = rng.random((20, 24)).astype(np.float32)
    sharp[2:8, 2:8] = 2
    planes = [sharp, simulate_defocus(sharp, np.full(sharp.shape, 3.0)).astype(np.float32)]
    shown = ShownDetail(sharp.shape, 2)
    for number, plane in enumerate(planes):
        shown.see(number, plane, plane)
    shares = Shares(2, 3.0, Disc(8.0), 1e-8, shown)
    position = np.zeros(sharp.shape, np.float32)
    together = blended(planes.__getitem__, position, shares, silent)
    np.testing.assert_allclose(together, sharp, atol=0.05)


@pytest.mark.skipif(not numba.config.DISABLE_JIT, reason="compiled calls cannot be watched")
def test_every_kernel_of_the_package_ran_above(called):
    kernels = {
        (str(path), function.name)
        for path in PACKAGE.rglob("*.py")
        for function in ast.walk(ast.parse(path.read_text()))
        if isinstance(function, ast.FunctionDef)
        and any(ast.unparse(decorator) in DECORATORS for decorator in function.decorator_list)
    }
    assert len(kernels) > 10
    assert kernels - called == set()
