"""Stacks, and pictures larger than memory: the same results part by part, by dask.

A plane that is one part is worked on as a whole. Of a larger one, every part is looked at twice.
The survey adds up the costs of its windows into those of cells of 4 x 4 windows; the cells of the
whole plane are labelled at once, which is what decides over long distances. Then each part, with
three windows around, is labelled from there on, its rim held to the cells' labels, and parts go
over into each other. A task takes pixels and returns maps, so that memory is bounded by parts.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Any

import dask
import numpy as np
from dask import delayed
from dask.callbacks import Callback
from dask.delayed import Delayed
from numpy.typing import DTypeLike, NDArray

from napari_defocus.core.intensity import Intensities, IntensityRange, Limits, needs_limits
from napari_defocus.core.known_pixels import known_values, limits_of
from napari_defocus.core.progress import Progress, silent
from napari_defocus.likelihood.blur_spectra import label_scales
from napari_defocus.likelihood.estimation import Estimation, Search
from napari_defocus.likelihood.maxima import CANDIDATES
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.psf.families import PSFFamily
from napari_defocus.settings import RestorationSettings
from napari_defocus.tiled.lazy_planes import Index, LazyPlanes
from napari_defocus.tiled.tile_graph import (
    PartGraph,
    Parts,
    after,
    pixels,
    placed,
    when_there,
)
from napari_defocus.tiled.tile_tasks import (
    Noise,
    Preparing,
    Wanted,
    blend_named,
    join_cells,
    join_intensities,
    judge_part,
    label_cells,
    look_at_noise,
    measure_part,
    noise_with_variance,
    survey_part,
    windows_of_part,
)
from napari_defocus.tiled.tiles import Cutting, Part, neighbors

_THREADS = min(4, os.cpu_count() or 1)
"""Of dask's threads: each part has all of numba's, and takes its share of memory."""

_STEP = "Measuring part by part"

_TIMES = {"measured-": 1.0, "surveyed-": 0.4, "noise-": 0.02, "intensities-": 0.01}
_SHORT = 0.002
"""How long tasks take: the share that is done is one of time, so that the rest can be told."""


_WHOLE = 4_000_000
"""px of a plane up to which the noise is measured everywhere."""

_PIECES, _PIECE, _EVERY = 8, 512, 3
"""Of a larger one, in so many pieces a side of so many px, at every third pixel."""

_EVERY_INTENSITY = 25
"""And there, the contrast is that of so few pixels."""


@dataclass(frozen=True, eq=False)
class LazyCandidates:
    """The candidates of a stack, or of a picture larger than memory: not kept, but made again.

    From `estimate_candidates`. `label_blur_map`, `segment_in_focus` and `confidence_map` take
    them as they take those of one picture, and return dask arrays, which are computed when they
    are asked for; or arrays, if an array of numpy came in.

    Attributes
    ----------
    planes : LazyPlanes
        The image.
    estimation : Estimation
        How each plane's candidates are estimated.
    noise_variance : float, ShotNoise or None
        As given.
    block_size : int
        Side of the parts of a plane, in px.
    found_noise : mapping of tuple to Noise
        That of each plane by its index, if it was found before, see `with_noise`.
    """

    planes: LazyPlanes
    estimation: Estimation
    noise_variance: float | ShotNoise | None
    block_size: int
    found_noise: Mapping[Index, Noise] = field(default_factory=dict, repr=False)

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
        return label_scales(self.psf)

    @property
    def curve(self) -> Any:
        """Log p(r) at `scales`, (..., R, C, L): what `BlurCandidates` of each plane have."""
        return self._of_windows("curve", len(self.scales), search=None)

    @property
    def radii(self) -> Any:
        """The best maxima of the likelihood in px, (..., R, C, 3): as `curve`."""
        return self._of_windows("radii", CANDIDATES, search=self.estimation.search)

    def measure(self, wanted: Wanted, seeds: Any = None) -> dict[str, Any]:
        """Return all that is asked for, by name: a dask array (..., H, W) each."""
        return self.planes.each(
            lambda index: self._measured(index, wanted, None if seeds is None else seeds[index])
        )

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
        if index in self.found_noise or not self._cutting.alone:
            return noise
        return delayed(noise_with_variance)(self.planes.plane(index), self.estimation, noise)

    def results(
        self, image: Any, progress: Progress, *, seeds: Any = None, **asked: Any
    ) -> dict[str, Any]:
        """Return what `Wanted` asks for, by name, as the user wants it.

        Computed, if an array of numpy came in; else dask arrays.

        Raises
        ------
        ValueError
            If `image` is another one than that of the candidates, or `seeds` have another shape.
        """
        self.planes.check_same(image)
        known = None if seeds is None else self.planes.belonging("seeds", seeds, "ui")
        found = self.measure(Wanted(**asked), known)
        return computed(found, progress) if self.planes.in_memory else found

    def judged(self, blur_map: Any, risk: float = RestorationSettings.risk) -> dict[str, Any]:
        """Return `confidence_map` and `cautious_blur_map` of any map, (..., H, W), by name."""
        radii = self.planes.belonging("blur_map", blur_map)
        parts = self._cutting.parts()

        def of_plane(index: Index) -> dict[str, Any]:
            plane, radius, noise = self.planes.plane(index), radii[index], self.noise(index)
            graph = PartGraph.of("judged", [plane, radius, noise], self._made_with, risk)
            for part, place in placed(parts):
                seen = pixels(plane, part.pixels), pixels(radius, part.pixels), part
                graph.add(place, judge_part, *seen, graph.key_of(noise), self._frugal, risk)
            return {name: _picked(graph, parts, name) for name in ("confidence", "cautious")}

        found = self.planes.each(of_plane)
        return computed(found, silent) if self.planes.in_memory else found

    @property
    def _cutting(self) -> Cutting:
        how = self.estimation
        return Cutting(self.image_shape, how.window, how.stride, self.block_size)

    @property
    def _frugal(self) -> Estimation:
        """The estimation without maxima where nobody needs them: (14) does, of the paper."""
        paper = self.estimation.mode == "paper"
        return self.estimation if paper else replace(self.estimation, search=None)

    @property
    def _made_with(self) -> tuple[Any, ...]:
        return self.estimation, self.noise_variance, self.block_size

    def noise(self, index: Index) -> Any:
        """Return the noise of a plane as its parts need it: a `Noise`, or a delayed one."""
        if index in self.found_noise:
            return self.found_noise[index]
        if self._cutting.alone:
            return Noise(self.noise_variance)
        return noise_of_plane(self.planes.plane(index), self.noise_variance, self.estimation)

    def _measured(self, index: Index, wanted: Wanted, seeds: Any) -> dict[str, Any]:
        plane, noise = self.planes.plane(index), self.noise(index)
        cells = None
        if not self._cutting.alone:
            read = after(plane, noise) if isinstance(noise, Delayed) else plane
            cells = self._labels_of_cells(read, noise, wanted, seeds)
            plane = after(plane, cells)
        parts = self._cutting.parts()
        sources = [plane, noise, seeds, cells]
        graph = PartGraph.of("measured", sources, self._made_with, wanted)
        for part, place in placed(parts):
            seen = pixels(plane, part.pixels), _seeds_of(seeds, part), part, self._cutting.levels
            known = graph.key_of(cells), graph.key_of(noise)
            graph.add(place, measure_part, *seen, *known, self._frugal, wanted)

        return {
            name: _blended(graph, parts, name)
            if dtype is np.float32
            else _picked(graph, parts, name, dtype)
            for name, dtype in wanted.dtypes.items()
        }

    def _labels_of_cells(self, plane: Any, noise: Any, wanted: Wanted, seeds: Any) -> Any:
        """Return the labels of the whole plane's cells, delayed."""
        graph = PartGraph.of("surveyed", [plane, noise, seeds], self._made_with, wanted)
        parts, levels = self._cutting.parts(survey=True), self._cutting.levels
        how = graph.key_of(noise), self._frugal, wanted
        rows: list[Any] = []
        for number, line in enumerate(parts):
            # Row after row: all at once, dask would read the whole plane before it surveys much.
            before = rows[-2] if number > 1 else None
            surveys = []
            for column, part in enumerate(line):
                seen = pixels(plane, part.pixels), _seeds_of(seeds, part), part, levels
                task = survey_part, *seen, *how
                surveys.append(graph.add((number, column), when_there, task, before))
            last = rows[-1] if rows else None
            rows.append(graph.add(("row", number), when_there, (join_cells, surveys, 1), last))
        return graph.value(graph.add("cells", label_cells, rows))

    def _of_windows(self, name: str, length: int, *, search: Search | None) -> Any:
        parts, how = self._cutting.parts(survey=True), replace(self.estimation, search=search)

        def of_plane(index: Index) -> dict[str, Any]:
            plane, noise = self.planes.plane(index), self.noise(index)
            graph = PartGraph.of(f"{name}-of", [plane, noise], self._made_with, search)

            def task_of(row: int, column: int) -> Any:
                part = parts[row][column]
                seen = pixels(plane, part.pixels), part
                return windows_of_part, *seen, graph.key_of(noise), how, name

            def shape_of(part: Part) -> tuple[int, ...]:
                return (*part.own_windows, length)

            return {name: graph.array(name, parts, task_of, np.float32, shape_of)}

        return self.planes.each(of_plane)[name]


