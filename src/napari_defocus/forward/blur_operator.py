"""The blur of (1) as a linear operator A on pictures, and its adjoint.

Every output pixel gathers with the PSF of its own scale, (A f)[x] = sum_u h_{r(x)}[x - u] f[u];
the adjoint spreads each with the same weights, (A' y)[u] = sum_x h_{r(x)}[x - u] y[x]. Kernels
are interpolated linearly between scales 0.05 px apart, in steps of 0.0125 px. What is blurred
widely may gather by Fourier transforms instead, see `wide_blur`.

Pixels near the border gather from beyond it: f lives on a *domain* that is larger than the
picture on all sides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.compiled import compiled
from napari_defocus.core.image import given_array
from napari_defocus.core.threads import in_bands
from napari_defocus.forward.wide_blur import WideBlur
from napari_defocus.psf.families import PSFFamily

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
Int32 = NDArray[np.int32]

_KERNEL_STEP, _STEPS_BETWEEN = 0.05, 4
"""px between scales whose kernels are worked out, and how many steps of linear interpolation lie
between. Chosen by hand.
"""

_MOST_KERNELS = 200
"""Kernels whose variances tell how it grows, or a few more. Chosen by hand."""

_LANES = 8
"""Weights in a row of a kernel come in multiples of this, as in the processor's vectors."""

_LEAST_BAND = 16
"""Rows that one thread spreads at a time, or as many as a kernel has if that is more."""


