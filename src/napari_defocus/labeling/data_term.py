"""What of the likelihood curves counts at each place: as far as there is texture, limited.

No window is exactly what the model says, so that the depth of its curve counts up to a limit.
Where the curves of a neighbourhood, averaged, are flat, there is no texture, and what each of
them prefers is chance: it does not count, and labels are extrapolated from around.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled, compiled_inline
from napari_defocus.core.threads import in_bands
from napari_defocus.labeling.multigrid import pieces
from napari_defocus.likelihood.blur_spectra import LABEL_STEP
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.evidence import DEPTH, evidence_share
from napari_defocus.likelihood.own_side import MovedCurves
from napari_defocus.likelihood.prior import log_prior

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Labels = NDArray[np.int32]
Places = NDArray[np.int32]

EXTRAPOLATED = 0.5
"""If the evidence is below this share, a map has its value from around."""

EXTRA_OF_SHARP = np.float32(8)
"""What is added to the weight, 1, of a pixel that shows sharp details itself. Windows are wider
than thin things, so these would be outvoted (docs/decisions.md)."""

KAPPA = np.array([1e-20, 1e-12, 1e-7, 1e-3, 1e-1, 1, 1e-1, 1e-3, 1e-7, 1e-12, 1e-20])
"""The kernel that widens candidates into an artificial likelihood (Section III-B)."""

LIKELIHOOD_FLOOR = 1e-24
"""The artificial likelihood of scales that no candidate reaches, instead of 0."""


def data_term(candidates: BlurCandidates) -> Float32:
    """Return D of (14) but for a weight: the cost of each scale at each window, (R, C, L).

    In the mode "paper", -log of the artificial likelihood; in "curve", the limited depth.
    """
    if candidates.mode == "paper":
        return -np.log(artificial_likelihood(candidates)).astype(np.float32)
    return limited_depth(candidates)


def artificial_likelihood(candidates: BlurCandidates) -> NDArray[np.float64]:
    """Return p~ of Section III-B: the three candidates widened by kappa, sum 1, (R, C, L)."""
    present = np.isfinite(candidates.radii)
    known = np.where(present, candidates.log_likelihoods, 0).astype(np.float64)
    height = np.where(present, np.exp(known - known[..., :1]), 0)
    label = np.rint(np.where(present, candidates.radii, 0) / LABEL_STEP).astype(int)
    count, reach = len(candidates.scales), len(KAPPA) // 2
    likelihood = np.zeros((*label.shape[:2], count + 2 * reach))
    rows, columns = np.indices(label.shape[:2])
    for k in range(label.shape[2]):
        for tap, weight in enumerate(KAPPA):
            likelihood[rows, columns, label[..., k] + tap] += weight * height[..., k]
    likelihood = np.maximum(likelihood[..., reach:-reach], LIKELIHOOD_FLOOR)
    return likelihood / likelihood.sum(axis=2, keepdims=True)


def limited_depth(candidates: BlurCandidates) -> Float32:
    """Return how far each scale lies below the best, at most 15, as far as it counts: (R, C, L).

    The whole curve keeps what a broad or shallow maximum says, and has the prior of the radius. A
    window that stands for n places along the border is not n of them; its weight is 1 / sqrt(n).
    """
    curve = np.asarray(candidates.curve)
    return _limited(curve, log_prior(candidates.scales), _say(candidates), DEPTH)


def _say(candidates: BlurCandidates) -> Float32:
    """Return how much each window counts, (R, C)."""
    weight = evidence_share(candidates) / np.sqrt(candidates.places_of_window())
    if candidates.weight is not None:
        weight *= candidates.weight
    return weight.astype(np.float32)


def _limited(curve: Float32, prior: Float32, weight: Float32, depth: np.float32) -> Float32:
    limited = np.empty_like(curve)
    in_bands(_limit_rows, len(curve), curve, prior, weight, depth, limited)
    return limited


@compiled
def _limit_rows(
    start: int,
    stop: int,
    curve: Float32,
    prior: Float32,
    weight: Float32,
    depth: np.float32,
    limited: Float32,
) -> None:
    for row in range(start, stop):
        for column in range(curve.shape[1]):
            top = np.float32(-np.inf)
            for scale in range(curve.shape[2]):
                limited[row, column, scale] = curve[row, column, scale] + prior[scale]
                top = max(top, limited[row, column, scale])
            for scale in range(curve.shape[2]):
                below = min(top - limited[row, column, scale], depth)
                limited[row, column, scale] = weight[row, column] * below


@dataclass(frozen=True, eq=False)
class Costs:
    """`limited_depth` of a large picture, times a factor, worked out where it is asked for.

    Parts of it are taken as those of an array, (R, C, L), and have the same bits.

    Attributes
    ----------
    curve : (R, C, L) float32 ndarray
    row, column : (R, C) int32 ndarray
        Of the window whose curve each place takes.
    prior : (L,) float32 ndarray
    top, say, factor : (R, C) float32 ndarray
        The best that a place says, prior included; how much it counts; the factor.
    """

    curve: Float32
    row: Places
    column: Places
    prior: Float32
    top: Float32
    say: Float32
    factor: Float32

    @classmethod
    def of(cls, candidates: BlurCandidates) -> Costs:
        """Return those of candidates of the mode "curve", times 1."""
        moved, prior = MovedCurves.of(candidates.curve), log_prior(candidates.scales)
        given = moved.curve, moved.row, moved.column, prior
        top = np.empty(moved.row.shape, np.float32)
        in_bands(_find_tops, len(top), *given, top)
        return cls(*given, top, _say(candidates), np.ones_like(top))

    def times(self, factor: Float32) -> Costs:
        """Return them with another factor."""
        return replace(self, factor=factor)

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the array."""
        return self.curve.shape

    def __len__(self) -> int:
        return len(self.curve)

    def __getitem__(self, part: slice | tuple[slice, slice]) -> Float32:
        """Return the costs of some rows, or of some rows and columns, as an array."""
        rows, columns = part if isinstance(part, tuple) else (part, slice(None))
        top, bottom, _ = rows.indices(self.shape[0])
        left, right, _ = columns.indices(self.shape[1])
        found = np.empty((bottom - top, right - left, self.shape[2]), np.float32)
        in_bands(_cost_rows, len(found), top, left, *self._arrays, found)
        return found

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Float32:
        """Return all of them."""
        return np.asarray(self[:], dtype)

    def change(self, labels: Labels, proposal: Labels, place: NDArray[np.int64]) -> Float64:
        """Return what `fusions.change_of` does of the array."""
        return _change_of_costs(labels, proposal, place, *self._arrays)

    def change_between(
        self,
        now: Labels,
        new: Labels,
        place: NDArray[np.int64],
        row_position: Float64,
        column_position: Float64,
    ) -> Float64:
        """Return D of new labels minus D of present ones, interpolated at some pixels."""
        return _interpolated_change(now, new, place, row_position, column_position, *self._arrays)

    @property
    def _arrays(self) -> tuple[Any, ...]:
        given = self.curve, self.row, self.column, self.prior
        return *given, self.top, self.say, self.factor, DEPTH


