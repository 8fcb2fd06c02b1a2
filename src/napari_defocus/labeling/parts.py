"""Parts of a grid of nodes, in groups: those of one group do not touch, so that they go on at once.

A minimum cut of a part takes far less than its share of the time of a cut of the whole grid. What
is around a part is held meanwhile.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

Range = tuple[int, int]

_SIDE, _OVERLAP = 96, 12
"""Nodes along the side of a part, about; and those beyond its border that may change with it.
Chosen by energies and seconds (docs/decisions.md).
"""


@dataclass(frozen=True)
class Part:
    """Rows and columns of a grid that may change; one more on each side is seen."""

    rows: Range
    columns: Range
    shape: tuple[int, int]

    @property
    def seen(self) -> tuple[slice, slice]:
        """The nodes that it sees."""
        return slice(*self._seen(0)), slice(*self._seen(1))

    @property
    def free(self) -> tuple[int, int, int, int]:
        """Its first row, the one after the last, and the same of columns, among what it sees."""
        top, left = self._seen(0)[0], self._seen(1)[0]
        (first, stop), (start, end) = self.rows, self.columns
        return first - top, stop - top, start - left, end - left

    def _seen(self, axis: int) -> Range:
        start, stop = (self.rows, self.columns)[axis]
        return max(start - 1, 0), min(stop + 1, self.shape[axis])


def groups_of_parts(shape: tuple[int, int], *, shifted: bool) -> list[list[Part]]:
    """Cut a grid into parts, every second of both directions together.

    Shifted ones have their borders in the middle of the others.
    """
    axes = [_ranges(length, shifted) for length in shape]
    groups = [
        [Part(rows, columns, shape) for rows in axes[0][down::2] for columns in axes[1][right::2]]
        for down, right in product((0, 1), repeat=2)
    ]
    return [group for group in groups if group]


def _ranges(length: int, shifted: bool) -> list[Range]:
    count = max(1, round(length / _SIDE))
    borders = [length * number // count for number in range(1, count)]
    if shifted and count > 1:
        half = length // count // 2
        borders = [half, *(border + half for border in borders)]
    starts, stops = [0, *borders], [*borders, length]
    return [
        (max(start - _OVERLAP, 0), min(stop + _OVERLAP, length))
        for start, stop in zip(starts, stops, strict=True)
    ]
