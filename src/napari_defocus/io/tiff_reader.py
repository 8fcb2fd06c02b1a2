"""TIFF in, lazily: stacks, tiles and pyramids, page by page and tile by tile."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.io.lazy_arrays import block_side, lazy_array
from napari_defocus.io.pictures import (
    color_model,
    cut_off,
    planes_are_missing,
    reading,
    tiff_colors,
    upright,
)
from napari_defocus.io.tiff_pixel_size import PixelSize, pixel_size_in_tiff
from napari_defocus.io.tiff_series import picture_number

if TYPE_CHECKING:
    import dask.array as da

_PAGE_AXES = ("YX", "YXS", "SYX")
_NO_PAGE = -1


@dataclass(frozen=True, eq=False)
class TiffPages:
    """Planes of one form, each a page of a file; regions are decoded, colours are last.

    `file_of` and `offsets` have the shape of the axes before rows. They say which file a plane is
    in, and where its page is described there; -1 stands for planes that were not recorded, which
    are 0. Palettes that are ImageJ's display colours do not count: values are `as_stored`. The last
    axis before rows can be that of channels that lie `apart` in each page, as in LSM.
    """

    files: tuple[str, ...]
    file_of: NDArray[np.int64]
    offsets: NDArray[np.int64]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    as_stored: bool
    apart: bool = False

    def __getitem__(self, region: tuple[slice, ...]) -> NDArray[Any]:
        """Read a region, one slice an axis."""
        leading = self.offsets.ndim
        rows, columns = region[leading : leading + 2]
        colors: tuple[Any, ...] = (..., *region[leading + 2 :])
        sizes = [part.stop - part.start for part in region]
        values = np.zeros(sizes, self.dtype)
        planes = product(*(range(part.start, part.stop) for part in region[:leading]))
        for at, plane in zip(np.ndindex(*sizes[:leading]), planes, strict=True):
            if self.offsets[plane] != _NO_PAGE:
                values[at] = self._pixels(plane, rows, columns)[colors]
        return values

    def _pixels(self, plane: tuple[int, ...], rows: slice, columns: slice) -> NDArray[Any]:
        import tifffile
        import zarr

        file = self.files[self.file_of[plane]]
        with reading(file), tifffile.TiffFile(file) as tiff:
            place = int(self.offsets[plane])
            # Of later pages, tifffile mends what some formats get wrong.
            index = int(place != tiff.pages.first.offset)
            tiff.filehandle.seek(place)
            # A page by its place, not the whole series: that reads the tags of all its pages.
            page = tifffile.TiffPage(tiff, index=index)
            stored = zarr.open_array(page.aszarr(), mode="r", zarr_format=2)
            samples = (plane[-1] if self.apart else slice(None),) if page.axes == "SYX" else ()
            pixels = np.asarray(stored[(*samples, rows, columns)])
            if page.axes == "SYX" and not self.apart:
                pixels = np.moveaxis(pixels, 0, -1)
            return _colors(pixels, page, self.as_stored)


def _colors(pixels: NDArray[Any], page: Any, as_stored: bool) -> NDArray[Any]:
    """Return pixels, (h, w[, samples]), as (h, w) or (h, w, 3 or 4)."""
    return pixels if as_stored and page.samplesperpixel == 1 else tiff_colors(pixels, page)


@dataclass(frozen=True, eq=False)
class TiffMemory:
    """Planes that lie in a file as they lie in memory, one after the other, uncompressed.

    The first pixel is `offset` bytes from the start; `stored` is NumPy's name of the dtype, with
    its order of bytes.
    """

    file: str
    offset: int
    shape: tuple[int, ...]
    stored: str

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the values that are read."""
        return np.dtype(self.stored).newbyteorder("=")

    def __getitem__(self, region: tuple[slice, ...]) -> NDArray[Any]:
        """Read a region, one slice an axis."""
        with reading(self.file):
            mapped = np.memmap(self.file, self.stored, "r", self.offset, self.shape)
            return np.array(mapped[region], self.dtype)


def open_tiff(path: Path) -> tuple[da.Array, str, PixelSize]:
    """Open the largest level of the picture, or stack, in a TIFF.

    Returns the data, (..., H, W) or (..., H, W, 3 or 4), which are read when they are computed; a
    letter for each axis, s for colours; and what `pixel_size_in_tiff` returns. ValueError is raised
    if the file holds several pictures or none, or is cut off.
    """
    import tifffile

    with tifffile.TiffFile(path) as tiff:
        number = picture_number(tiff)
        series = tiff.series[number]
        if series.dtype is None or series.dtype.kind not in "buif":
            raise ValueError(f"it holds {series.dtype}; real numbers are read")
        if planes_are_missing(tiff, series):
            raise ValueError("the file is cut off")
        if _is_memory(tiff, series):
            data, axes = _mapped(series)
        else:
            data, axes = _paged(tiff, series)
        orientation = int(series.keyframe.tags.valueof("Orientation", default=1))
        pixel_size, units = pixel_size_in_tiff(tiff, number)
    kept = {axis: step for axis, step in pixel_size.items() if axis in axes}
    return _turned(data, axes, orientation), axes, (kept, {axis: units[axis] for axis in kept})


