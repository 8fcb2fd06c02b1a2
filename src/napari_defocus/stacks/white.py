"""The value at which the camera of a stack clipped light.

It is the largest number of the type, or less: a camera of 12 bits writes 4095 into 16. Then it is
the largest value of all planes, if many more pixels have it than lie just below it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from napari_defocus.core.known_pixels import known_pixels

_JUST_BELOW, _TIMES = 0.02, 2.0
"""Share of a plane's range below its largest value, and how many times as many pixels must have
that value. A blurred bright spot that is not clipped has fewer pixels, the brighter they are. By
hand.
"""

_SIDE = 3
"""px: side of a square of such pixels that there must be: a single one may be a hot pixel."""


class White:
    """Finds it, plane by plane.

    Examples
    --------
    >>> white = White(np.dtype(np.uint16))
    >>> white.see(np.minimum(np.arange(10_000).reshape(100, 100), 4095).astype(np.uint16))
    >>> white.level
    4095.0
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._most = float(np.iinfo(dtype).max) if dtype.kind in "ui" else np.inf
        self._largest, self._is_clipped = -np.inf, False

    @property
    def level(self) -> float:
        """What is known so far; infinity if nothing was clipped."""
        return self._largest if self._is_clipped or self._largest >= self._most else np.inf

    def see(self, plane: NDArray[Any]) -> None:
        """Look at a plane, (H, W) or (H, W, C), as the camera gave it."""
        values = np.ma.getdata(plane)
        colors = values[..., None] if values.ndim == 2 else values[..., :3]
        known = known_pixels(plane)
        seen = colors if known is None else colors[known]
        if not seen.size or float(seen.max()) < self._largest:
            return
        top = seen.max()
        if float(top) > self._largest:
            self._largest, self._is_clipped = float(top), False
        self._is_clipped |= _is_clipped(colors == top, seen, float(top))


def _is_clipped(at_top: NDArray[np.bool_], seen: NDArray[Any], top: float) -> bool:
    near = top - _JUST_BELOW * (top - float(seen.min()))
    clipped = int(at_top.sum())
    if near >= top or clipped < _TIMES * (int((seen >= near).sum()) - clipped):
        return False
    square = np.ones((_SIDE, _SIDE), bool)
    return any(binary_erosion(at_top[..., c], square).any() for c in range(at_top.shape[2]))
