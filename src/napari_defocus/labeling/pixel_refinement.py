"""From labels of blocks to labels of pixels: colour weights (16), and cuts beside jumps.

A block of pixels carries the label of its window. Where neighbouring blocks differ by a jump,
their pixels become nodes of their own, and each side of the jump offers its label to them:
the boundary moves to where the picture's colours change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import (
    binary_dilation,
    grey_dilation,
    grey_erosion,
    maximum_filter,
    minimum_filter,
)

from napari_defocus.core.progress import Progress, silent
from napari_defocus.core.threads import in_bands
from napari_defocus.labeling.graph_cuts import Mask, Places, fuse
from napari_defocus.labeling.multigrid import STEPS, join_blocks
from napari_defocus.likelihood.blur_spectra import LABEL_STEP

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Labels = NDArray[np.int32]
Value = TypeVar("Value", bound=np.generic)
ChangeAt = Callable[[Labels, Labels, Places], Float64]


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
        joined = _block_weights(color, self.row_of_pixel, self.column_of_pixel, sharpness)
        return joined * np.float32(smoothness)


def _position(centers: Float64, window_of_pixel: NDArray[np.int64]) -> Float64:
    return np.interp(np.arange(len(window_of_pixel)), centers, np.arange(len(centers)))


def _nearest(centers: Float64, length: int) -> NDArray[np.int64]:
    middles = (centers[1:] + centers[:-1]) / 2
    return np.searchsorted(middles, np.arange(length), side="right")


@njit(cache=True, error_model="numpy", nogil=True)
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
                    weight = _color_weight(color, i, j, i + down, j + right, sharpness)
                    join_blocks(joined, here, left, there, beside, weight)
    return joined


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
def _color_weight(
    color: Float32, row: int, column: int, row_to: int, column_to: int, sharpness: np.float32
) -> np.float32:
    """Return (16), without lambda_0, between two pixels."""
    distance = np.float32(0)
    for channel in range(color.shape[2]):
        step = color[row, column, channel] - color[row_to, column_to, channel]
        distance += step * step
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
    change_at: ChangeAt | None = None,
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
    change_at : callable, optional
        Given the present labels, the offered ones and places in the flat picture, returns D of
        the offer minus D of the present label there, instead of what `cost` says; NaN leaves
        it at that.
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
    near = binary_dilation(beside_jump, iterations=-(-reach // blocks.side))
    free = blocks.spread(near).astype(bool)
    weights = pixel_weights(color, free, color_sigma, smoothness)
    if fixed is not None:
        free &= fixed < 0
    left = reach
    while left > 0:
        for offer in (grey_erosion, grey_dilation):
            progress("Following the picture's edges", 1 - left / reach)
            proposal = offer(pixels, 2 * left + 1)
            # Smaller steps are interpolated later, whichever side of them a pixel is on.
            place = np.flatnonzero(free & (np.abs(proposal - pixels) >= jump))
            proposal = _changed(pixels, place, proposal.ravel()[place])
            change = _interpolated_change(cost, pixels, proposal, place, *blocks.positions)
            if change_at is not None:
                own = change_at(pixels, proposal, place)
                change = np.where(np.isnan(own), change, own)
            pixels = fuse(pixels, proposal, place, change, weights)
        left //= 2
    return pixels


def _changed(values: Labels, place: Places, new: Labels) -> Labels:
    changed = values.copy()
    changed.ravel()[place] = new
    return changed


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


@njit(cache=True, error_model="numpy", nogil=True)
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
                    weights[k, i, j] = _color_weight(color, i, j, y, j + right, sharpness)


@njit(cache=True, error_model="numpy", nogil=True)
def _interpolated_change(
    cost: Float32,
    now: Labels,
    new: Labels,
    place: Places,
    row_position: Float64,
    column_position: Float64,
) -> Float64:
    """Return D of the new label minus D of the present one, at some pixels."""
    change = np.zeros(len(place))
    columns = len(column_position)
    for k in range(len(place)):
        row, column = place[k] // columns, place[k] % columns
        y, x = row_position[row], column_position[column]
        change[k] = _interpolated(cost, new[row, column], y, x)
        change[k] -= _interpolated(cost, now[row, column], y, x)
    return change


def energy_of_pixels(
    pixels: Labels,
    cost: Float32,
    blocks: Blocks,
    color: Float32,
    *,
    smoothness: float,
    color_sigma: float,
) -> float:
    """Evaluate (14) for labels of pixels; see `label_pixels` for the parameters."""
    sharpness = np.float32(0.5 / color_sigma**2)
    evidence, jumps = np.zeros((2, len(pixels)))
    places = blocks.positions
    in_bands(_energy_of_rows, len(pixels), pixels, cost, color, *places, sharpness, evidence, jumps)
    return float(evidence.sum() + smoothness * jumps.sum())


@njit(cache=True, error_model="numpy", nogil=True)
def _energy_of_rows(
    start: int,
    stop: int,
    pixels: Labels,
    cost: Float32,
    color: Float32,
    row_position: Float64,
    column_position: Float64,
    sharpness: np.float32,
    evidence: Float64,
    jumps: Float64,
) -> None:
    """Add up D, and the weighted differences of labels, that each row begins."""
    rows, columns = pixels.shape
    for i in range(start, stop):
        for j in range(columns):
            label = pixels[i, j]
            evidence[i] += _interpolated(cost, label, row_position[i], column_position[j])
            for down, right in STEPS:
                y, x = i + down, j + right
                if y < rows and 0 <= x < columns and pixels[y, x] != label:
                    weight = _color_weight(color, i, j, y, x, sharpness)
                    jumps[i] += weight * abs(pixels[y, x] - label)


@njit(cache=True, error_model="numpy", nogil=True, forceinline=True)
def _interpolated(cost: Float32, label: int, y: float, x: float) -> float:
    """Return D of a label between the windows."""
    top, left = int(y), int(x)
    value = 0.0
    for i in range(top, min(top + 2, cost.shape[0])):
        for j in range(left, min(left + 2, cost.shape[1])):
            value += (1 - abs(y - i)) * (1 - abs(x - j)) * cost[i, j, label]
    return value


def interpolate_labels(
    scales: Float64, labels: Labels, pixels: Labels, blocks: Blocks, jump: int
) -> Float32:
    """Interpolate the scales of blocks, at each pixel among those that its own label belongs to.

    Parameters
    ----------
    scales : (R, C) float ndarray
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
    scales = np.asarray(scales, np.float64)
    result = np.float32(LABEL_STEP) * pixels.astype(np.float32)
    places = blocks.positions
    in_bands(_interpolate_rows, len(pixels), scales, labels, pixels, *places, jump, result)
    return result


@njit(cache=True, error_model="numpy", nogil=True)
def _interpolate_rows(
    start: int,
    stop: int,
    scales: Float64,
    labels: Labels,
    pixels: Labels,
    row_position: Float64,
    column_position: Float64,
    jump: int,
    result: Float32,
) -> None:
    for row in range(start, stop):
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
