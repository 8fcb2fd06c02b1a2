"""Which blur the upper end of a map's colours stands for."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

LEAST_COLOR_LIMIT = 8.0
"""px: maps of little blur have one range of colours, so that they can be compared."""

_OUTLIERS = 1e-3
"""Share of the pixels that may be beyond the range. Chosen by hand."""


def color_limit(blur_map: Any) -> float:
    """Return the upper end, in px, of the colours of a map: 8 px, or more if the map has more.

    Beyond 8 px it is a round number above all but 0.1 % of the known values: whole px up to 20,
    then steps of 5 px. If an array is not in memory, a sample of it decides.

    Examples
    --------
    >>> color_limit(np.full((4, 4), 2.0)), color_limit(np.full((4, 4), 11.3))
    (8.0, 12.0)
    """
    step = max(1, max(blur_map.shape[-2:]) // 1024)
    values = np.asarray(blur_map[..., ::step, ::step])
    known = values[np.isfinite(values)]
    largest = float(np.quantile(known, 1 - _OUTLIERS)) if known.size else 0.0
    if largest <= LEAST_COLOR_LIMIT:
        return LEAST_COLOR_LIMIT
    step_px = 1.0 if largest <= 20 else 5.0
    return step_px * math.ceil(largest / step_px)
