"""How well PSF families explain windows of a picture: evidence over radius and scene softness.

Scenes and cameras have no white gradients: fine details fail by more than the lens takes away. A
family without zeros in its spectrum, the Gaussian, then explains a disc's picture better than the
disc does, and radii near the ends of the domain explain anything. So each family is tried with
several softnesses, Gaussians behind its kernels, and the picture as a whole takes the best one.
The likelihood is the plain one of (9), on pure spectra: with the mixed ones of the maps, or divided
by its dispersion, it tells families worse (docs/decisions.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.image import PreparedImage
from napari_defocus.likelihood.analysis_grid import AnalysisGrid
from napari_defocus.likelihood.blur_spectra import SpectrumTable
from napari_defocus.likelihood.exact_spectra import FilterPower
from napari_defocus.likelihood.gabor import gradients, local_power
from napari_defocus.likelihood.local_noise import LocalNoise
from napari_defocus.likelihood.prior import log_prior
from napari_defocus.likelihood.profile_likelihood import profile_log_likelihood
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.psf.domain import growth_of_details, softness_beside
from napari_defocus.psf.families import Gaussian, PSFFamily

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

SOFTER = (0.7, 1.0, 1.4, 2.0)
"""px: standard deviations of what a scene may lack in fine details, beside the camera's own
softness. Without any of them, discs on soft scenes are taken for Gaussians; with some of them only,
for rings (docs/decisions.md)."""

LARGEST_LOSS = 10.0
"""Units of log-likelihood that a family loses in a window at most. Chosen by hand."""

_STEP = 0.2
"""px between the scales that are summed over. Chosen by hand."""

_MOST_WINDOWS, _CLOSEST = 900, 4
"""About how many windows are looked at, and the part of their side that they are apart at least."""

_LEAST_KNOWN = 0.5
"""Share of a window that has to be known. By hand."""


@dataclass(frozen=True, eq=False)
class Windows:
    """The local power spectra of windows of one picture.

    Attributes
    ----------
    power : (n, 2, F) float32 ndarray
        (4), relative to how much noisier than the mean each window is; those with any texture.
    least_noise : float
        Noise variance, in units of the picture's contrast.
    noise_variance : float
        Of the luminance, intensities in [0, 1]; the mean if the noise grows with the light.
    window : int
        Side N, in px.
    fractions : (float, float)
        Fractional part of the windows' centres, in px.
    """

    power: Float32
    least_noise: float
    noise_variance: float
    window: int
    fractions: tuple[float, float]

    @classmethod
    def of(
        cls,
        picture: PreparedImage,
        given: float | ShotNoise | LocalNoise | None,
        window: int,
        stride: int,
    ) -> Windows:
        """Return those of a prepared picture, `stride` px apart; the noise is found if None."""
        noise = LocalNoise.of(picture, given)
        gradient = gradients(picture.evened, picture.opaque, window)
        grid = AnalysisGrid.over(picture.shape, window, stride)
        power = local_power(gradient, grid.rows, grid.columns, window)
        known = power.any(axis=(2, 3))
        unit = picture.intensities.unit
        if picture.opaque is not None:
            share = grid.mean_over_windows(picture.opaque, gradient.pad, window)
            power /= np.maximum(share, _LEAST_KNOWN)[..., None, None]
            known &= share >= _LEAST_KNOWN
        noisier = noise.relative_to_windows(picture, grid, gradient.pad, window)
        if noisier is not None:
            power /= noisier[..., None, None]
        least = max(noise.variance, picture.rounding_variance) / unit**2
        fractions = float(grid.rows[0] % 1), float(grid.columns[0] % 1)
        return cls(power[known], least, noise.variance, window, fractions)


def spacing(picture: PreparedImage, window: int, count: int) -> int:
    """Return how far windows are apart, in px, if about 900 of `count` pictures are looked at."""
    area = picture.shape[0] * picture.shape[1]
    return max(window // _CLOSEST, round(math.sqrt(count * area / _MOST_WINDOWS)))


@dataclass(frozen=True, eq=False)
class FamilyFit:
    """How well a family explains windows.

    Attributes
    ----------
    evidence : (n,) ndarray
        Logarithm of the mean of p(r) exp(-0.25 r) over the radii.
    scale, depth : (n,) ndarray
        The likeliest scale, in px, and how far its logarithm lies above the least likely one's.
    softness : float
        The one of the softnesses, in px, with which the family explains the windows best.
    """

    evidence: Float64
    scale: Float64
    depth: Float64
    softness: float


def family_fit(
    samples: Sequence[Windows],
    psf: PSFFamily,
    camera_softness: float,
    softer: tuple[float, ...] = SOFTER,
) -> FamilyFit:
    """Return how well a family explains the windows of samples, with the best softness."""
    tried = softnesses(psf, camera_softness, softer)
    fits = [
        [np.concatenate(each) for each in zip(*one_softness, strict=True)]
        for one_softness in zip(*(_fits(windows, psf, tried) for windows in samples), strict=True)
    ]
    evidence = np.array([fit[0] for fit in fits])
    loss = np.minimum(evidence.max(axis=0) - evidence, LARGEST_LOSS)
    best = int(loss.mean(axis=1).argmin()) if loss.size else 0
    return FamilyFit(evidence[best], fits[best][1], fits[best][2], tried[best])


def softnesses(
    psf: PSFFamily, camera_softness: float, softer: tuple[float, ...] = SOFTER
) -> tuple[float, ...]:
    """Return the softnesses, in px, that a family behind a camera is tried with.

    A Gaussian behind a Gaussian is one: of that family, the radius says it all.
    """
    camera_softness = softness_beside(psf, camera_softness)
    if isinstance(psf, Gaussian):
        return (camera_softness,)
    return (camera_softness, *(each for each in softer if each > camera_softness))


def _fits(
    windows: Windows, psf: PSFFamily, softnesses: tuple[float, ...]
) -> list[tuple[Float64, Float64, Float64]]:
    """Return evidence, likeliest scale and depth of windows for each softness."""
    found = []
    for table in _tables(psf, windows.window, windows.fractions, softnesses):
        curve = profile_log_likelihood(windows.power, table, table.scales, windows.least_noise)
        curve = curve + log_prior(table.scales)
        top = curve.max(axis=1, keepdims=True, initial=-np.inf)
        evidence = top[:, 0] + np.log(np.exp(curve - top).mean(axis=1))
        found.append((evidence, table.scales[curve.argmax(axis=1)], np.ptp(curve, axis=1)))
    return found


@lru_cache(maxsize=32)
def _tables(
    psf: PSFFamily, window: int, fractions: tuple[float, float], softnesses: tuple[float, ...]
) -> list[SpectrumTable]:
    """Tabulate (6) at the scales that are summed over, for each softness; no derivatives."""
    scales = np.linspace(0, psf.max_scale, int(np.ceil(psf.max_scale / _STEP - 1e-6)) + 1)
    kernels = [psf.kernel(float(scale)) for scale in scales]
    filters = FilterPower.of_window(window, *fractions, max(len(kernel) for kernel in kernels))
    noise = FilterPower.of_window(window, *fractions, largest=2).noise_spectra()
    growth = growth_of_details(psf)
    blurs = (filters.blur_spectra(kernels, softness, growth) for softness in softnesses)
    return [SpectrumTable(scales, blur, 0 * blur, 0 * blur, noise) for blur in blurs]