@compiled
def _find_tops(
    start: int, stop: int, curve: Float32, row: Places, column: Places, prior: Float32, top: Float32
) -> None:
    for i in range(start, stop):
        for j in range(top.shape[1]):
            best = np.float32(-np.inf)
            for k in range(len(prior)):
                best = max(best, curve[row[i, j], column[i, j], k] + prior[k])
            top[i, j] = best


@compiled_inline
def _cost_at(
    i: int,
    j: int,
    k: int,
    curve: Float32,
    row: Places,
    column: Places,
    prior: Float32,
    top: Float32,
    say: Float32,
    factor: Float32,
    depth: np.float32,
) -> np.float32:
    below = min(top[i, j] - (curve[row[i, j], column[i, j], k] + prior[k]), depth)
    return say[i, j] * below * factor[i, j]


@compiled
def _cost_rows(
    start: int,
    stop: int,
    first: int,
    left: int,
    curve: Float32,
    row: Places,
    column: Places,
    prior: Float32,
    top: Float32,
    say: Float32,
    factor: Float32,
    depth: np.float32,
    found: Float32,
) -> None:
    for i in range(start, stop):
        for j in range(found.shape[1]):
            y, x = first + i, left + j
            for k in range(found.shape[2]):
                found[i, j, k] = _cost_at(
                    y, x, k, curve, row, column, prior, top, say, factor, depth
                )


@compiled
def _change_of_costs(
    labels: Labels,
    proposal: Labels,
    place: NDArray[np.int64],
    curve: Float32,
    row: Places,
    column: Places,
    prior: Float32,
    top: Float32,
    say: Float32,
    factor: Float32,
    depth: np.float32,
) -> Float64:
    columns = labels.shape[1]
    change = np.empty(len(place))
    for k in range(len(place)):
        i, j = place[k] // columns, place[k] % columns
        new = _cost_at(i, j, proposal[i, j], curve, row, column, prior, top, say, factor, depth)
        now = _cost_at(i, j, labels[i, j], curve, row, column, prior, top, say, factor, depth)
        change[k] = new - now
    return change


@compiled
def _interpolated_change(
    now: Labels,
    new: Labels,
    place: NDArray[np.int64],
    row_position: Float64,
    column_position: Float64,
    curve: Float32,
    row: Places,
    column: Places,
    prior: Float32,
    top: Float32,
    say: Float32,
    factor: Float32,
    depth: np.float32,
) -> Float64:
    """Do what that of `pixel_refinement` does of an array."""
    change = np.zeros(len(place))
    columns = len(column_position)
    for k in range(len(place)):
        pixel_row, pixel_column = place[k] // columns, place[k] % columns
        y, x = row_position[pixel_row], column_position[pixel_column]
        for sign, label in ((1, new[pixel_row, pixel_column]), (-1, now[pixel_row, pixel_column])):
            value = 0.0
            for i in range(int(y), min(int(y) + 2, top.shape[0])):
                for j in range(int(x), min(int(x) + 2, top.shape[1])):
                    cost = _cost_at(i, j, label, curve, row, column, prior, top, say, factor, depth)
                    value += (1 - abs(y - i)) * (1 - abs(x - j)) * cost
            change[k] += sign * value
    return change


def least_of_both(data: Float32 | Costs, first: int) -> Float32:
    """Return the least costs beyond and among the first labels, at each window: (R, C, 2)."""
    least = np.full((*data.shape[:2], 2), np.inf, np.float32)
    for rows in pieces(len(data)):
        some = data[rows]
        in_bands(_least_of_rows, len(some), some, first, least[rows])
    return least


@compiled
def _least_of_rows(start: int, stop: int, data: Float32, first: int, least: Float32) -> None:
    for row in range(start, stop):
        for column in range(data.shape[1]):
            for label in range(data.shape[2]):
                side = int(label < first)
                least[row, column, side] = min(least[row, column, side], data[row, column, label])
