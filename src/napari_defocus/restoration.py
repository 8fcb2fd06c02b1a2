"""The all-in-focus picture: (19), a deconvolution with the PSF of every pixel's own scale.

What is minimised over pictures f, with the blur A of (1), the picture g and weights w, is

    sum_x w_x |(A f)[x] - g[x]|^2 + lambda sum_x sqrt(|grad f[x]|^2 + eps^2),

where |grad f|^2 is the sum over both directions and all channels: edges of the channels lie at
the same places. Each round replaces the second sum by the quadratic that touches it from above
(half-quadratic regularisation: Geman and Reynolds, IEEE PAMI 14(3), 1992; Vogel and Oman, SIAM
J. Sci. Comput. 17(1), 1996) and goes some steps of conjugate gradients towards its minimum.
They are preconditioned by Wiener-like filters on overlapping tiles, each with its own scale:
the blur is nearly constant in a tile, and what it takes away is what they give back. This is
what makes it fast: without, ten times as many steps are not enough.

The picture is solved for on a domain that is larger than it by the reach of the PSF, where
there are no data. Clipped highlights are data on one side only: they say nothing once A f is
at least as bright.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import ArrayLike, NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter, minimum_filter

from napari_defocus.axes import arranged_image
from napari_defocus.blur_operator import BlurOperator, checked_scales, half_variance_slope
from napari_defocus.image import (
    LUMA_WEIGHTS,
    PreparedImage,
    decode_srgb,
    encode_srgb,
    given_array,
    prepare_image,
)
from napari_defocus.lazy_arrays import need_large_extra
from napari_defocus.noise import estimate_noise_variance
from napari_defocus.progress import Progress, silent
from napari_defocus.psf import Disc, PSFFamily, as_family
from napari_defocus.settings import (
    BLOCK_SIZE,
    Linearize,
    MapSettings,
    RestorationSettings,
    check_block_size,
    check_linearize,
    check_noise_variance,
    check_tv_weight,
)

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]

_TV_OF_NOISE, _LEAST_TV = 30.0, 3e-5
_LUMA_OF_NOISE = float(np.sum(np.square(LUMA_WEIGHTS)))
"""Variance of the luminance of noise of variance 1 in each channel."""

_DOUBT, _DOUBT_POWER = 2.0, 3
_SILENCE = 1e-8
_CLIPPED = 1 - 1 / 255

_FIRST_ROUNDING, _ROUNDING = 0.02, 1e-3
"""eps, of the first round and from which on it no longer halves: intensities in [0, 1]."""

_STEPS_A_ROUND, _MOST_ROUNDS, _USUAL_ROUNDS = 5, 25, 8
_TOLERANCE = 3e-3

_CHECKED_AFTER = (2, 4)
_GROSS = 8.0
_VISIBLE = 2e-5
_RESIDUAL_SIGMA, _RESIDUAL_REACH = 3.0, 4
_LEAST_KNOWN = 0.05
_LEAST_SHARE, _UNCHANGED = 0.5, 0.95

_TILE = 64
_STIFFNESS_OF_TV = 15.0
_SCALE_STEP = 0.25


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
        Transparent pixels are no data; opacity comes back as it was.
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
        lambda; larger is smoother. 30 v + 3e-5 if left out, v the noise variance of a channel.
    linearize : {"srgb"}, optional
        Decode the picture into linear light before, and encode it afterwards.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1.
    axes, channel_axis, block_size
        See `estimate_candidates`.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    float32 ndarray
        Of the shape of `image`, in [0, 1]; of a stack, its planes' axes first and its colours
        last. A dask array if one came in.

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
        from napari_defocus.block_restoration import PartRestoration, restore_planes
        from napari_defocus.lazy_planes import LazyPlanes

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
    scales = checked_scales(blur_map, picture.shape, psf)
    sure = None if confidence is None else _checked_confidence(confidence, picture.shape)
    progress("Measuring the noise", 0.0)
    if noise_variance is None:
        noise_variance = estimate_noise_variance(
            image, linearize=linearize, intensity_range=intensity_range
        )
    channels = picture.color.shape[2]
    if tv_weight is None:
        tv_weight = usual_tv_weight(noise_variance, channels)
    noise_variance = _noise_of_a_channel(noise_variance, channels)
    with ThreadPoolExecutor(get_num_threads()) as pool:
        problem = _Deconvolution(picture, psf, sure, noise_variance, tv_weight, linearize, pool)
        sharp = np.clip(problem.solve(scales, progress), 0, 1)
    if linearize == "srgb":
        sharp = encode_srgb(sharp)
    return _in_shape_of(image, sharp)


def usual_tv_weight(noise_variance: float, channels: int) -> float:
    """Return the lambda of (19) that simulations asked for.

    Parameters
    ----------
    noise_variance : float
        Of the luminance.
    channels : {1, 3}
        Of the picture.
    """
    return _TV_OF_NOISE * _noise_of_a_channel(noise_variance, channels) + _LEAST_TV


def _noise_of_a_channel(noise_variance: float, channels: int) -> float:
    """Return the variance of independent noise in each channel that makes that of luminance."""
    return noise_variance / _LUMA_OF_NOISE if channels == 3 else noise_variance


class _Deconvolution:
    """(19) for one picture, whose map may still change."""

    def __init__(
        self,
        picture: PreparedImage,
        psf: PSFFamily,
        sure: Float32 | None,
        noise_variance: float,
        tv_weight: float,
        linearize: Linearize | None,
        pool: Executor,
    ) -> None:
        self._color, self._opaque = picture.color, picture.opaque
        self._psf, self._sure, self._pool = psf, sure, pool
        self._noise_variance = max(noise_variance, _SILENCE)
        self._tv_weight = tv_weight
        limit = np.array([_CLIPPED], np.float32)
        clipped = picture.color >= (decode_srgb(limit) if linearize == "srgb" else limit)
        self._clipped = clipped if clipped.any() else None

    def solve(self, scales: Float32, progress: Progress) -> Float32:
        """Return the minimiser, (H, W, C); nothing keeps it in [0, 1]."""
        self._blur_by(scales)
        sharp = self._blur.extend(self._color)
        sharp += self._inverse(self._pull(sharp)[0])
        rounding = _FIRST_ROUNDING
        for count in range(_MOST_ROUNDS):
            start, whole = _STEPS_A_ROUND * count, _STEPS_A_ROUND * _USUAL_ROUNDS
            before = sharp.copy()
            for step in self._descend(sharp, rounding):
                progress("Taking the blur away", min((start + step) / whole, 1.0))
            settled = np.linalg.norm(sharp - before) < _TOLERANCE * np.linalg.norm(sharp)
            if rounding <= _ROUNDING and settled:
                break
            rounding = max(rounding / 2, _ROUNDING)
            if count in _CHECKED_AFTER and self._sure is not None:
                scales, sharp = self._with_less_blur(scales, sharp)
        return sharp[self._blur.inner]

    def _blur_by(self, scales: Float32) -> None:
        self._blur = BlurOperator(scales, self._psf, self._color.shape[2])
        self._weight = self._weights(scales)
        stiffness = _STIFFNESS_OF_TV * self._tv_weight
        weight = self._weight[..., 0]
        self._inverse = _TiledInverse(self._blur, scales, self._psf, weight, stiffness, self._pool)

    def _weights(self, scales: Float32) -> Float32:
        """How much the data of each pixel count, (H, W, 1): noise over what else is wrong."""
        weight = np.ones((*scales.shape, 1), np.float32)
        if self._sure is not None:
            change = half_variance_slope(self._psf, scales)[..., None] * _laplacian(self._color)
            doubt = _DOUBT * (1 - self._sure[..., None]) ** _DOUBT_POWER
            wrong = np.mean((doubt * change) ** 2, axis=2, keepdims=True)
            weight = self._noise_variance / (self._noise_variance + wrong)
        if self._opaque is not None:
            weight = weight * self._opaque[..., None]
        return weight.astype(np.float32)

    def _pull(self, sharp: Float32) -> tuple[Float32, Float32]:
        """Return A' w (g - A f), and the w in use: 0 where clipped light is bright enough."""
        error = self._color - self._blur.apply(sharp)
        weight = self._weight
        if self._clipped is not None:
            weight = np.where(self._clipped & (error < 0), np.float32(0), weight)
        error *= weight
        return self._blur.adjoint(error), weight

    def _descend(self, sharp: Float32, rounding: float) -> Iterator[int]:
        """Go one round of conjugate gradient steps, in place; tell before each."""
        residual, weight = self._pull(sharp)
        stiffness = _stiffness(sharp, np.float32(self._tv_weight), np.float32(rounding))
        residual -= _smoothness_form(stiffness, sharp)
        conditioned = self._inverse(residual)
        direction = conditioned.copy()
        power = np.vdot(residual, conditioned)
        for step in range(_STEPS_A_ROUND):
            yield step
            form = self._blur.adjoint(weight * self._blur.apply(direction))
            form += _smoothness_form(stiffness, direction)
            curvature = np.vdot(direction, form)
            if not (power > 0 and curvature > 0):
                return
            length = power / curvature
            sharp += length * direction
            residual -= length * form
            conditioned = self._inverse(residual)
            power, last = np.vdot(residual, conditioned), power
            direction *= power / last
            direction += conditioned

    def _with_less_blur(self, scales: Float32, sharp: Float32) -> tuple[Float32, Float32]:
        """Reduce the scales where the result does not explain the picture, and start anew there.

        Too small a scale leaves blur, but hardly an error; too large a one, or two depths under
        one PSF, cannot be explained by any picture that is not full of rings.
        """
        error = self._blur.apply(sharp) - self._color
        square, known = np.mean(error**2, axis=2), np.ones(scales.shape, np.float32)
        if self._clipped is not None:
            known[self._clipped.any(axis=2)] = 0
        power = gaussian_filter(square * known, _RESIDUAL_SIGMA)
        power /= np.maximum(gaussian_filter(known, _RESIDUAL_SIGMA), _LEAST_KNOWN)
        expected = _GROSS * (self._noise_variance + _VISIBLE)
        share = np.sqrt(expected / np.maximum(power, expected))
        share = minimum_filter(np.maximum(share, _LEAST_SHARE), 2 * _RESIDUAL_REACH + 1)
        share = gaussian_filter(share, _RESIDUAL_REACH)
        if share.min() > _UNCHANGED:
            return scales, sharp
        picture = sharp[self._blur.inner]
        anew = np.clip((1 - share) / (1 - _UNCHANGED), 0, 1)[..., None]
        scales = (scales * share).astype(np.float32)
        self._blur_by(scales)
        return scales, self._blur.extend(picture + anew * (self._color - picture))


