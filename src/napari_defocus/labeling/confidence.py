"""How sure a blur map is: the probability that it is right to half a pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter, minimum_filter

from napari_defocus.core.image import given_array
from napari_defocus.core.progress import Progress, silent
from napari_defocus.labeling.problem import LabelingProblem
from napari_defocus.likelihood.blur_spectra import LABEL_STEP
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.evidence import averaged_curve, informed_share
from napari_defocus.likelihood.prior import log_prior
from napari_defocus.settings import RestorationSettings

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

TOLERANCE, RELATIVE_TOLERANCE = 0.5, 0.1
"""What counts as right: within 0.5 px, and beyond 5 px within a tenth of the radius."""

_JUMP_SIDE = 31
"""px, side of the square around a pixel in which jumps of the map lower its confidence."""

_ROUNDING = 1e-4
"""px: what scales differ by for no more than their rounding."""

_TEMPER = 0.7
"""Power of the likelihood that the confidence takes: by benchmarks/confidence.py."""

_WEIGHT_OF_MASS, _WEIGHT_OF_JUMP, _BIAS = 0.419, -0.280, 0.709
"""Fitted by benchmarks/confidence.py, which also says what they are worth."""

_LEAST_ODDS, _LEAST_JUMP = 5e-4, 0.05
"""Below which shares of likelihood, and jumps in px, make no difference; chosen by hand."""

_CAUTION_SIGMA = 8.0
"""px, over which what is taken off a map is smoothed."""


def map_confidence(candidates: BlurCandidates, blur_map: ArrayLike) -> Float32:
    """Return the probability that each value of a map is right to 0.5 px, see `confidence_map`."""
    radius = checked_map(blur_map, candidates.image_shape)
    places = _at_windows(candidates, radius)
    probability = window_confidence(candidates, averaged_curve(candidates), *places)
    return np.clip(_between_windows(probability, candidates), 0, 1)


def confidence_and_caution(
    candidates: BlurCandidates,
    blur_map: ArrayLike,
    *,
    risk: float = RestorationSettings.risk,
) -> tuple[Float32, Float32]:
    """Return `confidence_map` and `cautious_blur_map` for the time of one: see there."""
    radius = checked_map(blur_map, candidates.image_shape)
    at_windows, jump = _at_windows(candidates, radius)
    curve = averaged_curve(candidates)
    sure = window_confidence(candidates, curve, at_windows, jump)
    excess = np.maximum(at_windows - _safe_at_windows(candidates, curve, at_windows, sure, risk), 0)
    excess = gaussian_filter(excess, _CAUTION_SIGMA / candidates.stride)
    return (
        np.clip(_between_windows(sure, candidates), 0, 1),
        np.maximum(radius - _between_windows(excess, candidates), 0),
    )


def confidence_of_problem(
    problem: LabelingProblem, *, blur_map: Float32, progress: Progress = silent
) -> tuple[Float32, Float32]:
    """Return `confidence_and_caution` of the map of a labeling problem."""
    progress("Measuring the confidence", 0.0)
    return confidence_and_caution(problem.candidates, blur_map)


def _safe_at_windows(
    candidates: BlurCandidates, curve: Float32, radius: Float64, sure: Float64, risk: float
) -> Float64:
    """Return the smallest radius that the true one is below with a probability of at most risk."""
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
    candidates: BlurCandidates, curve: Float32, radius: Float64, jump: Float64
) -> Float64:
    """Return the confidence at the windows, (R, C), for the map's values and jumps there."""
    share, prior, depth = likelihood_share(candidates, curve, radius)
    odds = np.log((share + _LEAST_ODDS) / (1 - share + _LEAST_ODDS))
    logit = _WEIGHT_OF_MASS * odds + _WEIGHT_OF_JUMP * np.log(jump + _LEAST_JUMP) + _BIAS
    informed = informed_share(depth)
    return informed / (1 + np.exp(-logit)) + (1 - informed) * prior


def likelihood_share(
    candidates: BlurCandidates, curve: Float32, radius: Float64
) -> tuple[Float64, Float64, Float64]:
    """Return what share of the averaged likelihood agrees with a radius: (R, C) each.

    Returns
    -------
    share : ndarray
        Of the likelihood within the `tolerance` of `radius`.
    prior : ndarray
        Of the scales.
    depth : ndarray
        Of the averaged curve, from its top to its bottom, at most 15.
    """
    depth = np.ptp(curve, axis=2)
    likelihood = curve + log_prior(candidates.scales)
    likelihood -= likelihood.max(axis=2, keepdims=True)
    likelihood *= np.float32(_TEMPER)
    np.exp(likelihood, out=likelihood)
    spacing = _spacing(candidates)
    likelihood *= spacing
    away = candidates.scales.astype(np.float32) - radius[..., None]
    agrees = np.abs(away, out=away) <= tolerance(radius)[..., None] + _ROUNDING
    share = np.sum(likelihood, axis=2, where=agrees) / likelihood.sum(axis=2)
    return share, np.sum(agrees * spacing, axis=2) / spacing.sum(), depth


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


def _between_windows(values: Float64, candidates: BlurCandidates) -> Float32:
    """Interpolate from the windows' centres to all pixels."""
    height, width = candidates.image_shape
    rows = (np.arange(height) - candidates.row_centers[0]) / candidates.stride
    columns = (np.arange(width) - candidates.column_centers[0]) / candidates.stride
    places = np.meshgrid(rows, columns, indexing="ij")
    return map_coordinates(values.astype(np.float32), places, order=1, mode="nearest")
