"""How the blur of a field is distributed: counts in bins that grow with the radius.

Bins are evenly wide in log(r + 1 px): the first one is 0.07 px wide, that at 8 px is 0.6 px wide.
So one short list tells 1 px from 1.5 px, and 20 px from 30 px.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.psf import MAX_RADIUS

BINS = 64
"""How many there are; the last one takes all that is wider, too."""


def on_scale(radius: Any) -> Any:
    """Return where radii, in px, lie between no blur, 0, and the widest, 1: log(r + 1 px)."""
    return np.log1p(radius) / math.log1p(MAX_RADIUS)


def bin_edges() -> NDArray[np.float64]:
    """Return the radii, in px, at which the bins begin and end: (BINS + 1,).

    Examples
    --------
    >>> bin_edges()[[0, 1, -1]].round(2).tolist()
    [0.0, 0.07, 64.0]
    """
    return np.expm1(np.linspace(0, math.log1p(MAX_RADIUS), BINS + 1))


def blur_histogram(counts: NDArray[np.int64], step: float) -> list[int]:
    """Return how many pixels each bin has, from counts of radii that are multiples of a step.

    Parameters
    ----------
    counts : (N,) int64 ndarray
        How many pixels have the radius 0, `step`, 2 `step` and so on.
    step : float
        In px.

    Examples
    --------
    >>> sum(blur_histogram(np.array([5, 3, 1]), step=0.01))
    9
    """
    place = (on_scale(step * np.arange(len(counts))) * BINS).astype(np.int64)
    held = np.bincount(np.minimum(place, BINS - 1), weights=counts, minlength=BINS)
    return [int(count) for count in held]


def share_up_to(histogram: Sequence[int], radius: float) -> float | None:
    """Return the share of the pixels of a histogram with at most so wide a blur, in px.

    A bin that the radius divides counts in part. None if there is no pixel.

    Examples
    --------
    >>> share_up_to([2] * BINS, MAX_RADIUS), share_up_to([0] * BINS, 2.0)
    (1.0, None)
    """
    total = sum(histogram)
    if not total:
        return None
    below = np.concatenate([[0], np.cumsum(histogram)])
    return float(np.interp(radius, bin_edges(), below)) / total
