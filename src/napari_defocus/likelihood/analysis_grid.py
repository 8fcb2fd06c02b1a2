"""The windows of a picture that are computed, and which places each of them stands for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from napari_defocus.likelihood.gabor import padding, window_centers, within_picture

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

_WINDOWS_A_BLOCK, _LEAST_ROWS = 32768, 12
"""About so many windows, in at least so many rows, are worked on at once. They share their lines of
filtered pixels, and progress is reported between blocks. By hand; results do not depend on it.
"""


@dataclass(frozen=True)
class AnalysisGrid:
    """The windows that are computed: those that reach over the border are moved inside.

    Attributes
    ----------
    rows, columns : (r,) and (c,) float64 ndarray
        Distinct centres in px of the padded picture.
    row_of_window, column_of_window : (R,) and (C,) int ndarray
        Which of them stands for each window of the result.
    """

    rows: Float64
    columns: Float64
    row_of_window: NDArray[np.int64]
    column_of_window: NDArray[np.int64]

    @classmethod
    def over(cls, shape: tuple[int, int], window: int, stride: int) -> AnalysisGrid:
        """Return that of a picture of a height and width, for windows `stride` px apart."""
        axes = []
        for length in shape:
            extra = padding(length, window)
            centers = window_centers(length, stride) + extra
            inside = within_picture(centers, length + 2 * extra, window)
            axes.append(np.unique(inside, return_inverse=True))
        (rows, row_of_window), (columns, column_of_window) = axes
        return cls(rows, columns, row_of_window, column_of_window)

    def places(self) -> NDArray[np.int64]:
        """Return how many places of the result share the window of each: (R, C)."""
        rows, columns = (
            np.bincount(window)[window] for window in (self.row_of_window, self.column_of_window)
        )
        return np.multiply.outer(rows, columns)

    def spread(self, block: slice, values: Float32, result: Float32) -> None:
        """Write what the windows of a block of rows say, (P, n), to all that they stand for."""
        first, stop = np.searchsorted(self.row_of_window, (block.start, block.stop))
        of_rows = values.reshape(-1, len(self.columns), values.shape[1])
        place = np.ix_(self.row_of_window[first:stop] - block.start, self.column_of_window)
        result[first:stop] = of_rows[place]

    def blocks(self) -> Iterator[slice]:
        """Cut the rows into blocks: large enough to share their lines, small enough to report."""
        height = max(_LEAST_ROWS, _WINDOWS_A_BLOCK // len(self.columns))
        for start in range(0, len(self.rows), height):
            yield slice(start, min(start + height, len(self.rows)))

    def mean_over_windows(self, values: NDArray[Any], pad: tuple[int, int], window: int) -> Float32:
        """Return the mean of a quantity over each window, weighted as power is: (r, c)."""
        mean = gaussian_filter(values.astype(np.float32), window / 4 / np.sqrt(2))
        for axis, (centers, extra) in enumerate(zip((self.rows, self.columns), pad, strict=True)):
            mean = between_pixels(mean, np.clip(centers - extra, 0, values.shape[axis] - 1), axis)
        return mean


def between_pixels(values: Float32, places: Float64, axis: int) -> Float32:
    """Take values along an axis at places in px; half-way between two pixels, their mean."""
    low, high = np.floor(places).astype(int), np.ceil(places).astype(int)
    return np.float32(0.5) * (values.take(low, axis) + values.take(high, axis))
