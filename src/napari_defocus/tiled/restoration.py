"""The all-in-focus pictures of stacks, and of pictures larger than memory, tile by tile."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from dask.delayed import Delayed
from numpy.typing import NDArray

from napari_defocus.core.intensity import needs_limits
from napari_defocus.core.progress import Progress
from napari_defocus.restoration.all_in_focus import Restoration, TiledRestorationFit
from napari_defocus.settings import MapSettings
from napari_defocus.tiled.computing import run_tasks
from napari_defocus.tiled.lazy_planes import Index, LazyPlanes
from napari_defocus.tiled.plane_noise import intensities_of_plane, limits_of_planes, noise_of_plane
from napari_defocus.tiled.tile_graph import TileGraph, after, pixels, placed
from napari_defocus.tiled.tile_tasks import Noise
from napari_defocus.tiled.tiles import Tile, Tiling

Float32 = NDArray[np.float32]

_REACH = 64
"""Halo of a restored tile, in px: 53 dB between tiles of 256 px and the whole picture."""


def restore_tile(
    pixels: NDArray[Any],
    blur_map: NDArray[Any],
    confidence: NDArray[Any] | None,
    tile: Tile,
    noise: Noise,
    how: Restoration,
) -> dict[str, Float32]:
    """Restore what a tile sees; return its core and margin, and how far they were left."""
    how = replace(how, noise_variance=noise.known)
    picture = how.prepared(pixels, noise.intensities)
    restored, fit = how.restored_with_fit(pixels, picture, blur_map, confidence)
    made, core = {"in_focus": restored, "left": fit.left_as_it_was}, tile.core(margin=True)
    return {name: values[core].copy() for name, values in made.items()}


def restore_planes(
    planes: LazyPlanes,
    blur_map: Any,
    confidence: Any,
    how: Restoration,
    block_size: int,
    progress: Progress,
) -> tuple[Any, TiledRestorationFit]:
    """Do the work of `restore_all_in_focus`, which see, plane by plane and tile by tile.

    Returns
    -------
    restored : (..., H, W) or (..., H, W, 3 or 4) dask.array.Array
        Or an array, if the image was one.
    fit : TiledRestorationFit
    """
    radii = planes.belonging("blur_map", blur_map)
    sure = None if confidence is None else planes.belonging("confidence", confidence)
    tiling = Tiling(planes.shape, MapSettings.window, MapSettings.stride, block_size)
    tiles = tiling.tiles_with_halo(_REACH)
    colors = planes.image.shape[-1:] if planes.has_colors else ()
    shared = _shared_limits(planes, how)

    def of_plane(index: Index) -> dict[str, Any]:
        plane, radius = planes.plane(index), radii[index]
        noise = _noise(plane, how, shared, tiling.alone)
        if isinstance(noise, Delayed):
            plane = after(plane, noise)
        certain = None if sure is None else sure[index]
        graph = TileGraph("restored", plane, radius, certain, noise, how, block_size)
        for tile, place in placed(tiles):
            known = pixels(plane, tile.pixels), pixels(radius, tile.pixels)
            trusted = None if certain is None else pixels(certain, tile.pixels)
            graph.add(place, restore_tile, *known, trusted, tile, noise, how)
        return {
            "in_focus": graph.blended("in_focus", tiles, colors),
            "left": graph.blended("left", tiles),
        }

    made = planes.each(of_plane)
    if planes.in_memory:
        made = run_tasks(made, progress)
    return made["in_focus"], TiledRestorationFit(made["left"])


def _shared_limits(planes: LazyPlanes, how: Restoration) -> Any:
    """Return the limits of all planes, delayed, if their range is found: it must not flicker."""
    if not (planes.counts and needs_limits(planes.image.dtype, how.intensity_range)):
        return None
    return limits_of_planes([planes.plane(index) for index in np.ndindex(planes.counts)])


def _noise(plane: Any, how: Restoration, shared: Any, alone: bool) -> Any:
    """Return the noise of a plane as its tiles need it: a `Noise`, or a delayed one."""
    given = how.noise_variance
    if alone and shared is None:
        return Noise(given)
    if shared is not None:
        plane = after(plane, shared)
    intensities = intensities_of_plane(plane, how.intensity_range, shared)
    if not alone:
        return noise_of_plane(plane, given, how, intensities)
    graph = TileGraph("noise", intensities, given)
    return graph.value(graph.add("alone", Noise, given, None, intensities))
