"""How far the curves of a neighbourhood are evidence at all.

No window is exactly what the model says, so that the depth of its curve counts up to a limit.
Where the curves of a neighbourhood, averaged, are flat, there is no texture, and what each of
them prefers is chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from napari_defocus.core.compiled import compiled
from napari_defocus.core.threads import in_bands
from napari_defocus.likelihood.candidates import BlurCandidates

Float32 = NDArray[np.float32]

DEPTH = np.float32(15)
"""The depth of a curve, in log-likelihood, beyond which nothing counts more. Chosen on ramps and
bumps.
"""

_NEIGHBORHOOD = 8.0
"""Standard deviation, in px, of the Gaussian that averages curves: they tell where texture is."""

_TRUNCATE = 4.0
"""Standard deviations at which that Gaussian ends."""

_ROWS = 64
"""Rows of windows that are averaged at once; for memory only."""

_EVERY = 4
"""Every 4th scale is looked at for that: every 0.4 px."""

_INFORMATIVE, _STEEPNESS = 4.0, 3.0
"""Noise alone gives averaged curves a depth of 0.05 to 0.9, rarely 3; texture 8 to 15."""


def limited_below_top(curve: Float32) -> Float32:
    """Return curves relative to their maxima, at least -15: (R, C, L)."""
    limited = np.empty(curve.shape, np.float32)
    in_bands(_limit_rows, len(curve), curve, DEPTH, limited)
    return limited


def limit_below_top(curve: Float32) -> Float32:
    """Do the same in place."""
    in_bands(_limit_rows, len(curve), curve, DEPTH, curve)
    return curve


@compiled
def _limit_rows(start: int, stop: int, curve: Float32, depth: np.float32, limited: Float32) -> None:
    for row in range(start, stop):
        for column in range(curve.shape[1]):
            top = curve[row, column, 0]
            for scale in range(1, curve.shape[2]):
                top = max(top, curve[row, column, scale])
            for scale in range(curve.shape[2]):
                limited[row, column, scale] = max(curve[row, column, scale] - top, -depth)


def evidence_share(candidates: BlurCandidates) -> Float32:
    """Return how far there is evidence around each window: 0 where there is no texture, to 1."""
    return informed_share(np.ptp(averaged_curve(candidates, every=_EVERY), axis=2))


def averaged_curve(candidates: BlurCandidates, every: int = 1) -> Float32:
    """Average log p(r), of limited depth, over the windows that see about the same: (R, C, n).

    Only at every so many scales, if `every` is above 1.
    """
    if every == 1:
        whole = AveragedCurves(candidates)
        averaged = np.empty(whole.shape, np.float32)
        for first in range(0, len(whole), _ROWS):
            averaged[first : first + _ROWS] = whole[first : first + _ROWS]
        return averaged
    some = np.ascontiguousarray(candidates.curve[..., ::every])
    sigma = _NEIGHBORHOOD / candidates.stride
    return gaussian_filter(limited_below_top(some), (sigma, sigma, 0), truncate=_TRUNCATE)


@dataclass(frozen=True, eq=False)
class AveragedCurves:
    """`averaged_curve` of a large picture, worked out for the rows that are asked for.

    Attributes
    ----------
    candidates : BlurCandidates
    """

    candidates: BlurCandidates

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the array: (R, C, L)."""
        return self.candidates.curve.shape

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice) -> Float32:
        """Return those of some rows, to the same bits."""
        first, last, _ = rows.indices(len(self))
        sigma = _NEIGHBORHOOD / self.candidates.stride
        reach = int(_TRUNCATE * sigma + 0.5)
        top = max(first - reach, 0)
        seen = limited_below_top(self.candidates.curve[top : min(last + reach, len(self))])
        seen = gaussian_filter1d(seen, sigma, axis=0, truncate=_TRUNCATE)[first - top : last - top]
        averaged: Float32 = gaussian_filter1d(seen, sigma, axis=1, truncate=_TRUNCATE)
        return averaged


def informed_share(depth: Float32) -> Float32:
    """Return how far an averaged curve of this depth is evidence at all."""
    return 1 - np.exp(-((depth / np.float32(_INFORMATIVE)) ** np.float32(_STEEPNESS)))
