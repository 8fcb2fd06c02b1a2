"""Edges that are themselves out of focus, for the weights of the pairwise term.

Between two pixels of a blurred edge there is hardly a step of the colour, so that (16) takes a
thing that is blurred by 2 px and its ground, blurred by 20 px, for one. In the picture smoothed
over 8 px, the colour c changes across 8 px by 8 |grad c|. With that as distance of the colours,

    f = exp(-(8 |grad c|)^2 / (2 sigma_lambda^2))

is small at such edges, and the weights between windows are multiplied by it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from napari_defocus.labeling.multigrid import STEPS
from napari_defocus.labeling.pairwise_term import Blocks

Float32 = NDArray[np.float32]

_ACROSS = 8
"""px: standard deviation of the smoothing, and how far colours are compared (docs/decisions.md)."""

_SIDE = 4
"""px, side of the squares whose mean colours are smoothed; that is faster, and as good."""


def less_at_blurred_edges(weights: Float32, squared_step: Float32, color_sigma: float) -> Float32:
    """Return weights between blocks, less where the picture has an edge that may be blurred.

    Parameters
    ----------
    weights : (4, R, C) float32 ndarray
        See `Blocks.edge_weights`.
    squared_step : (R, C) float32 ndarray
        See `squared_step_of`.
    color_sigma : float
        sigma_lambda of (16), in the unit of the colours.

    Returns
    -------
    (4, R, C) float32 ndarray
    """
    share = np.exp(-squared_step * np.float32(0.25 / color_sigma**2))
    lessened = weights.copy()
    for between, here, there in _pairs(share):
        lessened[between] *= here * there
    return lessened


def less_at_outline(
    weights: Float32, inside: NDArray[np.bool_], counts: NDArray[np.bool_], share: np.float32
) -> None:
    """Leave a share of weights between blocks along an outline, where it counts.

    Parameters
    ----------
    weights : (4, R, C) or (8, R, C) float32 ndarray
        See `minimize_energy`; changed.
    inside, counts : (R, C) bool ndarray
        What the outline surrounds, and the blocks of which both have to count.
    share : float32
    """
    for (between, here, there), (_, one, other) in zip(_pairs(inside), _pairs(counts), strict=True):
        left = np.where((here != there) & one & other, share, np.float32(1))
        for half in range(0, len(weights), len(STEPS)):
            weights[half:][between] *= left


def _pairs(
    values: NDArray[Any],
) -> Iterator[tuple[tuple[int, slice, slice], NDArray[Any], NDArray[Any]]]:
    """Yield where the weights of each step are, and the values of both blocks of a pair."""
    rows, columns = values.shape
    for number, (down, right) in enumerate(STEPS):
        left, end = max(0, -right), columns - max(0, right)
        between = number, slice(0, rows - down), slice(left, end)
        yield between, values[between[1:]], values[down:, left + right : end + right]


def squared_step_of(color: Float32, blocks: Blocks) -> Float32:
    """Return the square of how much the smoothed colour changes across 8 px: (R, C).

    Parameters
    ----------
    color : (H, W, channels) float32 ndarray
    blocks : Blocks
    """
    across = _ACROSS / _SIDE
    total = np.zeros([-(-length // _SIDE) for length in color.shape[:2]], np.float32)
    for channel in range(color.shape[2]):
        means = _means_of_squares(color[..., channel])
        for order in ((1, 0), (0, 1)):
            total += (np.float32(across) * gaussian_filter(means, across, order=order)) ** 2
    at = (
        np.rint(centers).astype(int) // _SIDE
        for centers in (blocks.row_centers, blocks.column_centers)
    )
    return total[np.ix_(*at)]


def _means_of_squares(values: Float32) -> Float32:
    padding = [(0, -length % _SIDE) for length in values.shape]
    padded = np.pad(values, padding, mode="edge")
    rows, columns = (length // _SIDE for length in padded.shape)
    means: Float32 = padded.reshape(rows, _SIDE, columns, _SIDE).mean(axis=(1, 3))
    return means