class _TiledInverse:
    """Nearly the inverse of A' w A + c grad' grad, for conjugate gradients.

    Parameters
    ----------
    blur : BlurOperator
    scales, weight : (H, W) float32 ndarray
        What makes A, and w.
    psf : PSFFamily
    stiffness : float
        c.
    pool : Executor
        What filters rows of tiles at once.
    """

    def __init__(
        self,
        blur: BlurOperator,
        scales: Float32,
        psf: PSFFamily,
        weight: Float32,
        stiffness: float,
        pool: Executor,
    ) -> None:
        self._pool, self._domain = pool, blur.domain
        step = np.minimum(np.rint(scales / _SCALE_STEP), psf.max_scale // _SCALE_STEP)
        present = np.unique(step)
        kernels = [psf.kernel(_SCALE_STEP * float(number)) for number in present]
        self._half = max(_TILE // 2, fft.next_fast_len(max(map(len, kernels)), real=True))
        side = 2 * self._half
        self._tiles = tuple(-(-length // self._half) + 1 for length in blur.domain)
        self._size = tuple((count + 1) * self._half for count in self._tiles)
        wave = np.sin(np.pi * (np.arange(side) + 0.5) / side)
        self._window = np.outer(wave, wave).astype(np.float32)[..., None]
        edges = [
            (self._half + at.start, size - self._half - at.stop)
            for at, size in zip(blur.inner, self._size, strict=True)
        ]
        means = [
            self._views(np.pad(plane, edges, mode="edge")[..., None]).mean(axis=(2, 3, 4))
            for plane in (step, weight)
        ]
        nearest = np.abs(means[0][..., None] - present).argmin(axis=2)
        frequency = 2 * np.pi * fft.fftfreq(side)[:, None], 2 * np.pi * fft.rfftfreq(side)
        laplacian = 4 - 2 * np.cos(frequency[0]) - 2 * np.cos(frequency[1])
        spectra = np.stack([np.abs(fft.rfft2(kernel, (side, side))) ** 2 for kernel in kernels])
        form = means[1][..., None, None] * spectra.astype(np.float32)[nearest]
        form += (stiffness * (laplacian + 1e-2)).astype(np.float32)
        self._filters = (1 / form).astype(np.float32)[..., None]

    def __call__(self, picture: Float32) -> Float32:
        """Filter a picture on the domain."""
        padded = np.zeros((*self._size, picture.shape[2]), np.float32)
        inner = tuple(slice(self._half, self._half + length) for length in self._domain)
        padded[inner] = picture
        views, filtered = self._views(padded), np.zeros_like(padded)

        def filter_row(row: int) -> None:
            self._filter(views[row], self._filters[row], self._rows_of(filtered, row))

        # Rows of tiles share pixels with the next ones: every second at once.
        for parity in range(2):
            list(self._pool.map(filter_row, range(parity, self._tiles[0], 2)))
        return filtered[inner]

    def _filter(self, tiles: Float32, filters: Float32, rows: Float32) -> None:
        """Add filtered tiles to the rows that they cover, (2 T, columns of T, T, C)."""
        spectra = fft.rfft2(tiles * self._window, axes=(1, 2))
        spectra *= filters
        filtered = fft.irfft2(spectra, self._window.shape[:2], axes=(1, 2), overwrite_x=True)
        filtered *= self._window
        rows[:, :-1] += filtered[:, :, : self._half].swapaxes(0, 1)
        rows[:, 1:] += filtered[:, :, self._half :].swapaxes(0, 1)

    def _rows_of(self, picture: Float32, row: int) -> Float32:
        rows = picture[row * self._half : (row + 2) * self._half]
        return rows.reshape(len(rows), -1, self._half, picture.shape[2])

    def _views(self, picture: NDArray[np.floating]) -> NDArray[np.floating]:
        """Cut into overlapping tiles: (rows, columns, side, side, C)."""
        shape = 2 * self._half, 2 * self._half
        windows = np.lib.stride_tricks.sliding_window_view(picture, shape, axis=(0, 1))
        return windows[:: self._half, :: self._half].transpose(0, 1, 3, 4, 2)


def _laplacian(color: Float32) -> Float32:
    padded = np.pad(color, ((1, 1), (1, 1), (0, 0)), mode="symmetric")
    around = padded[2:, 1:-1] + padded[:-2, 1:-1] + padded[1:-1, 2:] + padded[1:-1, :-2]
    return around - 4 * color


@njit(cache=True, parallel=True, fastmath=True, nogil=True)
def _stiffness(picture: Float32, tv_weight: float, rounding: float) -> Float32:
    """Return lambda / (2 sqrt(|grad f|^2 + eps^2)): (H, W)."""
    height, width, channels = picture.shape
    stiffness = np.empty((height, width), np.float32)
    for row in prange(height):
        for column in range(width):
            square = rounding * rounding
            for channel in range(channels):
                if row + 1 < height:
                    step = picture[row + 1, column, channel] - picture[row, column, channel]
                    square += step * step
                if column + 1 < width:
                    step = picture[row, column + 1, channel] - picture[row, column, channel]
                    square += step * step
            stiffness[row, column] = tv_weight / 2 / np.sqrt(square)
    return stiffness


@njit(cache=True, parallel=True, fastmath=True, nogil=True)
def _smoothness_form(stiffness: Float32, picture: Float32) -> Float32:
    """Return grad' (c grad f), with c for the differences to the next row and column."""
    height, width, channels = picture.shape
    form = np.empty_like(picture)
    for row in prange(height):
        for column in range(width):
            own = stiffness[row, column]
            up = stiffness[row - 1, column] if row > 0 else np.float32(0)
            left = stiffness[row, column - 1] if column > 0 else np.float32(0)
            above, below = max(row - 1, 0), min(row + 1, height - 1)
            before, after = max(column - 1, 0), min(column + 1, width - 1)
            for channel in range(channels):
                value = picture[row, column, channel]
                form[row, column, channel] = (
                    own * (value - picture[below, column, channel])
                    + own * (value - picture[row, after, channel])
                    + up * (value - picture[above, column, channel])
                    + left * (value - picture[row, before, channel])
                )
    return form


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


def _in_shape_of(image: ArrayLike, color: Float32) -> Float32:
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
