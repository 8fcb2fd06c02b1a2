"""Which files are meant: what folders and patterns name, and what of it is left out."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatch
from itertools import chain
from pathlib import Path
from typing import Any

from napari_defocus.core.extras import is_there
from napari_defocus.io.ome_zarr import is_zarr
from napari_defocus.io.pictures import UnreadablePicture
from napari_defocus.io.provenance import SOFTWARE, is_picture, mark_of

_PHOTOGRAPHS = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".gif", ".heic", ".heif")
_SLIDES = (".svs", ".ndpi", ".scn", ".qptiff", ".bif", ".lsm", ".stk", ".btf", ".tf8")
PICTURE_SUFFIXES = (*_PHOTOGRAPHS, ".tif", ".tiff", *_SLIDES)
"""Files of folders and patterns that are taken for pictures; the slides are kinds of TIFF."""

_SUFFIXES_OF = {
    "bioio_czi": (".czi",),
    "bioio_nd2": (".nd2",),
    "bioio_lif": (".lif",),
    "openslide": (".mrxs", ".svslide"),
}
"""Those that are taken, too, if a package that reads them is installed."""

FOLDER, RESULT, NO_ENDING = "folder", "result", "no ending"
"""Kinds of files that are left out and have no ending of their own."""

_TOLD = {
    FOLDER: ("folder", "folders"),
    RESULT: (f"result of {SOFTWARE}", f"results of {SOFTWARE}"),
    NO_ENDING: ("without an ending", "without an ending"),
}
_WILD = re.compile(r"[*?\[]")


def picture_suffixes() -> tuple[str, ...]:
    """Return the endings of the files that are taken for pictures, with the extras that are there.

    Not those of slides whose parts are pictures that lie beside them (.vms): name these.
    """
    more = (suffixes for package, suffixes in _SUFFIXES_OF.items() if is_there(package))
    return (*PICTURE_SUFFIXES, *chain.from_iterable(more))


Inputs = Iterable[str | os.PathLike[str]] | str | os.PathLike[str]
"""Files, folders and patterns, as `find_sources` takes them, or one of them."""


@dataclass(frozen=True, eq=False)
class PictureFiles:
    """What files, folders and patterns name: pictures, each once, in their order.

    It is counted how many others there are, by their endings; `FOLDER` and `RESULT` for folders
    that are not looked into, and for what this package made.
    """

    pictures: list[Path]
    left_out: dict[str, int]


@dataclass(eq=False)
class _Search:
    """A search, and what it left out; of what is in the folder `besides`, nothing is counted."""

    besides: Path | None
    others: dict[Path, str] = field(default_factory=dict)

    def is_picture(self, path: Path) -> bool:
        """Return whether something found is a picture; note it if it is none."""
        if is_zarr(path) or (path.suffix.lower() in picture_suffixes() and path.is_file()):
            if not mark_of(path):
                return True
            self.leave_out(path, RESULT)
        elif path.is_file():
            self.leave_out(path, path.suffix.lower() or NO_ENDING)
        return False

    def leave_out(self, path: Path, kind: str) -> None:
        place = path.resolve()
        if self.besides is None or self.besides not in (place, *place.parents):
            self.others.setdefault(place, kind)

    def counts(self, named: Iterable[Path]) -> dict[str, int]:
        """Count what was left out and was not named otherwise, by kind."""
        kept = set(named)
        counted = Counter(kind for place, kind in self.others.items() if place not in kept)
        return dict(sorted(counted.items(), key=lambda item: (-item[1], item[0])))


def as_paths(inputs: Inputs) -> list[Path]:
    """Return what is given as paths; TypeError if it is none."""
    given = [inputs] if isinstance(inputs, str | os.PathLike) else inputs
    if not isinstance(given, Iterable):
        raise TypeError(f"inputs is {type(inputs).__name__}; it takes paths")
    given = list(given)
    for one in given:
        if not isinstance(one, str | os.PathLike):
            raise TypeError(f"inputs holds a {type(one).__name__}; it takes paths")
    return [Path(one) for one in given]


def look_for_pictures(inputs: Inputs, besides: Path | None = None) -> PictureFiles:
    """Return the pictures that files, folders and patterns name, and what is left out.

    Nothing is told of what is in the folder `besides`, such as that of results.
    """
    search = _Search(None if besides is None else besides.resolve())
    found: dict[Path, Path] = {}
    for one in as_paths(inputs):
        for path in _named_by(one, search):
            found.setdefault(path.resolve(), path)
    return PictureFiles(list(found.values()), search.counts(found))


def told_left_out(left_out: Mapping[str, int]) -> str:
    """Say what was left out.

    Examples
    --------
    >>> told_left_out({".txt": 3, "result": 2, "folder": 1})
    '3 .txt, 2 results of napari-defocus, 1 folder'
    """
    return ", ".join(
        f"{count} {_TOLD[kind][count > 1] if kind in _TOLD else kind}"
        for kind, count in left_out.items()
    )


def find_sources(inputs: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Return the pictures that files, folders and patterns name, each once, in their order.

    Parameters
    ----------
    inputs : iterable of path-like
        Files, whatever they are called, and OME-Zarr stores; folders, which stand for the
        pictures and stores right in them, by their endings; and patterns with `*`, `?`, `[]` and
        `**`, which stand for pictures and stores, at any depth. What is hidden, and what is
        inside of a store, is not found, nor is what this package made: by what files say of
        themselves, not by their names.

    Returns
    -------
    list of Path
        Those of a folder or a pattern in the natural order of their names.

    Raises
    ------
    UnreadablePicture
        If an input names nothing, a folder without pictures, or a map, a mask or a drawing that
        this package made. Pictures that it made can be named.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("b10.png", "b9.png", "a.txt"):
    ...         pathlib.Path(folder, name).touch()
    ...     [path.name for path in find_sources([folder, f"{folder}/b*"])]
    ['b9.png', 'b10.png']
    """
    return look_for_pictures(inputs).pictures


