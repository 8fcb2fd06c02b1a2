"""Results of tiled pictures into OME-Zarr stores, tile by tile."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from dask import delayed

from napari_defocus.core.progress import Progress
from napari_defocus.io.ome_zarr_writer import OmeZarrWriter
from napari_defocus.tiled.computing import run_tasks
from napari_defocus.tiled.tile_graph import cut_together


def store(arrays: dict[str, Any], writers: dict[str, OmeZarrWriter], progress: Progress) -> None:
    """Compute dask arrays tile by tile into stores, and finish these.

    What was written before an interruption is not computed again.

    Parameters
    ----------
    arrays : dict of str to dask.array.Array
        From `LazyCandidates.measure` and the like, all of one shape.
    writers : dict of str to OmeZarrWriter
        A new store for each, of its shape; all with tiles of one size.
    progress : callable
        An exception from it ends the work; the stores may be gone on with.
    """
    write = delayed(OmeZarrWriter.write_region, pure=False)
    first, tile = next(iter(arrays.values())), next(iter(writers.values())).tile
    regions = list(whole_tiles(first, tile))
    left = [
        write(writers[name], region, piece[name])
        for region, piece in zip(regions, cut_together(arrays, regions), strict=True)
        for name in arrays
        if not writers[name].has_region(region)
    ]
    run_tasks(left, progress)
    for writer in writers.values():
        writer.finish()


def whole_tiles(array: Any, tile: int) -> Iterator[tuple[slice | int, ...]]:
    """Return regions that make up a dask array, (..., H, W): its blocks, as whole tiles of px."""
    *planes, height, width = array.shape
    side = tile * max(1, max(array.chunks[-2] + array.chunks[-1]) // tile)
    for index in np.ndindex(*planes):
        for top, left in product(range(0, height, side), range(0, width, side)):
            rows = slice(top, min(top + side, height))
            yield (*index, rows, slice(left, min(left + side, width)))
