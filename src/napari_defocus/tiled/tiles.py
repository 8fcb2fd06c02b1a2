"""How a picture is cut into tiles: a core, a halo around it, and a margin to blend over.

The core of a tile is what it is responsible for; cores do not overlap. Its pixels are core and
halo: what it must see for its core to come out as in the whole picture. Over a margin on both
sides of a border between cores, one tile goes over into the next.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.likelihood.scale_space import reach_of

Float32 = NDArray[np.float32]

MARGIN = 32
"""px on both sides of a border between cores, over which tiles are blended.

Chosen by hand: wide enough that no border shows in maps (docs/decisions.md).
"""

_COARSE_HALO, _FINE_HALO = 2.0, 3.0
"""Halos, in sides of a window. Data terms are exact from 2 on. With 3, labels differ from those of
the whole picture by 0.004 to 0.018 px on average; twice the work would halve that
(docs/decisions.md).
"""

_MOST_CELLS = 600_000
"""Cells that are labelled at once: about 0.2 kB each in memory, chosen by hand."""

_LEAST_LEVELS = 2
"""Cells have 4 x 4 windows or more: the third level of the multigrid labeling."""


@dataclass(frozen=True)
class Span:
    """A tile along one axis: the windows of its core, and those that it sees.

    Attributes
    ----------
    start, stop : int
        Windows of its core.
    first, last : int
        With those around; `first` is a multiple of the cells' size.
    pixels : (int, int)
        Those of the windows from `first` to `last`: the same windows, if looked at alone.
    core : (int, int)
        Pixels of its core.
    length : int
        Of the picture, in px.
    """

    start: int
    stop: int
    first: int
    last: int
    pixels: tuple[int, int]
    core: tuple[int, int]
    length: int

    @property
    def goes_on(self) -> tuple[bool, bool]:
        """Whether the picture goes on before and after what is seen."""
        return self.pixels[0] > 0, self.pixels[1] < self.length

    @property
    def with_margin(self) -> tuple[int, int]:
        """Pixels of its core and of the margin, in which it goes over into the next tiles."""
        low, high = self.core
        return max(low - MARGIN, 0), min(high + MARGIN, self.length)

    def share(self, at: NDArray[np.int64]) -> Float32:
        """Return how much this tile counts at pixels, from 0 to 1; all tiles add up to 1."""
        low, high = self.core
        rising = (at + 0.5 - low + MARGIN) / (2 * MARGIN)
        falling = (high + MARGIN - at - 0.5) / (2 * MARGIN)
        share = np.minimum(rising if low else 1.0, falling if high < self.length else 1.0)
        return np.broadcast_to(np.clip(share, 0, 1), at.shape).astype(np.float32)


@dataclass(frozen=True)
class Tile:
    """A tile of a picture.

    Attributes
    ----------
    rows, columns : Span
    seen_pixels : ((int, int), (int, int)) or None
        Rows and columns of pixels that coarse levels see; None if no more than the spans.
    """

    rows: Span
    columns: Span
    seen_pixels: tuple[tuple[int, int], tuple[int, int]] | None = None

    @property
    def seen(self) -> tuple[slice, slice]:
        """Where its coarse levels look, in the picture."""
        rows, columns = self.seen_pixels or (self.rows.pixels, self.columns.pixels)
        return slice(*rows), slice(*columns)

    @property
    def within(self) -> tuple[slice, slice]:
        """Where `pixels` are in what is `seen`."""
        rows, columns = (
            slice(part.start - all_.start, part.stop - all_.start)
            for part, all_ in zip(self.pixels, self.seen, strict=True)
        )
        return rows, columns

    @property
    def pixels(self) -> tuple[slice, slice]:
        """Where it looks, in the picture."""
        return slice(*self.rows.pixels), slice(*self.columns.pixels)

    @property
    def core_shape(self) -> tuple[int, int]:
        """Height and width of its core, in px."""
        return self.rows.core[1] - self.rows.core[0], self.columns.core[1] - self.columns.core[0]

    @property
    def core_windows(self) -> tuple[int, int]:
        """How many windows its core has: rows and columns."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    @property
    def inner_sides(self) -> tuple[bool, bool, bool, bool]:
        """Whether the picture goes on beyond the top, left, bottom and right of what it sees."""
        (top, bottom), (left, right) = self.rows.goes_on, self.columns.goes_on
        return top, left, bottom, right

    def core(self, *, margin: bool = False) -> tuple[slice, slice]:
        """Return where its core, or core and margin, are in what it sees."""
        return tuple(  # type: ignore[return-value]
            slice(low - span.pixels[0], high - span.pixels[0])
            for span in (self.rows, self.columns)
            for low, high in [span.with_margin if margin else span.core]
        )

    def core_cells(self, levels: int) -> tuple[slice, slice]:
        """Return where the cells of its core are among those that it sees."""
        rows, columns = self.rows, self.columns
        return (
            _cells(rows.start - rows.first, rows.stop - rows.first, levels),
            _cells(columns.start - columns.first, columns.stop - columns.first, levels),
        )

    def cells(self, levels: int) -> tuple[slice, slice]:
        """Return where the cells that it sees are among all of the picture."""
        rows, columns = self.rows, self.columns
        return _cells(rows.first, rows.last, levels), _cells(columns.first, columns.last, levels)


