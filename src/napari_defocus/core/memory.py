"""Memory that is free goes back to the system between the steps of a large picture."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from functools import lru_cache

_LARGE = 1_000_000
"""px: below, there is little to give back."""


def give_back(shape: tuple[int, int]) -> None:
    """Give back what arrays of a picture of a height and width have left, if it is large.

    glibc keeps the room of arrays below 32 MB: 0.35 GB after the candidates of 10 megapixels. Other
    systems do it by themselves.
    """
    trim = _trim()
    if trim is not None and shape[0] * shape[1] >= _LARGE:
        trim(0)


@lru_cache
def _trim() -> Callable[[int], int] | None:
    """Return the function of glibc; None where there is none."""
    if not sys.platform.startswith("linux"):
        return None
    return getattr(ctypes.CDLL(None), "malloc_trim", None)