def _is_memory(tiff: Any, series: Any) -> bool:
    page = series.keyframe
    plain = color_model(page) in ("MINISBLACK", "RGB") or tiff.is_imagej
    samples = page.samplesperpixel in (1, 3, 4)
    memory = series.dataoffset is not None and page.bitspersample % 8 == 0
    return bool(plain and samples and memory and not page.is_tiled)


def _mapped(series: Any) -> tuple[da.Array, str]:
    file = series.keyframe.parent
    if series.dataoffset + series.nbytes > file.filehandle.size:
        raise ValueError("the file is cut off")
    stored = series.dtype.newbyteorder(file.byteorder).str
    name = str(Path(file.filehandle.path).absolute())
    reader = TiffMemory(name, int(series.dataoffset), tuple(series.shape), stored)
    letters = _letters(series.axes)
    blocks = tuple(
        size if letter in "xs" else min(size, 1024) if letter == "y" else 1
        for letter, size in zip(letters, series.shape, strict=True)
    )
    data = lazy_array(reader, blocks)
    order = sorted(range(len(letters)), key=lambda i: "yxs".find(letters[i]))
    return data.transpose(order), "".join(letters[i] for i in order)


def _paged(tiff: Any, series: Any) -> tuple[da.Array, str]:
    page = series.keyframe
    apart = page.axes == "SYX" and series.axes.endswith("CYX")
    page_axes = "YX" if apart else page.axes
    if page_axes not in _PAGE_AXES or not series.axes.endswith(page_axes):
        shape = " x ".join(map(str, series.shape))
        raise ValueError(f"its form {shape} (axes {series.axes}) is not read")
    as_stored = bool(tiff.is_imagej)
    samples = () if apart or page.samplesperpixel == 1 else (page.samplesperpixel,)
    pixel = _colors(np.zeros((1, 1, *samples), page.dtype), page, as_stored)
    planes: tuple[int, ...] = tuple(series.shape[: -len(page_axes)])
    files, file_of, offsets = _places(series, planes[:-1] if apart else planes)
    if apart:
        file_of, offsets = (np.repeat(e[..., None], planes[-1], -1) for e in (file_of, offsets))
    whole = (*planes, page.imagelength, page.imagewidth, *pixel.shape[2:])
    reader = TiffPages(files, file_of, offsets, whole, pixel.dtype, as_stored, apart)
    sides = map(block_side, page.chunks[:2], (page.imagelength, page.imagewidth))
    blocks = (*(1 for _ in planes), *sides, *pixel.shape[2:])
    letters = _letters(series.axes[: len(planes)] + "YX")
    return lazy_array(reader, blocks), letters + "s" * len(pixel.shape[2:])


def _places(
    series: Any, planes: tuple[int, ...]
) -> tuple[tuple[str, ...], NDArray[np.int64], NDArray[np.int64]]:
    files: dict[str, int] = {}
    places = []
    for page in series.pages:
        if page is None:
            places.append((0, _NO_PAGE))
            continue
        file = page.parent.filehandle
        if cut_off(page, file.size):
            raise ValueError("the file is cut off")
        name = str(Path(file.path).absolute())
        places.append((files.setdefault(name, len(files)), page.offset))
    if len(places) != prod(planes):
        raise ValueError(f"it has {len(places)} pages for {prod(planes)} planes: it is damaged")
    file_of, offsets = np.array(places, np.int64).T.reshape(2, *planes)
    return tuple(files), file_of, offsets


def _letters(axes: str) -> str:
    """Return a letter an axis, all different, s for colours only if they are beside rows."""
    given = axes.lower()
    if not given.endswith(("s", "syx")):
        given = given.replace("s", "c")
    free = (letter for letter in "qponmlkjihgfedbavwur" if letter not in given)
    return "".join(a if a not in given[:at] else next(free) for at, a in enumerate(given))


def _turned(data: da.Array, axes: str, orientation: int) -> da.Array:
    """Turn planes upright, as a single picture is."""
    import dask.array as da

    if orientation == 1:
        return data
    rows = axes.index("y")
    first = da.moveaxis(data, (rows, rows + 1), (0, 1))
    return da.moveaxis(upright(first, orientation), (0, 1), (rows, rows + 1))
