"""What kernels and scales of PSF families may be, and errors that name what they are."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import check_number

_ROUNDING = 1e-9
"""How far below 0 values may lie, as a share of the largest: that is rounding of an FFT. By hand.
"""

_LARGEST_SCALE = 10_000
"""px; the kernel of a disc of that radius takes 3 GB."""


def checked_scale(scale: float) -> float:
    """Check the scale of a kernel, in px; scales below 0 are a point, as 0 is."""
    takes = f"a number of px up to {_LARGEST_SCALE}"
    check_number("scale", scale, lambda s: -math.inf < s <= _LARGEST_SCALE, takes)
    return max(float(scale), 0.0)


def check_largest(name: str, value: float) -> None:
    """Check the largest scale of a family, in px."""
    check_number(name, value, lambda v: 1 <= v < math.inf, "a number from 1 px up")


def checked_kernels(kernels: ArrayLike, ndim: int, found: str, takes: str) -> NDArray[np.float64]:
    """Return kernels normalised to sum 1; `found` and `takes` begin and end the errors."""
    array = real_array(kernels, found)
    square = array.ndim == ndim and array.shape[-1] == array.shape[-2]
    if not square or array.shape[-1] % 2 == 0 or array.size == 0:
        raise ValueError(
            f"{found} an array of shape {array.shape}; it takes {takes}, (K, K) with K odd"
        )
    # Kernels that went through an FFT have zeros of either sign.
    if not (np.isfinite(array).all() and array.min() >= -_ROUNDING * array.max()):
        raise ValueError(
            f"{found} values from {array.min()} to {array.max()}; it takes finite ones from 0 up"
        )
    array = np.maximum(array, 0)
    sums = array.sum(axis=(-2, -1), keepdims=True)
    if not (sums > 0).all():
        raise ValueError(f"{found} only zeros; it takes a positive sum")
    return array / sums


def real_array(values: ArrayLike, found: str) -> NDArray[np.float64]:
    """Return values as real numbers; `found` begins the error if they are none."""
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{found} no array: {error}") from None
    if array.dtype.kind not in "buif":
        raise TypeError(f"{found} {array.dtype} values; it takes real numbers")
    return array.astype(np.float64)
