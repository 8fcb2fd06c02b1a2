"""What is to be worked on: photographs, stacks and slides, opened without reading their pixels."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.files import (
    TIFF_STARTS,
    UnreadablePicture,
    picture_form,
    read_picture,
    reading_failure,
)
from napari_defocus.lazy_arrays import lazy_array, need_large_extra
from napari_defocus.ome_zarr import RGB_COLORS, is_zarr, read_ome_zarr
from napari_defocus.tiff_planes import open_tiff

if TYPE_CHECKING:
    import dask.array as da

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff", ".btf")
"""Files of folders and globs that are taken for pictures; other TIFFs, such as .svs, by name."""

_WILD = re.compile(r"[*?\[]")


@dataclass(frozen=True, eq=False)
class Source:
    """A picture, or planes of one size, of which pixels are read when they are computed.

    Attributes
    ----------
    path : Path
    data : dask.array.Array
        bool or real numbers. It can be sent to other processes, which open the file themselves.
    axes : str
        A letter an axis of `data`: planes, such as t, c, z, then y, x, then s for colours.
    scale : dict of str to float
        How far apart neighbours are, for axes of which it is known.
    units : dict of str to str
        In the spelling of UDUNITS, such as "micrometer", for axes of which it is known.
    """

    path: Path
    data: da.Array
    axes: str
    scale: dict[str, float]
    units: dict[str, str]

    @property
    def plane_axes(self) -> str:
        """The axes before y and x."""
        return self.axes[: self.axes.index("y")]

    @property
    def plane_shape(self) -> tuple[int, ...]:
        """How many planes there are along each of `plane_axes`; () for a single picture."""
        return tuple(self.data.shape[: len(self.plane_axes)])

    def planes(self) -> Iterator[tuple[int, ...]]:
        """Return the index of every plane, the last axis fastest; one () for a single picture."""
        return iter(np.ndindex(*self.plane_shape))

    def plane(self, index: tuple[int, ...] = ()) -> da.Array:
        """Return a plane, (H, W) or (H, W, 3 or 4), not yet read.

        Raises
        ------
        IndexError
            If there is no such plane.
        """
        if len(index) != len(self.plane_axes):
            raise IndexError(f"index is {index}; the planes of {self.path} are {self._extent()}")
        for at, size in zip(index, self.plane_shape, strict=True):
            if not 0 <= at < size:
                raise IndexError(
                    f"index is {index}; the planes of {self.path} are {self._extent()}"
                )
        return self.data[index]

    def label_of(self, index: tuple[int, ...]) -> str:
        """Return a plane's index in words, such as "t=3 z=12"; "" for a single picture."""
        return " ".join(f"{a}={at}" for a, at in zip(self.plane_axes, index, strict=True))

    def _extent(self) -> str:
        sizes = zip(self.plane_axes, self.plane_shape, strict=True)
        return ", ".join(f"{axis} 0 to {size - 1}" for axis, size in sizes) or "() alone"


@dataclass(frozen=True, eq=False)
class _Photograph:
    """A photograph as a reader of regions: it is decoded whole."""

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def __getitem__(self, region: tuple[slice, ...]) -> NDArray[Any]:
        return read_picture(self.path)[region]


def open_source(path: str | os.PathLike[str]) -> Source:
    """Open a photograph, a stack or a slide; no pixels are read.

    - PNG, JPEG, WebP, BMP: what `read_picture` gives, as one block.
    - TIFF of one page, or of many (ImageJ, OME-TIFF, slides), tiled or not: the largest level,
      of which tiles, strips or parts of an uncompressed page are read. Values, colours and
      orientation are as `read_picture` gives them; scale and units as `scale_in_tiff`. Planes
      that an OME-TIFF tells of, but that were not recorded or whose file is missing, are 0.
    - OME-Zarr 0.4 and 0.5, folders: the largest level of the first picture. Three channels that
      the store says are pure red, green and blue become colours; all other channels are planes,
      even three of uint8, because a store does not say that they belong together.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Source

    Raises
    ------
    UnreadablePicture
        In one line: there is no such file, it is cut off or damaged, holds no picture or several,
        or no real numbers.
    ImportError
        If the extra "large" is not installed.

    Examples
    --------
    >>> import pathlib, tempfile, tifffile, numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "stack.tif")
    ...     tifffile.imwrite(
    ...         file, np.zeros((3, 4, 5), np.uint8), imagej=True, resolution=(4, 4),
    ...         metadata={"axes": "ZYX", "unit": "um", "spacing": 1.5})
    ...     stack = open_source(file)
    ...     [stack.label_of(index) for index in stack.planes()], stack.plane((2,)).shape
    (['z=0', 'z=1', 'z=2'], (4, 5))
    >>> stack.scale["z"], stack.scale["x"], stack.units["x"]
    (1.5, 0.25, 'micrometer')
    """
    need_large_extra()
    path = Path(path)
    if path.is_dir():
        if not is_zarr(path):
            raise UnreadablePicture(f"cannot read {path}: it is a folder, and no OME-Zarr store")
        return _zarr_source(path)
    if not _is_tiff(path):
        reader = _Photograph(path.absolute(), *picture_form(path))
        axes = "yxs"[: len(reader.shape)]
        return Source(path, lazy_array(reader, reader.shape), axes, {}, {})
    # Damaged TIFFs raise whatever their bytes led the decoder into.
    try:
        data, axes, (scale, units) = open_tiff(path)
    except Exception as error:
        raise UnreadablePicture(f"cannot read {path}: {reading_failure(error)}") from error
    return Source(path, data, axes, scale, units)


