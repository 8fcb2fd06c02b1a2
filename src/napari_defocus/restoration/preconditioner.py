"""The preconditioner of the conjugate gradients of (19): overlapping tiles, a Wiener filter each.

Take a tile of one scale with the transfer function H, the mean weight w and the constant IRLS
weight c. There, A' w A + grad' c grad is about the convolution with the spectrum w |H|^2 + c |D|^2,
where |D|^2 is that of the Laplacian. Tiles are divided by this spectrum. Sine windows are applied
before and after it; their squares add up to 1.
"""

from __future__ import annotations

from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from napari_defocus.forward.blur_operator import BlurOperator
from napari_defocus.psf.families import PSFFamily

Float32 = NDArray[np.float32]

_TILE = 64
"""px: the least side of a tile (docs/decisions.md), or two kernels if that is more."""

_SCALE_STEP = 0.25
"""px between the scales that tiles may have. Chosen by hand."""

_LEAST_LAPLACIAN = 1e-2
"""Added to |D|^2, which is 0 for the mean. Chosen by hand."""


class TiledPreconditioner:
    """Nearly the inverse of A' w A + c grad' grad, for preconditioned conjugate gradients.

    Parameters
    ----------
    blur : BlurOperator
    scales, weight : (H, W) float32 ndarray
        What makes A, and w.
    psf : PSFFamily
    regularization : float
        c, the same everywhere.
    pool : Executor
        What filters rows of tiles at once.
    """

    def __init__(
        self,
        blur: BlurOperator,
        scales: Float32,
        psf: PSFFamily,
        weight: Float32,
        regularization: float,
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
        form += (regularization * (laplacian + _LEAST_LAPLACIAN)).astype(np.float32)
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
