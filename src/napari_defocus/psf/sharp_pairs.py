"""The point spread function from pairs: what turns a sharp picture into the blurred one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls
from scipy.signal import correlate

from napari_defocus.psf.cleaning import border_of, centered, cleaned

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_MIDDLE = 512
"""px: side of the middle part that is compared, as the PSF of a lens differs in the corners. By
hand.
"""

_REACHES = (4, 8, 12, 17, 23)
"""px from the middle of a kernel to its border, tried in turn until the border is dark. By hand."""

_DARK = 0.05
"""Borders are dark if their mean is at most this share of the brightest pixel. Chosen by hand."""

_EXPLAINED = 0.5
"""Share of the blurred picture's variance. If less is explained, the pictures show different
things. By hand.
"""

_RIDGE = 1e-5
"""Added to the diagonal of the normal equations, as a share of its mean (Tikhonov regularization).
By hand.
"""


def kernel_of_pair(blurred: Float32, sharp: Float32, name: str) -> Float64:
    """Find the kernel that turns the sharp picture into the blurred one: (K, K), sum 1."""
    blurred, sharp = _aligned(_middle(blurred), _middle(sharp))
    widest = min(sharp.shape) // 4
    for reach in (reach for reach in _REACHES if reach <= widest):
        kernel, explained = _least_squares_kernel(blurred, sharp, reach)
        if border_of(kernel).mean() <= _DARK * kernel.max():
            if explained < _EXPLAINED:
                break
            return cleaned(centered(kernel))
    raise ValueError(
        f"{name} does not show what its sharp picture shows, "
        f"or is blurred over more than {min(widest, _REACHES[-1])} px from the centre"
    )


def _middle(picture: Float32) -> Float32:
    """Cut the middle out of a large picture."""
    top, left = (max(length - _MIDDLE, 0) // 2 for length in picture.shape)
    return picture[top : top + _MIDDLE, left : left + _MIDDLE]


def _aligned(blurred: Float32, sharp: Float32) -> tuple[Float32, Float32]:
    """Cut two pictures down to what both show, moved by whole px."""
    # What one shows beyond the border of the other must not count: both fade out.
    fading = np.multiply.outer(*(np.hanning(length) for length in sharp.shape))
    pair = ((picture - picture.mean()) * fading for picture in (blurred, sharp))
    likeness = correlate(*pair, mode="same", method="fft")
    best = np.unravel_index(np.argmax(likeness), likeness.shape)
    shift = np.array(best) - np.array(likeness.shape) // 2
    ahead = tuple(slice(max(amount, 0), min(amount, 0) or None) for amount in shift)
    behind = tuple(slice(max(-amount, 0), min(-amount, 0) or None) for amount in shift)
    return blurred[ahead], sharp[behind]


def _least_squares_kernel(blurred: Float32, sharp: Float32, reach: int) -> tuple[Float64, float]:
    """Minimise |sharp * h - blurred|^2 for h >= 0, up to a constant brightness.

    Returns
    -------
    kernel : (K, K) float64 ndarray
    explained : float
        The share of the blurred picture's variance that it explains, from 0 to 1.
    """
    target = blurred[reach:-reach, reach:-reach].astype(np.float64)
    target -= target.mean()
    source = sharp - sharp.mean(dtype=np.float64)
    normal = _correlations(source, reach)
    right = correlate(source, target, mode="valid")[::-1, ::-1].ravel()
    ridge = _RIDGE * np.trace(normal) / len(normal) + np.finfo(float).tiny
    factor = cholesky(normal + ridge * np.eye(len(normal)), lower=True)
    kernel, _ = nnls(factor.T, solve_triangular(factor, right, lower=True))
    power = np.sum(target**2)
    explained = (2 * kernel @ right - kernel @ normal @ kernel) / power if power > 0 else 0.0
    return kernel.reshape(2 * reach + 1, -1), explained


def _correlations(source: Float64, reach: int) -> Float64:
    """Return the products of the inner part of a picture moved in two ways: (K^2, K^2).

    Entry (u, v) is the sum over x of f[x - u] f[x - v] without the means; it is found from the
    product of the picture with itself moved by v - u, once for all pairs of that difference.
    """
    side = 2 * reach + 1
    height, width = source.shape
    rows, columns = (_moved_inner_part(length, reach) for length in source.shape)
    products = np.empty((side, side, side, side))
    for down, across in np.ndindex(side, 2 * side - 1):
        across -= side - 1
        if down == 0 and across < 0:
            continue
        left, right = max(across, 0), width + min(across, 0)
        moved = source[: height - down, left - across : right - across]
        sums = (
            rows[: side - down, down:]
            @ (source[down:, left:right] * moved)
            @ columns[max(-across, 0) : side - max(across, 0), left:right].T
        )
        i, j = (np.arange(length) for length in sums.shape)
        i, j = i[:, None], j + max(-across, 0)
        products[i, j, i + down, j + across] = sums
        products[i + down, j + across, i, j] = sums
    inner = (height - 2 * reach) * (width - 2 * reach)
    means = (rows @ source @ columns.T).ravel() / inner
    return products.reshape(side**2, -1) - inner * np.multiply.outer(means, means)


def _moved_inner_part(length: int, reach: int) -> Float64:
    """Mark the pixels that lie `reach` or more inside, moved by reach ... -reach: (K, length)."""
    first = 2 * reach - np.arange(2 * reach + 1)[:, None]
    place = np.arange(length)
    return ((place >= first) & (place < first + length - 2 * reach)).astype(np.float64)
