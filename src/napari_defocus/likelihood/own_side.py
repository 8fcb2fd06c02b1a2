"""Windows that are sharp only because of what lies beside them, and what is asked instead.

A window that overlaps two blur scales is won by the sharper one (Section V of the paper), so
that sharp regions grow by the window's radius. But it is seen where in the window the fine
details are: the mean shift of their energy E under the Gaussian window of standard deviation
sigma is d = sigma^2 grad log E (Fukunaga and Hostetler, IEEE Trans. Inf. Theory 21(1), 1975).
Beside a textured half-plane, a window moved away by 2 d has left it when its own centre is
outside, and not before. Where it is much blurrier there, the details belong to the other side,
and the place takes the moved window's evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from napari_defocus.core.image import PreparedImage
from napari_defocus.likelihood.analysis_grid import between_pixels
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.sharp_details import share_of_blocks

Float32 = NDArray[np.float32]

_DETAIL = 1.0
"""Standard deviation, in px, of the Gaussian that removes fine details."""

_SHIFTS = 2.0
"""How many mean shifts a window moves away from fine details, see above."""

_LARGEST_SHIFT = 0.5
"""The largest shift, as a share of the window's side."""

_LEAST_RATIO, _LEAST_STEP = 2.0, 0.5
"""The moved window counts if it is blurred by more than 2 r + 0.5 px: a steep slope of the blur is
not an edge. With a difference of 1 px instead, bumps lost what edges gained (docs/decisions.md).
"""

_MOSTLY = 0.5
"""Of a block's pixels: where so many show sharp details themselves, it is the sharper side."""

_LEAST_ENERGY = 1e-12
"""Added to the energy of fine details, so that its logarithm is defined."""

AT_ONCE = 100_000
"""Of more windows (1.6 megapixels), no second array of curves is made: it is as large as all else.
"""


@dataclass(frozen=True, eq=False)
class MovedCurves:
    """Curves of which some are those of other windows, read where they are asked for.

    They are indexed as the array is that they stand for, (R, C, L).

    Attributes
    ----------
    curve : (R, C, L) float32 ndarray
    row, column : (R, C) int32 ndarray
        Of the window that each place takes.
    """

    curve: Float32
    row: NDArray[np.int32]
    column: NDArray[np.int32]

    @classmethod
    def of(cls, curve: Float32 | MovedCurves) -> MovedCurves:
        """Return curves of an array, each the place's own, or what they are already."""
        if isinstance(curve, cls):
            return curve
        array = np.ascontiguousarray(cast(Float32, curve))
        row, column = np.indices(array.shape[:2], np.int32)
        return cls(array, np.asarray(row), np.asarray(column))

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the array."""
        return self.curve.shape

    def __getitem__(self, index: Any) -> Float32:
        """Return a part, which is an array of its own."""
        if isinstance(index, tuple) and index[0] is Ellipsis:
            return np.ascontiguousarray(self.curve[self.row, self.column, index[1]])
        return np.ascontiguousarray(self.curve[self.row[index], self.column[index]])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Float32:
        """Return all of them."""
        return np.asarray(self[..., :], dtype)


def on_own_side(candidates: BlurCandidates, picture: PreparedImage) -> BlurCandidates:
    """Replace the curves of windows that are sharp only because of what lies beside them.

    Of a large picture, the curves are `MovedCurves`.

    Parameters
    ----------
    candidates : BlurCandidates
        Of the mode "curve"; those of "paper" are returned as they are.
    picture : PreparedImage
        The same.
    """
    row, column = asked_windows(candidates, picture)
    rows, columns = np.indices(row.shape)
    moved = (row != rows) | (column != columns)
    if not moved.any():
        return candidates
    if moved.size > AT_ONCE:
        lazy = MovedCurves(candidates.curve, row.astype(np.int32), column.astype(np.int32))
        return replace(candidates, curve=cast(Float32, lazy))
    own = candidates.curve.copy()
    own[moved] = candidates.curve[row[moved], column[moved]]
    return replace(candidates, curve=own)


def asked_windows(
    candidates: BlurCandidates, picture: PreparedImage
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the row and the column of the window whose curve each place takes: (R, C) each.

    Its own, but where that is sharp only because of what lies beside it; see `on_own_side`.
    """
    curve = candidates.curve
    places = np.indices(curve.shape[:2])
    rows, columns = places[0], places[1]
    if candidates.mode == "paper":
        return rows, columns
    row_shift, column_shift = _shifts(candidates, picture)
    row = np.clip(np.rint(rows + row_shift), 0, curve.shape[0] - 1).astype(int)
    column = np.clip(np.rint(columns + column_shift), 0, curve.shape[1] - 1).astype(int)
    best = candidates.scales[curve.argmax(axis=2)]
    blurrier = best[row, column] > _LEAST_RATIO * best + _LEAST_STEP
    if candidates.sharp is not None:
        centers = candidates.row_centers, candidates.column_centers
        blurrier &= share_of_blocks(candidates.sharp, *centers, candidates.stride) < _MOSTLY
    return np.where(blurrier, row, rows), np.where(blurrier, column, columns)


def _shifts(candidates: BlurCandidates, picture: PreparedImage) -> Float32:
    """Return how far each window moves away from where its fine details are: (2, R, C) windows."""
    stride, window = candidates.stride, candidates.window
    details = picture.evened - gaussian_filter(picture.evened, _DETAIL)
    if picture.opaque is not None:
        details[~picture.opaque] = 0
    energy = gaussian_filter(details**2, stride / 2)
    centers = (candidates.row_centers, candidates.column_centers)
    sampled = energy
    for axis, places in enumerate(centers):
        sampled = between_pixels(sampled, places, axis)
    sampled += max(candidates.noise_variance / picture.intensities.unit**2, _LEAST_ENERGY)
    # Power has the square of the filters' window, of standard deviation N / 4.
    sigma = window / 4 / np.sqrt(2) / stride
    log_energy = np.log(gaussian_filter(sampled, sigma, mode="nearest"))
    shifts = (
        -_SHIFTS
        * sigma**2
        * np.stack(
            [
                np.gradient(log_energy, axis=axis) if log_energy.shape[axis] > 1 else 0 * log_energy
                for axis in (0, 1)
            ]
        )
    )
    length = np.hypot(*shifts)
    return shifts * np.minimum(1, _LARGEST_SHIFT * window / stride / np.maximum(length, 1e-6))