def _is_tiff(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(4).startswith(TIFF_STARTS)
    except OSError as error:
        raise UnreadablePicture(f"cannot read {path}: {reading_failure(error)}") from error


def _zarr_source(path: Path) -> Source:
    picture = read_ome_zarr(path)
    data, axes = picture.levels[0], picture.axes
    if tuple(color.upper().lstrip("#") for color in picture.channel_colors) == RGB_COLORS:
        channels = axes.find("c")
        if channels >= 0 and data.shape[channels] == 3:
            import dask.array as da

            data, axes = da.moveaxis(data, channels, -1), axes.replace("c", "") + "s"
            data = data.rechunk({-1: 3})
    return Source(path, data, axes, picture.scale, picture.units)


# Which files.


def find_sources(inputs: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Return the pictures that files, folders and patterns name, each once, in their order.

    Parameters
    ----------
    inputs : iterable of path-like
        A file, as it is; an OME-Zarr store; another folder, for the pictures and stores directly
        in it, in natural order (a2 before a10); or a pattern with `*`, `?`, `[...]`, and `**` for
        folders at any depth. What is hidden, and what is inside of a store, is not found.

    Returns
    -------
    list of Path

    Raises
    ------
    UnreadablePicture
        If an input names nothing, or a folder without pictures.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("b10.png", "b9.png", "a.txt"):
    ...         pathlib.Path(folder, name).touch()
    ...     [path.name for path in find_sources([folder, f"{folder}/b*"])]
    ['b9.png', 'b10.png']
    """
    given = [inputs] if isinstance(inputs, str | os.PathLike) else inputs
    found: dict[Path, Path] = {}
    for one in given:
        for path in _named_by(Path(one)):
            found.setdefault(path.resolve(), path)
    return list(found.values())


def _named_by(path: Path) -> list[Path]:
    if path.is_file() or is_zarr(path):
        return [path]
    kinds = ", ".join(PICTURE_SUFFIXES)
    if path.is_dir():
        pictures = [entry for entry in _entries(path) if _is_picture(entry)]
        if not pictures:
            raise UnreadablePicture(f"cannot read {path}: the folder has no pictures ({kinds})")
        return pictures
    if not _WILD.search(str(path)):
        raise UnreadablePicture(f"cannot read {path}: there is no such file")
    pattern = path.relative_to(path.anchor).parts if path.anchor else path.parts
    matches = {entry: None for entry in _matches(Path(path.anchor), pattern) if _is_picture(entry)}
    if not matches:
        raise UnreadablePicture(f"cannot read {path}: no picture matches ({kinds})")
    return sorted(matches, key=_naturally)


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
    return sorted(seen, key=_naturally)


def _folders(folder: Path) -> list[Path]:
    entries = _entries(folder) if folder.is_dir() else []
    return [e for e in entries if e.is_dir() and not e.is_symlink() and not is_zarr(e)]


def _is_picture(path: Path) -> bool:
    return is_zarr(path) or (path.suffix.lower() in PICTURE_SUFFIXES and path.is_file())


def _naturally(path: Path) -> list[tuple[list[tuple[int, str]], str]]:
    """Return a key that sorts numbers in names by their value."""
    return [(_words(part), part) for part in path.parts]


def _words(name: str) -> list[tuple[int, str]]:
    pieces = re.split(r"(\d+)", name.lower())
    return [(int(piece), "") if piece.isdecimal() else (-1, piece) for piece in pieces]
