"""How a picture too large for one go is cut into parts that see enough around themselves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

MARGIN = 32
"""px on both sides of a border over which one part goes over into the next."""

_SURVEY_REACH, _LABEL_REACH = 1.5, 3.0
"""Of the window's side: from where on data terms are exact, and labels as in the whole."""

_MOST_CELLS = 600_000
_LEAST_LEVELS = 2


@dataclass(frozen=True)
class Span:
    """A part of one axis: its own windows, and those that it sees.

    Attributes
    ----------
    start, stop : int
        Its own windows.
    first, last : int
        With those around; multiples of the cells' size, but at the picture's end.
    pixels : (int, int)
        Those of the windows from `first` to `last`: the same windows, if looked at alone.
    own : (int, int)
        Pixels of its own.
    length : int
        Of the picture, in px.
    """

    start: int
    stop: int
    first: int
    last: int
    pixels: tuple[int, int]
    own: tuple[int, int]
    length: int

    @property
    def goes_on(self) -> tuple[bool, bool]:
        """Whether the picture goes on before and after what is seen."""
        return self.pixels[0] > 0, self.pixels[1] < self.length

    @property
    def extended(self) -> tuple[int, int]:
        """Pixels of its own, and as far beyond as it goes over into the next parts."""
        low, high = self.own
        return max(low - MARGIN, 0), min(high + MARGIN, self.length)

    def share(self, at: NDArray[np.int64]) -> Float32:
        """Return how much this part counts at pixels, from 0 to 1; all parts add up to 1."""
        low, high = self.own
        rising = (at + 0.5 - low + MARGIN) / (2 * MARGIN)
        falling = (high + MARGIN - at - 0.5) / (2 * MARGIN)
        share = np.minimum(rising if low else 1.0, falling if high < self.length else 1.0)
        return np.broadcast_to(np.clip(share, 0, 1), at.shape).astype(np.float32)


@dataclass(frozen=True)
class Part:
    """A part of a picture.

    Attributes
    ----------
    rows, columns : Span
    """

    rows: Span
    columns: Span

    @property
    def pixels(self) -> tuple[slice, slice]:
        """Where it looks, in the picture."""
        return slice(*self.rows.pixels), slice(*self.columns.pixels)

    @property
    def own_shape(self) -> tuple[int, int]:
        """Height and width of what it is responsible for, in px."""
        return self.rows.own[1] - self.rows.own[0], self.columns.own[1] - self.columns.own[0]

    @property
    def own_windows(self) -> tuple[int, int]:
        """How many windows it has of its own: rows and columns."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    @property
    def inner_sides(self) -> tuple[bool, bool, bool, bool]:
        """Whether the picture goes on beyond the top, left, bottom and right of what it sees."""
        (top, bottom), (left, right) = self.rows.goes_on, self.columns.goes_on
        return top, left, bottom, right

    def own(self, *, extended: bool = False) -> tuple[slice, slice]:
        """Return where its own pixels, or the extended ones, are in what it sees."""
        return tuple(  # type: ignore[return-value]
            slice(low - span.pixels[0], high - span.pixels[0])
            for span in (self.rows, self.columns)
            for low, high in [span.extended if extended else span.own]
        )

    def own_cells(self, levels: int) -> tuple[slice, slice]:
        """Return where its own cells are among those that it sees."""
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
class Cutting:
    """How a picture is cut.

    Attributes
    ----------
    shape : (int, int)
        Height and width of the picture, in px.
    window, stride : int
    block_size : int
        Side of a part's own pixels, in px; the last ones may be smaller.
    """

    shape: tuple[int, int]
    window: int
    stride: int
    block_size: int

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
        """Whether the picture is one part."""
        return len(self._spans(0, 0)) * len(self._spans(1, 0)) == 1

    def parts(self, *, survey: bool = False) -> list[list[Part]]:
        """Return rows of parts; for a survey, those that see just enough for the data term."""
        return self.parts_that_see((_SURVEY_REACH if survey else _LABEL_REACH) * self.window)

    def parts_that_see(self, reach: float) -> list[list[Part]]:
        """Return rows of parts that see so many px around themselves."""
        columns = self._spans(1, reach)
        return [[Part(row, column) for column in columns] for row in self._spans(0, reach)]

    def _spans(self, axis: int, reach: float) -> list[Span]:
        length, stride = self.shape[axis], self.stride
        windows = -(-length // stride)
        lacking = windows * stride - length
        cell = 1 << self.levels
        side = max(1, self.block_size // (stride * cell)) * cell
        halo = -(-int(np.ceil(reach / stride)) // cell) * cell
        spans = []
        for start in range(0, windows, side):
            stop = min(start + side, windows)
            first, last = max(start - halo, 0), min(stop + halo, windows)
            pixels = first * stride, last * stride - lacking
            own = start * stride, length if stop == windows else stop * stride
            spans.append(Span(start, stop, first, last, pixels, own, length))
        return spans


def neighbors(parts: list[list[Part]], row: int, column: int) -> Iterator[tuple[int, int]]:
    """Return which parts reach into one's own pixels: itself and those around."""
    for y in range(max(row - 1, 0), min(row + 2, len(parts))):
        for x in range(max(column - 1, 0), min(column + 2, len(parts[0]))):
            yield y, x


def blended(target: Part, pieces: list[tuple[Part, Float32]]) -> Float32:
    """Put a part's own pixels together from what it and its neighbours say of them.

    Parameters
    ----------
    target : Part
    pieces : list of (Part, (h, w) or (h, w, C) float32 ndarray)
        Each with what it says of its own pixels and those beyond, see `Span.extended`.

    Returns
    -------
    (h, w) or (h, w, C) float32 ndarray
    """
    colors = pieces[0][1].shape[2:]
    result = np.zeros(target.own_shape + colors, np.float32)
    for part, values in pieces:
        into, out_of, shares = [], [], []
        for own, span in zip((target.rows, target.columns), (part.rows, part.columns), strict=True):
            low, high = max(own.own[0], span.extended[0]), min(own.own[1], span.extended[1])
            into.append(slice(low - own.own[0], high - own.own[0]))
            out_of.append(slice(low - span.extended[0], high - span.extended[0]))
            shares.append(span.share(np.arange(low, high)))
        if all(part.stop > part.start for part in into):
            share = np.outer(*shares).reshape(len(shares[0]), len(shares[1]), *(1 for _ in colors))
            result[tuple(into)] += share * values[tuple(out_of)]
    return result
