"""What is likely of a blur radius before anything is seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

PRIOR_RATE = 0.25
"""1 / px. Chosen between 0 and 0.5 on photographs with measured radii, plain shapes and simulations
(docs/decisions.md).
"""

_PRIOR_END = 8.0
"""px: beyond it the prior falls with the logarithm of the radius, as steeply as it did there."""


def log_prior(scales: Float64) -> Float32:
    """Return the logarithm of the prior of radii in px, exp(-0.25 r) up to 8 px: (L,).

    Plain things with sharp edges and nothing inside put their power into few frequencies, and fit
    a wide blur nearly as well as their own: half of their windows have the maximum at the largest
    radius, the true one a few units below. Texture decides by more than the prior says.
    """
    below = np.minimum(scales, _PRIOR_END)
    octaves = np.log(np.maximum(scales, _PRIOR_END) / _PRIOR_END)
    return (-PRIOR_RATE * (below + _PRIOR_END * octaves)).astype(np.float32)
