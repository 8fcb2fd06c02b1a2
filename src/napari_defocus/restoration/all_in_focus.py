"""The all-in-focus picture, (19): what is asked for, checked, and deconvolved with care."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import (
    Linearize,
    check_linearize,
    check_noise_variance,
    check_tv_weight,
)
from napari_defocus.core.image import (
    LUMA_WEIGHTS,
    PreparedImage,
    encode_srgb,
    given_array,
    prepare_image,
    with_unknown,
)
from napari_defocus.core.intensity import Intensities, IntensityRange, Limits
from napari_defocus.core.progress import Progress, silent
from napari_defocus.core.threads import thread_count
from napari_defocus.forward.blur_operator import checked_scales
from napari_defocus.likelihood.noise import PROCESSING_VARIANCE, noise_variance_of
from napari_defocus.psf.families import PSFFamily, as_family
from napari_defocus.restoration.damage import unexplained_share, unrestored_share
from napari_defocus.restoration.deconvolution import Deconvolution
from napari_defocus.settings import MapSettings, RestorationSettings

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_TV_OF_NOISE, _LEAST_TV = 30.0, 3e-5
"""lambda of (19): so many times the noise variance of a channel, and at least so much, for a
contrast of 1. By hand, on simulated pictures.
"""

_LUMA_OF_NOISE = float(np.sum(np.square(LUMA_WEIGHTS)))
"""Variance of the luminance of noise of variance 1 in each channel."""


@dataclass(frozen=True)
class RestorationFit:
    """How well a picture fits its map, and what was done about it.

    Attributes
    ----------
    noise_variance : float
        Of the luminance, given or found.
    tv_weight : float
        lambda of (19), as it was used.
    misfit : float
        Variance of what noise, lens and map do not explain, for intensities in [0, 1]; 0 if the
        picture fits. If it is above 0, less blur was taken away, with more smoothing. Noise
        with a variance of 2e-5 or more, for a contrast of 1, would hide a misfit: then it is
        assumed.
    left_as_it_was : (H, W) float32 ndarray
        How far each pixel was left as it was, from 0 to 1: rings beyond black and white, or
        ripples in what is not explained, say that the radii there are wrong.
    """

    noise_variance: float
    tv_weight: float
    misfit: float
    left_as_it_was: Float32 = field(compare=False, repr=False)

    @property
    def unrestored(self) -> float:
        """Share of the picture that was left as it was, from 0 to 1."""
        return float(self.left_as_it_was.mean())


@dataclass(frozen=True, eq=False)
class TiledRestorationFit:
    """What was not restored of the planes of a stack, or of a picture larger than memory.

    Attributes
    ----------
    left_as_it_was : (..., H, W) float32 ndarray or dask.array.Array
        How far each pixel was left as it was, from 0 to 1, see `RestorationFit`. It is a dask
        array if the image was one.
    """

    left_as_it_was: Any

    @property
    def unrestored(self) -> Any:
        """Share of each plane that was left as it was, (...), of the kind of `left_as_it_was`."""
        return self.left_as_it_was.mean(axis=(-2, -1))


@dataclass(frozen=True)
class Restoration:
    """How a picture is restored: what `restore_all_in_focus` takes, checked, but for arrays.

    Attributes
    ----------
    psf : PSFFamily
    noise_variance : float or None
        Of the luminance; None finds it.
    tv_weight : float or None
        lambda of (19); None derives it, see `usual_tv_weight`.
    linearize : {"srgb"} or None
    intensity_range : (float, float) or None
        The intensities that count as 0 and 1; None finds them.
    """

    psf: PSFFamily
    noise_variance: float | None = RestorationSettings.noise_variance
    tv_weight: float | None = RestorationSettings.tv_weight
    linearize: Linearize | None = MapSettings.linearize
    intensity_range: IntensityRange | None = None

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        object.__setattr__(self, "psf", as_family(self.psf))
        check_noise_variance(self.noise_variance)
        check_tv_weight(self.tv_weight)
        check_linearize(self.linearize)

    def prepared(
        self, image: ArrayLike, intensities: Intensities | Limits | None = None
    ) -> PreparedImage:
        """Return the picture as it is restored; of a tile, with the intensities of its plane."""
        return prepare_image(image, intensities or self.intensity_range, self.linearize)

    def restored(
        self,
        image: ArrayLike,
        picture: PreparedImage,
        blur_map: ArrayLike,
        confidence: ArrayLike | None = None,
        progress: Progress = silent,
    ) -> Float32:
        """Minimise (19) for a picture and how it is prepared; return it in the image's shape."""
        return self.restored_with_fit(image, picture, blur_map, confidence, progress)[0]

    def restored_with_fit(
        self,
        image: ArrayLike,
        picture: PreparedImage,
        blur_map: ArrayLike,
        confidence: ArrayLike | None = None,
        progress: Progress = silent,
    ) -> tuple[Float32, RestorationFit]:
        """Return what `restored` does, and how well the picture fits its map."""
        colors, fit = self._colors(picture, blur_map, confidence, progress)
        return with_unknown(in_shape_of(image, colors), image), fit

    def _colors(
        self,
        picture: PreparedImage,
        blur_map: ArrayLike,
        confidence: ArrayLike | None,
        progress: Progress,
    ) -> tuple[Float32, RestorationFit]:
        """Return the restored colours, (H, W, C)."""
        scales = checked_scales(blur_map, picture.shape, self.psf)
        sure = None if confidence is None else _checked_confidence(confidence, picture.shape)
        progress("Measuring the noise", 0.0)
        noise_variance, tv_weight = self.noise_variance, self.tv_weight
        if noise_variance is None:
            noise_variance = noise_variance_of(picture)
        channels = picture.color.shape[2]
        if tv_weight is None:
            tv_weight = usual_tv_weight(noise_variance, channels, picture.intensities)
        of_channel = _noise_of_a_channel(noise_variance, channels)
        with ThreadPoolExecutor(thread_count()) as pool:
            problem = Deconvolution(
                *(picture, self.psf, sure, of_channel, tv_weight, self.linearize, pool),
                follows_misfit=self.tv_weight is None,
                hides_misfit=noise_variance >= PROCESSING_VARIANCE * picture.intensities.unit**2,
            )
            sharp = problem.solve(scales, progress)
        contrast = picture.intensities.unit
        left = unrestored_share(sharp, scales, contrast)
        if problem.left_over is not None:
            ripples = unexplained_share(problem.left_over, picture.color, of_channel, contrast)
            left = np.maximum(left, ripples)
        sharp += left[..., None] * (picture.color - sharp)
        sharp = np.clip(sharp, 0, 1)
        fit = RestorationFit(
            noise_variance=float(noise_variance),
            tv_weight=problem.tv_weight,
            misfit=problem.misfit,
            left_as_it_was=left,
        )
        return encode_srgb(sharp) if self.linearize == "srgb" else sharp, fit


