"""Which well of a plate a picture shows, as its name says, and how plates are laid out."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import PurePath

_NAMED = re.compile(r"(?<![A-Za-z0-9])([A-P])(0?[1-9]|1[0-9]|2[0-4])(?![0-9A-Za-z])")
_NUMBERED = re.compile(r"(?<![A-Za-z0-9])r(\d{2})c(\d{2})(?=f\d|[^0-9A-Za-z]|$)", re.IGNORECASE)
"""As some microscopes write it: r02c03f01 is a field of B03."""

_MOST = 0.9
"""If fewer of the names say a well, they are not about a plate. Chosen by hand."""

ROWS = "ABCDEFGHIJKLMNOP"
_LAYOUTS = ((8, 12), (16, 24))
"""Rows and columns of plates of 96 and of 384 wells."""


def wells_of(sources: Iterable[str]) -> dict[str, str]:
    """Return the well of each path that says one, A01 to P24; none if they are not about a plate.

    The name of the file counts, or else that of its folder. Of several words that look like a
    well, such as those of P01_A02_F03, the one that differs most from path to path is it. Paths
    are about a plate if nine in ten say a well, and these are several wells.

    Examples
    --------
    >>> wells_of(["day1/plate7_b3_s2.tif", "day1/plate7_b4_s2.tif"])
    {'day1/plate7_b3_s2.tif': 'B03', 'day1/plate7_b4_s2.tif': 'B04'}
    >>> wells_of(["r02c03f01.tiff", "P24/field1.png"])
    {'r02c03f01.tiff': 'B03', 'P24/field1.png': 'P24'}
    >>> wells_of(["A01.tif", "worm.tif"])
    {}
    """
    named = {source: _like_wells(source) for source in dict.fromkeys(sources)}
    telling = [wells for wells in named.values() if wells]
    if not telling or len(telling) < _MOST * len(named):
        return {}
    places = range(min(map(len, telling)))
    place = max(places, key=lambda at: len({wells[at] for wells in telling}))
    found = {source: wells[place] for source, wells in named.items() if wells}
    return found if len(set(found.values())) > 1 else {}


def _like_wells(source: str) -> list[str]:
    """Return the words of a path that look like wells: capitals first, then the folder's."""
    path = PurePath(source)
    for name in (path.stem, path.stem.upper(), path.parent.name):
        pairs = [(ROWS.index(row), int(column)) for row, column in _NAMED.findall(name)]
        pairs += [(int(row) - 1, int(column)) for row, column in _NUMBERED.findall(name)]
        rows, columns = _LAYOUTS[-1]
        wells = [
            f"{ROWS[row]}{column:02d}"
            for row, column in pairs
            if 0 <= row < rows and 1 <= column <= columns
        ]
        if wells:
            return wells
    return []


@dataclass(frozen=True)
class PlateLayout:
    """The rows and columns of a plate: letters and numbers."""

    rows: str
    columns: tuple[int, ...]

    @classmethod
    def of(cls, wells: Iterable[str]) -> PlateLayout:
        """Return the smallest usual plate, of 96 or 384 wells, that has these wells.

        Examples
        --------
        >>> len(PlateLayout.of(["A01", "H12"]).columns), PlateLayout.of(["I01"]).rows[-1]
        (12, 'P')
        """
        places = [(ROWS.index(well[0]) + 1, int(well[1:])) for well in wells]
        for rows, columns in _LAYOUTS:
            if all(row <= rows and column <= columns for row, column in places):
                break
        return cls(ROWS[:rows], tuple(range(1, columns + 1)))
