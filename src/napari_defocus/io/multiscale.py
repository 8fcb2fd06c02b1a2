"""Pyramids: each level half as high and wide as the one before, made in bounded memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.io.lazy_arrays import regions

SMALLEST_LEVEL = 512
"""px: the pyramid ends at a level that has no longer side."""


def level_shapes(shape: tuple[int, ...], row_axis: int) -> list[tuple[int, ...]]:
    """Return the shapes of all levels; rows are along `row_axis`, columns along the next one.

    Examples
    --------
    >>> level_shapes((3, 2000, 1001), 1)
    [(3, 2000, 1001), (3, 1000, 501), (3, 500, 251)]
    """
    shapes = [tuple(shape)]
    picture = slice(row_axis, row_axis + 2)
    while max(shapes[-1][picture]) > SMALLEST_LEVEL:
        last = shapes[-1]
        halves = [-(-size // 2) for size in last[picture]]
        shapes.append((*last[:row_axis], *halves, *last[row_axis + 2 :]))
    return shapes


def halve_into(fine: Any, coarse: Any, piece: tuple[int, ...], *, labels: bool = False) -> None:
    """Fill the next level of a pyramid, (..., ceil(H / 2), ceil(W / 2)), a piece at a time.

    Levels are read and written by slices, such as arrays of Zarr; `labels` are as in `halved`.
    """
    for target in regions(coarse.shape, piece):
        rows, columns = (slice(2 * part.start, 2 * part.stop) for part in target[-2:])
        coarse[target] = halved(fine[(*target[:-2], rows, columns)], labels=labels)


def halved(values: NDArray[Any], *, labels: bool = False) -> NDArray[Any]:
    """Return the next level of a pyramid, (..., ceil(H / 2), ceil(W / 2)), of the same dtype.

    A pixel is the mean of the 2 x 2 that it covers, without those that are NaN or outside; NaN
    if all are. Of `labels`, and of bool, it is the largest of them: what is thin does not
    vanish, and no value is invented.

    Examples
    --------
    >>> halved(np.array([[1.0, np.nan, 5.0], [3.0, np.nan, 7.0]]))
    array([[2., 6.]])
    >>> halved(np.array([[0, 0, 1], [0, 0, 0], [7, 0, 0]]), labels=True)
    array([[0, 1],
           [7, 0]])
    """
    odd = [(0, size % 2) for size in values.shape[-2:]]
    sides = [(0, 0)] * (values.ndim - 2) + odd
    if labels or values.dtype.kind == "b":
        return _of_four(np.maximum, np.pad(values, sides, mode="edge"))
    if values.dtype.kind != "f":
        padded = np.pad(values, sides, mode="edge").astype(np.float64)
        return np.rint(_of_four(np.add, padded) / 4).astype(values.dtype)
    padded = np.pad(values, sides, constant_values=np.nan)
    known = ~np.isnan(padded)
    counts = _of_four(np.add, known.astype(np.float32))
    exact = np.promote_types(values.dtype, np.float32)
    sums = _of_four(np.add, np.where(known, padded, 0).astype(exact))
    with np.errstate(invalid="ignore"):
        return (sums / counts).astype(values.dtype)


def _of_four(joined: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
    tall = joined(values[..., 0::2, :], values[..., 1::2, :])
    return np.asarray(joined(tall[..., 0::2], tall[..., 1::2]))
