"""Which well of which plate a picture shows, as its name says, and how plates are laid out."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter
from pathlib import PurePath

_NAMED = re.compile(r"(?<![A-Za-z0-9])([A-P])(0?[1-9]|1[0-9]|2[0-4])(?![0-9A-Za-z])")
_NUMBERED = re.compile(r"(?<![A-Za-z0-9])r(\d{2})c(\d{2})(?=f\d|[^0-9A-Za-z]|$)", re.IGNORECASE)
"""As some microscopes write it: r02c03f01 is a field of B03."""

_MOST = 0.9
"""If fewer of the names say a well, they are not about a plate. Chosen by hand."""

_COUNTERS = "CDFMP"
"""Letters that number something else, too: channels, days, fields, mosaics, positions."""

ROWS = "ABCDEFGHIJKLMNOP"
_LAYOUTS = ((8, 12), (16, 24))
"""Rows and columns of plates of 96 and of 384 wells."""


@dataclass(frozen=True)
class WellWord:
    """A word of a path that looks like a well, A01 to P24, and the path before the word.

    `is_loose` says that it is written as other numbers are, too, such as f1 or C2. `folder` is the
    folder of the file, or of the folder that has the word.
    """

    well: str
    before: str
    folder: str
    is_loose: bool


def wells_of(sources: Iterable[str]) -> dict[str, str]:
    """Return the well of each path that says one, A01 to P24; none if they are not about a plate.

    The name of the file counts, or else that of its folder. Of several words that look like a
    well, such as those of P01_A02_F03, the first one counts that has several rows of a plate, or
    else that differs from path to path and is no number of a channel, field or position. Paths are
    about a plate if nine in ten say a well, and these are several wells.

    Examples
    --------
    >>> wells_of(["day1/plate7_b3_s2.tif", "day1/plate7_b4_s2.tif"])
    {'day1/plate7_b3_s2.tif': 'B03', 'day1/plate7_b4_s2.tif': 'B04'}
    >>> wells_of(["r02c03f01.tiff", "P24/field1.png"])
    {'r02c03f01.tiff': 'B03', 'P24/field1.png': 'P24'}
    >>> wells_of(["A01.tif", "worm.tif"]), wells_of(["cells_f1.tif", "cells_f2.tif"])
    ({}, {})
    """
    return {source: word.well for source, word in _words_of(sources).items()}


def plates_of(sources: Iterable[str]) -> dict[str, str]:
    """Return the plate of each path that says a well: what its path says before the well.

    Paths are of several plates only if these have the same wells, and several each. Otherwise they
    have one name, which is empty.

    Examples
    --------
    >>> list(plates_of(["p1/A01.tif", "p1/A02.tif", "p2/A01.tif", "p2/A02.tif"]).values())
    ['p1', 'p1', 'p2', 'p2']
    >>> list(plates_of(["7_A01.tif", "8_A01.tif", "9_A02.tif"]).values())
    ['', '', '']
    """
    words = _words_of(sources)
    for named in (attrgetter("before"), attrgetter("folder")):
        held: dict[str, set[str]] = {}
        for word in words.values():
            held.setdefault(named(word), set()).add(word.well)
        repeated = sum(map(len, held.values())) > len(set().union(*held.values()))
        if repeated and all(len(wells) > 1 for wells in held.values()):
            return {source: named(word).rstrip("/_-. ") for source, word in words.items()}
    return dict.fromkeys(words, "")


def _words_of(sources: Iterable[str]) -> dict[str, WellWord]:
    given = list(dict.fromkeys(sources))
    return _agreed({source: _like_wells(source) for source in given}) or _agreed(
        {source: _in_folder(source) for source in given}
    )


def _agreed(named: dict[str, list[WellWord]]) -> dict[str, WellWord]:
    """Return the word of each path that is its well; none if the paths are not about a plate."""
    telling = [words for words in named.values() if words]
    if not telling or len(telling) < _MOST * len(named):
        return {}
    places = [[words[at] for words in telling] for at in range(min(map(len, telling)))]
    fitting = [at for at, words in enumerate(places) if _may_be_wells(words)]
    if not fitting:
        return {}
    place = max(fitting, key=lambda at: (*_likeliness(places[at]), -at))
    return {source: words[place] for source, words in named.items() if words}


def _may_be_wells(words: list[WellWord]) -> bool:
    """Return whether words differ, and do not number something else: f1, f2, f3."""
    counts = len(_rows(words)) == 1 and words[0].well[0] in _COUNTERS
    return len({word.well for word in words}) > 1 and not (
        counts and any(word.is_loose for word in words)
    )


def _likeliness(words: list[WellWord]) -> tuple[bool, bool]:
    return len(_rows(words)) > 1, words[0].well[0] not in _COUNTERS


def _rows(words: list[WellWord]) -> set[str]:
    return {word.well[0] for word in words}


def _like_wells(source: str) -> list[WellWord]:
    """Return the words of a path that look like wells: capitals first, then the folder's."""
    path = PurePath(source)
    stem, folder = path.stem, str(path.parent)
    return _found(stem, stem, folder) or _found(stem.upper(), stem, folder) or _in_folder(source)


def _in_folder(source: str) -> list[WellWord]:
    folder = PurePath(source).parent
    return _found(folder.name, folder.name, str(folder.parent))


def _found(text: str, name: str, folder: str) -> list[WellWord]:
    """Return what looks like wells in a name that is read as `text`."""
    found = [(at, ROWS.index(at[1]), int(at[2])) for at in _NAMED.finditer(text)]
    found += [(at, int(at[1]) - 1, int(at[2])) for at in _NUMBERED.finditer(text)]
    rows, columns = _LAYOUTS[-1]
    return [
        WellWord(
            f"{ROWS[row]}{column:02d}",
            str(PurePath(folder, name[: at.start()] or ".")),
            folder,
            at.re is _NAMED and at[0] != name and (text != name or len(at[2]) == 1),
        )
        for at, row, column in found
        if 0 <= row < rows and 1 <= column <= columns
    ]


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
