"""OME-Zarr out: written region by region, from any process, and given its name when it is whole."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from types import EllipsisType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from napari_defocus.core.checks import renamed
from napari_defocus.core.extras import need_large_extra
from napari_defocus.core.writing import NeedsForce, UnwritableResult
from napari_defocus.io.lazy_arrays import regions
from napari_defocus.io.multiscale import halve_into, level_shapes
from napari_defocus.io.ome_zarr import OUR_KEY, is_zarr
from napari_defocus.io.ome_zarr_metadata import (
    check_form,
    check_named_axes,
    description,
    stored_names,
    stored_order,
)
from napari_defocus.io.provenance import plain_json

TILE = 512
"""px of a chunk's side."""

Region = tuple[slice | int | EllipsisType, ...]


@dataclass(frozen=True)
class OmeZarrWriter:
    """A store that comes into being: regions are written, then it is finished.

    It holds nothing but values, so it can be sent to other processes, which write their own
    regions. Between them no lock is needed: regions are whole chunks.

    Attributes
    ----------
    path, part : Path
        Where the store will be, and where it is until `finish`.
    shape : tuple of int
    dtype : str
    axes : str
        As given: colours, `s`, last.
    pixel_size, units : dict
    tile : int
        Regions start at its multiples in y and x, and end there or at the border.
    labels, force : bool
        As given to `new_ome_zarr`.
    """

    path: Path
    part: Path
    shape: tuple[int, ...]
    dtype: str
    axes: str
    pixel_size: dict[str, float]
    units: dict[str, str]
    tile: int
    labels: bool
    force: bool

    @property
    def scale(self) -> dict[str, float]:
        """The old name of `pixel_size`."""
        return renamed("scale", self.pixel_size, "pixel_size", None) or {}

    def write_region(self, region: Region, values: ArrayLike) -> None:
        """Write values at slices, one an axis, or at the number of a plane.

        Parameters
        ----------
        region : tuple of slice or int
            In the order of `axes`; whole tiles. A last `...` stands for all of the other axes.
        values : array_like
            Of the region's shape.

        Raises
        ------
        ValueError
            If the region is not whole tiles, is outside, or the values have another shape.
        """
        parts = self._slices(region)
        shape = tuple(part.stop - part.start for part in parts)
        given = np.asarray(values, self.dtype)
        keys = zip(shape, self._keys(region), strict=True)
        kept = tuple(n for n, key in keys if isinstance(key, slice))
        if given.shape not in (shape, kept):
            raise ValueError(f"values have the shape {given.shape}; the region has {kept}")
        order = stored_order(self.axes)
        stored = given.reshape(shape).transpose(order)
        write_region(self.part, tuple(parts[i] for i in order), stored)

    def __setitem__(self, region: Region, values: ArrayLike) -> None:
        """Write a region: what `dask.array.store` calls."""
        self.write_region(region, values)

    def has_region(self, region: Region) -> bool:
        """Return whether a region was written, here or before an interruption."""
        parts = zip(self._slices(region), self._sides, strict=True)
        numbers = [range(part.start // side, -(-part.stop // side)) for part, side in parts]
        level = self.part / "0" / "c"
        chunks = product(*(map(str, numbers[i]) for i in stored_order(self.axes)))
        return all(level.joinpath(*chunk).is_file() for chunk in chunks)

    def missing(self) -> list[tuple[slice, ...]]:
        """Return the tiles that were not written."""
        return [tile for tile in regions(self.shape, self._sides) if not self.has_region(tile)]

    def finish(self) -> Path:
        """Make the pyramid, say what the store is, and give it its name.

        Returns
        -------
        Path
            Where the store is now.

        Raises
        ------
        ValueError
            If a region was not written.
        UnwritableResult
            If there is something at the path by now and `force` was not given.
        """
        if missing := len(self.missing()):
            tiles = sum(1 for _ in regions(self.shape, self._sides))
            raise ValueError(f"{missing} of {tiles} tiles of {self.path} were not written")
        levels = _make_pyramid(self)
        _say_what_it_is(self, levels)
        for left in self.part.rglob("*.partial"):
            left.unlink()
        _give_name(self.part, self.path, force=self.force)
        return self.path

    @property
    def _sides(self) -> tuple[int, ...]:
        """Of a chunk, in the order of `axes`."""
        return tuple(self.tile if letter in "yx" else 1 for letter in self.axes)

    def _keys(self, region: Region) -> tuple[slice | int, ...]:
        keys = tuple(key for key in region if not isinstance(key, EllipsisType))
        if region[-1:] == (...,):
            keys += (slice(None),) * (len(self.shape) - len(keys))
        if len(keys) != len(self.shape):
            raise ValueError(f"region has {len(keys)} axes; the store has {len(self.shape)}")
        return keys

    def _slices(self, region: Region) -> tuple[slice, ...]:
        given = zip(self._keys(region), self.shape, self.axes, self._sides, strict=True)
        return tuple(self._slice(*what) for what in given)

    def _slice(self, key: slice | int, size: int, letter: str, chunk: int) -> slice:
        start, stop = (key, key + 1) if not isinstance(key, slice) else key.indices(size)[:2]
        if not 0 <= start < stop <= size:
            raise ValueError(f"region is {key} along {letter}; it takes a part of 0 to {size}")
        if start % chunk or (stop % chunk and stop != size):
            raise ValueError(f"region is {key} along {letter}; it takes whole tiles of {chunk}")
        return slice(start, stop)


def new_ome_zarr(
    path: str | os.PathLike[str],
    *,
    shape: tuple[int, ...],
    dtype: DTypeLike,
    axes: str,
    pixel_size: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    attributes: Mapping[str, Any],
    tile: int = TILE,
    labels: bool = False,
    resume: bool = False,
    force: bool = False,
    scale: Mapping[str, float] | None = None,
) -> OmeZarrWriter:
    """Begin an OME-Zarr 0.5 store, beside its place and under a hidden name, `.NAME.part`.

    The same values make the same bytes. An interrupted run leaves a part. With `resume`, it is
    continued if it has the same shape, dtype, axes, tile and attributes; otherwise it is thrown
    away. A store that an interruption at the very end of an earlier run moved aside is put back
    first.

    Parameters
    ----------
    path : path-like
        Where the store will be; its folder exists.
    shape : tuple of int
        Length of every axis.
    dtype : dtype-like
        bool, or a real number.
    axes : str
        A letter an axis, y and x among them; up to 5. OME-Zarr wants time first and space last:
        axes are stored in that order, and colours, `s`, as channels. Regions are still given in
        the order of `axes`.
    pixel_size : mapping of str to float, optional
        How far apart neighbours are along an axis; 1 for those that are not in it.
    units : mapping of str to str, optional
        In the spelling of UDUNITS, such as "micrometer" and "second".
    attributes : mapping
        What made it: anything that JSON can hold; `read_ome_zarr` gives it back.
    tile : int, optional
        px of a chunk's side, 16 or more. Planes and colours have chunks of their own.
    labels : bool, optional
        Whether integers are names or a mask, and no intensities. Smaller levels of the pyramid
        then hold the largest of 2 x 2, so that what is thin does not vanish and no value is
        invented; else the mean. Means of floats leave NaN out.
    resume, force : bool, optional
        Whether to go on with a part; whether to replace a store that is there.
    scale : mapping of str to float, optional
        The old name of `pixel_size`.

    Returns
    -------
    OmeZarrWriter

    Raises
    ------
    UnwritableResult
        If the folder is missing, or `path` exists and `force` is not set, or is no Zarr store.
    TypeError, ValueError
        If another argument is not as said above.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     writer = new_ome_zarr(
    ...         Path(folder, "mask.ome.zarr"), shape=(2, 600, 700), dtype="uint8", axes="zyx",
    ...         attributes={"quantity": "in-focus mask"}, labels=True)
    ...     for plane in range(2):
    ...         writer.write_region((plane, slice(0, 600), slice(0, 700)), np.ones((600, 700)))
    ...     writer.finish().name
    'mask.ome.zarr'
    """
    pixel_size = renamed("scale", scale, "pixel_size", pixel_size)
    need_large_extra()
    target = Path(path).absolute()
    about = plain_json("attributes", attributes)
    kind = np.dtype(dtype)
    check_form(shape, kind, axes, tile)
    check_named_axes("pixel_size", pixel_size, axes)
    check_named_axes("units", units, axes)
    _put_back(target)
    _check_target(target, force)
    writer = OmeZarrWriter(
        path=target,
        part=part_of(target),
        shape=tuple(int(size) for size in shape),
        dtype=kind.name,
        axes=axes,
        pixel_size=dict(pixel_size or {}),
        units=dict(units or {}),
        tile=tile,
        labels=labels,
        force=force,
    )
    if not (resume and _can_go_on(writer, about)):
        shutil.rmtree(writer.part, ignore_errors=True)
        _create(writer, about)
    return writer


def whole_tiles(shape: tuple[int, int], block: int, tile: int = TILE) -> list[tuple[slice, slice]]:
    """Return regions of a plane, about as large as blocks that are computed, in whole tiles."""
    side = tile * max(1, block // tile)
    return [(rows, columns) for rows, columns in regions(shape, (side, side))]


def write_region(
    store: str | os.PathLike[str], region: tuple[slice, ...], values: NDArray[Any]
) -> None:
    """Write values into the largest level of a store, in the order in which its axes are stored.

    `OmeZarrWriter.write_region` checks them first, and takes them in the order they were given.
    """
    import zarr

    _array(zarr.open_group(store, mode="r+"), "0")[region] = values


def _array(group: Any, name: str) -> Any:
    # Chunks that hold nothing but zeros are files, too: a file says that a region was written.
    return group[name].with_config({"write_empty_chunks": True})


def _check_target(path: Path, force: bool) -> None:
    refusal = None
    if not path.parent.is_dir():
        refusal = f"there is no folder {path.parent}"
    elif path.exists() and not is_zarr(path):
        refusal = "it exists, and is not a Zarr store"
    if refusal:
        raise UnwritableResult(f"cannot write {path}: {refusal}")
    if path.exists() and not force:
        raise NeedsForce(f"cannot write {path}: it exists already", "{force} overwrites it")


def _can_go_on(writer: OmeZarrWriter, about: dict[str, Any]) -> bool:
    import zarr

    # Killed while it was created, a part holds anything.
    try:
        group = zarr.open_group(writer.part, mode="r")
        array = group["0"]
    except (OSError, KeyError, ValueError):
        return False
    form = (array.shape, array.dtype, array.chunks, list(array.metadata.dimension_names or ()))
    return form == _stored_form(writer) and group.attrs.get(OUR_KEY) == about


def _stored_form(writer: OmeZarrWriter) -> tuple[Any, ...]:
    order = stored_order(writer.axes)
    shape = tuple(writer.shape[i] for i in order)
    chunks = tuple(min(writer._sides[i], writer.shape[i]) for i in order)
    return shape, np.dtype(writer.dtype), chunks, stored_names(writer.axes)


def _create(writer: OmeZarrWriter, about: dict[str, Any]) -> None:
    import zarr

    shape, dtype, chunks, names = _stored_form(writer)
    group = zarr.open_group(writer.part, mode="w", zarr_format=3)
    _create_level(group, "0", shape, dtype, chunks, names)
    group.attrs.put({OUR_KEY: about})


def _create_level(
    group: Any,
    name: str,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    chunks: tuple[int, ...],
    names: list[str],
) -> Any:
    from zarr.codecs import BloscCodec

    group.create_array(
        name,
        shape=shape,
        dtype=dtype,
        chunks=chunks,
        compressors=BloscCodec(cname="zstd", clevel=5, shuffle="shuffle"),
        fill_value=math.nan if dtype.kind == "f" else 0,
        dimension_names=names,
        overwrite=True,
    )
    return _array(group, name)


def _make_pyramid(writer: OmeZarrWriter) -> int:
    """Write the smaller levels, a chunk at a time; return how many there are with the largest."""
    import zarr

    group = zarr.open_group(writer.part, mode="r+")
    _, dtype, chunks, names = _stored_form(writer)
    fine = group["0"]
    shapes = level_shapes(fine.shape, len(fine.shape) - 2)
    for level, shape in enumerate(shapes[1:], 1):
        sides = tuple(min(size, side) for size, side in zip(shape, chunks, strict=True))
        coarse = _create_level(group, str(level), shape, dtype, sides, names)
        halve_into(fine, coarse, coarse.chunks, labels=writer.labels)
        fine = coarse
    return len(shapes)


def _say_what_it_is(writer: OmeZarrWriter, levels: int) -> None:
    import zarr

    colors = writer.shape[writer.axes.index("s")] if "s" in writer.axes else 0
    zarr.open_group(writer.part, mode="r+").attrs["ome"] = description(
        writer.axes,
        writer.pixel_size,
        writer.units,
        name=writer.path.name.removesuffix(".zarr").removesuffix(".ome"),
        levels=levels,
        labels=writer.labels,
        rgb_of=np.dtype(writer.dtype) if colors == 3 else None,
    )


def part_of(path: Path) -> Path:
    """Return where a store is until it is whole."""
    return path.with_name(f".{path.name}.part")


def aside(path: Path) -> Path:
    """Return where a store is while another one takes its place."""
    return path.with_name(f".{path.name}.old")


def _give_name(part: Path, path: Path, *, force: bool) -> None:
    """Put a finished store at its place; at every moment the old or the new one is whole."""
    _check_target(path, force)
    if path.exists():
        path.rename(aside(path))
    part.rename(path)
    shutil.rmtree(aside(path), ignore_errors=True)


def _put_back(path: Path) -> None:
    """Undo, or clean up after, a renaming that was killed half-way."""
    if not aside(path).exists():
        return
    if path.exists():
        shutil.rmtree(aside(path))
    else:
        aside(path).rename(path)
