"""Labels of low energy from coarse to fine, with regions of wide blur that moves do not find.

Grids of joined nodes (`multigrid.coarser`) decide about whole regions: the coarsest one is solved
exactly, and each next one starts from the labels of the one before it.

A sharp subject before a ground of wide blur needs more. To take the ground from 0 to 30 px, a
region of many megapixels has to change at once, each of its places by another number of labels, and
no move offers that: the ground of a photograph of 10 megapixels stayed at 0 px, at 7 % more energy.
So where a grid can have wide blur, it has a second solution beside the first: a cut tells only
narrow from wide, and the labels below 8 px are forbidden where it says wide. Each place of the next
grid has the better one of both, by one more cut.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.labeling.data_term import Costs, least_of_both
from napari_defocus.labeling.graph_cuts import CHOOSING_LABELS, fuse_labels, improve, solve_exactly
from napari_defocus.labeling.multigrid import HALF, WIDE, coarser, finer

Float32 = NDArray[np.float32]
Labels = NDArray[np.int32]
Grid = tuple[Float32 | Costs, Float32]

_COARSEST = 2600
"""The most nodes of the coarsest grid, which is solved exactly."""

_COARSE_STEP = 4
"""There, every 4th label is a choice (every 2nd: no better a map, three times the time)."""

_FIRST_WIDE = 81
"""The first label beyond 8 px, with windows of 41 px."""

_PRICE = np.float32(30)
"""How many labels of difference it costs to go from narrow to wide blur, when only these two are
told apart. 0 to 30 px are 155 labels apart; a higher price would hide what is looked for."""

_FORBIDDEN = np.float32(1e9)
"""Cost of a forbidden label; energies stay below."""


def minimize_energy(
    data: Float32 | Costs,
    weights: Float32,
    progress: Progress = silent,
    *,
    coarse: bool = False,
    finest: bool = True,
) -> Labels:
    """Find labels of low energy, from coarse to fine.

    Parameters
    ----------
    data : (R, C, L) float32 ndarray or Costs
        D, the cost of each label at each node.
    weights : (4, R, C) or (8, R, C) float32 ndarray
        w between a node and its neighbour at each of `STEPS`; 0 where there is none. If there are
        eight, the last four are those of differences beyond the label `WIDE`.
    progress : callable, optional
    coarse : bool, optional
        Stop before the finest grid: two by two nodes have a label in common.
    finest : bool, optional
        Whether this grid is the finest one. If not, it is worth more work: see
        `minimize_energy_from`.

    Returns
    -------
    (R, C) int32 ndarray
    """
    levels: list[Grid] = [(data, weights)]
    while levels[-1][1][0].size > _COARSEST:
        levels.append(coarser(*levels[-1]))
    labels = _coarse_start(np.asarray(levels[-1][0]), levels[-1][1])
    return _to_the_finest(levels, labels, progress, coarse=coarse, finest=finest)


def minimize_energy_from(
    start: Labels, data: Float32 | Costs, weights: Float32, progress: Progress = silent
) -> Labels:
    """Find labels of low energy from those of a coarser grid.

    If they come from `minimize_energy` of this grid's own costs, joined by `coarser`, the result
    is that of `minimize_energy` of this grid, but for regions of wide blur: these are looked for on
    the grids between anew.

    Parameters
    ----------
    start : (r, c) int32 ndarray
        r is R / 2, R / 4 or so, rounded up.
    data, weights
        As for `minimize_energy`.
    progress : callable, optional

    Returns
    -------
    (R, C) int32 ndarray
    """
    levels: list[Grid] = [(data, weights)]
    while -(-levels[-1][0].shape[0] // 2) > start.shape[0]:
        levels.append(coarser(*levels[-1]))
    return _to_the_finest(levels, start, progress)


def _to_the_finest(
    levels: list[Grid],
    labels: Labels,
    progress: Progress,
    *,
    coarse: bool = False,
    finest: bool = True,
) -> Labels:
    """Lower the energy of labels on each grid, from the last to the first."""
    wide = None
    for depth in reversed(range(len(levels))):
        grid, last = levels[depth], depth == 0
        shape = grid[1].shape[1:]
        labels, wide = _of_shape(labels, shape), None if wide is None else _of_shape(wide, shape)
        if last and wide is not None:
            labels = fuse_labels(labels, wide, *grid)
        if last and coarse and len(levels) > 1:
            return labels
        # Each level has four times the nodes of the one before it.
        report = within(progress, 0.25 ** (depth + 1), 0.25**depth)
        labels = improve(labels, *grid, everywhere=not (last and finest), progress=report)
        if not last:
            wide = _with_wide_regions(labels, wide, np.asarray(grid[0]), grid[1])
    progress(CHOOSING_LABELS, 1.0)
    return labels


def _of_shape(labels: Labels, shape: tuple[int, ...]) -> Labels:
    return labels if labels.shape == shape else finer(labels, *shape)


@dataclass(frozen=True, eq=False)
class _Allowed:
    """Costs of which narrow labels are forbidden where it is wide, a part at a time.

    Attributes
    ----------
    data : (R, C, L) float32 ndarray
    is_wide : (R, C) bool ndarray
    """

    data: Float32
    is_wide: NDArray[np.bool_]

    @property
    def shape(self) -> tuple[int, ...]:
        return self.data.shape

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, part: slice | tuple[slice, slice]) -> Float32:
        allowed: Float32 = self.data[part].copy()
        allowed[self.is_wide[part], :_FIRST_WIDE] += _FORBIDDEN
        return allowed


def _coarse_start(data: Float32, weights: Float32) -> Labels:
    """Find the labels of least energy among every fourth: they decide about whole regions."""
    every = np.ascontiguousarray(data[..., ::_COARSE_STEP])
    weights = weights * np.float32(_COARSE_STEP)
    return _COARSE_STEP * solve_exactly(every, weights, WIDE // _COARSE_STEP)


def _with_wide_regions(
    labels: Labels, wide: Labels | None, data: Float32, weights: Float32
) -> Labels | None:
    """Return the second solution of a grid, from that of the one before; None if it has none.

    It has one where `labels` are narrow and a cut that only tells narrow from wide says wide.
    """
    if len(weights) == HALF or data.shape[2] <= _FIRST_WIDE:
        return None
    is_wide = solve_exactly(least_of_both(data, _FIRST_WIDE), _PRICE * weights[HALF:]) == 0
    if wide is None and not (is_wide & (labels < _FIRST_WIDE)).any():
        return None
    allowed = _Allowed(data, is_wide)
    if wide is not None:
        start = wide
    elif is_wide.size <= _COARSEST:
        start = _coarse_start(allowed[:], weights)
    else:
        start = np.where(is_wide, np.maximum(labels, _FIRST_WIDE), labels).astype(np.int32)
    return improve(start, allowed, weights, everywhere=True)
