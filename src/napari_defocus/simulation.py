"""The forward model (1): a sharp picture seen through a blur that varies from place to place."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from napari_defocus.image import prepare_image
from napari_defocus.psf import Disc, PSFFamily, as_family

Float32 = NDArray[np.float32]

_KERNEL_STEP = 0.05


def simulate_defocus(
    image: ArrayLike,
    blur_map: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    noise_variance: float = 0.0,
    rng: int | np.random.Generator | None = None,
    intensity_range: tuple[float, float] | None = None,
) -> Float32:
    """Blur a sharp picture by a map of scales and add noise, as (1) has it.

    Every output pixel gathers from its neighbours with the PSF of its own scale:
    g[x] = sum_u h_{r(x)}[u] f[x - u] + n[x]. The picture is mirrored at its border.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The sharp picture; a fourth channel (opacity) is left out.
    blur_map : (H, W) array_like
        Scale at every pixel, in px, within the family's domain. Kernels are interpolated
        between scales 0.05 px apart.
    psf : PSFFamily or callable, optional
    noise_variance : float, optional
        Variance of the white Gaussian noise in each channel, intensities in [0, 1].
    rng : int or numpy.random.Generator, optional
        Seed or source of the noise.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1.

    Returns
    -------
    (H, W) or (H, W, 3) float32 ndarray
        Nominally in [0, 1]; noise may go beyond, nothing is clipped.

    Raises
    ------
    TypeError, ValueError
        If `image` is no picture (see `estimate_candidates`), if `blur_map` has another shape
        or scales outside the domain, or if `noise_variance` is negative.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_defocus import simulate_defocus
    >>> point = np.zeros((5, 5)); point[2, 2] = 1.0
    >>> simulate_defocus(point, np.full((5, 5), 1.0))[1:4, 1:4].round(3)
    array([[0.025, 0.145, 0.025],
           [0.145, 0.318, 0.145],
           [0.025, 0.145, 0.025]], dtype=float32)
    """
    psf = as_family(psf)
    picture = prepare_image(image, intensity_range)
    scales = _checked_map(blur_map, picture.shape, psf)
    if not (np.isfinite(noise_variance) and noise_variance >= 0):
        raise ValueError(f"noise_variance is {noise_variance}; it takes a finite number from 0 up")
    kernels = _kernel_stack(psf)
    reach = kernels.shape[1] // 2
    padded = np.pad(picture.color, ((reach, reach), (reach, reach), (0, 0)), mode="symmetric")
    blurred = _gather(padded, scales / np.float32(_KERNEL_STEP), kernels)
    if noise_variance > 0:
        noise = np.random.default_rng(rng).standard_normal(blurred.shape, np.float32)
        blurred += np.float32(np.sqrt(noise_variance)) * noise
    return blurred[..., 0] if blurred.shape[2] == 1 else blurred


def _checked_map(blur_map: ArrayLike, shape: tuple[int, int], psf: PSFFamily) -> Float32:
    scales = np.asarray(blur_map)
    if scales.shape != shape:
        raise ValueError(f"blur_map has shape {scales.shape}; it takes the picture's, {shape}")
    if scales.dtype.kind not in "uif":
        raise TypeError(f"blur_map has dtype {scales.dtype}; it takes real numbers")
    if not (np.isfinite(scales).all() and scales.min() >= 0 and scales.max() <= psf.max_scale):
        raise ValueError(
            f"blur_map has scales from {scales.min()} to {scales.max()} px; "
            f"{psf!r} takes 0 to {psf.max_scale} px"
        )
    return scales.astype(np.float32)


def _kernel_stack(psf: PSFFamily) -> Float32:
    """Return the kernels of scales 0, 0.05, ... px past the domain's end, in one frame."""
    count = int(np.ceil(psf.max_scale / _KERNEL_STEP)) + 2
    kernels = [psf.kernel(_KERNEL_STEP * k) for k in range(count)]
    side = max(len(kernel) for kernel in kernels)
    stack = np.zeros((count, side, side), np.float32)
    for frame, kernel in zip(stack, kernels, strict=True):
        edge = (side - len(kernel)) // 2
        frame[edge : edge + len(kernel), edge : edge + len(kernel)] = kernel
    return stack


@njit(cache=True, parallel=True, fastmath=True, nogil=True)
def _gather(padded: Float32, position: Float32, kernels: Float32) -> Float32:
    height, width = position.shape
    side, channels = kernels.shape[1], padded.shape[2]
    blurred = np.zeros((height, width, channels), np.float32)
    for row in prange(height):
        for column in range(width):
            index = int(position[row, column])
            share = position[row, column] - np.float32(index)
            # A PSF is turned by half a turn when it gathers instead of spreading.
            for i in range(side):
                for j in range(side):
                    near = kernels[index, side - 1 - i, side - 1 - j]
                    far = kernels[index + 1, side - 1 - i, side - 1 - j]
                    weight = near + share * (far - near)
                    if weight != 0:
                        for channel in range(channels):
                            blurred[row, column, channel] += (
                                weight * padded[row + i, column + j, channel]
                            )
    return blurred