def usual_tv_weight(
    noise_variance: float, channels: int, intensities: Intensities | None = None
) -> float:
    """Return the lambda of (19) that simulations asked for.

    A picture of u times the contrast, with u^2 times the noise, asks for u times as much.

    Parameters
    ----------
    noise_variance : float
        Of the luminance.
    channels : {1, 3}
        Of the picture.
    intensities : Intensities, optional
        Of the picture; without, its contrast is 1.
    """
    unit = 1.0 if intensities is None else intensities.unit
    noise = _noise_of_a_channel(noise_variance, channels) / unit**2
    return unit * (_TV_OF_NOISE * noise + _LEAST_TV)


def _noise_of_a_channel(noise_variance: float, channels: int) -> float:
    """Return the variance of independent noise in each channel that makes that of luminance."""
    return noise_variance / _LUMA_OF_NOISE if channels == 3 else noise_variance


def _checked_confidence(confidence: ArrayLike, shape: tuple[int, int]) -> Float32:
    array = given_array("confidence", confidence)
    if array.dtype.kind not in "buif":
        raise TypeError(f"confidence has dtype {array.dtype}; it takes real numbers")
    if array.shape != shape:
        raise ValueError(f"confidence has shape {array.shape}; it takes the picture's, {shape}")
    if not (np.isfinite(array).all() and array.min() >= 0 and array.max() <= 1):
        raise ValueError(
            f"confidence has values from {array.min()} to {array.max()}; it takes 0 to 1"
        )
    return array.astype(np.float32)


def in_shape_of(image: ArrayLike, color: Float32) -> Float32:
    """Return colours, (H, W, C), in the shape of a picture, with its opacity if it has one."""
    array = np.asarray(image)
    if array.ndim == 2:
        return color[..., 0]
    if array.shape[2] == 3:
        return color
    opacity = array[..., 3:].astype(np.float32)
    if array.dtype.kind in "ui":
        opacity /= np.iinfo(array.dtype).max
    return np.concatenate([color, np.clip(opacity, 0, 1)], axis=2)
