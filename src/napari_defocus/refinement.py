"""From labels 0.1 px apart to a continuous map: what the likelihood says between labels.

Around each window's label the curve log p(r) has a mean and a variance. The continuous map r
minimises

    sum_x (r_x - mean_x)^2 / (variance_x + (r_x - mean_x)^2)
        + lambda_1 sum w (r_x - r_v)^2 + lambda_2 sum w (r_u - 2 r_x + r_v)^2

over neighbours v in rows and columns, and pairs u, v on either side of x, that no jump of the
labels separates; the weights w are those of (16), at least a small share. The second difference
is what counts: it leaves slopes free, where (15) turns them into stairs. Windows that disagree
with all around them lose their say: the first term is a robust loss, minimised by reweighted
least squares.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from napari_defocus.candidates import BlurCandidates
from napari_defocus.coarser_grids import STEPS, Float32, Labels
from napari_defocus.progress import Progress, silent
from napari_defocus.settings import MapSettings
from napari_defocus.spectrum import LABEL_STEP

Float64 = NDArray[np.floating]
Slices = tuple[slice, slice]

_REFERENCE_STRIDE = 4
_SLOPE_WEIGHT, _BEND_WEIGHT = 1.0, 3e4
_LEAST_WEIGHT = 0.02
_REACH = 14
_TEMPER = 0.8
_LEAST_VARIANCE = 0.02**2
_ROUNDS = 3
_STEPS_A_ROUND = 3
_SAY_OF_DISPLACED = 0.1
_TILE = 256
_NEARLY = 0.02
_OVERLAP, _MARGIN = 128, 32
"""px that tiles see around themselves; what is farther away has hardly any influence. And px on
both sides of a border over which one tile goes over into the next."""


def refine_labels(
    candidates: BlurCandidates,
    labels: Labels,
    weights: Float32,
    jump: int,
    smoothness: float,
    own: Slices | None = None,
    progress: Progress = silent,
) -> Float32:
    """Find the continuous scale at every window.

    Parameters
    ----------
    candidates : BlurCandidates
    labels : (R, C) int32 ndarray
    weights : (4, R, C) float32 ndarray
        Of (16), between a window and its neighbour at each of `STEPS`, relative to lambda_0.
    jump : int
        The smallest difference of labels that counts as a discontinuity.
    smoothness : float
        lambda_0 of (16); both lambdas above grow with it.
    own : (slice, slice), optional
        If they are a part of a picture: which rows and columns of windows matter. Those around
        go along as far as they are seen.
    progress : callable, optional

    Returns
    -------
    (R, C) float32 ndarray
        In px.
    """
    elsewhere = candidates.displacement() > candidates.stride
    return refine_curves(
        candidates.curve,
        labels,
        weights,
        jump,
        stride=candidates.stride,
        strength=smoothness / MapSettings.smoothness,
        say=np.where(elsewhere, _SAY_OF_DISPLACED, 1.0),
        own=own,
        progress=progress,
    )


def refine_curves(
    curve: Float32,
    labels: Labels,
    weights: Float32,
    jump: int,
    *,
    stride: int,
    strength: float = 1.0,
    say: Float64 | None = None,
    own: Slices | None = None,
    progress: Progress = silent,
) -> Float32:
    """Find what lies between labels on a grid of any curves of log-likelihood.

    Parameters
    ----------
    curve : (R, C, L) float32 ndarray
        Log-likelihood of each label; a label counts as 0.1 px.
    labels, weights, jump
        As in `refine_labels`.
    stride : int
        Distance between the grid's places, in px.
    strength : float, optional
        Of both lambdas above, against the default.
    say : (R, C) float64 ndarray, optional
        How much each place counts, 1 by default.
    own
        As in `refine_labels`.
    progress : callable, optional

    Returns
    -------
    (R, C) float32 ndarray
        0.1 times a label, and between.
    """
    spacing = stride / _REFERENCE_STRIDE
    independent = spacing**2 * (np.ones(labels.shape) if say is None else say)
    scales = LABEL_STEP * np.arange(curve.shape[2])
    scale, total = np.zeros(labels.shape), np.zeros(labels.shape)
    overlap, margin = -(-_OVERLAP // stride), -(-_MARGIN // stride)
    tiles = list(_tiles(labels.shape, own, overlap, margin))
    for done, (around, share) in enumerate(tiles):
        progress("Smoothing out the steps", done / len(tiles))
        form = strength * _smoothness_form(labels[around], weights[:, *around], jump, spacing)
        start = LABEL_STEP * labels[around].astype(np.float64)
        near = curve[around].reshape(start.size, -1)
        solved = _solve(start.ravel(), near, scales, form, independent[around].ravel())
        scale[around] += share * solved.reshape(start.shape)
        total[around] += share
    progress("Smoothing out the steps", 1.0)
    return np.clip(scale / total, 0, scales[-1]).astype(np.float32)


def _tiles(
    shape: tuple[int, ...], own: Slices | None, overlap: int, margin: int
) -> Iterator[tuple[Slices, Float64]]:
    """Cut a grid into tiles; return what each sees, and how much it counts there.

    What is seen beyond `own` belongs to the tiles beside it.
    """
    kept = own or (slice(0, shape[0]), slice(0, shape[1]))
    axes = [
        [
            _tile(start, part, length, overlap, margin)
            for start in range(part.start, part.stop, _TILE)
        ]
        for part, length in zip(kept, shape, strict=True)
    ]
    for rows, row_share in axes[0]:
        for columns, column_share in axes[1]:
            yield (rows, columns), np.outer(row_share, column_share)


def _tile(start: int, own: slice, length: int, overlap: int, margin: int) -> tuple[slice, Float64]:
    """Return what a tile sees of an axis, and how much it counts there."""
    stop = min(start + _TILE, own.stop)
    first = 0 if start == own.start else max(start - overlap, 0)
    last = length if stop == own.stop else min(stop + overlap, length)
    share = np.ones(last - first)
    at = np.arange(first, last) + 0.5
    if start > own.start:
        share = np.minimum(share, np.clip((at - start + margin) / (2 * margin), 0, 1))
    if stop < own.stop:
        share = np.minimum(share, np.clip((stop + margin - at) / (2 * margin), 0, 1))
    return slice(first, last), share


def _solve(
    scale: Float64, curve: Float32, scales: Float64, form: sparse.csr_matrix, independent: Float64
) -> Float64:
    """Minimise by reweighted least squares, from the labels' scales: (P,).

    The first system is factorised, in single precision: half the memory, and the steps towards
    the solution, which take double precision, need no better. The factors serve the other
    systems, which differ little, too.
    """
    precondition = None
    for _ in range(_ROUNDS):
        mean, variance = _around(curve, scales, scale)
        evidence = independent / (variance + (scale - mean) ** 2)
        if precondition is None:
            precondition = _factorized(form + sparse.diags(evidence), evidence * mean)
            scale = precondition(evidence * mean)
        scale = _conjugate_gradients(form, evidence, mean, scale, precondition)
    return scale


def _factorized(matrix: sparse.csr_matrix, right: Float64) -> Callable[[Float64], Float64]:
    """Return what solves a system nearly, this one with `right` to 2 %.

    Where smoothness is all, single precision does not: the evidence is lost beside it.
    """
    try:
        solve = _factors(matrix, np.float32)
        if np.abs(matrix @ solve(right) - right).max() <= _NEARLY * np.abs(right).max():
            return solve
    except RuntimeError:  # it is singular, once rounded
        pass
    return _factors(matrix, np.float64)


def _factors(matrix: sparse.csr_matrix, dtype: type) -> Callable[[Float64], Float64]:
    factors = splu(
        matrix.tocsc().astype(dtype),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return lambda rest: factors.solve(rest.astype(dtype)).astype(np.float64)


def _conjugate_gradients(
    form: sparse.csr_matrix,
    evidence: Float64,
    mean: Float64,
    scale: Float64,
    precondition: Callable[[Float64], Float64],
) -> Float64:
    """Take some steps from a scale towards that where (form + evidence) scale = evidence mean."""
    rest = evidence * (mean - scale) - form @ scale
    direction = np.zeros_like(scale)
    before = np.inf
    for _ in range(_STEPS_A_ROUND):
        better = precondition(rest)
        after = np.sum(rest * better)
        if after <= 0:
            break
        direction = better + after / before * direction
        image = form @ direction + evidence * direction
        length = after / np.sum(direction * image)
        scale = scale + length * direction
        rest = rest - length * image
        before = after
    return scale


@njit(cache=True, parallel=True, nogil=True)
def _around(curve: Float32, scales: Float64, scale: Float64) -> tuple[Float64, Float64]:
    """Return mean and variance of the tempered likelihood within 1.4 px of a scale: (P,) each."""
    count = len(scales)
    reach = min(_REACH, (count - 1) // 2)
    mean, variance = np.empty(len(scale)), np.empty(len(scale))
    for place in prange(len(scale)):
        middle = int(np.rint(scale[place] / LABEL_STEP))
        first = min(max(middle - reach, 0), count - 1 - 2 * reach)
        near = scales[first : first + 2 * reach + 1]
        height = curve[place, first : first + 2 * reach + 1]
        likelihood = np.exp(_TEMPER * (height - height.max()))
        total = likelihood.sum()
        mean[place] = (likelihood * near).sum() / total
        spread = (likelihood * (near - mean[place]) ** 2).sum() / total
        variance[place] = spread + _LEAST_VARIANCE
    return mean, variance


def _smoothness_form(
    labels: Labels, weights: Float32, jump: int, spacing: float
) -> sparse.csr_matrix:
    """Return the matrix of the quadratic form of first and second differences.

    `spacing` is the distance between windows relative to that for which the weights hold.
    """
    columns = labels.shape[1]
    own, *beside = _stencil(labels, weights, jump, _BEND_WEIGHT / spacing**2)
    number = np.arange(labels.size)
    first, second, value = [number], [number], [own.ravel()]
    for step, coupling in zip((1, 2, columns, 2 * columns), beside, strict=True):
        coupled = np.flatnonzero(coupling)
        first += [coupled, coupled + step]
        second += [coupled + step, coupled]
        value += [coupling.ravel()[coupled]] * 2
    places = np.concatenate(first), np.concatenate(second)
    return sparse.csr_matrix((np.concatenate(value), places), shape=(labels.size, labels.size))


@njit(cache=True, nogil=True)
def _stencil(labels: Labels, weights: Float32, jump: int, bend_weight: float) -> Float64:
    """Return the form's entries between a window and itself, and those 1 and 2 steps after it.

    Along rows, then along columns: differences along diagonals were tried, and bumps got worse.
    """
    rows, columns = labels.shape
    entries = np.zeros((5, rows, columns))
    for i in range(rows):
        for j in range(columns):
            for k in range(2):
                down, right = STEPS[k]
                slope = _likeness(labels, weights, jump, k, i, j)
                if slope == 0:
                    continue
                y, x = i + down, j + right
                slope_weight = _SLOPE_WEIGHT * slope
                entries[0, i, j] += slope_weight
                entries[0, y, x] += slope_weight
                entries[1 + 2 * k, i, j] -= slope_weight
                bend = bend_weight * min(slope, _likeness(labels, weights, jump, k, y, x))
                if bend == 0:
                    continue
                entries[0, i, j] += bend
                entries[0, y, x] += 4 * bend
                entries[0, y + down, x + right] += bend
                entries[1 + 2 * k, i, j] -= 2 * bend
                entries[1 + 2 * k, y, x] -= 2 * bend
                entries[2 + 2 * k, i, j] += bend
    return entries


@njit(cache=True, nogil=True)
def _likeness(labels: Labels, weights: Float32, jump: int, k: int, i: int, j: int) -> float:
    """Return how much a window and the next one should be alike: not at all across a jump."""
    y, x = i + STEPS[k][0], j + STEPS[k][1]
    if y >= labels.shape[0] or x >= labels.shape[1] or abs(labels[i, j] - labels[y, x]) >= jump:
        return 0.0
    return max(weights[k, i, j], _LEAST_WEIGHT)
