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
import qdldl
from numpy.typing import NDArray
from scipy import sparse

from napari_defocus.core.compiled import compiled
from napari_defocus.core.progress import Progress, silent
from napari_defocus.core.threads import in_bands, in_order
from napari_defocus.labeling.multigrid import STEPS, Float32, Labels
from napari_defocus.likelihood.blur_spectra import LABEL_STEP
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.own_side import MovedCurves
from napari_defocus.settings import MapSettings

Float64 = NDArray[np.floating]
Slices = tuple[slice, slice]
Curves = tuple[Float32, Labels, Labels]

_REFERENCE_STRIDE = 4
"""px: the weights below hold for windows at this distance."""

_SLOPE_WEIGHT, _BEND_WEIGHT = 1.0, 3e4
"""lambda_1 and lambda_2, in 1 / px^2, at the usual smoothness: on ramps and bumps, first
differences alone flatten bumps (0.42 instead of 0.33 px; docs/decisions.md)."""

_LEAST_WEIGHT = 0.02
"""The least weight of an edge, as a share of lambda_0, so that all regions are connected. By hand.
"""

_REACH = 14
"""The labels within this distance of a window's own give its mean and variance: 1.4 px."""

_TEMPER = 0.8
"""Power of the likelihood there, as its windows overlap; chosen on ramps and bumps."""

_LEAST_VARIANCE = 0.02**2
"""px^2: no window knows its radius better."""

_LEAST_EVIDENCE = 1e-12
"""The least weight of a window, as a share of the largest weight of the differences."""

_ROUNDS = 3
"""Rounds of iteratively reweighted least squares (IRLS). More rounds change nothing visible."""

_STEPS_A_ROUND = 3
"""Steps of conjugate gradients in later rounds, with the factors of the first as preconditioner."""

_LEAST_PLACES = 512
"""The fewest places that are worth a thread."""

_SAY_OF_DISPLACED = 0.1
"""Weight of windows that were moved inside the picture: they say little about its border."""

_TILE = 256
"""Windows along the side of a tile: 1024 px, as for tiles of large pictures."""

_OVERLAP, _MARGIN = 128, 32
"""px that tiles see around themselves; what is farther away has hardly any influence. And px on
both sides of a border over which tiles are blended.
"""


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
    place = refine_curves(
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
    if candidates.weight is None:
        return place
    axis = candidates.scales
    return np.interp(place, LABEL_STEP * np.arange(len(axis)), axis).astype(np.float32)


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

    moved = MovedCurves.of(curve)

    def solved(around: Slices) -> Float64:
        form = strength * _smoothness_form(labels[around], weights[:, *around], jump, spacing)
        start = LABEL_STEP * labels[around].astype(np.float64)
        near = moved.curve, moved.row[around].ravel(), moved.column[around].ravel()
        found = _solve(start.ravel(), near, scales, form, independent[around].ravel())
        return found.reshape(start.shape)

    progress("Smoothing out the steps", 0.0)
    parts = in_order(solved, [around for around, _ in tiles])
    for done, ((around, share), part) in enumerate(zip(tiles, parts, strict=True), 1):
        scale[around] += share * part
        total[around] += share
        progress("Smoothing out the steps", done / len(tiles))
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
    scale: Float64, curve: Curves, scales: Float64, form: sparse.csc_matrix, independent: Float64
) -> Float64:
    """Minimise by reweighted least squares, from the labels' scales: (P,).

    `curve` is an array (R, C, L), and the row and the column of each place in it: (P,) each.

    `form` is the upper triangle of the matrix of what smoothness costs. QDLDL (Stellato et al.,
    Math. Prog. Comp. 12, 2020) factorises the first system, without any library of linear algebra,
    whose bits depend on the processor. Its factors precondition the next systems, which differ
    little.
    """
    precondition = None
    # Where smoothness is all, the evidence would be lost beside it in rounding.
    least = _LEAST_EVIDENCE * form.data.max(initial=0.0)
    for _ in range(_ROUNDS):
        mean, variance = _around(curve, scales, scale)
        evidence = independent / (variance + (scale - mean) ** 2) + least
        if precondition is None:
            precondition = qdldl.Solver(form + sparse.diags(evidence, format="csc"), upper=True)
            scale = precondition.solve(evidence * mean)
        else:
            scale = _conjugate_gradients(form, evidence, mean, scale, precondition)
    return scale


