"""Places that are sharp in two planes: something transparent, or one thing before another.

Contrast along the planes has two peaks there, and a single position that fits both lies between
them, where nothing is sharp. So one is chosen, and planes beyond the valley have no say.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from napari_defocus.stacks.depth_from_focus import StackPower

Float64 = NDArray[np.floating]
Mask = NDArray[np.bool_]
Peak = Literal["strongest", "first", "last"]

_LEAST_PEAK, _LEAST_OF_OTHER, _DEEPEST = 3.0, 0.1, 0.5
"""The least power of a second peak, in units of the noise's and of the first peak's; and how deep
the valley must be, at most, as a share of the second peak. Chosen by hand.
"""

_AROUND = 1.0
"""Windows: standard deviation of the Gaussian that averages power. Chosen by hand."""

_APART = 2
"""The least number of planes between two peaks."""

_LEAST_KNOWN = 1e-3
"""The least share of averaged windows that is divided by."""


def check_peak(peak: Any) -> None:
    """Refuse what names no peak."""
    if not isinstance(peak, str) or peak not in get_args(Peak):
        raise ValueError(f"peak is {peak!r}; it takes one of {get_args(Peak)}")


def one_peak(power: StackPower, peak: Peak) -> tuple[StackPower, Mask]:
    """Take the say from planes of a peak that is not chosen; return which windows have two, too.

    Parameters
    ----------
    power : StackPower
    peak : {"strongest", "first", "last"}
        Which is chosen: the first is that of the lowest plane.
    """
    shape = len(power.bank.rows), len(power.bank.columns)
    heard = power.heard.astype(np.float32)
    shown, known = (
        gaussian_filter(each.reshape(*shape, -1), (_AROUND, _AROUND, 0)).reshape(each.shape)
        for each in (heard * (power.mean_power() - 1), heard)
    )
    curve = np.where(power.heard, shown / np.maximum(known, _LEAST_KNOWN), -np.inf)
    count = curve.shape[1]
    windows = np.arange(len(curve))
    best = curve.argmax(axis=1)
    most = curve[windows, best]
    other, valley = np.full(len(curve), -1), np.zeros(len(curve), int)
    height = np.zeros(len(curve))
    for plane in range(count):
        low, at = _lowest_between(curve, best, plane)
        here = curve[:, plane]
        second = (np.abs(plane - best) >= _APART) & (here > height) & (low < _DEEPEST * here)
        second &= (here > _LEAST_PEAK) & (here > _LEAST_OF_OTHER * most)
        other[second], valley[second], height[second] = plane, at[second], here[second]
    two = other >= 0
    chosen = best
    if peak != "strongest":
        extreme = np.minimum if peak == "first" else np.maximum
        chosen = np.where(two, extreme(best, other), best)
    planes = np.arange(count)
    lower = (chosen < valley)[:, None]
    beyond = np.where(lower, planes > valley[:, None], planes < valley[:, None])
    return replace(power, heard=power.heard & ~(two[:, None] & beyond)), two


def _lowest_between(
    curve: Float64, best: NDArray[np.intp], plane: int
) -> tuple[Float64, NDArray[np.intp]]:
    """Return the least power between a plane and the best one of each window, and where it is."""
    planes = np.arange(curve.shape[1])
    low, high = np.minimum(best, plane)[:, None], np.maximum(best, plane)[:, None]
    inside = (planes >= low) & (planes <= high) & np.isfinite(curve)
    between = np.where(inside, curve, np.inf)
    at = between.argmin(axis=1)
    return between[np.arange(len(curve)), at], at
