"""The all-in-focus picture: (19), a deconvolution with the PSF of every pixel's own scale.

What is minimised over pictures f, with the blur A of (1), the picture g and weights w, is

    sum_x w_x |(A f)[x] - g[x]|^2 + lambda sum_x sqrt(|grad f[x]|^2 + eps^2),

where |grad f|^2 is the sum over both directions and all channels: edges of the channels lie at
the same places. Each round replaces the second sum by the quadratic that touches it from above
(half-quadratic regularisation: Geman and Reynolds, IEEE PAMI 14(3), 1992; Vogel and Oman, SIAM
J. Sci. Comput. 17(1), 1996) and goes some steps of conjugate gradients towards its minimum.
They are preconditioned by Wiener-like filters on overlapping tiles, each with its own scale:
the blur is nearly constant in a tile, and what it takes away is what they give back.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from napari_defocus.blur_operator import BlurOperator, checked_scales, half_variance_slope
from napari_defocus.image import (
    LUMA_WEIGHTS,
    PreparedImage,
    decode_srgb,
    encode_srgb,
    prepare_image,
)
from napari_defocus.noise import estimate_noise_variance
from napari_defocus.progress import Progress, silent
from napari_defocus.psf import Disc, PSFFamily, as_family
from napari_defocus.settings import (
    Linearize,
    MapSettings,
    RestorationSettings,
    check_noise_variance,
    check_tv_weight,
)

Float32 = NDArray[np.float32]

_TV_OF_NOISE, _LEAST_TV = 30.0, 3e-5
_LUMA_OF_NOISE = float(np.sum(np.square(LUMA_WEIGHTS)))
"""Variance of the luminance of noise of variance 1 in each channel."""

_DOUBT, _DOUBT_POWER = 2.0, 3
_SILENCE = 1e-8
_CLIPPED = 1 - 1 / 255

_FIRST_ROUNDING, _ROUNDING = 0.02, 1e-3
"""eps, of the first round and from which on it no longer halves: intensities in [0, 1]."""

_MOST_ROUNDS, _STEPS_A_ROUND = 20, 5
_TOLERANCE = 3e-3

_TILE = 64
_PRECONDITIONED_TV = 15.0
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
    progress: Progress = silent,
) -> Float32:
    psf = as_family(psf)
    check_noise_variance(noise_variance)
    check_tv_weight(tv_weight)
    picture = prepare_image(image, intensity_range, linearize)
    scales = checked_scales(blur_map, picture.shape, psf)
    sure = None if confidence is None else _checked_confidence(confidence, picture.shape)
    progress("Measuring the noise", 0.0)
    if noise_variance is None:
        noise_variance = estimate_noise_variance(
            image, linearize=linearize, intensity_range=intensity_range
        )
    if picture.color.shape[2] == 3:
        noise_variance /= _LUMA_OF_NOISE
    if tv_weight is None:
        tv_weight = _TV_OF_NOISE * noise_variance + _LEAST_TV
    weight = _weights(picture, scales, psf, sure, noise_variance)
    clipped = _clipped(picture, linearize)
    sharp = _minimize(picture.color, scales, psf, weight, clipped, tv_weight, progress)
    sharp = np.clip(sharp, 0, 1)
    if linearize == "srgb":
        sharp = encode_srgb(sharp)
    return _as_given(sharp, image, intensity_range)


def _weights(picture, scales, psf, sure, noise_variance) -> Float32:
    """How much the data of each pixel count, (H, W, 1): its noise over what else is wrong."""
    weight = np.ones((*picture.shape, 1), np.float32)
    if sure is not None:
        change = half_variance_slope(psf, scales)[..., None] * _laplacian(picture.color)
        doubt = _DOUBT * (1 - sure[..., None]) ** _DOUBT_POWER
        wrong = np.mean((doubt * change) ** 2, axis=2, keepdims=True)
        noise = max(noise_variance, _SILENCE)
        weight = noise / (noise + wrong)
    if picture.opaque is not None:
        weight = weight * picture.opaque[..., None]
    return weight.astype(np.float32)


def _clipped(picture, linearize):
    limit = np.float32(_CLIPPED)
    if linearize == "srgb":
        limit = decode_srgb(np.array([limit]))[0]
    clipped = picture.color >= limit
    return clipped if clipped.any() else None


def _minimize(color, scales, psf, weight, clipped, tv_weight, progress, watch=None):
    channels = color.shape[2]
    blur = BlurOperator(scales, psf, channels)
    tv = np.float32(tv_weight)
    invert = _TiledInverse(blur, scales, psf, weight[..., 0], _PRECONDITIONED_TV * tv_weight)
    sharp = blur.extend(color)
    data_pull = blur.adjoint(weight * (color - blur.apply(sharp)))
    start = invert(data_pull)
    sharp += start
    counted = weight
    data_pull -= blur.adjoint(weight * blur.apply(start))
    rounding = _FIRST_ROUNDING
    steps = 0
    for round_ in range(_MOST_ROUNDS):
        before = sharp.copy()
        if clipped is not None:
            blurred = blur.apply(sharp)
            counted = np.where(clipped & (blurred > color), np.float32(0), weight)
            data_pull = blur.adjoint(counted * (color - blurred))
        stiffness = _stiffness(sharp, tv, np.float32(rounding))
        residual = data_pull - _smoothness_form(stiffness, sharp)
        conditioned = invert(residual)
        direction = conditioned.copy()
        power = np.vdot(residual, conditioned)
        for _ in range(_STEPS_A_ROUND):
            progress("Taking the blur away", 0.0)
            steps += 1
            pull = blur.adjoint(counted * blur.apply(direction))
            form = pull + _smoothness_form(stiffness, direction)
            length = power / np.vdot(direction, form)
            sharp += length * direction
            data_pull -= length * pull
            residual -= length * form
            conditioned = invert(residual)
            power, last = np.vdot(residual, conditioned), power
            direction *= power / last
            direction += conditioned
        change = np.linalg.norm(sharp - before) / np.linalg.norm(sharp)
        if watch:
            watch(round_, steps, change, rounding, sharp[blur.inner])
        if rounding <= _ROUNDING and change < _TOLERANCE:
            break
        rounding = max(rounding / 2, _ROUNDING)
    return sharp[blur.inner]


class _TiledInverse:
    def __init__(self, blur, scales, psf, weight, tv) -> None:
        half = _TILE // 2
        self._domain = blur.domain
        self._tiles = tuple(-(-length // half) + 1 for length in blur.domain)
        self._size = tuple((count + 1) * half for count in self._tiles)
        wave = np.sin(np.pi * (np.arange(_TILE) + 0.5) / _TILE)
        self._window = np.outer(wave, wave).astype(np.float32)[..., None]
        edges = [
            (half + at.start, size - half - at.stop)
            for at, size in zip(blur.inner, self._size, strict=True)
        ]
        scale = self._views(np.pad(scales, edges, mode="edge")[..., None]).mean(axis=(2, 3, 4))
        count = self._views(np.pad(weight, edges, mode="edge")[..., None]).mean(axis=(2, 3, 4))
        steps = np.minimum(np.rint(scale / _SCALE_STEP), int(psf.max_scale / _SCALE_STEP)).astype(
            int
        )
        present, place = np.unique(steps, return_inverse=True)
        power = np.stack([_power(psf.kernel(_SCALE_STEP * step)) for step in present])
        rows, columns = fft.fftfreq(_TILE)[:, None], fft.rfftfreq(_TILE)
        laplacian = 4 - 2 * np.cos(2 * np.pi * rows) - 2 * np.cos(2 * np.pi * columns)
        form = count[..., None, None] * power[place.reshape(steps.shape)] + tv * laplacian
        self._filters = (1 / (form + 1e-2 * tv)).astype(np.float32)[..., None]
        self._pool = ThreadPoolExecutor(2)

    def _views(self, picture):
        half = _TILE // 2
        windows = np.lib.stride_tricks.sliding_window_view(picture, (_TILE, _TILE), axis=(0, 1))
        return windows[::half, ::half].transpose(0, 1, 3, 4, 2)

    def __call__(self, picture):
        half = _TILE // 2
        padded = np.zeros((*self._size, picture.shape[2]), np.float32)
        inner = tuple(slice(half, half + length) for length in self._domain)
        padded[inner] = picture
        views = self._views(padded)
        filtered = np.zeros_like(padded)

        def one(index):
            tiles = fft.rfft2(views[index] * self._window, axes=(1, 2))
            tiles *= self._filters[index]
            tiles = fft.irfft2(tiles, (_TILE, _TILE), axes=(1, 2), overwrite_x=True)
            tiles *= self._window
            rows = filtered[index * half : index * half + _TILE].reshape(
                _TILE, -1, half, picture.shape[2]
            )
            rows[:, :-1] += tiles[:, :, :half].swapaxes(0, 1)
            rows[:, 1:] += tiles[:, :, half:].swapaxes(0, 1)

        # Rows of tiles overlap their neighbours only.
        for parity in range(2):
            list(self._pool.map(one, range(parity, self._tiles[0], 2)))
        return filtered[inner]


def _power(kernel):
    frame = np.zeros((_TILE, _TILE))
    half = len(kernel) - _TILE
    if half > 0:
        raise ValueError
    frame[: len(kernel), : len(kernel)] = kernel
    return np.abs(fft.rfft2(frame)) ** 2


def _laplacian(color):
    padded = np.pad(color, ((1, 1), (1, 1), (0, 0)), mode="symmetric")
    inner = padded[1:-1, 1:-1]
    return (padded[2:, 1:-1] + padded[:-2, 1:-1] + padded[1:-1, 2:] + padded[1:-1, :-2]) - 4 * inner


@njit(cache=True, parallel=True, fastmath=True, nogil=True)
def _stiffness(picture: Float32, tv_weight: float, rounding: float) -> Float32:
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


def _checked_confidence(confidence, shape):
    array = np.asarray(confidence)
    if array.shape != shape:
        raise ValueError(f"confidence has shape {array.shape}; it takes the picture's, {shape}")
    return array.astype(np.float32)


def _as_given(sharp, image, intensity_range):
    array = np.asarray(image)
    if array.ndim == 2:
        return sharp[..., 0]
    return sharp