def _picked(graph: PartGraph, parts: Parts, name: str, dtype: DTypeLike = np.float32) -> Any:
    """Return one result of all parts: a dask array."""
    return graph.array(name, parts, lambda *place: (itemgetter(name), (graph.name, *place)), dtype)


def _blended(graph: PartGraph, parts: Parts, name: str) -> Any:
    """Return one result of all parts, which go over into each other: a dask array."""

    def task_of(row: int, column: int) -> tuple[Any, ...]:
        at = list(neighbors(parts, row, column))
        near, found = [parts[y][x] for y, x in at], [(graph.name, y, x) for y, x in at]
        return blend_named, parts[row][column], near, found, name

    return graph.array(name, parts, task_of)


def _seeds_of(seeds: Any, part: Part) -> Any:
    return None if seeds is None else pixels(seeds, part.pixels)


def noise_of_plane(
    plane: Any, given: float | ShotNoise | None, how: Preparing, intensities: Any = None
) -> Any:
    """Return the noise of a plane as its parts need it, delayed.

    Parameters
    ----------
    plane : (H, W) or (H, W, C) dask.array.Array
    given : float, ShotNoise or None
        What is known of it.
    how : Preparing
    intensities : dask.delayed.Delayed, optional
        Those of the plane, if they were asked for before.
    """
    if intensities is None:
        intensities = intensities_of_plane(plane, how.intensity_range)
    read, known = after(plane, intensities), PartGraph.key_of(intensities)
    pieces, every = _noise_pieces(plane.shape[:2])
    graph = PartGraph.of("noise", [read, intensities], given, how)
    samples = [
        graph.add(number, look_at_noise, pixels(read, piece), how, known, every)
        for number, piece in enumerate(pieces)
        if given is None or isinstance(given, ShotNoise)
    ]
    return graph.value(graph.add("of samples", Noise.of_samples, given, known, samples))


