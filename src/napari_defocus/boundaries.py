"""From labels of blocks to labels of pixels: colour weights (16), and cuts beside jumps.

A block of pixels carries the label of its window. Where neighbouring blocks differ by a jump,
their pixels become nodes of their own, and each side of the jump offers its label to them:
the boundary moves to where the picture's colours change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_dilation,
    grey_dilation,
    grey_erosion,
    maximum_filter,
    minimum_filter,
)

from napari_defocus.graphcut import STEPS, Edges, fuse, join_blocks
from napari_defocus.progress import Progress, silent
from napari_defocus.spectrum import LABEL_STEP

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Labels = NDArray[np.int32]


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

    def spread(self, values: Labels) -> Labels:
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
        joined = _block_weights(color, self.row_of_pixel, self.column_of_pixel, sharpness)
        return joined * np.float32(smoothness)


def _position(centers: Float64, window_of_pixel: NDArray[np.int64]) -> Float64:
    return np.interp(np.arange(len(window_of_pixel)), centers, np.arange(len(centers)))


def _nearest(centers: Float64, length: int) -> NDArray[np.int64]:
    middles = (centers[1:] + centers[:-1]) / 2
    return np.searchsorted(middles, np.arange(length), side="right")


@njit(cache=True, nogil=True)
def _block_weights(
    color: Float32, row_block: NDArray[np.int64], column_block: NDArray[np.int64], sharpness: float
) -> Float32:
    rows, columns, _ = color.shape
    joined = np.zeros((4, row_block[-1] + 1, column_block[-1] + 1), np.float32)
    for down, right in STEPS:
        for i in range(rows - down):
            for j in range(max(0, -right), columns - max(0, right)):
                here, there = row_block[i], row_block[i + down]
                left, beside = column_block[j], column_block[j + right]
                if here != there or left != beside:
                    weight = _color_weight(color[i, j], color[i + down, j + right], sharpness)
                    join_blocks(joined, here, left, there, beside, weight)
    return joined


@njit(cache=True, nogil=True, inline="always")
def _color_weight(here: Float32, there: Float32, sharpness: float) -> float:
    """Return (16) without lambda_0."""
    distance = np.float32(0)
    for channel in range(here.shape[0]):
        distance += (here[channel] - there[channel]) ** 2
    return np.exp(-distance * sharpness)


def label_pixels(
    labels: Labels,
    cost: Float32,
    blocks: Blocks,
    color: Float32,
    *,
    smoothness: float,
    color_sigma: float,
    jump: int,
    reach: int,
    fixed: Labels | None = None,
    progress: Progress = silent,
) -> Labels:
    """Label pixels on their own wherever neighbouring blocks differ by a jump.

    Parameters
    ----------
    labels : (R, C) int32 ndarray
        Of the blocks.
    cost : (R, C, L) float32 ndarray
        D at the windows; between them it is interpolated.
    blocks : Blocks
    color : (H, W, channels) float32 ndarray
    smoothness, color_sigma : float
        lambda_0 and sigma_lambda of (16).
    jump : int
        The smallest difference of labels that counts as a discontinuity.
    reach : int
        How far, in px, a boundary may move at once.
    fixed : (H, W) int32 ndarray, optional
        Labels that pixels must have, -1 where they are free.
    progress : callable, optional

    Returns
    -------
    (H, W) int32 ndarray
    """
    pixels = blocks.spread(labels)
    beside_jump = maximum_filter(labels, 3) - minimum_filter(labels, 3) >= jump
    if fixed is not None:
        beside_jump |= blocks.count((fixed >= 0) & (fixed != pixels)) > 0
        pixels = np.where(fixed >= 0, fixed, pixels)
    if not beside_jump.any():
        return pixels
    free = blocks.spread(binary_dilation(beside_jump, iterations=-(-reach // blocks.side)))
    place = np.flatnonzero(binary_dilation(free, np.ones((3, 3))))
    if fixed is not None:
        free &= fixed < 0
    edges = _pixel_edges(color, place, smoothness, color_sigma)
    rows, columns = blocks.positions
    left = reach
    while left > 0:
        for offer in (grey_erosion, grey_dilation):
            progress("Following the picture's edges", 1 - left / reach)
            proposal = np.where(free, offer(pixels, 2 * left + 1), pixels)
            now, new = pixels.ravel()[place], proposal.ravel()[place].astype(np.int32)
            change = _interpolated_change(cost, now, new, place, rows, columns)
            pixels.flat[place] = fuse(now, new, change, edges)
        left //= 2
    return pixels


def _pixel_edges(
    color: Float32, place: NDArray[np.int64], smoothness: float, color_sigma: float
) -> Edges:
    """Return the pairs of neighbours among some pixels, with the weights (16)."""
    node_of_pixel = np.full(color.shape[:2], -1, np.int32)
    node_of_pixel.flat[place] = np.arange(len(place))
    sharpness = np.float32(0.5 / color_sigma**2)
    first, second, weight = _pixel_pairs(color, node_of_pixel, len(place), sharpness)
    return Edges(first, second, weight * np.float32(smoothness))


@njit(cache=True, nogil=True)
def _pixel_pairs(
    color: Float32, node_of_pixel: Labels, nodes: int, sharpness: float
) -> tuple[Labels, Labels, Float32]:
    rows, columns = node_of_pixel.shape
    first, second = np.empty(4 * nodes, np.int32), np.empty(4 * nodes, np.int32)
    weight = np.empty(4 * nodes, np.float32)
    count = 0
    for i in range(rows):
        for j in range(columns):
            if node_of_pixel[i, j] < 0:
                continue
            for down, right in STEPS:
                y, x = i + down, j + right
                if y < rows and 0 <= x < columns and node_of_pixel[y, x] >= 0:
                    first[count] = node_of_pixel[i, j]
                    second[count] = node_of_pixel[y, x]
                    weight[count] = _color_weight(color[i, j], color[y, x], sharpness)
                    count += 1
    return first[:count], second[:count], weight[:count]


@njit(cache=True, nogil=True)
def _interpolated_change(
    cost: Float32,
    now: Labels,
    new: Labels,
    place: NDArray[np.int64],
    row_position: Float64,
    column_position: Float64,
) -> Float64:
    """Return D of the new label minus D of the present one, at each pixel."""
    change = np.zeros(len(place))
    for k in range(len(place)):
        if now[k] == new[k]:
            continue
        y = row_position[place[k] // len(column_position)]
        x = column_position[place[k] % len(column_position)]
        top, left = int(y), int(x)
        for i in range(top, min(top + 2, cost.shape[0])):
            for j in range(left, min(left + 2, cost.shape[1])):
                share = (1 - abs(y - i)) * (1 - abs(x - j))
                change[k] += share * (cost[i, j, new[k]] - cost[i, j, now[k]])
    return change


def interpolate_labels(
    scales: Float32, labels: Labels, pixels: Labels, blocks: Blocks, jump: int
) -> Float32:
    """Interpolate the scales of blocks, at each pixel among those that its own label belongs to.

    Parameters
    ----------
    scales : (R, C) float32 ndarray
        Of the blocks, in px.
    labels : (R, C) int32 ndarray
        Of the blocks.
    pixels : (H, W) int32 ndarray
        Labels of the pixels; where no block around has one alike, it is the result.
    blocks : Blocks
    jump : int
        Labels that differ by less belong together.

    Returns
    -------
    (H, W) float32 ndarray
        In px.
    """
    return _interpolated_alike(scales, labels, pixels, *blocks.positions, jump)


@njit(cache=True, parallel=True, nogil=True)
def _interpolated_alike(
    scales: Float32,
    labels: Labels,
    pixels: Labels,
    row_position: Float64,
    column_position: Float64,
    jump: int,
) -> Float32:
    result = np.float32(LABEL_STEP) * pixels.astype(np.float32)
    for row in prange(pixels.shape[0]):
        y = row_position[row]
        top = int(y)
        for column in range(pixels.shape[1]):
            x = column_position[column]
            left = int(x)
            total, weight = 0.0, 0.0
            for i in range(top, min(top + 2, labels.shape[0])):
                for j in range(left, min(left + 2, labels.shape[1])):
                    if abs(labels[i, j] - pixels[row, column]) < jump:
                        share = (1 - abs(y - i)) * (1 - abs(x - j))
                        total += share * scales[i, j]
                        weight += share
            if weight > 1e-6:
                result[row, column] = total / weight
    return result
