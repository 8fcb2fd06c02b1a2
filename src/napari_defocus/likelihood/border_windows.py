"""Windows that reach over the border of the picture, and where they count.

Windows that would reach over the border are moved inside, by up to half of their side. What such a
window says is as good as what others say, if the blur is the same all the way. But of a strip of
ground between a thing and the border it sees the thing. So there, windows that stay near their
places are asked as well. Beyond the border, the gradients are those inside, mirrored: these are
continuous, but have kinks, and half a window is all that is seen, so that these windows are wrong
twice as much as others. A place takes what they say only if it is surely something else: if one
of both radii is more than twice the other, and 0.5 px, and the window over the border denies the
other one. Then there is an edge between them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_defocus.likelihood.analysis_grid import AnalysisGrid
from napari_defocus.likelihood.gabor import Gradients, local_power, padding, window_centers
from napari_defocus.likelihood.prior import log_prior
from napari_defocus.likelihood.window_analysis import Said

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Mask = NDArray[np.bool_]
Places = NDArray[np.int64]
PowerSays = Callable[[Float32, tuple[Places, Places]], Said]

_APART = 8
"""px between lines of such windows along a border: with lines 4 px apart, maps are no better."""

_RATIO, _STEP = 2.0, 0.5
"""Radii r < q are those of two sides of an edge if q > 2 r + 0.5 px, as in `own_side`."""

_DENIED = np.float32(8)
"""Units of log-likelihood by which a window over the border has to deny the other radius. Half of
what it sees is there twice. With less, plain ground reads another radius by chance
(docs/decisions.md)."""


@dataclass(frozen=True, eq=False)
class _Axis:
    """The places along one axis.

    Attributes
    ----------
    centers : (n,) float64 ndarray
        In px of the picture.
    asked : (n,) int64 ndarray
        The place in the middle of whose window each looks.
    near : (n,) int64 ndarray
        -1 for those near the low border, 1 for those near the high one, else 0. Places whose
        windows are moved, but too little for a line of their own, are 2: they keep theirs.
    """

    centers: Float64
    asked: Places
    near: Places

    @classmethod
    def over(cls, length: int, window: int, stride: int) -> _Axis:
        centers = window_centers(length, stride)
        count = len(centers)
        moved = int(np.sum(centers < (window - 1) // 2 + centers[0] % 1))
        every = max(1, _APART // stride)
        lines = moved // every
        number = np.arange(count)
        outside = np.minimum(number, count - 1 - number)
        low = number < count - 1 - number
        first = outside - outside % every
        near = np.where(low, -1, 1)
        near[outside >= every * lines] = 2
        near[outside >= moved] = 0
        asked = np.where(low, first, count - 1 - first)
        return cls(centers, np.where(np.abs(near) == 1, asked, number), near)

    def alone(self, side: int) -> tuple[Places, Places, Places]:
        """Return the windows of the lines of one side, the places that ask, and which of them."""
        places = np.flatnonzero(self.near == side)
        windows, which = np.unique(self.asked[places], return_inverse=True)
        return windows, places, which

    def asking(self) -> tuple[Places, Places, Places]:
        """Return the same of all places but those that keep their windows."""
        places = np.flatnonzero(self.near != 2)
        windows, which = np.unique(self.asked[places], return_inverse=True)
        return windows, places, which


@dataclass(frozen=True, eq=False)
class BorderWindows:
    """The windows of a picture that reach over its border.

    Attributes
    ----------
    window : int
    rows, columns : _Axis
    """

    window: int
    rows: _Axis
    columns: _Axis

    @classmethod
    def over(cls, shape: tuple[int, int], window: int, stride: int) -> BorderWindows | None:
        """Return those of a picture of a height and width; None if it is smaller than a window."""
        if any(padding(length, window) for length in shape):
            return None
        rows, columns = (_Axis.over(length, window, stride) for length in shape)
        return cls(window, rows, columns)

    def grid(self) -> AnalysisGrid:
        """Return all places as windows that are not moved."""
        rows, columns = self.rows.centers, self.columns.centers
        return AnalysisGrid(rows, columns, np.arange(len(rows)), np.arange(len(columns)))

    def take_over(self, said: Said, scales: Float64, gradient: Gradients, says: PowerSays) -> Mask:
        """Let places have what these windows say, where that is surely something else.

        Parameters
        ----------
        said : Said
            What the windows say that were moved inside, (R, C, ...); changed, but for the signs:
            what is mirrored prefers other directions.
        scales : (L,) float64 ndarray
            Of its curves, in px.
        gradient : Gradients
            Of the picture.
        says : callable
            Given powers of windows, (r, c, 2, F), and which rows and columns of places they
            are, returns what they say, one after the other.

        Returns
        -------
        (R, C) bool ndarray
            Where it was.
        """
        taken = np.zeros(said.curve.shape[:2], bool)
        prior = log_prior(scales)
        for (rows, *of_rows), (columns, *of_columns) in self._strips():
            if not (len(rows) and len(columns)):
                continue
            power = self._power(gradient, rows, columns)
            found = says(power, (rows, columns))
            places = np.ix_(of_rows[0], of_columns[0])
            which = np.ix_(of_rows[1], of_columns[1])
            shape = len(rows), len(columns)
            curve = (found.curve + prior).reshape(*shape, -1)[which]
            best, moved = curve.argmax(axis=2), (said.curve[places] + prior).argmax(axis=2)
            low, high = scales[np.minimum(best, moved)], scales[np.maximum(best, moved)]
            denied = curve.max(axis=2) - np.take_along_axis(curve, moved[..., None], 2)[..., 0]
            apart = (high > _RATIO * low + _STEP) & (denied > _DENIED)
            for name in ("radii", "log_likelihoods", "curve"):
                into, values = getattr(said, name), getattr(found, name)
                new = values.reshape(*shape, -1)[which]
                into[places] = np.where(apart[..., None], new, into[places])
            taken[places] = apart
        return taken

    def _strips(self) -> Iterator[tuple[tuple[Places, Places, Places], ...]]:
        """Yield the rows and the columns of windows along each side, see `_Axis.alone`."""
        for side in (-1, 1):
            yield self.rows.alone(side), self.columns.asking()
        for side in (-1, 1):
            yield self.rows.alone(0), self.columns.alone(side)

    def _power(self, gradient: Gradients, rows: Places, columns: Places) -> Float32:
        """Return (4) of these windows: (r, c, 2, F)."""
        row_centers, column_centers = self.rows.centers[rows], self.columns.centers[columns]
        top, left = (int(at[0]) - self.window // 2 - 2 for at in (row_centers, column_centers))
        last = row_centers[-1], column_centers[-1]
        bottom, right = (int(at) + self.window // 2 + 4 for at in last)
        strips = [
            samples[np.ix_(_mirrored(top, bottom, height), _mirrored(left, right, width))]
            for samples in (gradient.along_columns, gradient.along_rows)
            for height, width in (samples.shape,)
        ]
        return local_power(
            Gradients(strips[0], strips[1], (0, 0)),
            row_centers - top,
            column_centers - left,
            self.window,
        )

    def center_of(self, row: int, column: int) -> tuple[float, float]:
        """Return the centre of the window that one place may take over, in px."""
        return (
            float(self.rows.centers[self.rows.asked[row]]),
            float(self.columns.centers[self.columns.asked[column]]),
        )


def _mirrored(start: int, stop: int, length: int) -> Places:
    """Return which of so many samples stand for those from one to another, some of them outside."""
    at = np.arange(start, stop)
    at = np.where(at < 0, -1 - at, at)
    return np.where(at >= length, 2 * length - 1 - at, at)
