"""How good a map of blur is against the truth, and how scores without a unit become px."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.stats import rankdata

THRESHOLD = 2.0
"""px, up to which a pixel counts as in focus."""

UNDECIDED = 0.25
"""px around the threshold that count neither as in focus nor as blurred."""

RIGHT = 0.5
"""px, up to which a radius is right; what the confidence is about."""

_BINS = 100
_FEWEST = 100


def area_under_roc(score: np.ndarray, positive: np.ndarray) -> float:
    """Return the share of pairs, one positive and one not, that are in order; ties are half.

    NaN where all or none are positive.
    """
    count = int(positive.sum())
    if count in (0, positive.size):
        return np.nan
    ranks = rankdata(score)[positive.ravel()]
    return float((ranks.sum() - count * (count + 1) / 2) / (count * (positive.size - count)))


def rank_correlation(score: np.ndarray, truth: np.ndarray) -> float:
    """Return Spearman's, NaN where one of them does not vary."""
    if np.ptp(truth) == 0 or np.ptp(score) == 0:
        return np.nan
    return float(np.corrcoef(rankdata(score), rankdata(truth))[0, 1])


def overlap(found: np.ndarray, true: np.ndarray) -> float:
    """Return the intersection over union; NaN where nothing is true."""
    return float((found & true).sum() / (found | true).sum()) if true.any() else np.nan


def decided(truth: np.ndarray) -> np.ndarray:
    """Return which pixels are clearly in focus or clearly blurred."""
    return np.abs(truth - THRESHOLD) >= UNDECIDED


def share_right(error: np.ndarray, stated: np.ndarray, low: float, high: float) -> float:
    """Return the share of right pixels among those of such a confidence; NaN for a few."""
    inside = (stated >= low) & (stated < high)
    return float(np.mean(error[inside] <= RIGHT)) if inside.sum() >= _FEWEST else np.nan


@dataclass(frozen=True)
class MonotoneMap:
    """From a score that grows with the blur to px: the monotone map of least absolute error.

    Attributes
    ----------
    score, radius : (n,) ndarray
        Both grow; between them it is interpolated.
    """

    score: np.ndarray
    radius: np.ndarray

    @classmethod
    def fitted(cls, score: np.ndarray, truth: np.ndarray) -> Self:
        """Fit by pooling adjacent violators, with medians, over a hundred quantiles."""
        order = np.argsort(score, kind="stable")
        parts = np.array_split(order, min(_BINS, len(order)))
        blocks: list[list[np.ndarray]] = []
        medians: list[float] = []
        for part in parts:
            blocks.append([part])
            medians.append(float(np.median(truth[part])))
            while len(medians) > 1 and medians[-2] > medians[-1]:
                last = blocks.pop()
                blocks[-1] += last
                medians.pop()
                medians[-1] = float(np.median(truth[np.concatenate(blocks[-1])]))
        radius = np.repeat(medians, [len(block) for block in blocks])
        return cls(np.array([np.mean(score[part]) for part in parts]), radius)

    def __call__(self, score: np.ndarray) -> np.ndarray:
        return np.interp(score, self.score, self.radius)
