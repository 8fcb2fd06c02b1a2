"""Places beside sharp details that are not sharp themselves: on which side of an outline are they?

Their windows see the details, and say "little". That is right within a thing, and wrong on the
ground beside it. So they offer both: what their windows say, and what the ground would say, which
is what coarser levels see without the details. The picture's colours and the neighbours decide
between the two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from napari_defocus.core.compiled import compiled
from napari_defocus.core.threads import in_bands
from napari_defocus.likelihood.between_windows import neighbors, of_four
from napari_defocus.likelihood.evidence import DEPTH
from napari_defocus.likelihood.prior import log_prior
from napari_defocus.likelihood.sharp_details import SharpDetails, share_of_blocks

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

_NEAR = 8.0
"""px: standard deviation of the Gaussian over which the share of sharp details is averaged."""

_FEW, _MANY = np.float32(0.1), np.float32(0.3)
"""Up to, and from which share a place is beside them not at all, and surely."""

_OWN = np.float32(0.25)
"""Share of a block's pixels that are sharp, from which on it is no ground."""

_LESS_LIKELY = np.float32(5)
"""Units of log-likelihood that the ground is worse than what the windows say themselves: with 2,
bumps have 0.38 px of error instead of 0.32 (docs/decisions.md)."""

_RATIO, _STEP = 3.0, 1.0
"""The ground is blurred by more than 3 r + 1 px: a slope of the blur has no other side."""

_AT_ONCE = 4096
"""Places that are worked on at once; for memory only."""

_NO = np.float32(-30)
"""Units of log-likelihood: what is not offered."""


@dataclass(frozen=True, eq=False)
class GroundBeside:
    """What places beside sharp details say if they are of the ground.

    Attributes
    ----------
    row, column : (P,) int64 ndarray
        The places, counted in windows.
    doubt : (P,) float32 ndarray
        How surely they are beside details, from 0 to 1.
    curve : (P, L) float32 ndarray
        Changed by `add`.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    doubt: Float32
    curve: Float32

    @classmethod
    def of(
        cls, details: SharpDetails, at: tuple[Float64, Float64], stride: int, count: int
    ) -> GroundBeside:
        """Find the places: windows `stride` px apart at rows and columns of px, `count` scales."""
        around = share_of_blocks(details.around, *at, stride)
        near = gaussian_filter(around, _NEAR / stride, truncate=3.0)
        beside = np.clip((near - _FEW) / (_MANY - _FEW), 0, 1)
        beside *= 1 - np.minimum(share_of_blocks(details.inside, *at, stride) / _OWN, 1)
        row, column = np.nonzero(beside)
        return cls(row, column, beside[row, column], np.zeros((len(row), count), np.float32))

    def add(
        self,
        curve: Float32,
        first: int,
        height: int,
        some: slice,
        rows: Float64,
        columns: Float64,
        gain: Float32,
    ) -> None:
        """Add a share, (R, C), of what a level says between its windows, to places of some rows.

        `curve`, (r, c, L), holds its rows from the first one given on, of `height` in all.
        """
        of_rows = slice(*np.searchsorted(self.row, (some.start, some.stop)))
        row, column = self.row[of_rows], self.column[of_rows]
        places = rows[row], columns[column], gain[row, column]
        in_bands(_add_between, len(row), curve, first, height, *places, self.curve[of_rows])

    def best(self, own: Float32, scales: Float64) -> NDArray[np.int64]:
        """Return the likeliest of the first scales, (P,), of what level 0 says: (R, C, K)."""
        return (own[self.row, self.column] + log_prior(scales)).argmax(axis=1)

    def offered(
        self, total: Float32, best: NDArray[np.int64], scales: Float64, anything: float
    ) -> None:
        """Let places have what is likelier of both, if it is.

        Parameters
        ----------
        total : (R, C, L) float32 ndarray
            Joined curves, 0 at their tops; changed.
        best : (P,) int64 ndarray
            The likeliest scale of level 0.
        scales : (L,) float64 ndarray
        anything : float
            px: what lies above is one class to level 0.
        """
        for first in range(0, len(self.row), _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            row, column = self.row[some], self.column[some]
            least = np.maximum(anything, _RATIO * scales[best[some]] + _STEP)
            ground = np.where(scales < least[:, None] - 1e-6, _NO, self.curve[some])
            ground -= ground.max(axis=1, keepdims=True)
            ground -= (_LESS_LIKELY + 2 * DEPTH * (1 - self.doubt[some]))[:, None]
            total[row, column] = np.maximum(total[row, column], ground)


@compiled
def _add_between(
    start: int,
    stop: int,
    curve: Float32,
    first: int,
    height: int,
    rows: Float64,
    columns: Float64,
    gain: Float32,
    found: Float32,
) -> None:
    """Add a share of what windows say at places between them, counted in windows."""
    _, width, count = curve.shape
    for place in range(start, stop):
        top, bottom, down = neighbors(rows[place], height)
        left, right, along = neighbors(columns[place], width)
        for k in range(count):
            said = of_four(curve, top - first, bottom - first, left, right, down, along, k)
            found[place, k] += gain[place] * said
