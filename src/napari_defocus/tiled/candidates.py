"""Candidates of stacks, and of pictures larger than memory: the same results, tile by tile.

A plane that fits into one tile is worked on as a whole. In a larger one, every tile is read twice.
The coarse pass adds up the data terms of cells of 4 x 4 windows. The cells of the whole plane are
labelled at once, which decides over long distances. Then each tile, with a halo of three windows,
is labelled finely. Its rim is held to the labels of the cells, and tiles are blended over their
margins. A task takes pixels and returns maps, so memory is bounded by tiles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from dask import delayed
from dask.delayed import Delayed
from numpy.typing import NDArray

from napari_defocus.core.intensity import Intensities
from napari_defocus.core.progress import Progress, silent
from napari_defocus.likelihood.estimation import Estimation
from napari_defocus.likelihood.maxima import CANDIDATES
from napari_defocus.likelihood.psf_choice import PSFChoice
from napari_defocus.likelihood.scale_space import joined_scales
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.likelihood.window_analysis import Search
from napari_defocus.psf import AUTO
from napari_defocus.psf.families import PSFFamily
from napari_defocus.settings import THRESHOLD_PLANES, RestorationSettings
from napari_defocus.tiled.computing import run_tasks
from napari_defocus.tiled.lazy_planes import Index, LazyPlanes
from napari_defocus.tiled.plane_noise import noise_of_plane
from napari_defocus.tiled.psf_of_planes import evenly_spaced
from napari_defocus.tiled.tile_graph import Key, TileGraph, after, pixels, placed
from napari_defocus.tiled.tile_tasks import (
    Noise,
    Wanted,
    blur_pass,
    coarse_pass,
    confidence_pass,
    join_cells,
    label_cells,
    measure_tile,
    noise_with_variance,
    threshold_of_tiles,
    windows_of_tile,
)
from napari_defocus.tiled.tiles import Tile, Tiling


@dataclass(frozen=True, eq=False)
class LazyCandidates:
    """The candidates of a stack, or of a picture larger than memory: computed when needed.

    They come from `estimate_candidates`. `label_blur_map`, `segment_in_focus` and
    `confidence_map` take them as they take those of one picture. They return dask arrays, which are
    computed when they are asked for, or NumPy arrays if the picture was one.

    Attributes
    ----------
    planes : LazyPlanes
        The image.
    estimation : Estimation
        How each plane's candidates are estimated.
    noise_variance : float, ShotNoise or None
        As given.
    block_size : int
        Side of the tiles of a plane, in px.
    found_noise : mapping of tuple to Noise
        That of each plane by its index, if it was found before, see `with_noise`.
    psf_choice : PSFChoice or None
        How the family of all planes was chosen, if they were to choose it.
    """

    planes: LazyPlanes
    estimation: Estimation
    noise_variance: float | ShotNoise | None
    block_size: int
    found_noise: Mapping[Index, Noise] = field(default_factory=dict, repr=False)
    psf_choice: PSFChoice | None = None

    def __post_init__(self) -> None:
        """Find the levels of a plane: its tiles have the same."""
        object.__setattr__(self, "estimation", self.estimation.for_shape(self.planes.shape))

    @property
    def plane_shape(self) -> Index:
        """How many planes there are along each axis before the last two; () for one picture."""
        return self.planes.counts

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of a plane, in px."""
        return self.planes.shape

    @property
    def psf(self) -> PSFFamily:
        """The family whose scales are candidates."""
        return self.estimation.psf

    @property
    def scales(self) -> NDArray[np.floating]:
        """Those of the curves: (L,), in px."""
        how = self.estimation
        return joined_scales(self.psf.max_scale, how.window, how.levels or 1)

    @property
    def curve(self) -> Any:
        """Log p(r) at `scales`, (..., R, C, L): what `BlurCandidates` of each plane have."""
        return self._of_windows("curve", len(self.scales), search=None)

    @property
    def radii(self) -> Any:
        """The best maxima of the likelihood in px, (..., R, C, 3): as `curve`."""
        return self._of_windows("radii", CANDIDATES, search=self.estimation.search)

    def measure(
        self, wanted: Wanted, seeds: Any = None, within: Any = None, threshold: Any = None
    ) -> dict[str, Any]:
        """Return all that is asked for, by name: a dask array (..., H, W) each.

        `threshold` is that of masks as `threshold` returns it, if it was asked for before.
        """
        if threshold is None and wanted.mask is not None and wanted.mask.threshold == AUTO:
            threshold = self.threshold(within)

        def of_plane(index: Index) -> dict[str, Any]:
            known, where = (None if one is None else one[index] for one in (seeds, within))
            return self._measured(index, wanted, known, where, threshold)

        return self.planes.each(of_plane)

    def threshold(self, within: Any = None) -> Delayed:
        """Return up to which blur all planes count as in focus, delayed.

        It is found from all of a picture, and from up to eight planes of a stack, evenly apart.
        """
        planes = list(np.ndindex(self.plane_shape))
        some = evenly_spaced(len(planes), THRESHOLD_PLANES)
        counted = [self._blur_counts(planes[number], within) for number in some]
        graph = TileGraph("threshold", counted)
        found = threshold_of_tiles, counted, self.scales, self.estimation.mode
        return graph.value(graph.add("of planes", *found))

    def threshold_now(self, image: Any, within: Any, progress: Progress) -> float:
        """Return the threshold as a number."""
        self.planes.check_same(image)
        return float(run_tasks(self.threshold(self._belonging("within", within)), progress))

    def _blur_counts(self, index: Index, within: Any) -> Delayed:
        plane, noise = self.planes.plane(index), self.noise(index)
        where = None if within is None else within[index]
        read = after(plane, noise) if isinstance(noise, Delayed) else plane
        graph = TileGraph("blur", read, noise, where, self._made_with)
        keys = []
        for tile, place in placed(self._tiling.tiles(coarse=True)):
            seen = pixels(read, tile.seen), _part_of(where, tile), tile
            keys.append(graph.add(place, blur_pass, *seen, noise, self._frugal))
        return graph.value(graph.add("all", _added, keys))

    def with_noise(self, progress: Progress = silent) -> LazyCandidates:
        """Return the same candidates, with the noise of every plane found now, once for all.

        See `variances` for what was found.
        """
        asked = {index: self._asked_noise(index) for index in np.ndindex(self.plane_shape)}
        return replace(self, found_noise=run_tasks(asked, progress, "Measuring the noise"))

    @property
    def variances(self) -> NDArray[np.float64]:
        """Of the noise of each plane, (...), once it was found; means if it grows with light."""
        found = [self.found_noise[index].variance for index in np.ndindex(self.plane_shape)]
        return np.array(found, np.float64).reshape(self.plane_shape)

    @property
    def intensities(self) -> list[Intensities]:
        """Of each plane, in order, once the noise was found, see `with_noise`."""
        found = [self.found_noise[index].intensities for index in np.ndindex(self.plane_shape)]
        return [one for one in found if one is not None]

    def _asked_noise(self, index: Index) -> Any:
        """Return the noise of a plane with its variance, which a small plane finds by itself."""
        noise = self.noise(index)
        if index in self.found_noise or not self._tiling.alone:
            return noise
        return delayed(noise_with_variance)(self.planes.plane(index), self.estimation, noise)

    def results(
        self,
        image: Any,
        progress: Progress,
        *,
        seeds: Any = None,
        within: Any = None,
        **asked: Any,
    ) -> dict[str, Any]:
        """Return what `Wanted` asks for, by name, as the user wants it.

        Computed, if an array of numpy came in; else dask arrays.

        Raises
        ------
        ValueError
            If `image` is another one than that of the candidates, or `seeds` or `within` have
            another shape.
        """
        self.planes.check_same(image)
        known = None if seeds is None else self.planes.belonging("seeds", seeds, "ui")
        found = self.measure(Wanted(**asked), known, self._belonging("within", within))
        return run_tasks(found, progress) if self.planes.in_memory else found

    def _belonging(self, name: str, marks: Any) -> Any:
        return None if marks is None else self.planes.belonging(name, marks, "bui")

    def judged(self, blur_map: Any, risk: float = RestorationSettings.risk) -> dict[str, Any]:
        """Return `confidence_map` and `cautious_blur_map` of any map, (..., H, W), by name."""
        radii = self.planes.belonging("blur_map", blur_map)
        tiles = self._tiling.tiles()

        def of_plane(index: Index) -> dict[str, Any]:
            plane, radius, noise = self.planes.plane(index), radii[index], self.noise(index)
            graph = TileGraph("confidence", plane, radius, noise, self._made_with, risk)
            for tile, place in placed(tiles):
                seen = pixels(plane, tile.seen), pixels(radius, tile.pixels), tile
                graph.add(place, confidence_pass, *seen, noise, self._frugal, risk)
            return {name: graph.picked(name, tiles) for name in ("confidence", "cautious")}

        found = self.planes.each(of_plane)
        return run_tasks(found, silent) if self.planes.in_memory else found

    @property
    def _tiling(self) -> Tiling:
        how = self.estimation
        levels = how.levels or 1
        return Tiling(self.image_shape, how.window, how.stride, self.block_size, levels)

    @property
    def _frugal(self) -> Estimation:
        """The estimation without maxima where nobody needs them: (14) does, of the paper."""
        paper = self.estimation.mode == "paper"
        return self.estimation if paper else replace(self.estimation, search=None)

    @property
    def _made_with(self) -> tuple[Any, ...]:
        return self.estimation, self.noise_variance, self.block_size

    def noise(self, index: Index) -> Any:
        """Return the noise of a plane as its tiles need it: a `Noise`, or a delayed one."""
        if index in self.found_noise:
            return self.found_noise[index]
        if self._tiling.alone:
            return Noise(self.noise_variance)
        return noise_of_plane(self.planes.plane(index), self.noise_variance, self.estimation)

    def _measured(
        self, index: Index, wanted: Wanted, seeds: Any, within: Any, threshold: Any
    ) -> dict[str, Any]:
        plane, noise = self.planes.plane(index), self.noise(index)
        cells = None
        how = noise, self._frugal, wanted, threshold
        if not self._tiling.alone:
            before = next((one for one in (threshold, noise) if isinstance(one, Delayed)), None)
            read = plane if before is None else after(plane, before)
            cells = self._labels_of_cells(read, seeds, *how)
            plane = after(plane, cells)
        tiles = self._tiling.tiles()
        made_of = plane, noise, seeds, within, cells, self._made_with, wanted, threshold
        graph = TileGraph("measured", *made_of)
        for tile, place in placed(tiles):
            given = (_part_of(one, tile) for one in (seeds, within))
            seen = pixels(plane, tile.seen), *given, tile, self._tiling.levels
            graph.add(place, measure_tile, *seen, cells, *how)
        return {
            name: graph.blended(name, tiles)
            if dtype is np.float32
            else graph.picked(name, tiles, dtype)
            for name, dtype in wanted.dtypes.items()
        }

    def _labels_of_cells(self, plane: Any, seeds: Any, *how: Any) -> Any:
        """Return the labels of the whole plane's cells, delayed."""
        graph = TileGraph("coarse", plane, seeds, self._made_with, *how)
        tiles, levels = self._tiling.tiles(coarse=True), self._tiling.levels
        rows: list[Any] = []
        for number, line in enumerate(tiles):
            # Row after row: all at once, dask would read the whole plane before much is done.
            before = rows[-2] if number > 1 else None
            costs = []
            for column, tile in enumerate(line):
                seen = pixels(plane, tile.seen), _part_of(seeds, tile), tile, levels
                costs.append(graph.add((number, column), coarse_pass, *seen, *how, after=before))
            last = rows[-1] if rows else None
            rows.append(graph.add(("row", number), join_cells, costs, 1, after=last))
        return graph.value(graph.add("cells", label_cells, rows))

    def _of_windows(self, name: str, length: int, *, search: Search | None) -> Any:
        tiles, how = self._tiling.tiles(coarse=True), replace(self.estimation, search=search)

        def of_plane(index: Index) -> dict[str, Any]:
            plane, noise = self.planes.plane(index), self.noise(index)
            graph = TileGraph(f"{name}-of", plane, noise, self._made_with, search)
            for tile, place in placed(tiles):
                seen = pixels(plane, tile.seen), tile
                graph.add(place, windows_of_tile, *seen, noise, how, name)

            def task_of(*place: int) -> Key:
                return (graph.name, *place)

            def shape_of(tile: Tile) -> tuple[int, ...]:
                return (*tile.core_windows, length)

            return {name: graph.array(name, tiles, task_of, np.float32, shape_of)}

        return self.planes.each(of_plane)[name]


def _part_of(array: Any, tile: Tile) -> Any:
    return None if array is None else pixels(array, tile.pixels)


def _added(counts: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    return np.sum(counts, axis=0)
