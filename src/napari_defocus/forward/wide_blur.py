"""The blur of (1) where it is wide, by Fourier transforms of tiles.

A disc of 20 px has more than 1000 weights. So kernels are worked out at *nodes*, scales that lie a
part of an octave apart. A tile is convolved with the kernel of each node that occurs in it, and
each of its pixels mixes the two nodes around its own scale,

    (A f)[x] = sum_k c_k[x] (h_k * f)[x],        A' y = sum_k h_k(-) * (c_k y),

where (-) turns a kernel by half a turn. Both have the same weights.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import EllipsisType

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from napari_defocus.core.threads import in_bands
from napari_defocus.psf.families import PSFFamily

Float32 = NDArray[np.float32]

_NODES_AN_OCTAVE = 12
"""Kernels that are worked out in an octave of scales, with linear interpolation between. Fewer are
faster, more are nearer to the blur of each scale (docs/decisions.md).
"""

_KERNELS_A_TILE = 3
"""A tile is so many times as wide as the largest kernel. Chosen by hand."""


@dataclass(frozen=True)
class _Tile:
    """Where the pixels of a tile lie, its nodes, and which of them is below each pixel."""

    pixels: tuple[slice, slice]
    nodes: list[int]
    below: NDArray[np.intp]


class WideBlur:
    """A for those pixels of a map that are blurred widely; the others get nothing.

    Parameters
    ----------
    scales : (H, W) float32 ndarray
        In px.
    wide : (H, W) bool ndarray
        Which pixels count: at least one.
    least : float
        px. No scale that counts is smaller.
    psf : PSFFamily

    Attributes
    ----------
    side : int
        Of the largest kernel.
    """

    def __init__(
        self, scales: Float32, wide: NDArray[np.bool_], least: float, psf: PSFFamily
    ) -> None:
        place = _NODES_AN_OCTAVE * np.log2(np.maximum(scales, np.float32(least)) / least)
        self._below, self._wide = place.astype(np.int32), wide
        share = (place - self._below).astype(np.float32)
        self._mixture = np.where(wide, np.stack([1 - share, share]), np.float32(0))
        kernels = {}
        for node in self._nodes_of(...):
            scale = least * 2 ** (node / _NODES_AN_OCTAVE)
            kernels[node] = psf.kernel(min(scale, psf.max_scale))[::-1, ::-1]
        self.side = max(map(len, kernels.values()))
        self._length = fft.next_fast_len(_KERNELS_A_TILE * self.side, real=True)
        self._core = self._length - self.side + 1
        self._spectra = {node: self._spectrum(kernel) for node, kernel in kernels.items()}

    def add(self, picture: Float32, inner: tuple[slice, ...], blurred: Float32) -> None:
        """Add A f to (H, W, C), of f on a domain in which the picture lies at `inner`."""
        in_bands(self._gather, self._rows_of_tiles(), picture, inner, blurred)

    def add_adjoint(self, picture: Float32, inner: tuple[slice, ...], spread: Float32) -> None:
        """Add A' y to what lies on such a domain, of y, (H, W, C)."""
        # Rows of tiles share pixels with the next ones: every second one at once.
        for parity in range(2):
            rows = (self._rows_of_tiles() + 1 - parity) // 2
            in_bands(self._spread, rows, parity, picture, inner, spread)

    def _gather(
        self, start: int, stop: int, picture: Float32, inner: tuple[slice, ...], blurred: Float32
    ) -> None:
        for tile in self._tiles(range(start, stop)):
            seen = np.zeros((picture.shape[2], self._length, self._length), np.float32)
            part = np.moveaxis(picture[self._reach(tile, inner)], 2, 0)
            seen[:, : part.shape[1], : part.shape[2]] = part
            # The product of spectra spreads; with the conjugate, it gathers.
            spectra = fft.rfft2(seen) * np.conj(self._spectra_of(tile))
            nodes = fft.irfft2(spectra, seen.shape[1:], overwrite_x=True)
            height, width = tile.below.shape
            for above, mixture in enumerate(self._mixture):
                of_pixel = tile.below[None, None] + above
                mixed = np.take_along_axis(nodes[..., :height, :width], of_pixel, axis=0)[0]
                blurred[tile.pixels] += np.moveaxis(mixed * mixture[tile.pixels], 0, 2)

    def _spread(
        self,
        start: int,
        stop: int,
        parity: int,
        picture: Float32,
        inner: tuple[slice, ...],
        spread: Float32,
    ) -> None:
        for tile in self._tiles(range(2 * start + parity, 2 * stop, 2)):
            part = np.moveaxis(picture[tile.pixels], 2, 0)
            nodes = np.zeros((len(tile.nodes), len(part), self._length, self._length), np.float32)
            within = nodes[..., : part.shape[1], : part.shape[2]]
            for above, mixture in enumerate(self._mixture):
                of_pixel = tile.below[None, None] + above
                value = np.take_along_axis(within, of_pixel, axis=0) + part * mixture[tile.pixels]
                np.put_along_axis(within, of_pixel, value, axis=0)
            spectrum = np.sum(fft.rfft2(nodes) * self._spectra_of(tile), axis=0)
            sums = fft.irfft2(spectrum, nodes.shape[2:], overwrite_x=True)
            target = spread[self._reach(tile, inner)]
            target += np.moveaxis(sums[:, : target.shape[0], : target.shape[1]], 0, 2)

    def _tiles(self, rows: range) -> Iterator[_Tile]:
        """Yield the tiles of some rows that have wide pixels."""
        height, width = self._wide.shape
        for top in (row * self._core for row in rows):
            for left in range(0, width, self._core):
                pixels = (
                    slice(top, min(top + self._core, height)),
                    slice(left, min(left + self._core, width)),
                )
                nodes = self._nodes_of(pixels)
                if nodes:
                    below = np.where(self._wide[pixels], self._below[pixels], nodes[0])
                    yield _Tile(pixels, nodes, np.searchsorted(nodes, below))

    def _nodes_of(self, pixels: tuple[slice, slice] | EllipsisType) -> list[int]:
        present = np.unique(self._below[pixels][self._wide[pixels]])
        return [int(node) for node in np.union1d(present, present + 1)]

    def _rows_of_tiles(self) -> int:
        return -(-len(self._wide) // self._core)

    def _reach(self, tile: _Tile, inner: tuple[slice, ...]) -> tuple[slice, ...]:
        """Return where in the domain lies what a tile's pixels gather from."""
        starts = [
            at.start + pixels.start - self.side // 2
            for at, pixels in zip(inner, tile.pixels, strict=True)
        ]
        return tuple(slice(start, start + self._length) for start in starts)

    def _spectrum(self, kernel: NDArray[np.floating]) -> NDArray[np.complex64]:
        """Return the spectrum of a kernel in the corner of a tile, (length, length // 2 + 1)."""
        edge = (self.side - len(kernel)) // 2
        framed = np.pad(kernel, (edge, self._length - edge - len(kernel)))
        return fft.rfft2(framed).astype(np.complex64)

    def _spectra_of(self, tile: _Tile) -> NDArray[np.complex64]:
        return np.stack([self._spectra[node] for node in tile.nodes])[:, None]