class BlurOperator:
    """A, for one map of scales.

    Parameters
    ----------
    blur_map : (H, W) float32 ndarray
        Scale at every pixel, in px, within the family's domain.
    psf : PSFFamily
    channels : {1, 3}
        C, of the pictures that it is applied to.
    wide_from : float, optional
        px. From this scale on, kernels lie farther apart, which is faster; none by default.

    Attributes
    ----------
    shape : (int, int)
        H and W.
    domain : (int, int)
        Height and width of what it is applied to.
    inner : tuple of slice
        Where the picture lies in the domain.
    """

    def __init__(
        self, blur_map: Float32, psf: PSFFamily, channels: int, wide_from: float | None = None
    ) -> None:
        least = np.inf if wide_from is None else wide_from
        wide = blur_map >= least
        self._wide = WideBlur(blur_map, wide, least, psf) if wide.any() else None
        other = np.zeros(1, np.float32) if wide.all() else blur_map[~wide]
        first, kernels = _kernels_between(psf, float(other.min()), float(other.max()))
        kernels = _interpolated(kernels)
        side = kernels.shape[1]
        widest = side if self._wide is None else max(side, self._wide.side)
        self._margin = (widest - side) // 2
        self.shape: tuple[int, int] = (blur_map.shape[0], blur_map.shape[1])
        lanes = _in_lanes(side * channels)
        width = max(-(-lanes // channels) + self._margin, widest)
        self.domain: tuple[int, int] = (self.shape[0] + widest - 1, self.shape[1] + width - 1)
        reach = widest // 2
        self.inner: tuple[slice, ...] = tuple(slice(reach, reach + length) for length in self.shape)
        self._channels = channels
        step = np.float32(_KERNEL_STEP / _STEPS_BETWEEN)
        self._kernel = np.rint(blur_map / step - first * _STEPS_BETWEEN).astype(np.int32)
        self._kernel[wide] = -1
        self._weights, self._frames = _in_rows(kernels, lanes, channels)

    def extend(self, picture: Float32) -> Float32:
        """Mirror a picture, (H, W, C), at its border to fill the domain."""
        margins = [
            (at.start, whole - at.stop) for at, whole in zip(self.inner, self.domain, strict=True)
        ]
        return np.pad(picture, (*margins, (0, 0)), mode="symmetric")

    def apply(self, picture: Float32) -> Float32:
        """Return A f, (H, W, C), of f on the domain."""
        blurred = np.empty((*self.shape, self._channels), np.float32)
        kernels = self._kernel, self._weights, self._frames, self._margin
        in_bands(_gather, self.shape[0], _rows(picture), *kernels, _rows(blurred))
        if self._wide is not None:
            self._wide.add(picture, self.inner, blurred)
        return blurred

    def adjoint(self, picture: Float32) -> Float32:
        """Return A' y on the domain, of y, (H, W, C)."""
        spread = np.zeros((*self.domain, self._channels), np.float32)
        arguments = (
            _rows(np.ascontiguousarray(picture)), self._kernel, self._weights, self._frames,
            self._margin, _rows(spread),
        )  # fmt: skip
        # Bands of rows that write to no common row, every second one, at once.
        height = max(self._weights.shape[1], _LEAST_BAND)
        bands = -(-self.shape[0] // height)
        for parity in range(2):
            in_bands(_spread, (bands + 1 - parity) // 2, parity, height, *arguments)
        if self._wide is not None:
            self._wide.add_adjoint(picture, self.inner, spread)
        return spread


def half_variance_slope(psf: PSFFamily, blur_map: Float32) -> Float32:
    """Return half the growth of the kernels' variance with the scale, in px, at each scale.

    As the heat equation has it, a small change of the scale changes a picture g by about this
    times its Laplacian: for a disc, r / 4.
    """
    low, high = float(blur_map.min()), float(blur_map.max())
    # Of wide blur, few of many kernels will do.
    step = _KERNEL_STEP * np.ceil((high - low) / (_KERNEL_STEP * _MOST_KERNELS) + 1e-9)
    first, kernels = _kernels_between(psf, low, high, step)
    side = kernels.shape[1]
    offset = np.arange(side) - side // 2
    square = (offset**2 + offset[:, None] ** 2) / 2
    variance = np.sum(kernels * square, axis=(1, 2))
    slope = np.maximum(np.gradient(variance, step), 0) / 2
    position = blur_map / step - first
    return np.interp(position, np.arange(len(slope)), slope).astype(np.float32)


def checked_scales(blur_map: ArrayLike, shape: tuple[int, int], psf: PSFFamily) -> Float32:
    """Check a map of scales against a picture's height and width, and a family's domain."""
    scales = given_array("blur_map", blur_map)
    if scales.shape != shape:
        raise ValueError(f"blur_map has shape {scales.shape}; it takes the picture's, {shape}")
    if scales.dtype.kind not in "uif":
        raise TypeError(f"blur_map has dtype {scales.dtype}; it takes real numbers")
    if not (np.isfinite(scales).all() and scales.min() >= 0 and scales.max() <= psf.max_scale):
        raise ValueError(
            f"blur_map has scales from {scales.min()} to {scales.max()} px; "
            f"{psf!r} takes 0 to {psf.max_scale} px"
        )
    return scales.astype(np.float32, order="C")


def _rows(picture: Float32) -> Float32:
    return picture.reshape(picture.shape[0], -1)


def _kernels_between(
    psf: PSFFamily, low: float, high: float, step: float = _KERNEL_STEP
) -> tuple[int, Float64]:
    """Return kernels in one frame, (K, S, S), and the number of the first of them.

    Number k has the scale k times the step, in px; they reach past both ends.
    """
    first, last = int(low / step), int(high / step) + 2
    kernels = [psf.kernel(step * k) for k in range(first, last + 1)]
    side = max(len(kernel) for kernel in kernels)
    frames = np.zeros((len(kernels), side, side))
    for frame, kernel in zip(frames, kernels, strict=True):
        edge = (side - len(kernel)) // 2
        frame[edge : edge + len(kernel), edge : edge + len(kernel)] = kernel
    return first, frames


def _interpolated(kernels: Float64) -> Float64:
    """Put kernels between neighbouring ones."""
    place = np.arange((len(kernels) - 1) * _STEPS_BETWEEN) / _STEPS_BETWEEN
    near = place.astype(np.intp)
    share = (place - near)[:, None, None]
    return (1 - share) * kernels[near] + share * kernels[near + 1]


def _in_rows(kernels: Float64, lanes: int, channels: int) -> tuple[Float32, Int32]:
    """Lay out kernels for `_gather` and `_spread`.

    Returns
    -------
    rows : (K, S, lanes) float32 ndarray
        Each kernel from its first column that is not empty, each weight repeated for all
        channels. A PSF is turned by half a turn when it gathers instead of spreading.
    frames : (K, 4) int32 ndarray
        The first row, the row after the last, the first column and the number of weights in a row,
        a multiple of `_LANES`.
    """
    turned = kernels[:, ::-1, ::-1]
    side = kernels.shape[1]
    laid = np.zeros((len(kernels), side, lanes), np.float32)
    frames = np.zeros((len(kernels), 4), np.int32)
    for kernel, rows, frame in zip(turned, laid, frames, strict=True):
        high, wide = (np.flatnonzero(kernel.any(axis=axis)) for axis in (1, 0))
        used = _in_lanes((wide[-1] + 1 - wide[0]) * channels)
        left = min(wide[0], (lanes - used) // channels)
        rows[:, : (side - left) * channels] = kernel[:, left:].repeat(channels, axis=1)
        frame[:] = high[0], high[-1] + 1, left, used
    return laid, frames


def _in_lanes(weights: int) -> int:
    return -(-weights // _LANES) * _LANES


@compiled
def _gather(
    start: int,
    stop: int,
    domain: Float32,
    kernel: Int32,
    rows: Float32,
    frames: Int32,
    margin: int,
    blurred: Float32,
) -> None:
    width = kernel.shape[1]
    channels = blurred.shape[1] // width
    total = np.empty(rows.shape[2], np.float32)
    for row in range(start, stop):
        for column in range(width):
            index = kernel[row, column]
            if index < 0:
                blurred[row, column * channels : (column + 1) * channels] = 0
                continue
            top, bottom, left, used = frames[index]
            at = (column + left + margin) * channels
            total[:used] = 0
            # Slices, as the compiler makes vectors only of places that it sees to be in a row.
            for i in range(top, bottom):
                seen, weight = domain[row + margin + i, at : at + used], rows[index, i]
                for lane in range(used):
                    total[lane] += weight[lane] * seen[lane]
            for channel in range(channels):
                value = np.float32(0)
                for lane in range(channel, used, channels):
                    value += total[lane]
                blurred[row, column * channels + channel] = value


@compiled
def _spread(
    start: int,
    stop: int,
    parity: int,
    thick: int,
    picture: Float32,
    kernel: Int32,
    rows: Float32,
    frames: Int32,
    margin: int,
    domain: Float32,
) -> None:
    height, width = kernel.shape
    channels = picture.shape[1] // width
    value = np.empty(rows.shape[2], np.float32)
    for pair in range(start, stop):
        first = (2 * pair + parity) * thick
        for row in range(first, min(first + thick, height)):
            for column in range(width):
                index = kernel[row, column]
                if index < 0:
                    continue
                top, bottom, left, used = frames[index]
                at = (column + left + margin) * channels
                for channel in range(channels):
                    for lane in range(channel, used, channels):
                        value[lane] = picture[row, column * channels + channel]
                for i in range(top, bottom):
                    spread, weight = domain[row + margin + i, at : at + used], rows[index, i]
                    for lane in range(used):
                        spread[lane] += weight[lane] * value[lane]
