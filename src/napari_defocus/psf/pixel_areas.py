"""How much of a shape falls on each pixel: exact areas, from sums up to the pixels' corners."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.floating]


def corners_to(reach: float) -> Float64:
    """Return 0.5, 1.5, ... px: the corners from the middle pixel's to the first past `reach`."""
    return np.arange(max(math.ceil(reach - 0.5), 0) + 1) + 0.5


def from_quadrant(area: Float64) -> NDArray[np.float64]:
    """Return the kernel whose sums from the centre to the corners right below are given."""
    return from_cumulative(np.block([[area[::-1, ::-1], -area[::-1]], [-area[:, ::-1], area]]))


def from_cumulative(below: Float64) -> NDArray[np.float64]:
    """Return the kernel whose sums up to each corner, but for a constant, are given."""
    covered = np.maximum(np.diff(np.diff(below, axis=0), axis=1), 0)
    return covered / covered.sum()


def disc_area(corners: Float64, radius: float | Float64) -> Float64:
    """Return the area of a disc between its centre and each pair of corners: (..., C, C).

    Parameters
    ----------
    corners : (C,) float64 ndarray
        Positive, in px.
    radius : float or (..., 1, 1) float64 ndarray
    """
    down, across = np.minimum(corners[:, None], radius), np.minimum(corners, radius)

    def half_chord(u: Float64) -> Float64:
        return np.sqrt((radius - u) * (radius + u))

    def under_arc(u: Float64) -> Float64:
        return 0.5 * (u * half_chord(u) + radius**2 * np.arcsin(u / radius))

    flat = np.minimum(half_chord(down), across)
    return down * flat + under_arc(across) - under_arc(flat)


def polygon_area_below(row: Float64, column: Float64, corners: Float64) -> Float64:
    """Return the area of a polygon up to each row and column, but for a constant: (C, C).

    By the divergence theorem: the integral of min(row, limit) over the columns, along all
    edges. The sign of the area is that of the sense in which the polygon is run through.
    """
    row0, row1 = row[:, None, None], np.roll(row, -1)[:, None, None]
    column0, column1 = column[:, None, None], np.roll(column, -1)[:, None, None]
    width = column1 - column0
    slope = np.divide(row1 - row0, width, out=np.zeros_like(width), where=width != 0)
    start, stop = np.minimum(column0, corners), np.minimum(column1, corners)
    # Rows relative to the limit: over a closed line, the limit itself cancels.
    row_start = row0 + slope * (start - column0) - corners[:, None]
    row_stop = row0 + slope * (stop - column0) - corners[:, None]
    inside = np.minimum(row_start, 0) + np.minimum(row_stop, 0)
    span = np.abs(row_start) + np.abs(row_stop)
    mean = inside**2 / (2 * np.maximum(span, np.finfo(float).tiny))
    return np.sum((start - stop) * mean, axis=0)