def _named_by(path: Path, search: _Search) -> list[Path]:
    if path.is_file() or is_zarr(path):
        return [_checked(path)]
    if path.is_dir():
        entries, none = _entries(path), "the folder has no pictures"
        for folder in entries:
            if folder.is_dir() and not is_zarr(folder):
                search.leave_out(folder, FOLDER)
    elif _WILD.search(str(path)):
        pattern = path.relative_to(path.anchor).parts if path.anchor else path.parts
        entries, none = [*_matches(Path(path.anchor), pattern)], "no picture matches"
    else:
        raise UnreadablePicture(f"cannot read {path}: there is no such file")
    pictures = [entry for entry in dict.fromkeys(entries) if search.is_picture(entry)]
    if not pictures:
        left_out = told_left_out(search.counts([]))
        told = f"({', '.join(picture_suffixes())})"
        told += f"; left out: {left_out}" if left_out else ""
        raise UnreadablePicture(f"cannot read {path}: {none} {told}")
    return sorted(pictures, key=naturally)


def _checked(path: Path) -> Path:
    """Refuse what this package made and that shows no scene."""
    mark = mark_of(path)
    if not is_picture(mark):
        what = mark.get("quantity") or "result"
        raise UnreadablePicture(
            f"cannot read {path}: it is not a picture but a result of {SOFTWARE} ({what}); "
            "folders, and patterns in quotation marks, leave results out"
        )
    return path


def _matches(folder: Path, pattern: tuple[str, ...]) -> Iterator[Path]:
    first, *rest = pattern
    following = tuple(rest) or ("*",) if first == "**" else tuple(rest)
    if first == "**":
        yield from _matches(folder, following)
        for entry in _folders(folder):
            yield from _matches(entry, pattern)
    elif (entry := folder / first).exists():
        yield from _matches(entry, following) if following else [entry]
    elif following:
        for entry in _folders(folder):
            if fnmatch(entry.name, first):
                yield from _matches(entry, following)
    elif folder.is_dir():
        yield from (entry for entry in _entries(folder) if fnmatch(entry.name, first))


def _entries(folder: Path) -> list[Path]:
    seen = (entry for entry in folder.iterdir() if not entry.name.startswith("."))
    return sorted(seen, key=naturally)


def _folders(folder: Path) -> list[Path]:
    entries = _entries(folder) if folder.is_dir() else []
    return [e for e in entries if e.is_dir() and not e.is_symlink() and not is_zarr(e)]


def in_stack_order(paths: Iterable[Path]) -> list[Path]:
    """Return the planes of a stack in the natural order of their names.

    If a name has a number with a plus, signs count: z-0.7um comes before z-0.1um and z+0.1um.

    Examples
    --------
    >>> [path.name for path in in_stack_order(map(Path, ("z+0.1", "z+0.0", "z-0.1", "z-0.2")))]
    ['z-0.2', 'z-0.1', 'z+0.0', 'z+0.1']
    """
    planes = list(paths)
    if not any(re.search(r"\+\d", path.name) for path in planes):
        return sorted(planes, key=naturally)

    def signed(path: Path) -> tuple[Any, ...]:
        words = re.split(r"([+-]?\d+(?:\.\d+)?)", path.name.lower())
        numbers = [(float(word), "") if at % 2 else (0.0, word) for at, word in enumerate(words)]
        return naturally(path.parent), numbers, path.name

    return sorted(planes, key=signed)


def naturally(path: Path) -> list[tuple[list[tuple[int, str]], str]]:
    """Return a key that sorts numbers in names by their value."""
    words = (re.split(r"(\d+)", part.lower()) for part in path.parts)
    numbers = ([(int(w), "") if w.isdecimal() else (-1, w) for w in each] for each in words)
    return list(zip(numbers, path.parts, strict=True))
