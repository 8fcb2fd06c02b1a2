"""One picture from many planes, whose details are blended by the weights of the planes.

The sizes of detail are the levels of a Laplacian pyramid. The weights of a level are smooth, so
that no seam shows between planes. Planes are read one at a time, and each adds to the sums of all
levels. `plane_weights` says how much a plane counts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled
from napari_defocus.core.image import nearest_known
from napari_defocus.core.known_pixels import known_pixels
from napari_defocus.core.progress import Progress
from napari_defocus.core.threads import in_bands
from napari_defocus.stacks.matched_planes import cast_to
from napari_defocus.stacks.plane_weights import Shares
from napari_defocus.stacks.pyramids import assembled, pyramid

Float32 = NDArray[np.float32]
Floating = NDArray[np.floating]
Mask = NDArray[np.bool_]

_LEAST_WEIGHT = np.float32(1e-6)
"""Weight of a plane without any share: it counts only where no better one is known."""

_LEAST_ROWS = 32
"""Fewer rows are not worth a thread of their own. Results do not depend on it."""


def blended(
    read: Callable[[int], NDArray[Any]], position: Float32, shares: Shares, progress: Progress
) -> NDArray[Any]:
    """Put planes together by their shares: (H, W) or (H, W, C), of their dtype.

    Parameters
    ----------
    read : callable
        Returns a plane, given its number: (H, W) or (H, W, C), masked or NaN where not known.
    position : (H, W) float32 ndarray
        Of best focus, in planes from the first.
    shares : Shares
    progress : callable
    """
    step = "Putting the planes together"
    levels = shares.at(position)
    sums: list[Floating] = []
    totals = [np.zeros(weights.position.shape, np.float32) for weights in levels]
    seen = np.zeros(position.shape, bool)
    for number in range(shares.planes):
        progress(step, number / shares.planes)
        plane = read(number)
        known = known_pixels(plane)
        seen |= True if known is None else known
        details = pyramid(_filled(plane, known), len(levels))
        sums = sums or [np.zeros_like(each) for each in details]
        for level, weights in enumerate(levels):
            weight = weights.of_plane(number)
            counts = np.ones((1, 1), bool) if known is None else known[:: 2**level, :: 2**level]
            in_bands(
                _add, len(weight), weight, counts, details[level], sums[level], totals[level],
                least=_LEAST_ROWS,
            )  # fmt: skip
        dtype, shape = plane.dtype, plane.shape
    for each, total in zip(sums, totals, strict=True):
        each /= np.maximum(total, np.finfo(np.float32).tiny)[..., None]
    picture = assembled(sums).reshape(shape)
    progress(step, 1.0)
    composite = cast_to(picture, dtype)
    if not seen.all():
        composite[~seen] = np.nan if dtype.kind == "f" else 0
    return composite


@compiled
def _add(
    start: int,
    stop: int,
    weight: Float32,
    counts: Mask,
    details: Floating,
    sums: Floating,
    totals: Float32,
) -> None:
    """Add details times weights to sums; binomials smooth weights, about a Gaussian of 0.7 px."""
    height, width = weight.shape
    line = np.empty(width + 2, np.float32)
    two, sixteenth = np.float32(2), np.float32(1 / 16)
    for y in range(start, stop):
        up, here, down = weight[max(y - 1, 0)], weight[y], weight[min(y + 1, height - 1)]
        for x in range(width):
            line[x + 1] = up[x] + two * here[x] + down[x]
        line[0], line[width + 1] = line[1], line[width]
        for x in range(width):
            if counts.size > 1 and not counts[y, x]:
                continue
            smooth = sixteenth * (line[x] + two * line[x + 1] + line[x + 2]) + _LEAST_WEIGHT
            totals[y, x] += smooth
            for c in range(details.shape[2]):
                sums[y, x, c] += smooth * details[y, x, c]


def _filled(plane: NDArray[Any], known: NDArray[np.bool_] | None) -> Floating:
    """Return a plane as (H, W, C) of floats; unknown pixels have the nearest one's colour."""
    single = plane.dtype.itemsize <= 2 or plane.dtype == np.float32
    dtype = np.float32 if single else np.float64
    values: Floating = np.ma.getdata(plane).astype(dtype, order="C", copy=False)
    values = values.reshape(*values.shape[:2], -1)
    return values if known is None else nearest_known(values, known)
