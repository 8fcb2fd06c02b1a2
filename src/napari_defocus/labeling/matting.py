"""How much of each pixel is in focus: opacity at hair and fur, by closed-form matting.

A mask puts every pixel on one side. Near its border, what is in focus may be thinner than a pixel,
so that the pixel is a mixture of both. From what lies safely inside and outside, its opacity
follows from the colours (Levin, Lischinski, Weiss, IEEE Trans. PAMI 30(2), 2008). PyMatting solves
it, tile by tile along the border only.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from napari_defocus.core.extras import need_matting_extra
from napari_defocus.core.progress import Progress, silent
from napari_defocus.settings import UNKNOWN

Float32 = NDArray[np.float32]

_WIDTH_SHARE, _LEAST_WIDTH, _MOST_WIDTH = 0.025, 4, 40
"""Of the shorter side, how far from the border of a mask pixels may be mixed; and in px."""

_CORE, _HALO = 192, 48
"""px: what a tile is responsible for, and what it sees around. Two tiles differ by 0.01 at most
where they meet; chosen by hand."""

_UNKNOWN_REACH = 3
"""Widths: so near to what is in focus, what is not known may be mixed, too; farther it is not."""

_SHIFTS = (1e-4, 1e-3, 1e-2, 0.1, 0.5, 1.0, 10.0, 100.0)
"""Of the diagonal, tried by turns for the incomplete Cholesky factors of the preconditioner."""

_UNSURE = 0.5
"""In a trimap, what the matting is to find out."""

_STEP = "Finding the opacity"


def opacity(
    color: Float32,
    mask: NDArray[np.uint8],
    width: int | None = None,
    progress: Progress = silent,
) -> Float32:
    """Return the opacity of what is in focus, from 0 to 1: (H, W), see `matte_in_focus`.

    Parameters
    ----------
    color : (H, W, channels) float32 ndarray
        From 0 to 1.
    mask : (H, W) uint8 ndarray
        1 in focus, 0 blurred, 2 not known.
    width : int, optional
        How far from the border pixels may be mixed, in px.
    progress : callable, optional
    """
    need_matting_extra()
    width = usual_width(mask.shape) if width is None else width
    known = trimap(mask == 1, width)
    if (mask == UNKNOWN).any() and (mask == 1).any():
        near = distance_transform_edt(mask != 1) <= _UNKNOWN_REACH * width
        known[(mask == UNKNOWN) & near] = _UNSURE
    found, weight = np.zeros((2, *mask.shape), np.float32)
    tiles = _tiles(known)
    for number, (seen, share) in enumerate(tiles):
        progress(_STEP, number / len(tiles))
        found[seen] += share * _solved(color[seen], known[seen], mask[seen])
        weight[seen] += share
    mixed = (known == _UNSURE) & (weight > 0)
    alpha = known.copy()
    alpha[mixed] = (found[mixed] / weight[mixed]).clip(0, 1)
    progress(_STEP, 1.0)
    return alpha


def usual_width(shape: tuple[int, ...]) -> int:
    """Return how far from the border of a mask pixels may be mixed, in px."""
    return int(np.clip(round(_WIDTH_SHARE * min(shape)), _LEAST_WIDTH, _MOST_WIDTH))


def trimap(in_focus: NDArray[np.bool_], width: int) -> Float32:
    """Return 1 inside of a mask, 0 outside and 0.5 up to so many px from its border."""
    known = in_focus.astype(np.float32)
    if in_focus.all() or not in_focus.any():
        return known
    known[distance_transform_edt(in_focus) + distance_transform_edt(~in_focus) <= width] = _UNSURE
    return known


def _tiles(known: Float32) -> list[tuple[tuple[slice, slice], Float32]]:
    """Return where tiles with something to find out lie, and how much each counts at its pixels."""
    tiles = []
    for top in range(0, known.shape[0], _CORE):
        for left in range(0, known.shape[1], _CORE):
            core = slice(top, top + _CORE), slice(left, left + _CORE)
            if (known[core] != _UNSURE).all():
                continue
            spans = [
                (max(at - _HALO, 0), min(at + _CORE + _HALO, length))
                for at, length in zip((top, left), known.shape, strict=True)
            ]
            ramps = [
                _ramp(*span, at, length)
                for span, at, length in zip(spans, (top, left), known.shape, strict=True)
            ]
            seen = slice(*spans[0]), slice(*spans[1])
            tiles.append((seen, np.outer(*ramps).astype(np.float32)))
    return tiles


def _ramp(low: int, high: int, start: int, length: int) -> NDArray[np.float64]:
    """Return the share of a tile along an axis: 1 in its core, falling to 0 over its halo."""
    at = np.arange(low, high) + 0.5
    rising = (at - low) / (2 * _HALO) if low else np.ones_like(at)
    falling = (high - at) / (2 * _HALO) if start + _CORE < length else np.ones_like(at)
    return np.clip(np.minimum(rising, falling), 1e-3, 1)


def _solved(color: Float32, known: Float32, mask: NDArray[np.uint8]) -> NDArray[np.floating]:
    """Return the opacity in a tile; the mask itself where it shows one side only."""
    if not ((known == 1).any() and (known == 0).any()):
        return (mask == 1).astype(np.float32)
    with _compiled_when_called():
        from pymatting import estimate_alpha_cf, ichol

    channels = np.repeat(color, 3, axis=2) if color.shape[2] == 1 else color
    alpha: NDArray[np.floating] = estimate_alpha_cf(
        channels.astype(np.float64),
        known.astype(np.float64),
        # Without a shift it often fails at first, and prints that.
        preconditioner=lambda matrix: ichol(matrix, shifts=_SHIFTS),
    )
    return alpha


@contextmanager
def _compiled_when_called() -> Iterator[None]:
    """Let numba compile what is imported here when it is called, and no more than that.

    PyMatting says the types of each of its kernels, at which numba compiles all of them at the
    first import: 50 s, of which the four that are used here take 5. Opacities are the same.
    """
    at_once = numba.njit

    def when_called(*signature_or_kernel: Any, **options: Any) -> Any:
        return at_once(*filter(callable, signature_or_kernel), **options)

    numba.njit = when_called
    try:
        yield
    finally:
        numba.njit = at_once
