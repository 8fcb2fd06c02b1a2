"""How sure a blur map is: the probability that it is right to half a pixel, or to a tenth."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter, minimum_filter

from napari_defocus.core.compiled import compiled
from napari_defocus.core.image import given_array
from napari_defocus.core.progress import Progress, silent
from napari_defocus.core.threads import in_bands
from napari_defocus.labeling.multigrid import pieces
from napari_defocus.labeling.problem import LabelingProblem
from napari_defocus.likelihood.blur_spectra import LABEL_STEP
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.evidence import AveragedCurves, averaged_curve, informed_share
from napari_defocus.likelihood.own_side import AT_ONCE
from napari_defocus.likelihood.prior import log_prior
from napari_defocus.settings import RestorationSettings

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

TOLERANCE, RELATIVE_TOLERANCE = 0.5, 0.1
"""What counts as right: within 0.5 px, and beyond 5 px within a tenth of the radius."""

_JUMP_SIDE = 31
"""px, side of the square around a pixel in which jumps of the map lower its confidence."""

_ROUNDING = 1e-4
"""px: differences of scales up to this are rounding."""

_TEMPER = 0.7
"""Power of the likelihood that the confidence takes: by benchmarks/confidence.py."""

_WEIGHTS = (0.288, -0.234, 1.491, 0.115, -0.109, -0.072, 0.148, -0.801, -3.599)
"""Weights of `features_of`, in their order, and the constant. Fitted by benchmarks/confidence.py,
which also says what each one gains.
"""

_CONTRADICTED, _PER_UNIT = -4.0, 0.8
"""Below these log odds of the share, the likelihood contradicts the map, and each unit below lowers
the logit by so much. By hand, for maps that others made; in our own, 0.4 % of the windows do so.
"""

_LEAST_ODDS, _LEAST_JUMP, _LEAST_AWAY = 5e-4, 0.05, 0.1
"""Smaller shares of the likelihood, jumps in px, and distances (in tolerances) between the map and
the likeliest radius count as these. Chosen by hand.
"""

_HARDLY, _CLEARLY = 1.6, 2.5
"""px: smaller blur can hardly be told from a camera's own; larger blur than the second clearly can.
"""

_LEAST_NOISE = 1e-7
"""A smaller noise variance, for a contrast of 1, counts as this. Chosen by hand."""

_USUAL_STRENGTH = 10.0
"""The strength of texture, for windows whose strength is not known."""

_MOST_STRENGTH = 12.0
"""A larger logarithm of power relative to noise counts as this. Chosen by hand."""

_AROUND = 24.0
"""px: standard deviation of the Gaussian over which directions are averaged."""

_REACH = 3.0
"""Standard deviations at which that Gaussian ends, because tiles see no farther."""

_ISOTROPIC = 1.0
"""A smaller preferred direction d (`likelihood/signs.py`) is usual, and does not count. By hand."""

_CAUTION_SIGMA = 8.0
"""px: standard deviation of the Gaussian that smooths the reduction of a map."""


def map_confidence(candidates: BlurCandidates, blur_map: ArrayLike) -> Float32:
    """Return the probability that each value of a map is right to 0.5 px, see `confidence_map`."""
    radius = checked_map(blur_map, candidates.image_shape)
    places = _at_windows(candidates, radius)
    probability = window_confidence(candidates, _averaged(candidates), *places)
    return np.clip(at_pixels(probability, candidates), 0, 1)


def confidence_and_caution(
    candidates: BlurCandidates,
    blur_map: ArrayLike,
    *,
    risk: float = RestorationSettings.risk,
) -> tuple[Float32, Float32]:
    """Return `confidence_map` and `cautious_blur_map` for the time of one: see there."""
    radius = checked_map(blur_map, candidates.image_shape)
    at_windows, jump = _at_windows(candidates, radius)
    curve = _averaged(candidates)
    sure = window_confidence(candidates, curve, at_windows, jump)
    excess = np.maximum(at_windows - _safe_at_windows(candidates, curve, at_windows, sure, risk), 0)
    excess = gaussian_filter(excess, _CAUTION_SIGMA / candidates.stride)
    return (
        np.clip(at_pixels(sure, candidates), 0, 1),
        np.maximum(radius - at_pixels(excess, candidates), 0),
    )


def confidence_of_problem(
    problem: LabelingProblem, *, blur_map: Float32, progress: Progress = silent
) -> tuple[Float32, Float32]:
    """Return `confidence_and_caution` of the map of a labeling problem."""
    progress("Measuring the confidence", 0.0)
    return confidence_and_caution(problem.candidates, blur_map)


def _averaged(candidates: BlurCandidates) -> Float32 | AveragedCurves:
    """Return `averaged_curve`; of a large picture, worked out where it is asked for."""
    rows, columns = candidates.curve.shape[:2]
    is_large = rows * columns > AT_ONCE
    return AveragedCurves(candidates) if is_large else averaged_curve(candidates)


def _safe_at_windows(
    candidates: BlurCandidates,
    curve: Float32 | AveragedCurves,
    radius: Float64,
    sure: Float64,
    risk: float,
) -> Float64:
    """Return the smallest radius that the true one is below with a probability of at most risk."""
    some = (
        _safe_in_rows(candidates, curve[rows], radius[rows], sure[rows], risk)
        for rows in pieces(len(curve))
    )
    return np.concatenate([*some])


def _safe_in_rows(
    candidates: BlurCandidates, curve: Float32, radius: Float64, sure: Float64, risk: float
) -> Float64:
    curve = curve + log_prior(candidates.scales)
    likelihood = np.exp(_TEMPER * (curve - curve.max(axis=2, keepdims=True)))
    likelihood *= _spacing(candidates)
    away = candidates.scales - radius[..., None]
    likelihood *= np.abs(away) > tolerance(radius)[..., None] + _ROUNDING
    likelihood *= ((1 - sure) / np.maximum(likelihood.sum(axis=2), _LEAST_ODDS))[..., None]
    below = np.cumsum(np.where(away < 0, likelihood, 0), axis=2)
    reached = below >= risk
    return np.where(reached.any(axis=2), candidates.scales[reached.argmax(axis=2)], radius)


def window_confidence(
    candidates: BlurCandidates,
    curve: Float32 | AveragedCurves,
    radius: Float64,
    jump: Float64,
) -> Float64:
    """Return the confidence at the windows, (R, C), for the map's values and jumps there.

    A logistic function of `features_of`, where there is texture; where there is none, the share
    of the scales that would do.
    """
    features, prior, depth = features_of(candidates, curve, radius, jump)
    logit = np.full(depth.shape, _WEIGHTS[-1])
    for weight, feature in zip(_WEIGHTS[:-1], features, strict=True):
        logit += weight * feature
    logit -= _PER_UNIT * np.maximum(_CONTRADICTED - features[0], 0)
    informed = informed_share(depth)
    return informed / (1 + np.exp(-logit)) + (1 - informed) * prior


def features_of(
    candidates: BlurCandidates,
    curve: Float32 | AveragedCurves,
    radius: Float64,
    jump: Float64,
) -> tuple[Float64, Float64, Float64]:
    """Return what the confidence rests on; nothing in it knows the answer.

    Parameters
    ----------
    candidates : BlurCandidates
    curve : (R, C, L) float32 ndarray
        `averaged_curve` of them.
    radius, jump : (R, C) ndarray
        The map's value at the windows, and its largest difference within 31 px.

    Returns
    -------
    features : (8, R, C) ndarray
        Log odds of the share of the averaged likelihood within the `tolerance` of the radius; log
        of the jump; how far the radius is told from a camera's own softness, from 0 to 1; depth of
        the averaged curve; log10 of the noise variance for a contrast of 1; log of how many
        tolerances away the averaged curve's best lies; log of the power relative to the noise's,
        at most 12; by how much the windows within 24 px prefer one direction more than usual.
    prior : (R, C) ndarray
        Share of the scales within the tolerance.
    depth : (R, C) ndarray
        Of the averaged curve, from its top to its bottom, at most 15.
    """
    depth, best, share, prior = _compared(candidates, curve, radius)
    told = np.log(np.clip(radius, _HARDLY, _CLEARLY) / _HARDLY) / np.log(_CLEARLY / _HARDLY)
    features = (
        np.log((share + _LEAST_ODDS) / (1 - share + _LEAST_ODDS)),
        np.log(jump + _LEAST_JUMP),
        told,
        depth,
        np.full(depth.shape, _log_noise(candidates)),
        np.log(np.abs(best - radius) / tolerance(radius) + _LEAST_AWAY),
        _strength(candidates),
        _preference(candidates),
    )
    return np.stack(features), prior, depth


def _compared(
    candidates: BlurCandidates, curve: Float32 | AveragedCurves, radius: Float64
) -> Float32:
    """Hold averaged curves against a map: (4, R, C).

    Returns
    -------
    (4, R, C) float32 ndarray
        The depth of the curve; its likeliest scale; the share of the likelihood within the
        `tolerance` of the radius, and the share of the scales.
    """
    scales, spacing = candidates.scales.astype(np.float32), _spacing(candidates)
    near = radius.astype(np.float32), (tolerance(radius) + _ROUNDING).astype(np.float32)
    found = np.empty((4, *curve.shape[:2]), np.float32)
    given = log_prior(candidates.scales), scales, spacing
    for rows in pieces(len(curve)):
        some = np.empty_like(found[:, rows])
        around = (np.ascontiguousarray(values[rows]) for values in near)
        in_bands(_compare_rows, some.shape[1], curve[rows], *given, *around, some)
        found[:, rows] = some
    return found


@compiled
def _compare_rows(
    start: int,
    stop: int,
    curve: Float32,
    prior: Float32,
    scales: Float32,
    spacing: Float32,
    radius: Float32,
    allowed: Float32,
    found: Float32,
) -> None:
    every = np.float32(0)
    for label in range(len(spacing)):
        every += spacing[label]
    for row in range(start, stop):
        for column in range(curve.shape[1]):
            low = high = curve[row, column, 0]
            best, top = 0, curve[row, column, 0] + prior[0]
            for label in range(1, len(scales)):
                value = curve[row, column, label]
                low, high = min(low, value), max(high, value)
                if value + prior[label] > top:
                    best, top = label, value + prior[label]
            inside, total, agreed = 0.0, 0.0, 0.0
            for label in range(len(scales)):
                below = curve[row, column, label] + prior[label] - top
                likelihood = spacing[label] * np.exp(np.float32(_TEMPER) * below)
                total += likelihood
                if abs(scales[label] - radius[row, column]) <= allowed[row, column]:
                    inside += likelihood
                    agreed += spacing[label]
            found[0, row, column] = high - low
            found[1, row, column] = scales[best]
            found[2, row, column] = inside / total
            found[3, row, column] = agreed / every


def _log_noise(candidates: BlurCandidates) -> float:
    """Return log10 of the noise variance for a contrast of 1."""
    contrast = 1.0 if candidates.intensities is None else candidates.intensities.contrast
    return math.log10(candidates.noise_variance / contrast**2 + _LEAST_NOISE)


def _strength(candidates: BlurCandidates) -> Float64:
    """Return the logarithm of the power relative to the noise's, at most 12: (R, C)."""
    if candidates.strength is None:
        return np.full(candidates.curve.shape[:2], _USUAL_STRENGTH)
    return np.minimum(candidates.strength, _MOST_STRENGTH)


