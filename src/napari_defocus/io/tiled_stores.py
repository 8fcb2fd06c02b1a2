"""Results of tiled pictures into OME-Zarr stores, tile by tile."""

from __future__ import annotations

from typing import Any

import numpy as np
from dask import delayed

from napari_defocus.core.progress import Progress
from napari_defocus.io.ome_zarr_writer import OmeZarrWriter, whole_tiles
from napari_defocus.tiled.computing import run_tasks
from napari_defocus.tiled.tile_graph import cut_together


def store(arrays: dict[str, Any], writers: dict[str, OmeZarrWriter], progress: Progress) -> None:
    """Compute dask arrays tile by tile into stores, and finish these.

    Arrays are of one shape, such as those of `LazyCandidates.measure`, and stores have tiles of one
    size. What was written before an interruption, such as an exception from `progress`, is not
    computed again.
    """
    write = delayed(OmeZarrWriter.write_region, pure=False)
    first, tile = next(iter(arrays.values())), next(iter(writers.values())).tile
    *planes, height, width = first.shape
    tiles = list(whole_tiles((height, width), max(first.chunks[-2] + first.chunks[-1]), tile))
    places = [(*index, *region) for index in np.ndindex(*planes) for region in tiles]
    left = [
        write(writers[name], region, piece[name])
        for region, piece in zip(places, cut_together(arrays, places), strict=True)
        for name in arrays
        if not writers[name].has_region(region)
    ]
    run_tasks(left, progress)
    for writer in writers.values():
        writer.finish()
