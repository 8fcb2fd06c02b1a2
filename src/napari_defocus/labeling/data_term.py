"""What of the likelihood curves counts at each place: of its own side, limited, of texture.

A window that overlaps two blur scales is won by the sharper one (Section V of the paper), so
that sharp regions grow by the window's radius. But it is seen where in the window the fine
details are: the mean shift of their energy E under the Gaussian window of standard deviation
sigma is d = sigma^2 grad log E (Fukunaga and Hostetler, IEEE Trans. Inf. Theory 21(1), 1975).
Beside a textured half-plane, a window moved away by 2 d has left it when its own centre is
outside, and not before. Where it is much blurrier there, the details belong to the other side,
and the place takes the moved window's evidence.

No window is exactly what the model says, so that the depth of its curve counts up to a limit.
Where the curves of a neighbourhood, averaged, are flat, there is no texture, and what each of
them prefers is chance: it does not count, and labels are extrapolated from around.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from napari_defocus.core.image import PreparedImage
from napari_defocus.core.threads import in_bands
from napari_defocus.likelihood.blur_spectra import LABEL_STEP
from napari_defocus.likelihood.candidates import BlurCandidates

Float32 = NDArray[np.float32]

EXTRAPOLATED = 0.5
"""Below this share of evidence, a map is counted as extrapolated from around."""

_DETAIL = 1.0
"""Standard deviation, in px, of the Gaussian that leaves no fine details."""

_SHIFTS = 2.0
"""How many mean shifts a window moves away from fine details, see above."""

_LARGEST_SHIFT = 0.5
"""As a share of the window's side."""

_LEAST_RATIO, _LEAST_STEP = 2.0, 0.5
"""The moved window is believed if it is blurred by more than 2 r + 0.5 px: a steep slope of the
blur is no edge (a difference of 1 px instead cost bumps what edges gained; docs/decisions.md)."""

_LEAST_ENERGY = 1e-12
"""Of fine details, so that the logarithm of their energy is defined."""

_DEPTH = np.float32(15)
"""Of a curve, in log-likelihood: what lies deeper counts as much. Chosen on ramps and bumps."""

_PRIOR_RATE = 0.25
"""1 / px. Of 0 to 0.5, on photographs with measured radii, plain shapes and simulations
(docs/decisions.md)."""

_NEIGHBORHOOD = 8.0
"""Standard deviation, in px, of the Gaussian that averages curves: they tell where texture is."""

_EVERY = 4
"""Of the scales, so many are looked at for that: every 0.4 px."""

_INFORMATIVE, _STEEPNESS = 4.0, 3.0
"""Noise alone gives averaged curves a depth of 0.05 to 0.9, rarely 3; texture 8 to 15."""

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


def on_own_side(candidates: BlurCandidates, picture: PreparedImage) -> BlurCandidates:
    """Replace the curves of windows that are sharp only because of what lies beside them.

    Parameters
    ----------
    candidates : BlurCandidates
        Of the mode "curve"; those of "paper" are returned as they are.
    picture : PreparedImage
        The same.
    """
    row, column = asked_windows(candidates, picture)
    rows, columns = np.indices(row.shape)
    moved = (row != rows) | (column != columns)
    if not moved.any():
        return candidates
    own = candidates.curve.copy()
    own[moved] = candidates.curve[row[moved], column[moved]]
    return replace(candidates, curve=own)


