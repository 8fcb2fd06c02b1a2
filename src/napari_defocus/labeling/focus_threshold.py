"""Up to which blur a picture counts as in focus: found from how its blur is distributed.

What is sharp in a picture depends on its lens, its size and its sharpening, so that no number of px
fits all of them. Two things tell it. The sharpest 15 % of the places that are sure lie in focus,
and what is blurred by 1.2 px more still does. And few places have the blur between what is in
focus and what is not: there is a valley in the distribution. So tau of (18) is where

    d(u) + 2 (u - u0)^2,    u = log(tau + 1 px)

is least: d is the density of u over the sure places, and u0 is that of 1.2 px above the sharpest
15 %. It lies within 1 and 3.5 px, so that what is blurred everywhere is never called in focus; and
above the sharpest places, if these are hardly blurred.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.checks import Mode, check_threshold
from napari_defocus.core.progress import Progress, silent
from napari_defocus.labeling.confidence import window_confidence
from napari_defocus.labeling.multigrid import pieces
from napari_defocus.labeling.problem import LabelingProblem
from napari_defocus.likelihood.blur_spectra import LABEL_STEP
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.evidence import averaged_curve
from napari_defocus.likelihood.prior import log_prior
from napari_defocus.psf import AUTO
from napari_defocus.settings import CONFIDENT, USUAL_THRESHOLD, MaskSettings

Float64 = NDArray[np.floating]
Counts = NDArray[np.int64]

_SHARPEST, _ABOVE, _PULL, _WIDTH = 0.15, 1.2, 2.0, 0.15
"""The share of the places that is in focus for sure, what may be added to its blur in px, the
factor of the square above, and the standard deviation of the Gaussian that makes d smooth. Chosen
on photographs and on scenes of all kinds; a half more or less is nearly as good (decisions.md)."""

_LEAST, _MOST, _MOST_USUAL = 1.0, 3.5, 3.0
"""px: the range of tau, and the largest tau of u0. Up to 1 px, radii are hardly told apart."""

_BELOW = ((0.05, 2.5, 0.2), (0.1, 2.0, 0.4))
"""Shares of the places that lie below tau, if their blur is at most so many px; by so many px."""

_PLUS = 1.0
"""px: what is added to radii before their logarithm is taken."""

_FEWEST = 20
"""Of sure places: fewer tell nothing."""

_EVERY = 8
"""px: places are so far apart, or as the windows are; windows see far more."""

_MOST_SKIPPED = 4
"""Windows: those of tiles begin at multiples of it, so that tiles have the places of the whole."""


def focus_threshold_of(
    problem: LabelingProblem,
    within: NDArray[np.bool_] | None = None,
    progress: Progress = silent,
) -> float:
    """Return up to which blur, in px, a picture counts as in focus, see above.

    Parameters
    ----------
    problem : LabelingProblem
    within : (H, W) bool ndarray, optional
        Where the picture counts.
    progress : callable, optional
    """
    progress("Finding what is in focus", 0.0)
    own = problem.own
    return threshold_of_counts(blur_counts(problem, within), own.scales, own.mode)


def blur_counts(
    problem: LabelingProblem,
    within: NDArray[np.bool_] | None = None,
    own: tuple[slice, slice] | None = None,
) -> Counts:
    """Return how many places are surely blurred by each scale of the curves: (L,).

    Of a tile, `own` says which rows and columns of windows count: all tiles add up to the whole.
    """
    scale, sure, step = _sure_places(problem.own)
    if within is not None:
        sure &= _at_windows(problem.own, within)[::step, ::step]
    if own is not None:
        places = tuple(slice(-(-at.start // step), -(-at.stop // step)) for at in own)
        scale, sure = scale[places], sure[places]
    return np.bincount(scale[sure], minlength=len(problem.own.scales)).astype(np.int64)


def _sure_places(own: BlurCandidates) -> tuple[NDArray[np.int64], NDArray[np.bool_], int]:
    """Return the likeliest scale of some windows, whether it is sure, and every which they are."""
    step = min(max(1, _EVERY // own.stride), _MOST_SKIPPED)
    scale, confidence = likeliest_scales(_every(own, step))
    return scale, confidence >= CONFIDENT, step


def likeliest_scales(own: BlurCandidates) -> tuple[NDArray[np.int64], Float64]:
    """Return which scale is the likeliest around each window, and the confidence in it: (R, C)."""
    curve = averaged_curve(own)
    prior = log_prior(own.scales)
    scale = np.concatenate([(curve[rows] + prior).argmax(axis=2) for rows in pieces(len(curve))])
    radius = own.scales[scale].astype(np.float32)
    return scale, window_confidence(own, curve, radius, np.zeros_like(radius))


def _every(own: BlurCandidates, step: int) -> BlurCandidates:
    """Return the candidates of every so many windows."""

    def some(values: NDArray[np.float32] | None) -> NDArray[np.float32] | None:
        return None if values is None else np.ascontiguousarray(values[::step, ::step])

    return replace(
        own,
        curve=np.ascontiguousarray(own.curve[::step, ::step]),
        stride=own.stride * step,
        row_centers=own.row_centers[::step],
        column_centers=own.column_centers[::step],
        strength=some(own.strength),
        direction=some(own.direction),
    )


def _at_windows(own: BlurCandidates, pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    rows, columns = (
        np.rint(centers).astype(int) for centers in (own.row_centers, own.column_centers)
    )
    return pixels[np.ix_(rows, columns)]


def settled(
    problem: LabelingProblem, settings: MaskSettings, within: NDArray[np.bool_] | None = None
) -> MaskSettings:
    """Return the settings with the threshold that the picture says, if it was to say it."""
    if settings.threshold != AUTO:
        check_threshold(threshold_in_px(settings), float(problem.own.scales[-1]))
        return settings
    return replace(settings, threshold=focus_threshold_of(problem, within))


def threshold_in_px(settings: MaskSettings) -> float:
    """Return the threshold of settings that say it, see `settled`."""
    if isinstance(settings.threshold, str):
        raise ValueError(f"threshold is {settings.threshold!r}; it takes a number of px here")
    return settings.threshold


def threshold_of_counts(counts: Counts, scales: Float64, mode: Mode = "curve") -> float:
    """Return tau in px, of the `blur_counts` of a picture or of several.

    It is 2 px, as in the paper, if they tell nothing, and in the paper's mode.
    """
    largest = float(scales[-1])
    if mode == "paper" or counts.sum() < _FEWEST or largest <= _LEAST + LABEL_STEP:
        return min(USUAL_THRESHOLD, largest / 2)
    tau = _possible_thresholds(counts, scales)
    # A threshold keeps its own label, so that it lies half a step above.
    u = np.log(tau + LABEL_STEP / 2 + _PLUS)
    usual = _quantile(counts, scales, _SHARPEST) + _ABOVE
    usual = np.log(np.clip(usual, _LEAST, _MOST_USUAL) + _PLUS)
    apart = (u[:, None] - np.log(scales + _PLUS)) / _WIDTH
    share = counts / (counts.sum() * _WIDTH * np.sqrt(2 * np.pi))
    density = np.sum(np.exp(-(apart**2) / 2) * share, axis=1)
    return round(float(tau[np.argmin(density + _PULL * (u - usual) ** 2)]), 1)


def _possible_thresholds(counts: Counts, scales: Float64) -> Float64:
    largest = min(_MOST, float(scales[-1]) - LABEL_STEP)
    least = _LEAST
    for share, most, more in _BELOW:
        sharp = _quantile(counts, scales, share)
        if sharp <= most:
            least = max(least, min(sharp + more, largest))
    return np.arange(round(least, 1), largest + LABEL_STEP / 2, LABEL_STEP)


def _quantile(counts: Counts, scales: Float64, share: float) -> float:
    cumulated = np.cumsum(counts)
    return float(scales[np.searchsorted(cumulated, share * cumulated[-1])])