def _preference(candidates: BlurCandidates) -> Float64:
    """Return by how much windows prefer one direction more than usual, over 24 px: (R, C)."""
    if candidates.direction is None:
        return np.zeros(candidates.curve.shape[:2])
    sigma = _AROUND / candidates.stride
    mean = gaussian_filter(candidates.direction, (sigma, sigma, 0), truncate=_REACH)
    return np.maximum(np.hypot(mean[..., 0], mean[..., 1]) - _ISOTROPIC, 0)


def tolerance(radius: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return how far, in px, a radius may be off and counts as right."""
    return np.maximum(TOLERANCE, RELATIVE_TOLERANCE * radius)


def _spacing(candidates: BlurCandidates) -> Float32:
    """Return how many labels' worth of scales each label stands for: (L,)."""
    return (np.gradient(candidates.scales) / LABEL_STEP).astype(np.float32)


def checked_map(blur_map: ArrayLike, shape: tuple[int, int]) -> Float64:
    """Check a blur map against the height and width of its picture, and return it as float32."""
    radius = given_array("blur_map", blur_map)
    if radius.dtype.kind not in "uif":
        raise TypeError(f"blur_map has dtype {radius.dtype}; it takes real numbers")
    if radius.shape != shape:
        raise ValueError(f"blur_map has shape {radius.shape}; it takes the picture's, {shape}")
    if not np.isfinite(radius).all():
        raise ValueError("blur_map has NaN or infinite values; it takes finite ones")
    return radius.astype(np.float32)


def _at_windows(candidates: BlurCandidates, radius: Float64) -> tuple[Float64, Float64]:
    """Return a map's value, and its largest difference nearby, at the windows: (R, C) each."""
    jump = maximum_filter(radius, _JUMP_SIDE) - minimum_filter(radius, _JUMP_SIDE)
    rows, columns = (
        np.rint(centers).astype(int)
        for centers in (candidates.row_centers, candidates.column_centers)
    )
    windows = np.ix_(rows, columns)
    return radius[windows], jump[windows]


def at_pixels(values: Float64, candidates: BlurCandidates) -> Float32:
    """Interpolate from the windows' centres to all pixels."""
    height, width = candidates.image_shape
    rows = (np.arange(height) - candidates.row_centers[0]) / candidates.stride
    columns = (np.arange(width) - candidates.column_centers[0]) / candidates.stride
    known, found = values.astype(np.float32), np.empty((height, width), np.float32)
    for some in pieces(height):
        places = np.meshgrid(rows[some], columns, indexing="ij")
        map_coordinates(known, places, found[some], order=1, mode="nearest")
    return found
