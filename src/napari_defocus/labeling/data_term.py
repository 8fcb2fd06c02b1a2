"""What of the likelihood curves counts at each place: as far as there is texture, limited.

No window is exactly what the model says, so that the depth of its curve counts up to a limit.
Where the curves of a neighbourhood, averaged, are flat, there is no texture, and what each of
them prefers is chance: it does not count, and labels are extrapolated from around.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.compiled import compiled
from napari_defocus.core.threads import in_bands
from napari_defocus.likelihood.blur_spectra import LABEL_STEP
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.evidence import DEPTH, evidence_share
from napari_defocus.likelihood.prior import log_prior

Float32 = NDArray[np.float32]

EXTRAPOLATED = 0.5
"""If the evidence is below this share, a map has its value from around."""

EXTRA_OF_SHARP = np.float32(8)
"""What is added to the weight, 1, of a pixel that shows sharp details itself. Windows are wider
than thin things, so these would be outvoted (docs/decisions.md)."""

KAPPA = np.array([1e-20, 1e-12, 1e-7, 1e-3, 1e-1, 1, 1e-1, 1e-3, 1e-7, 1e-12, 1e-20])
"""The kernel that widens candidates into an artificial likelihood (Section III-B)."""

LIKELIHOOD_FLOOR = 1e-24
"""The artificial likelihood of scales that no candidate reaches, instead of 0."""


def data_term(candidates: BlurCandidates) -> Float32:
    """Return D of (14) but for a weight: the cost of each scale at each window, (R, C, L).

    In the mode "paper", -log of the artificial likelihood; in "curve", the limited depth.
    """
    if candidates.mode == "paper":
        return -np.log(artificial_likelihood(candidates)).astype(np.float32)
    return limited_depth(candidates)


def artificial_likelihood(candidates: BlurCandidates) -> NDArray[np.float64]:
    """Return p~ of Section III-B: the three candidates widened by kappa, sum 1, (R, C, L)."""
    present = np.isfinite(candidates.radii)
    known = np.where(present, candidates.log_likelihoods, 0).astype(np.float64)
    height = np.where(present, np.exp(known - known[..., :1]), 0)
    label = np.rint(np.where(present, candidates.radii, 0) / LABEL_STEP).astype(int)
    count, reach = len(candidates.scales), len(KAPPA) // 2
    likelihood = np.zeros((*label.shape[:2], count + 2 * reach))
    rows, columns = np.indices(label.shape[:2])
    for k in range(label.shape[2]):
        for tap, weight in enumerate(KAPPA):
            likelihood[rows, columns, label[..., k] + tap] += weight * height[..., k]
    likelihood = np.maximum(likelihood[..., reach:-reach], LIKELIHOOD_FLOOR)
    return likelihood / likelihood.sum(axis=2, keepdims=True)


def limited_depth(candidates: BlurCandidates) -> Float32:
    """Return how far each scale lies below the best, at most 15, as far as it counts: (R, C, L).

    The whole curve keeps what a broad or shallow maximum says, and has the prior of the radius. A
    window that stands for n places along the border is not n of them; its weight is 1 / sqrt(n).
    """
    weight = evidence_share(candidates) / np.sqrt(candidates.places_of_window())
    if candidates.weight is not None:
        weight *= candidates.weight
    return _limited(
        candidates.curve, log_prior(candidates.scales), weight.astype(np.float32), DEPTH
    )


def _limited(curve: Float32, prior: Float32, weight: Float32, depth: np.float32) -> Float32:
    limited = np.empty_like(curve)
    in_bands(_limit_rows, len(curve), curve, prior, weight, depth, limited)
    return limited


@compiled
def _limit_rows(
    start: int,
    stop: int,
    curve: Float32,
    prior: Float32,
    weight: Float32,
    depth: np.float32,
    limited: Float32,
) -> None:
    for row in range(start, stop):
        for column in range(curve.shape[1]):
            top = np.float32(-np.inf)
            for scale in range(curve.shape[2]):
                limited[row, column, scale] = curve[row, column, scale] + prior[scale]
                top = max(top, limited[row, column, scale])
            for scale in range(curve.shape[2]):
                below = min(top - limited[row, column, scale], depth)
                limited[row, column, scale] = weight[row, column] * below


def least_of_both(data: Float32, first: int) -> Float32:
    """Return the least costs beyond and among the first labels, at each window: (R, C, 2)."""
    least = np.full((*data.shape[:2], 2), np.inf, np.float32)
    in_bands(_least_of_rows, len(data), data, first, least)
    return least


@compiled
def _least_of_rows(start: int, stop: int, data: Float32, first: int, least: Float32) -> None:
    for row in range(start, stop):
        for column in range(data.shape[1]):
            for label in range(data.shape[2]):
                side = int(label < first)
                least[row, column, side] = min(least[row, column, side], data[row, column, label])
