"""The pairwise term of (14): the prior of a Markov random field, with colour-dependent weights.

Neighbours p, q in an 8-neighbourhood pay w_pq |l_p - l_q| for their labels (15), where

    w_pq = lambda_0 exp(-|c_p - c_q|^2 / (2 sigma_lambda^2))                                  (16)

depends on their colours c: the blur may jump where the picture has an edge. Labels are first
chosen for blocks of pixels, one around each analysed window; the weight between two blocks is the
sum over all pairs of pixels that cross their border, and less where that is a blurred edge
(`blurred_edges`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled, compiled_inline
from napari_defocus.core.threads import in_bands
from napari_defocus.labeling.multigrid import STEPS, join_blocks

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Mask = NDArray[np.bool_]
Value = TypeVar("Value", bound=np.generic)


@dataclass(frozen=True)
class Blocks:
    """Which window each row and column of pixels belongs to.

    Attributes
    ----------
    row_centers, column_centers : (R,) and (C,) float64 ndarray
        In px.
    row_of_pixel, column_of_pixel : (H,) and (W,) int ndarray
    """

    row_centers: Float64
    column_centers: Float64
    row_of_pixel: NDArray[np.int64]
    column_of_pixel: NDArray[np.int64]

    @classmethod
    def around(
        cls,
        row_centers: Float64,
        column_centers: Float64,
        shape: tuple[int, int],
    ) -> Blocks:
        """Give every pixel of a picture to the nearest window."""
        return cls(
            row_centers,
            column_centers,
            _nearest(row_centers, shape[0]),
            _nearest(column_centers, shape[1]),
        )

    @property
    def area(self) -> Float32:
        """Number of pixels of each block: (R, C)."""
        area = np.outer(np.bincount(self.row_of_pixel), np.bincount(self.column_of_pixel))
        return area.astype(np.float32)

    @property
    def side(self) -> int:
        """Height of a block, in px."""
        return int(np.bincount(self.row_of_pixel).max())

    @property
    def positions(self) -> tuple[Float64, Float64]:
        """Where each row and column of pixels lies between the windows, counted in windows."""
        return _position(self.row_centers, self.row_of_pixel), _position(
            self.column_centers, self.column_of_pixel
        )

    def spread(self, values: NDArray[Value]) -> NDArray[Value]:
        """Give every pixel its block's value: (R, C) to (H, W)."""
        return values[np.ix_(self.row_of_pixel, self.column_of_pixel)]

    def count(self, marked: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Count the marked pixels of each block: (H, W) to (R, C)."""
        rows, columns = np.nonzero(marked)
        counts = np.zeros((len(self.row_centers), len(self.column_centers)), np.int64)
        np.add.at(counts, (self.row_of_pixel[rows], self.column_of_pixel[columns]), 1)
        return counts

    def edge_weights(self, color: Float32, color_sigma: float, smoothness: float) -> Float32:
        """Add up lambda of (16) over the pixel pairs between neighbouring blocks: (4, R, C)."""
        sharpness = np.float32(0.5 / color_sigma**2)
        joined = np.zeros((4, len(self.row_centers), len(self.column_centers)), np.float32)
        given = color, self.row_of_pixel, self.column_of_pixel, sharpness
        in_bands(_weigh_blocks, len(self.row_centers), *given, joined)
        joined *= np.float32(smoothness)
        return joined


def _position(centers: Float64, window_of_pixel: NDArray[np.int64]) -> Float64:
    return np.interp(np.arange(len(window_of_pixel)), centers, np.arange(len(centers)))


def _nearest(centers: Float64, length: int) -> NDArray[np.int64]:
    middles = (centers[1:] + centers[:-1]) / 2
    return np.searchsorted(middles, np.arange(length), side="right")


@compiled
def _weigh_blocks(
    start: int,
    stop: int,
    color: Float32,
    row_block: NDArray[np.int64],
    column_block: NDArray[np.int64],
    sharpness: np.float32,
    joined: Float32,
) -> None:
    """Add up the weights of some rows of blocks: each pair counts in that of its upper pixel."""
    rows, columns, _ = color.shape
    for down, right in STEPS:
        for i in range(rows - down):
            if not start <= row_block[i] < stop:
                continue
            for j in range(max(0, -right), columns - max(0, right)):
                here, there = row_block[i], row_block[i + down]
                left, beside = column_block[j], column_block[j + right]
                if here != there or left != beside:
                    weight = color_weight(color, i, j, i + down, j + right, sharpness)
                    join_blocks(joined, here, left, there, beside, weight)


@compiled_inline
def color_weight(
    color: Float32, row: int, column: int, row_to: int, column_to: int, sharpness: np.float32
) -> np.float32:
    """Return (16), without lambda_0, between two pixels."""
    distance = np.float32(0)
    for channel in range(color.shape[2]):
        step = color[row, column, channel] - color[row_to, column_to, channel]
        distance += step * step
    return np.exp(-distance * sharpness)


def pixel_weights(color: Float32, near: Mask, color_sigma: float, smoothness: float) -> Float32:
    """Return lambda of (16) between pixels of which at least one is among those given.

    Parameters
    ----------
    color : (H, W, channels) float32 ndarray
    near : (H, W) bool ndarray
    color_sigma, smoothness : float

    Returns
    -------
    (4, H, W) float32 ndarray
        Between a pixel and its neighbour at each of `STEPS`, else 0.
    """
    weights = np.zeros((4, *color.shape[:2]), np.float32)
    in_bands(_weigh_rows, len(color), color, near, np.float32(0.5 / color_sigma**2), weights)
    weights *= np.float32(smoothness)
    return weights


@compiled
def _weigh_rows(
    start: int, stop: int, color: Float32, near: Mask, sharpness: np.float32, weights: Float32
) -> None:
    """Write the weights of `pixel_weights`, without lambda_0, of some rows of pixels."""
    rows, columns, _ = color.shape
    for i in range(start, stop):
        for k, (down, right) in enumerate(STEPS):
            y = i + down
            if y >= rows:
                continue
            for j in range(max(0, -right), columns - max(0, right)):
                if near[i, j] or near[y, j + right]:
                    weights[k, i, j] = color_weight(color, i, j, y, j + right, sharpness)
