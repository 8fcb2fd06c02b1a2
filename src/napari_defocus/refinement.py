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

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from napari_defocus.candidates import BlurCandidates
from napari_defocus.graphcut import STEPS, Float32, Labels
from napari_defocus.progress import Progress, silent
from napari_defocus.settings import MapSettings
from napari_defocus.spectrum import LABEL_STEP

Float64 = NDArray[np.floating]
Slices = tuple[slice, slice]

_REFERENCE_STRIDE = 4
_SLOPE_WEIGHT, _BEND_WEIGHT = 1.0, 2e4
_LEAST_WEIGHT = 0.02
_REACH = 6
_TEMPER = 0.6
_LEAST_VARIANCE = 0.02**2
_ROUNDS = 3
_TILE = 256
_OVERLAP = 80
"""px; what is farther away has no influence."""


def refine_labels(
    candidates: BlurCandidates,
    labels: Labels,
    weights: Float32,
    jump: int,
    smoothness: float,
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
    progress : callable, optional

    Returns
    -------
    (R, C) float32 ndarray
        In px.
    """
    spacing = candidates.stride / _REFERENCE_STRIDE
    independent = spacing**2 / candidates.places_of_window()
    scale = LABEL_STEP * labels.astype(np.float64)
    overlap = -(-_OVERLAP // candidates.stride)
    tiles = list(_tiles(labels.shape, overlap))
    for done, (inner, around, inner_of_around) in enumerate(tiles):
        progress("Smoothing out the steps", done / len(tiles))
        form = _smoothness_form(labels[around], weights[:, *around], jump, spacing)
        form *= smoothness / MapSettings.smoothness
        start = LABEL_STEP * labels[around].astype(np.float64)
        curve = candidates.curve[around].reshape(start.size, -1)
        solved = _solve(start.ravel(), curve, candidates.scales, form, independent[around].ravel())
        scale[inner] = solved.reshape(start.shape)[inner_of_around]
    progress("Smoothing out the steps", 1.0)
    return np.clip(scale, 0, candidates.scales[-1]).astype(np.float32)


def _tiles(shape: tuple[int, int], overlap: int) -> Iterator[tuple[Slices, Slices, Slices]]:
    """Cut a grid into tiles; return each, with what is around it, and its place therein."""
    for top in range(0, shape[0], _TILE):
        for left in range(0, shape[1], _TILE):
            start = np.array([top, left])
            stop = np.minimum(start + _TILE, shape)
            low, high = np.maximum(start - overlap, 0), np.minimum(stop + overlap, shape)
            yield _slices(start, stop), _slices(low, high), _slices(start - low, stop - low)


def _slices(start: NDArray[np.int64], stop: NDArray[np.int64]) -> Slices:
    return slice(start[0], stop[0]), slice(start[1], stop[1])


def _solve(
    scale: Float64, curve: Float32, scales: Float64, form: sparse.csr_matrix, independent: Float64
) -> Float64:
    """Minimise by reweighted least squares, from the labels' scales: (P,)."""
    for _ in range(_ROUNDS):
        mean, variance = _around(curve, scales, scale)
        evidence = independent / (variance + (scale - mean) ** 2)
        system = (form + sparse.diags(evidence)).tocsc()
        factors = splu(
            system,
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        scale = factors.solve(evidence * mean)
    return scale


def _around(curve: Float32, scales: Float64, scale: Float64) -> tuple[Float64, Float64]:
    """Return mean and variance of the tempered likelihood within 0.6 px of a scale: (P,) each."""
    reach = min(_REACH, (len(scales) - 1) // 2)
    middle = np.clip(np.rint(scale / LABEL_STEP).astype(int), reach, len(scales) - 1 - reach)
    near = middle[:, None] + np.arange(-reach, reach + 1)
    height = np.take_along_axis(curve, near, axis=1)
    likelihood = np.exp(_TEMPER * (height - height.max(axis=1, keepdims=True)))
    likelihood /= likelihood.sum(axis=1, keepdims=True)
    mean = (likelihood * scales[near]).sum(axis=1)
    variance = (likelihood * (scales[near] - mean[:, None]) ** 2).sum(axis=1)
    return mean, variance + _LEAST_VARIANCE


def _smoothness_form(
    labels: Labels, weights: Float32, jump: int, spacing: float
) -> sparse.csr_matrix:
    """Return the matrix of the quadratic form of first and second differences.

    `spacing` is the distance between windows relative to that for which the weights hold.
    """
    rows, columns = labels.shape
    number = np.arange(labels.size).reshape(labels.shape)
    total = sparse.csr_matrix((labels.size, labels.size))
    # Along rows and columns; differences along diagonals were tried, and bumps got worse.
    for k, (down, right) in enumerate(STEPS[:2]):
        step = down * columns + right
        first = number[: rows - down, : columns - right].ravel()
        likeness = np.maximum(weights[k].flat[first], _LEAST_WEIGHT)
        likeness *= np.abs(labels.flat[first] - labels.flat[first + step]) < jump
        total += _SLOPE_WEIGHT * _form(labels.size, likeness, (1, -1), (first, first + step))
        along = np.zeros(labels.size, np.float32)
        along[first] = likeness
        middle = number[down : rows - down, right : columns - right].ravel()
        both = np.minimum(along[middle - step], along[middle])
        bend = _form(labels.size, both, (1, -2, 1), (middle - step, middle, middle + step))
        total += _BEND_WEIGHT / spacing**2 * bend
    return total


def _form(
    size: int, weight: Float32, factors: tuple[int, ...], places: tuple[NDArray[np.int64], ...]
) -> sparse.csr_matrix:
    """Return the matrix of sum weight (sum factor x[place])^2."""
    kept = weight > 0
    count = int(kept.sum())
    values = np.repeat(np.array(factors, np.float64), count)
    columns = np.concatenate([place[kept] for place in places])
    rows = np.tile(np.arange(count), len(factors))
    difference = sparse.csr_matrix((values, (rows, columns)), shape=(count, size))
    return difference.T @ sparse.diags(weight[kept].astype(np.float64)) @ difference