def intensities_of_plane(
    plane: Any, intensity_range: IntensityRange | None, limits: Any = None
) -> Any:
    """Return the intensities of a plane, delayed, as an array of it would have them.

    Of planes above 4 megapixels, the contrast comes from as many pieces as the noise.

    Parameters
    ----------
    plane : (H, W) or (H, W, C) dask.array.Array
    intensity_range : (float, float) or None
        As given.
    limits : dask.delayed.Delayed, optional
        `Limits` to go by instead of the plane's own.
    """
    graph = PartGraph.of("intensities", [plane, limits], intensity_range)
    pieces, every = _noise_pieces(plane.shape[:2])
    some = 1 if every == 1 else _EVERY_INTENSITY
    values = [
        graph.add(number, known_values, pixels(plane, piece), some)
        for number, piece in enumerate(pieces)
    ]
    known = [graph.key_of(limits)]
    if limits is None:
        known = (
            _limits_of_blocks(graph, plane) if needs_limits(plane.dtype, intensity_range) else []
        )
    found = join_intensities, plane.dtype, intensity_range, known, values
    return graph.value(graph.add("of samples", *found))


def limits_of_planes(planes: list[Any]) -> Any:
    """Return the `Limits` of all planes of a stack, delayed: the range that they share."""
    graph = PartGraph.of("limits", planes)
    blocks = [key for plane in planes for key in _limits_of_blocks(graph, plane)]
    return graph.value(graph.add("of all", Limits.joined, blocks))


