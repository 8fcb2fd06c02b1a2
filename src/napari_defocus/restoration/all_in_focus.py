"""The all-in-focus picture, (19): what is asked for, checked, and restored with care."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.axes import arranged_image
from napari_defocus.core.checks import (
    Linearize,
    check_block_size,
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
from napari_defocus.core.intensity import Intensities
from napari_defocus.core.progress import Progress, silent
from napari_defocus.core.threads import thread_count
from napari_defocus.forward.blur_operator import checked_scales
from napari_defocus.io.lazy_arrays import need_large_extra
from napari_defocus.likelihood.noise import noise_variance_of
from napari_defocus.psf.families import Disc, PSFFamily, as_family
from napari_defocus.restoration.deconvolution import Deconvolution
from napari_defocus.settings import BLOCK_SIZE, MapSettings, RestorationSettings

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_TV_OF_NOISE, _LEAST_TV = 30.0, 3e-5
_LUMA_OF_NOISE = float(np.sum(np.square(LUMA_WEIGHTS)))
"""Variance of the luminance of noise of variance 1 in each channel."""


def restore_all_in_focus(
    image: ArrayLike,
    blur_map: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    noise_variance: float | None = RestorationSettings.noise_variance,
    confidence: ArrayLike | None = None,
    tv_weight: float | None = RestorationSettings.tv_weight,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    axes: str | None = None,
    channel_axis: int | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
) -> Float32:
    """Take the blur of a map away: minimise (19).

    ``sum_x w_x |(h_x * f)[x] - g[x]|^2 + lambda sum_x |grad f[x]|``, the total variation over both
    directions and all channels together. With an exact map, f is as good as the data allow. An
    estimated one is best softened, because too large a radius makes rings: give
    ``cautious_blur_map(candidates, blur_map)`` instead of the map, and its `confidence`.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like, or dask.array.Array
        Any real dtype, see `estimate_candidates`. A stack if `axes` or `channel_axis` says so,
        then `blur_map` and `confidence` are (..., H, W), as `estimate_blur_map` gives them.
        Pixels that are not known are no data: opacity comes back as it was, and NaN or masked
        pixels are NaN.
    blur_map : (H, W) array_like
        Scale at every pixel, in px, within the family's domain.
    psf : PSFFamily or callable, optional
    noise_variance : float, optional
        Variance of the noise in the luminance, intensities in [0, 1], as `estimate_candidates`
        takes it: noise of variance v in each channel of a colour picture is 0.45 v. Found from
        the picture if left out.
    confidence : (H, W) array_like, optional
        How sure the map is, from 0 to 1, see `confidence_map`. The data of a pixel count less,
        the more a wrong radius there would change them, w = v / (v + (dg/dr)^2 d^2) with
        d = 2 (1 - confidence)^3 px; and where the result does not explain the picture, the
        radius is reduced. Without it, the map is taken as exact.
    tv_weight : float, optional
        lambda; larger is smoother. 30 v + 3e-5 if left out, v the noise variance of a channel,
        for a picture of full contrast; see `usual_tv_weight`.
    linearize : {"srgb"}, optional
        Decode the picture into linear light before, and encode it afterwards.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; found by default, see `estimate_candidates`. The
        planes of a stack share what is found.
    axes, channel_axis, block_size
        See `estimate_candidates`.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    float32 ndarray
        Of the shape of `image`, in [0, 1], which is `intensity_range`; NaN where `image` is NaN
        or masked. Of a stack, its planes' axes first and its colours last. A dask array if one
        came in.

    Raises
    ------
    TypeError
        If `image` is no picture, or `blur_map` or `confidence` holds no real numbers.
    ValueError
        If `image` is no picture (see `estimate_candidates`), if `blur_map` or `confidence` has
        another shape, scales outside the domain or a confidence outside [0, 1], or if
        `noise_variance`, `tv_weight` or `linearize` is impossible.

    References
    ----------
    .. [1] X. Zhu, S. Cohen, S. Schiller, P. Milanfar, "Estimating Spatially Varying Defocus
       Blur from A Single Image", IEEE Transactions on Image Processing 22(12), 2013, (19).
    .. [2] L. I. Rudin, S. Osher, E. Fatemi, "Nonlinear total variation based noise removal
       algorithms", Physica D 60, 1992.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import restore_all_in_focus, simulate_defocus
    >>> sharp, radius = camera()[100:180, 200:280] / 255, np.full((80, 80), 2.0)
    >>> blurred = simulate_defocus(sharp, radius, noise_variance=1e-6, rng=0)
    >>> restored = restore_all_in_focus(blurred, radius)
    >>> float(np.abs(blurred - sharp).mean() / np.abs(restored - sharp).mean()) > 2
    True
    """
    psf = as_family(psf)
    check_noise_variance(noise_variance)
    check_tv_weight(tv_weight)
    check_block_size(block_size)
    image, roles = arranged_image(image, axes, channel_axis)
    if roles:
        need_large_extra()
        from napari_defocus.tiled.lazy_planes import LazyPlanes
        from napari_defocus.tiled.restoration import PartRestoration, restore_planes

        check_linearize(linearize)
        how = PartRestoration(
            psf=psf,
            noise_variance=noise_variance,
            tv_weight=tv_weight,
            linearize=linearize,
            intensity_range=intensity_range,
        )
        planes = LazyPlanes.of(image, roles, intensity_range)
        return restore_planes(planes, blur_map, confidence, how, block_size, progress)
    picture = prepare_image(image, intensity_range, linearize)
    return with_unknown(
        in_shape_of(
            image,
            restored_colors(
                picture,
                blur_map,
                psf=psf,
                noise_variance=noise_variance,
                confidence=confidence,
                tv_weight=tv_weight,
                linearize=linearize,
                progress=progress,
            ),
        ),
        image,
    )


def restored_colors(
    picture: PreparedImage,
    blur_map: ArrayLike,
    *,
    psf: PSFFamily,
    noise_variance: float | None,
    confidence: ArrayLike | None,
    tv_weight: float | None,
    linearize: Linearize | None,
    progress: Progress = silent,
) -> Float32:
    """Do the work of `restore_all_in_focus`, which see, on a prepared picture: (H, W, C)."""
    scales = checked_scales(blur_map, picture.shape, psf)
    sure = None if confidence is None else _checked_confidence(confidence, picture.shape)
    progress("Measuring the noise", 0.0)
    if noise_variance is None:
        noise_variance = noise_variance_of(picture)
    channels = picture.color.shape[2]
    if tv_weight is None:
        tv_weight = usual_tv_weight(noise_variance, channels, picture.intensities)
    noise_variance = _noise_of_a_channel(noise_variance, channels)
    with ThreadPoolExecutor(thread_count()) as pool:
        problem = Deconvolution(picture, psf, sure, noise_variance, tv_weight, linearize, pool)
        sharp = np.clip(problem.solve(scales, progress), 0, 1)
    return encode_srgb(sharp) if linearize == "srgb" else sharp


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
    """Return a picture's colour with its number of channels, and its own opacity."""
    array = np.asarray(image)
    if array.ndim == 2:
        return color[..., 0]
    if array.shape[2] == 3:
        return color
    opacity = array[..., 3:].astype(np.float32)
    if array.dtype.kind in "ui":
        opacity /= np.iinfo(array.dtype).max
    return np.concatenate([color, np.clip(opacity, 0, 1)], axis=2)