def asked_windows(
    candidates: BlurCandidates, picture: PreparedImage
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the row and the column of the window whose curve each place takes: (R, C) each.

    Its own, but where that is sharp only because of what lies beside it; see `on_own_side`.
    """
    curve = candidates.curve
    places = np.indices(curve.shape[:2])
    rows, columns = places[0], places[1]
    if candidates.mode == "paper":
        return rows, columns
    row_shift, column_shift = _shifts(candidates, picture)
    row = np.clip(np.rint(rows + row_shift), 0, curve.shape[0] - 1).astype(int)
    column = np.clip(np.rint(columns + column_shift), 0, curve.shape[1] - 1).astype(int)
    best = candidates.scales[curve.argmax(axis=2)]
    blurrier = best[row, column] > _LEAST_RATIO * best + _LEAST_STEP
    return np.where(blurrier, row, rows), np.where(blurrier, column, columns)


def _shifts(candidates: BlurCandidates, picture: PreparedImage) -> Float32:
    """Return how far each window moves away from where its fine details are: (2, R, C) windows."""
    stride, window = candidates.stride, candidates.window
    details = picture.evened - gaussian_filter(picture.evened, _DETAIL)
    if picture.opaque is not None:
        details[~picture.opaque] = 0
    energy = gaussian_filter(details**2, stride / 2)
    centers = (candidates.row_centers, candidates.column_centers)
    sampled = energy[np.ix_(*(np.rint(center).astype(int) for center in centers))]
    sampled += max(candidates.noise_variance / picture.intensities.unit**2, _LEAST_ENERGY)
    # Power has the square of the filters' window, of standard deviation N / 4.
    sigma = window / 4 / np.sqrt(2) / stride
    log_energy = np.log(gaussian_filter(sampled, sigma, mode="nearest"))
    shifts = (
        -_SHIFTS
        * sigma**2
        * np.stack(
            [
                np.gradient(log_energy, axis=axis) if log_energy.shape[axis] > 1 else 0 * log_energy
                for axis in (0, 1)
            ]
        )
    )
    length = np.hypot(*shifts)
    return shifts * np.minimum(1, _LARGEST_SHIFT * window / stride / np.maximum(length, 1e-6))


def limited_depth(candidates: BlurCandidates) -> Float32:
    """Return how far each scale lies below the best, at most 15, as far as it counts: (R, C, L).

    The whole curve keeps what a broad or shallow maximum says, and has the prior of the radius. A
    window that stands for n places along the border is not n of them; its weight is 1 / sqrt(n).
    """
    weight = evidence_share(candidates) / np.sqrt(candidates.places_of_window())
    posterior = candidates.curve + log_prior(candidates)
    return _limited(posterior, weight.astype(np.float32), _DEPTH)


def log_prior(candidates: BlurCandidates) -> Float32:
    """Return the logarithm of the prior of each scale, exp(-0.25 r), r in px: (L,).

    Plain things with sharp edges and nothing inside put their power into few frequencies, and fit
    a wide blur nearly as well as their own: half of their windows have the maximum at the largest
    radius, the true one a few units below. Texture decides by more than the prior says.
    """
    return (-_PRIOR_RATE * candidates.scales).astype(np.float32)


def _limited(curve: Float32, weight: Float32, depth: np.float32) -> Float32:
    limited = np.empty_like(curve)
    in_bands(_limit_rows, len(curve), curve, weight, depth, limited)
    return limited


@njit(cache=True, error_model="numpy", nogil=True)
def _limit_rows(
    start: int, stop: int, curve: Float32, weight: Float32, depth: np.float32, limited: Float32
) -> None:
    for row in range(start, stop):
        for column in range(curve.shape[1]):
            top = curve[row, column, 0]
            for scale in range(1, curve.shape[2]):
                top = max(top, curve[row, column, scale])
            for scale in range(curve.shape[2]):
                below = min(top - curve[row, column, scale], depth)
                limited[row, column, scale] = weight[row, column] * below


def evidence_share(candidates: BlurCandidates) -> Float32:
    """Return how far there is evidence around each window: 0 where there is no texture, to 1."""
    return informed_share(np.ptp(averaged_curve(candidates, every=_EVERY), axis=2))


def averaged_curve(candidates: BlurCandidates, every: int = 1) -> Float32:
    """Average log p(r), of limited depth, over the windows that see about the same: (R, C, n).

    Only at every so many scales, if `every` is above 1.
    """
    some = candidates.curve[..., ::every]
    limited = np.maximum(some - some.max(axis=2, keepdims=True), -_DEPTH)
    sigma = _NEIGHBORHOOD / candidates.stride
    return gaussian_filter(limited, (sigma, sigma, 0))


def informed_share(depth: Float32) -> Float32:
    """Return how far an averaged curve of this depth is evidence at all."""
    return 1 - np.exp(-((depth / np.float32(_INFORMATIVE)) ** np.float32(_STEEPNESS)))
