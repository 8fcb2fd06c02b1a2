"""Between the windows of a coarser level: each place between four of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled, compiled_inline
from napari_defocus.core.threads import in_bands

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]


def between(values: Float32, rows: Float64, columns: Float64) -> Float32:
    """Interpolate between windows: (r, c, n) at R rows and C columns to (R, C, n).

    Rows and columns are counted in windows.
    """
    found = np.empty((len(rows), len(columns), values.shape[2]), np.float32)
    in_bands(_interpolate, len(rows), np.ascontiguousarray(values), rows, columns, found)
    return found


@compiled
def _interpolate(
    start: int, stop: int, values: Float32, rows: Float64, columns: Float64, found: Float32
) -> None:
    height, width, count = values.shape
    for i in range(start, stop):
        top, bottom, down = neighbors(rows[i], height)
        for j in range(len(columns)):
            left, right, along = neighbors(columns[j], width)
            for k in range(count):
                found[i, j, k] = of_four(values, top, bottom, left, right, down, along, k)


@compiled_inline
def neighbors(place: float, length: int) -> tuple[int, int, np.float32]:
    """Return the windows on both sides of a place on an axis, and how far it is from the first."""
    first = min(int(place), max(length - 2, 0))
    return first, min(first + 1, length - 1), np.float32(place - first)


@compiled_inline
def of_four(
    values: Float32,
    top: int,
    bottom: int,
    left: int,
    right: int,
    down: np.float32,
    along: np.float32,
    k: int,
) -> np.float32:
    """Interpolate between four windows; `down` and `along` are the place between them, 0 to 1."""
    upper, lower = values[top, left, k], values[bottom, left, k]
    upper += along * (values[top, right, k] - upper)
    lower += along * (values[bottom, right, k] - lower)
    return upper + down * (lower - upper)