def _cells(start: int, stop: int, levels: int) -> slice:
    return slice(start >> levels, -(-stop >> levels))


@dataclass(frozen=True)
class Tiling:
    """How a picture is cut into tiles.

    Attributes
    ----------
    shape : (int, int)
        Height and width of the picture, in px.
    window, stride : int
    block_size : int
        Side of a tile's core, in px; the last ones may be smaller.
    scale_levels : int
        Of pictures with averaged pixels, see `scale_space`: tiles have the same ones as the whole.
    """

    shape: tuple[int, int]
    window: int
    stride: int
    block_size: int
    scale_levels: int = 1

    @property
    def levels(self) -> int:
        """The whole picture is labelled on a grid that is coarser by so many powers of two."""
        windows = [-(-length // self.stride) for length in self.shape]
        levels = _LEAST_LEVELS
        while (windows[0] >> levels) * (windows[1] >> levels) > _MOST_CELLS:
            levels += 1
        return levels

    @property
    def alone(self) -> bool:
        """Whether the picture is one tile."""
        return len(self._spans(0, 0)) * len(self._spans(1, 0)) == 1

    def tiles(self, *, coarse: bool = False) -> list[list[Tile]]:
        """Return rows of tiles; of the coarse pass, with a halo that is enough for data terms."""
        return self.tiles_with_halo((_COARSE_HALO if coarse else _FINE_HALO) * self.window)

    def tiles_with_halo(self, reach: float) -> list[list[Tile]]:
        """Return rows of tiles with a halo of so many px."""
        rows, columns = self._spans(0, reach), self._spans(1, reach)
        return [
            [Tile(row, column, (self._seen(0, row), self._seen(1, column))) for column in columns]
            for row in rows
        ]

    def _seen(self, axis: int, span: Span) -> tuple[int, int]:
        """Return the pixels that coarse levels see around those of a span."""
        reach = reach_of(self.scale_levels, self.window)
        if not reach:
            return span.pixels
        return self._span(axis, span.start, span.stop, span.first, span.last, reach).pixels

    def _spans(self, axis: int, reach: float) -> list[Span]:
        windows = -(-self.shape[axis] // self.stride)
        side = max(1, self.block_size // (self.stride * self._unit)) * self._unit
        spans = []
        for start in range(0, windows, side):
            stop = min(start + side, windows)
            spans.append(self._span(axis, start, stop, start, stop, reach))
        return spans

    @property
    def _unit(self) -> int:
        """Windows that tiles are multiples of: cells, and windows of the coarsest level, whole."""
        return 1 << max(self.levels, self.scale_levels - 1)

    def _span(self, axis: int, start: int, stop: int, first: int, last: int, reach: float) -> Span:
        """Return a core, and what is seen `reach` px around some windows."""
        length, stride, unit = self.shape[axis], self.stride, self._unit
        windows = -(-length // stride)
        # So that the windows of all levels are those of the whole, what is seen ends as it does.
        lacking = -length % (stride << (self.scale_levels - 1))
        halo = -(-int(np.ceil(reach / stride)) // unit) * unit
        first = max(first - halo, 0)
        last = -(-last // unit) * unit + halo
        end = last * stride - lacking
        if end >= length:
            last, end = windows, length
        else:
            last -= lacking // stride
        own = start * stride, length if stop == windows else stop * stride
        return Span(start, stop, first, last, (first * stride, end), own, length)


def neighbors(tiles: list[list[Tile]], row: int, column: int) -> Iterator[tuple[int, int]]:
    """Return which tiles reach into the core of one: itself and those around."""
    for y in range(max(row - 1, 0), min(row + 2, len(tiles))):
        for x in range(max(column - 1, 0), min(column + 2, len(tiles[0]))):
            yield y, x


def blended(
    target: Tile, near: list[Tile], found: list[dict[str, NDArray[Any]]], name: str
) -> Float32:
    """Put the core of a tile together from what it and its neighbours say of it.

    Parameters
    ----------
    target : Tile
    near : list of Tile
        Itself and its neighbours.
    found : list of dict of str to ((h, w) or (h, w, C) float32 ndarray)
        What each says of its core and margin, see `Span.with_margin`.
    name : str
        Of the result.

    Returns
    -------
    (h, w) or (h, w, C) float32 ndarray
    """
    pieces = [one[name] for one in found]
    colors = pieces[0].shape[2:]
    result = np.zeros(target.core_shape + colors, np.float32)
    for tile, values in zip(near, pieces, strict=True):
        into, out_of, shares = [], [], []
        for own, span in zip((target.rows, target.columns), (tile.rows, tile.columns), strict=True):
            low, high = max(own.core[0], span.with_margin[0]), min(own.core[1], span.with_margin[1])
            into.append(slice(low - own.core[0], high - own.core[0]))
            out_of.append(slice(low - span.with_margin[0], high - span.with_margin[0]))
            shares.append(span.share(np.arange(low, high)))
        if all(tile.stop > tile.start for tile in into):
            share = np.outer(*shares).reshape(len(shares[0]), len(shares[1]), *(1 for _ in colors))
            result[tuple(into)] += share * values[tuple(out_of)]
    return result
