"""Small pictures of a plane that is measured tile by tile: each tile notes its own few pixels."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.batch.thumbnails import SIDE, as_image, encoded, small_size
from napari_defocus.core.image import prepare_image, shown_colors

Region = tuple[slice, slice]


def tile_sample(
    region: Region,
    shape: tuple[int, int],
    picture: NDArray[Any],
    blur_map: NDArray[Any],
    known: NDArray[np.bool_],
) -> bytes:
    """Return what the thumbnail of a plane needs of a tile, as an NPZ file.

    Parameters
    ----------
    region : (slice, slice)
        Where the tile is.
    shape : (int, int)
        Height and width of the plane, in px.
    picture : (h, w) or (h, w, 3) or (h, w, 4) ndarray
        Of the tile; its colours are averaged as far as the thumbnail's pixels reach.
    blur_map : (h, w) ndarray
        In px.
    known : (h, w) bool ndarray
    """
    from scipy.ndimage import uniform_filter

    places = [
        _places(part, many, few)
        for part, many, few in zip(region, shape, small_size(*shape), strict=True)
    ]
    (rows, row_numbers), (columns, column_numbers) = places
    reach = max(1, round(max(shape) / max(small_size(*shape))))
    size = (reach, reach) + (1,) * (picture.ndim - 2)
    averaged = uniform_filter(picture.astype(np.float32), size, mode="nearest")
    inside = np.ix_(rows, columns)
    buffer = io.BytesIO()
    np.savez(
        buffer,
        rows=row_numbers,
        columns=column_numbers,
        colors=averaged[inside],
        radii=np.where(known, blur_map, np.nan)[inside],
    )
    return buffer.getvalue()


def _places(part: slice, many: int, few: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return which pixels of a tile, and which of the thumbnail, are one, along an axis."""
    centers = ((np.arange(few) + 0.5) * many / few).astype(int)
    (numbers,) = np.nonzero((centers >= part.start) & (centers < part.stop))
    return centers[numbers] - part.start, numbers


def small_pictures_of_tiles(
    thumbnail: Path,
    plane: Any,
    samples: Iterable[bytes],
    intensity_range: tuple[float, float] | None = None,
) -> dict[Path, bytes]:
    """Return the files of a plane, a dask array, from the samples of all of its tiles."""
    shape = plane.shape[:2]
    colors = np.zeros(small_size(*shape) + plane.shape[2:], np.float32)
    radii = np.full(small_size(*shape), np.nan, np.float32)
    for sample in samples:
        with np.load(io.BytesIO(sample)) as tile:
            inside = np.ix_(tile["rows"], tile["columns"])
            colors[inside], radii[inside] = tile["colors"], tile["radii"]
    whole = np.rint(colors).astype(plane.dtype) if plane.dtype.kind != "f" else colors
    prepared = prepare_image(whole, intensity_range)
    shown, known = shown_colors(prepared), np.isfinite(radii)
    detail = plane[_liveliest(shown, known, shape)].compute(scheduler="synchronous")
    in_detail = shown_colors(prepare_image(detail, prepared.intensities))
    return encoded(thumbnail, as_image(shown), as_image(in_detail), radii, known)


def _liveliest(
    shown: NDArray[np.float32], known: NDArray[np.bool_], shape: tuple[int, int]
) -> Region:
    """Return the part of a plane with most contrast where most is known."""
    from scipy.ndimage import uniform_filter

    grey = shown.mean(axis=2)
    reach = max(3, round(SIDE * grey.shape[0] / shape[0]))
    spread = uniform_filter(grey**2, reach) - uniform_filter(grey, reach) ** 2
    worth = spread * (0.01 + uniform_filter(known.astype(np.float32), reach))
    place = np.unravel_index(int(worth.argmax()), worth.shape)
    starts = (
        int(np.clip((at + 0.5) * many / few - SIDE / 2, 0, max(0, many - SIDE)))
        for at, many, few in zip(place, shape, grey.shape, strict=True)
    )
    row, column = (slice(start, start + SIDE) for start in starts)
    return row, column