def _limits_of_blocks(graph: PartGraph, plane: Any) -> list[Any]:
    """Add the tasks that look for the limits of each block of a plane; return their keys."""
    rows, columns, *colors = plane.numblocks
    return [
        graph.add(
            ("limits of", plane.name, *at), limits_of, (plane.name, *at, *(0 for _ in colors))
        )
        for at in np.ndindex(rows, columns)
    ]


def _noise_pieces(shape: tuple[int, int]) -> tuple[list[tuple[slice, slice]], int]:
    """Return where the noise of a plane is looked at, and at every how many pixels."""
    if shape[0] * shape[1] <= _WHOLE:
        return [(slice(0, shape[0]), slice(0, shape[1]))], 1
    rows, columns = (
        [slice(start, start + _PIECE) for start in _starts(length)] for length in shape
    )
    return [(row, column) for row in rows for column in columns], _EVERY


def sampled(image: Any) -> NDArray[Any]:
    """Return pixels of a plane that tell of all of it: the plane, or pieces of a large one.

    Parameters
    ----------
    image : (H, W) or (H, W, 3 or 4) array-like
        Of dask, or whatever has a shape and slices.

    Returns
    -------
    ndarray
        Up to 4096 px a side; pieces of 512 px are put together as they lie.
    """
    height, width = image.shape[:2]
    if height * width <= _WHOLE:
        return np.asarray(image)
    rows = [
        [np.asarray(image[row : row + _PIECE, at : at + _PIECE]) for at in _starts(width)]
        for row in _starts(height)
    ]
    return np.concatenate([np.concatenate(row, axis=1) for row in rows])


def _starts(length: int) -> list[int]:
    count = min(_PIECES, max(1, length // _PIECE))
    return [int(start) for start in np.linspace(0, max(length - _PIECE, 0), count)]


def computed(arrays: dict[str, Any], progress: Progress) -> dict[str, NDArray[Any]]:
    """Compute dask arrays together, by whichever scheduler is set, and report.

    Parameters
    ----------
    arrays : dict of str to dask.array.Array
    progress : callable
        An exception from it ends the work.

    Returns
    -------
    dict of str to ndarray
    """
    return dict(run_tasks(arrays, progress))


def run_tasks(tasks: Any, progress: Progress, step: str = _STEP) -> Any:
    """Compute delayed values together, by whichever scheduler is set, and report."""
    progress(step, 0.0)
    with _Reports(progress, step):
        (done,) = dask.compute(tasks, num_workers=_THREADS)
    progress(step, 1.0)
    return done


class _Reports(Callback):
    """Reports how much dask's own schedulers have done; a cluster's tells nothing."""

    def __init__(self, progress: Progress, step: str) -> None:
        self._progress, self._step = progress, step
        self._done = self._all = 0.0
        super().__init__(start_state=self._begin, posttask=self._count)

    def _begin(self, tasks: Any, state: Any) -> None:
        self._all += sum(map(_time_of, state["dependencies"]))

    def _count(self, key: Any, result: Any, tasks: Any, state: Any, worker: Any) -> None:
        self._done += _time_of(key)
        self._progress(self._step, min(1.0, self._done / self._all))


def _time_of(key: Any) -> float:
    """Return about how long a task takes, in parts of what measuring a part takes."""
    name, *place = key if isinstance(key, tuple) else (key,)
    if place[:1] == ["row"]:
        return _SHORT
    return next((time for begin, time in _TIMES.items() if str(name).startswith(begin)), _SHORT)