def _conjugate_gradients(
    form: sparse.csc_matrix,
    evidence: Float64,
    mean: Float64,
    scale: Float64,
    precondition: qdldl.Solver,
) -> Float64:
    """Take some steps from a scale towards that where (form + evidence) scale = evidence mean."""
    transposed, diagonal = form.T, evidence - form.diagonal()

    def system(values: Float64) -> Float64:
        return form @ values + transposed @ values + diagonal * values

    rest = evidence * mean - system(scale)
    direction = np.zeros_like(scale)
    before = np.inf
    for _ in range(_STEPS_A_ROUND):
        better = precondition.solve(rest)
        after = np.sum(rest * better)
        if after <= 0:
            break
        direction = better + after / before * direction
        image = system(direction)
        length = after / np.sum(direction * image)
        scale = scale + length * direction
        rest = rest - length * image
        before = after
    return scale


def _around(curve: Curves, scales: Float64, scale: Float64) -> tuple[Float64, Float64]:
    """Return mean and variance of the tempered likelihood within 1.4 px of a scale: (P,) each."""
    mean, variance = np.empty(len(scale)), np.empty(len(scale))
    given = *curve, scales, scale, mean, variance
    in_bands(_moments_around, len(scale), *given, least=_LEAST_PLACES)
    return mean, variance


@compiled
def _moments_around(
    start: int,
    stop: int,
    curve: Float32,
    row: Labels,
    column: Labels,
    scales: Float64,
    scale: Float64,
    mean: Float64,
    variance: Float64,
) -> None:
    count = len(scales)
    reach = min(_REACH, (count - 1) // 2)
    for place in range(start, stop):
        middle = int(np.rint(scale[place] / LABEL_STEP))
        first = min(max(middle - reach, 0), count - 1 - 2 * reach)
        i, j = row[place], column[place]
        top = curve[i, j, first]
        for k in range(first, first + 2 * reach + 1):
            top = max(top, curve[i, j, k])
        center = scales[first + reach]
        total, moment, square = 0.0, 0.0, 0.0
        for k in range(first, first + 2 * reach + 1):
            likelihood = np.exp(_TEMPER * (curve[i, j, k] - top))
            away = scales[k] - center
            total += likelihood
            moment += likelihood * away
            square += likelihood * away * away
        mean[place] = center + moment / total
        variance[place] = max(square / total - (moment / total) ** 2, 0.0) + _LEAST_VARIANCE


def _smoothness_form(
    labels: Labels, weights: Float32, jump: int, spacing: float
) -> sparse.csc_matrix:
    """Return the upper triangle of the quadratic form of first and second differences.

    `spacing` is the distance between windows relative to that for which the weights hold.
    Differences along diagonals were tried, and bumps got worse.
    """
    own = np.zeros(labels.shape)
    number = np.arange(labels.size).reshape(labels.shape)
    first, second, value = [number.ravel()], [number.ravel()], [own.ravel()]
    for k, (_, right) in enumerate(STEPS[:2]):
        # All as (lines, places along them), views of the same arrays; in double precision, since
        # rows of the form must add up to 0.
        along = (lambda array: array) if right else np.transpose
        alike = np.abs(np.diff(along(labels), axis=1)) < jump
        slope = np.maximum(along(weights[k])[:, :-1].astype(np.float64), _LEAST_WEIGHT) * alike
        bend = _BEND_WEIGHT / spacing**2 * np.minimum(slope[:, :-1], slope[:, 1:])
        diagonal, numbers = along(own), along(number)
        diagonal[:, :-1] += _SLOPE_WEIGHT * slope
        diagonal[:, 1:] += _SLOPE_WEIGHT * slope
        diagonal[:, :-2] += bend
        diagonal[:, 1:-1] += 4 * bend
        diagonal[:, 2:] += bend
        beside = -_SLOPE_WEIGHT * slope
        beside[:, :-1] -= 2 * bend
        beside[:, 1:] -= 2 * bend
        for coupling, step in ((beside, 1), (bend, 2)):
            coupled = coupling != 0
            first.append(numbers[:, : coupling.shape[1]][coupled])
            second.append(numbers[:, step:][coupled])
            value.append(coupling[coupled])
    places = np.concatenate(first), np.concatenate(second)
    form = sparse.coo_matrix((np.concatenate(value), places), shape=(labels.size, labels.size))
    return form.tocsc()
