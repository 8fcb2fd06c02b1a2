"""TIFF out, for stacks and large maps: tiled, with a pyramid, in bounded memory."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.checks import renamed
from napari_defocus.core.writing import UnwritableResult, check_results, unused_name
from napari_defocus.io.multiscale import halved, level_shapes
from napari_defocus.io.provenance import mark_in_tiff, plain_json, signature
from napari_defocus.io.tiff_pixel_size import MICROMETERS, SYMBOLS_OF_UNIT

TILE = 512
"""px of a tile's side."""

_LARGE = 2**32 - 2**25
"""If all levels have more bytes than this before compression, offsets take 64 bits."""

_BUFFER = 2**24
"""Bytes of tiles that are compressed at a time."""

_OME_AXES = set("tcz")
_OME_DTYPES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")
_CENTIMETER = 1e4
"""In micrometers."""


def write_pyramidal_tiff(
    path: str | os.PathLike[str],
    data: Any,
    *,
    axes: str,
    pixel_size: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    description: Mapping[str, Any],
    labels: bool = False,
    force: bool = False,
    scale: Mapping[str, float] | None = None,
) -> Path:
    """Write a map, a picture or a stack as a tiled TIFF with smaller levels.

    It appears whole or not at all. A row of tiles, or of dask's blocks, is computed and held at a
    time. Each is computed once if blocks hold one plane. Smaller levels wait in scratch files
    without a name beside `path`, which take a third of the data's bytes. Planes along t, c and z
    make it an OME-TIFF. Other axes are named in `axes` of the description.

    Parameters
    ----------
    path : path-like
        Ends, by custom, in `.tif` or, if there are planes, in `.ome.tif`.
    data : array-like
        (..., H, W) or (..., H, W, 3 or 4) of NumPy, dask, or whatever has shape, dtype and slices.
        bool is written as 0 and 1 of uint8.
    axes : str
        A letter an axis: planes, then y, x, then s for colours.
    pixel_size, units : mapping, optional
        Of the axes that have them, as in `napari_defocus.io.open.Source`.
    description : mapping
        What the values are and what made them, for instance `quantity`, `unit` and `settings`;
        what JSON can hold. Software, version, shape and axes are added.
        `made_by` gives it back.
    labels : bool, optional
        As in `napari_defocus.io.multiscale.halved`.
    force : bool, optional
        Whether a file that exists is overwritten.
    scale : mapping, optional
        The old name of `pixel_size`.

    Returns
    -------
    Path

    Raises
    ------
    UnwritableResult
        If the folder is missing, the file exists and `force` is not set, or writing fails.
    TypeError, ValueError
        If `axes` does not fit `data`, or `description` is not for JSON.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = write_pyramidal_tiff(
    ...         Path(folder, "stack.ome.tif"), np.ones((2, 600, 700), "float32"), axes="zyx",
    ...         description={"quantity": "defocus blur", "unit": "px"})
    ...     made_by(file)["unit"], made_by(file)["shape"]
    ('px', [2, 600, 700])
    """
    pixel_size = renamed("scale", scale, "pixel_size", pixel_size)
    _check_axes(tuple(data.shape), np.dtype(data.dtype), axes)
    # tifffile reads `axes` again, and takes capitals.
    form = {**signature(), "shape": tuple(data.shape), "axes": axes.upper()}
    about = plain_json("description", {**description, **form})
    check_results([Path(path)], force=force)
    target = Path(path).resolve()
    part = unused_name(target.parent)
    options = _page_options(data, axes) | _noted(
        axes, np.dtype(data.dtype), pixel_size, units, about
    )
    levels = _Levels(data, axes, labels=labels)
    try:
        levels.wait_in(target.parent)
        _write(part, levels, options)
        part.replace(target)
    except OSError as error:
        raise UnwritableResult(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        levels.arrays.clear()
        part.unlink(missing_ok=True)
    return Path(path)


def made_by(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what a TIFF of this package says about itself, of one plane or many; else nothing.

    No pixels are read.
    """
    return mark_in_tiff(path)


def _check_axes(shape: tuple[int, ...], dtype: np.dtype[Any], axes: str) -> None:
    planes, _, picture = axes.partition("y")
    if picture not in ("x", "xs") or set(planes) & set("xs") or len(set(axes)) < len(axes):
        raise ValueError(f"axes is {axes!r}; it takes planes, then y, x, then s for colours")
    if len(shape) != len(axes) or min(shape) < 1:
        raise ValueError(f"data have the shape {shape}; axes {axes!r} take {len(axes)} sizes")
    if picture == "xs" and shape[-1] not in (3, 4):
        raise ValueError(f"data have {shape[-1]} colours; they take 3 or 4")
    if dtype.kind not in "buif":
        raise TypeError(f"data are {dtype}; bool and real numbers are written")


class _Levels:
    """Tiles of every level, from the largest on, each made while the one before is written."""

    def __init__(self, data: Any, axes: str, *, labels: bool) -> None:
        self.row_axis = axes.index("y")
        self.labels = labels or np.dtype(data.dtype).kind == "b"
        self.dtype = np.dtype(np.uint8 if data.dtype.kind == "b" else data.dtype)
        self.shapes = level_shapes(tuple(data.shape), self.row_axis)
        self.arrays = [data]

    def wait_in(self, folder: Path) -> None:
        """Keep the smaller levels, until they are written, in files without a name in a folder."""
        for shape in self.shapes[1:]:
            with tempfile.TemporaryFile(dir=folder) as file:
                _allocate(file.fileno(), prod(shape) * self.dtype.itemsize)
                self.arrays.append(np.memmap(file, self.dtype, "r+", shape=shape))

    def tiles(self, level: int) -> Iterator[NDArray[Any]]:
        """Yield the tiles of a level, plane by plane and row by row; the level above is filled."""
        for plane in np.ndindex(*self.shapes[level][: self.row_axis]):
            at = 0
            for rows in _tile_rows(self.arrays[level], plane):
                values = rows.astype(self.dtype, copy=False)
                if level + 1 < len(self.arrays):
                    half = self._halved(values)
                    self.arrays[level + 1][(*plane, slice(at, at + len(half)))] = half
                    at += len(half)
                # tifffile pads those at the borders.
                yield from (values[:, x : x + TILE] for x in range(0, values.shape[1], TILE))

    def _halved(self, rows: NDArray[Any]) -> NDArray[Any]:
        if rows.ndim == 2:
            return halved(rows, labels=self.labels)
        colors = [halved(rows[..., i], labels=self.labels) for i in range(rows.shape[2])]
        return np.stack(colors, axis=-1)


def _allocate(file: int, size: int) -> None:
    """Make a file so long, or fail: writing into a mapping on a full disk ends the process."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file, 0, size)
        return
    for _ in range(0, size, _BUFFER):
        os.write(file, bytes(_BUFFER))


def _tile_rows(data: Any, plane: tuple[int, ...]) -> Iterator[NDArray[Any]]:
    """Yield a plane in pieces as high as tiles; each of dask's blocks is computed once."""
    waiting: list[NDArray[Any]] = []
    for start, stop in _bounds_of_blocks(data, len(plane)):
        waiting.append(np.asarray(data[(*plane, slice(start, stop))]))
        if sum(map(len, waiting)) >= TILE:
            rows = np.concatenate(waiting) if len(waiting) > 1 else waiting[0]
            whole = len(rows) // TILE * TILE
            for first in range(0, whole, TILE):
                yield rows[first : first + TILE]
            waiting = [rows[whole:]]
    left = np.concatenate(waiting)
    if len(left):
        yield left


def _bounds_of_blocks(data: Any, row_axis: int) -> Iterator[tuple[int, int]]:
    height = data.shape[row_axis]
    # Chunks of Zarr are single numbers, and reading a part of them is cheap.
    of_dask = hasattr(data, "numblocks")
    heights = data.chunks[row_axis] if of_dask else [TILE] * -(-height // TILE)
    start = 0
    for rows in heights:
        yield start, min(start + rows, height)
        start += rows


def _page_options(data: Any, axes: str) -> dict[str, Any]:
    colors = data.shape[-1] if axes.endswith("s") else 0
    return {
        "tile": (TILE, TILE),
        "photometric": "rgb" if colors else "minisblack",
        "planarconfig": "contig" if colors else None,
        "extrasamples": ["unassalpha"] if colors == 4 else None,
        "compression": "zlib",
        # Of integers alone: few programs undo that of floats.
        "predictor": np.dtype(data.dtype).kind in "bui",
        "buffersize": _BUFFER,
    }


def _noted(
    axes: str,
    dtype: np.dtype[Any],
    pixel_size: Mapping[str, float] | None,
    units: Mapping[str, str] | None,
    about: Mapping[str, Any],
) -> dict[str, Any]:
    """Return what the first page notes: OME-XML if there are planes that it knows, else JSON."""
    steps = {axis: step for axis, step in (pixel_size or {}).items() if axis in (units or {})}
    noted = {"software": " ".join(signature().values()), **_resolution(steps, units or {})}
    planes = set(axes) - set("yxs")
    name = "uint8" if dtype.kind == "b" else dtype.name
    if not planes or planes - _OME_AXES or name not in _OME_DTYPES:
        # tifffile adds the shape.
        return {**noted, "metadata": {k: v for k, v in about.items() if k != "shape"}}
    metadata: dict[str, Any] = {"axes": axes.upper(), "Description": json.dumps(about)}
    for axis, step in steps.items():
        if (symbols := SYMBOLS_OF_UNIT.get((units or {})[axis])) and axis in "zyxt":
            key = "TimeIncrement" if axis == "t" else f"PhysicalSize{axis.upper()}"
            metadata |= {key: step, f"{key}Unit": symbols[0]}
    return {**noted, "metadata": metadata}


def _resolution(pixel_size: Mapping[str, float], units: Mapping[str, str]) -> dict[str, Any]:
    sizes = [pixel_size.get(axis, 0) * MICROMETERS.get(units.get(axis, ""), 0) for axis in "xy"]
    if min(sizes) <= 0:
        return {}
    across, up = (_CENTIMETER / size for size in sizes)
    return {"resolution": (across, up), "resolutionunit": "CENTIMETER"}


def _write(path: Path, levels: _Levels, options: Mapping[str, Any]) -> None:
    import tifffile

    size = sum(map(prod, levels.shapes)) * levels.dtype.itemsize
    first = {"subifds": len(levels.shapes) - 1, **options}
    later = {**options, "subfiletype": 1, "metadata": {}}
    for of_the_first in ("resolution", "resolutionunit"):
        later.pop(of_the_first, None)
    ome = "Description" in options["metadata"]
    with tifffile.TiffWriter(path, mode="w", bigtiff=size > _LARGE, ome=ome) as tiff:
        for level, shape in enumerate(levels.shapes):
            tiff.write(
                levels.tiles(level),
                shape=shape,
                dtype=levels.dtype,
                **(later if level else first),
            )
    with path.open("rb+") as file:
        os.fsync(file.fileno())
