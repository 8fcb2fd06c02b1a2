"""What is to be worked on: photographs, stacks and slides, opened without reading their pixels."""

from __future__ import annotations

import operator
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.checks import renamed
from napari_defocus.core.extras import need_large_extra
from napari_defocus.io.file_kinds import is_raw
from napari_defocus.io.lazy_arrays import lazy_array
from napari_defocus.io.ome_zarr import RGB_COLORS, is_zarr, read_ome_zarr
from napari_defocus.io.picture_files import Inputs, as_paths, find_sources, naturally
from napari_defocus.io.pictures import (
    UnreadablePicture,
    is_tiff,
    picture_form,
    read_frame,
    read_picture,
    reading,
)
from napari_defocus.io.provenance import SHARPEST_PIXELS, mark_of
from napari_defocus.io.tiff_reader import open_tiff

if TYPE_CHECKING:
    import dask.array as da

__all__ = ["Source", "find_sources", "open_source", "open_stack"]


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
    pixel_size : dict of str to float
        How far apart neighbours are, for axes of which it is known.
    units : dict of str to str
        In the spelling of UDUNITS, such as "micrometer", for axes of which it is known.
    pictures : tuple of Path
        The pictures that are its planes, if it is made of several; see `open_stack`.
    """

    path: Path
    data: da.Array
    axes: str
    pixel_size: dict[str, float]
    units: dict[str, str]
    pictures: tuple[Path, ...] = ()

    @property
    def scale(self) -> dict[str, float]:
        """The old name of `pixel_size`."""
        return renamed("scale", self.pixel_size, "pixel_size", None) or {}

    @property
    def files(self) -> tuple[Path, ...]:
        """What is read: `pictures`, or `path` alone."""
        return self.pictures or (self.path,)

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
        sizes = dict(zip(self.plane_axes, self.plane_shape, strict=True))
        within = map(operator.contains, map(range, sizes.values()), index)
        if len(index) != len(sizes) or not all(within):
            extent = ", ".join(f"{axis} 0 to {size - 1}" for axis, size in sizes.items())
            raise IndexError(
                f"index is {index}; the planes of {self.path} are {extent or '() alone'}"
            )
        return self.data[index]

    def label_of(self, index: tuple[int, ...]) -> str:
        """Return a plane's index in words, such as "t=3 z=12"; "" for a single picture."""
        return " ".join(f"{a}={at}" for a, at in zip(self.plane_axes, index, strict=True))


@dataclass(frozen=True, eq=False)
class _Photograph:
    """A photograph as a reader of regions: it is decoded whole."""

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def __getitem__(self, region: tuple[slice, ...]) -> NDArray[Any]:
        return read_picture(self.path)[region]


@dataclass(frozen=True, eq=False)
class _Animation:
    """An animation as a reader of regions: each frame is decoded whole."""

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def __getitem__(self, region: tuple[slice, ...]) -> NDArray[Any]:
        numbers = range(*region[0].indices(self.shape[0]))
        return np.stack([read_frame(self.path, number) for number in numbers])[:, *region[1:]]


def open_source(path: str | os.PathLike[str]) -> Source:
    """Open a photograph, a stack or a slide; no pixels are read.

    - PNG, JPEG, WebP, BMP, GIF, HEIC and raw files: what `read_picture` gives, as one block. Of
      an animation each frame is a plane along t, and a block.
    - TIFF of one page, or of many (ImageJ, OME-TIFF, LSM, STK, slides), tiled or not: the
      largest level of the picture, without labels and previews. Tiles, strips, or parts of an
      uncompressed page are read one by one. Values, colours and orientation are those of
      `read_picture`; pixel size and units those of `pixel_size_in_tiff`. An OME-TIFF may name
      planes that were not recorded, or whose file is missing: they are 0.
    - OME-Zarr 0.4 and 0.5, folders: the largest level of the first picture. Three channels become
      colours if the store says that they are pure red, green and blue. All other channels are
      planes, even three of uint8, because a store does not say that they belong together.

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
    >>> stack.pixel_size["z"], stack.pixel_size["x"], stack.units["x"]
    (1.5, 0.25, 'micrometer')
    """
    need_large_extra()
    path = Path(path)
    if path.is_dir():
        if not is_zarr(path):
            raise UnreadablePicture(
                f"cannot read {path}: it is a folder, but not an OME-Zarr store"
            )
        return _zarr_source(path)
    with reading(path):
        if is_tiff(path) and not is_raw(path):
            data, axes, (pixel_size, units) = open_tiff(path)
            return Source(path, data, axes, pixel_size, units)
        return Source(path, *_photograph(path), {}, {})


def _photograph(path: Path) -> tuple[da.Array, str]:
    """Return a photograph, or the frames of an animation, and their axes."""
    frames, shape, dtype = picture_form(path)
    axes = "yxs"[: len(shape)]
    if frames == 1:
        return lazy_array(_Photograph(path.absolute(), shape, dtype), shape), axes
    animation = _Animation(path.absolute(), (frames, *shape), dtype)
    return lazy_array(animation, (1, *shape)), f"t{axes}"


