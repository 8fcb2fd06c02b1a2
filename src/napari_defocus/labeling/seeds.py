"""What somebody knows about focus at some pixels, and the checks of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.image import given_array

NOT_KNOWN, IN_FOCUS, BLURRED = 0, 1, 2
"""What a pixel of seeds says."""


def checked_seeds(seeds: ArrayLike, shape: tuple[int, int]) -> NDArray[np.integer]:
    """Check seeds against the height and width of their picture.

    Raises
    ------
    TypeError
        If they are no integers.
    ValueError
        If they have another shape, or values beside 0, 1 and 2.
    """
    array = given_array("seeds", seeds)
    if array.dtype.kind not in "ui":
        raise TypeError(f"seeds has dtype {array.dtype}; it takes integers")
    if array.shape != tuple(shape):
        raise ValueError(
            f"seeds has shape {array.shape}; it takes the height and width of the picture, "
            f"{tuple(shape)}"
        )
    wrong = array[(array < NOT_KNOWN) | (array > BLURRED)]
    if wrong.size:
        raise ValueError(
            f"seeds has the value {wrong[0]}; it takes {NOT_KNOWN} (not known), {IN_FOCUS} "
            f"(in focus) and {BLURRED} (blurred)"
        )
    return array