def _zarr_source(path: Path) -> Source:
    picture = read_ome_zarr(path)
    data, axes = picture.levels[0], picture.axes
    if tuple(color.upper().lstrip("#") for color in picture.channel_colors) == RGB_COLORS:
        channels = axes.find("c")
        if channels >= 0 and data.shape[channels] == 3:
            import dask.array as da

            data, axes = da.moveaxis(data, channels, -1), axes.replace("c", "") + "s"
            data = data.rechunk({-1: 3})
    return Source(path, data, axes, picture.pixel_size, picture.units)


# Pictures that are planes of one stack.


def open_stack(inputs: Inputs) -> Source:
    """Open a stack: one file, or pictures of one plane that are its planes; no pixels are read.

    Parameters
    ----------
    inputs : path-like, or iterable of path-like
        A stack as `open_source` takes it; or a folder, several pictures, or patterns, see
        `find_sources`. Several pictures are planes in the natural order of their names: slice2
        comes before slice10. They are along z, and each may have channels, c, beside.

    Returns
    -------
    Source
        Its `path` is the folder, or the first picture. Pixel size and units are those of the
        pictures where all agree.

    Raises
    ------
    UnreadablePicture
        As `find_sources` and `open_source`; if there is only one picture, or one of them has
        several planes, or another shape or dtype than the others: the message names it.

    Examples
    --------
    >>> import pathlib, tempfile, PIL.Image, numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for number in (2, 10, 1):
    ...         plane = PIL.Image.fromarray(np.full((4, 5), number, np.uint8))
    ...         plane.save(pathlib.Path(folder, f"slice{number}.png"))
    ...     stack = open_stack(folder)
    ...     stack.axes, stack.data[:, 0, 0].compute().tolist()
    ('zyx', [1, 2, 10])
    """
    need_large_extra()
    given = as_paths(inputs)
    files = sorted(find_sources(given), key=naturally)
    if len(given) == 1 and files == given:
        return open_source(given[0])
    if not files:
        raise UnreadablePicture("cannot read a stack: there are no files")
    place = given[0] if len(given) == 1 and given[0].is_dir() else files[0]
    if len(files) == 1:
        raise UnreadablePicture(
            f"cannot read {place} as a stack: it is one picture, {files[0].name}; give two or "
            "more, or the file itself if it is a stack"
        )
    return _as_planes(place, [_as_plane(open_source(path)) for path in files])


def _as_plane(picture: Source) -> Source:
    """Return a picture without axes of length 1; refuse it if it has planes beside channels."""
    if mark_of(picture.path).get("quantity") == SHARPEST_PIXELS:
        raise UnreadablePicture(
            f"cannot read {picture.path} as a plane of a stack: it was made of the sharpest pixels "
            "of a stack"
        )
    sizes = dict(zip(picture.plane_axes, picture.plane_shape, strict=True))
    kept = "".join(axis for axis, size in sizes.items() if size > 1)
    if kept not in ("", "c"):
        held = " and ".join(f"{sizes[axis]} along {axis}" for axis in kept)
        raise UnreadablePicture(
            f"cannot read {picture.path} as a plane of a stack: it has {held}; pictures of one "
            "plane are taken, or a single file that is a stack"
        )
    index = tuple(slice(None) if axis in kept else 0 for axis in sizes)
    axes = kept + picture.axes[len(sizes) :]
    return Source(picture.path, picture.data[index], axes, picture.pixel_size, picture.units)


def _as_planes(place: Path, pictures: list[Source]) -> Source:
    import dask.array as da

    _check_alike(pictures)
    first = pictures[0]
    same = {
        axis: step
        for axis, step in first.pixel_size.items()
        if axis in "yx" and all(each.pixel_size.get(axis) == step for each in pictures)
    }
    units = {axis: unit for axis, unit in first.units.items() if axis in same}
    data = da.stack([each.data for each in pictures])
    return Source(place, data, f"z{first.axes}", same, units, tuple(each.path for each in pictures))


def _check_alike(pictures: list[Source]) -> None:
    forms = [(each.axes, each.data.shape, each.data.dtype) for each in pictures]
    usual, _ = Counter(forms).most_common(1)[0]
    for picture, form in zip(pictures, forms, strict=True):
        if form != usual:
            raise UnreadablePicture(
                f"cannot read {picture.path} as a plane of a stack: it is {_told_form(*form)}, and "
                f"others are {_told_form(*usual)}"
            )


def _told_form(axes: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> str:
    sizes = dict(zip(axes, shape, strict=True))
    more = f" of {sizes['s']} colours" if "s" in sizes else ""
    more += f" of {sizes['c']} channels" if "c" in sizes else ""
    return f"{sizes['x']} x {sizes['y']} px{more}, {dtype}"
