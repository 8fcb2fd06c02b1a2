"""Stacks, and pictures larger than memory: the same results part by part, by dask.

A plane that is one part is worked on as a whole. Of a larger one, every part is looked at twice.
The survey adds up the costs of its windows into those of cells of 4 x 4 windows; the cells of the
whole plane are labelled at once, which is what decides over long distances. Then each part, with
three windows around, is labelled from there on, its rim held to the cells' labels, and parts go
over into each other. A task takes pixels and returns maps, so that memory is bounded by parts.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, product
from typing import Any

import dask
import numpy as np
from dask import delayed
from dask.callbacks import Callback
from numpy.typing import NDArray

from napari_defocus.block_tasks import (
    Estimation,
    Noise,
    Wanted,
    judge_part,
    label_cells,
    look_at_noise,
    measure_part,
    survey_part,
    windows_of_part,
)
from napari_defocus.candidates import CANDIDATES, Search
from napari_defocus.image import PreparedImage
from napari_defocus.lazy_planes import Index, LazyPlanes, assembled, blended_parts
from napari_defocus.noise import ShotNoise
from napari_defocus.ome_zarr_writer import OmeZarrWriter
from napari_defocus.parts import Cutting, Part
from napari_defocus.progress import Progress, silent
from napari_defocus.psf import PSFFamily
from napari_defocus.settings import RestorationSettings
from napari_defocus.spectrum import label_scales

_THREADS = min(4, os.cpu_count() or 1)
"""Of dask's threads: each part has all of numba's, and takes its share of memory."""

_STEP = "Measuring part by part"


_WHOLE = 4_000_000
"""px of a plane up to which the noise is measured everywhere."""

_PIECES, _PIECE, _EVERY = 8, 512, 3
"""Of a larger one, in so many pieces a side of so many px, at every third pixel."""


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
    """

    planes: LazyPlanes
    estimation: Estimation
    noise_variance: float | ShotNoise | None
    block_size: int
    _noises: dict[Index, Any] = field(default_factory=dict, repr=False)

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
        known = None if seeds is None else self.planes.belonging("seeds", seeds)
        found = self.measure(Wanted(**asked), known)
        return computed(found, progress) if self.planes.in_memory else found

    def judged(self, blur_map: Any, risk: float = RestorationSettings.risk) -> dict[str, Any]:
        """Return `confidence_map` and `cautious_blur_map` of any map, (..., H, W), by name."""
        radii = self.planes.belonging("blur_map", blur_map)
        judge, how = delayed(judge_part, pure=True), self._frugal
        parts = self._cutting.parts()

        def of_plane(index: Index) -> dict[str, Any]:
            plane, noise, radius = self.planes.image[index], self._noise(index), radii[index]
            found = {
                part: judge(plane[part.pixels], radius[part.pixels], part, noise, how, risk)
                for part in chain(*parts)
            }
            return {
                name: assembled(parts, {part: one[name] for part, one in found.items()})
                for name in ("confidence", "cautious")
            }

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

    def _noise(self, index: Index) -> Any:
        """Return the noise of a plane as its parts need it: a `Noise`, or a delayed one."""
        if self._cutting.alone:
            return Noise(self.noise_variance)
        if index not in self._noises:
            plane, how = self.planes.image[index], self.estimation
            self._noises[index] = noise_of_plane(plane, self.noise_variance, how.prepared)
        return self._noises[index]

    def _measured(self, index: Index, wanted: Wanted, seeds: Any) -> dict[str, Any]:
        plane, noise, levels = self.planes.image[index], self._noise(index), self._cutting.levels
        survey, measure = (delayed(what, pure=True) for what in (survey_part, measure_part))

        def seen(part: Part) -> tuple[Any, Any, Part, int]:
            known = None if seeds is None else seeds[part.pixels]
            return plane[part.pixels], known, part, levels

        cells: Any = {}
        if not self._cutting.alone:
            surveys = [
                [survey(*seen(part), noise, self._frugal, wanted) for part in row]
                for row in self._cutting.parts(survey=True)
            ]
            cells = delayed(label_cells, pure=True)(surveys)
        parts = self._cutting.parts()
        found = {
            part: measure(*seen(part), cells, noise, self._frugal, wanted) for part in chain(*parts)
        }
        results = {}
        for name, dtype in wanted.dtypes.items():
            pieces = {part: one[name] for part, one in found.items()}
            pieces = blended_parts(parts, pieces) if dtype is np.float32 else pieces
            results[name] = assembled(parts, pieces, dtype)
        return results

    def _of_windows(self, name: str, length: int, *, search: Search | None) -> Any:
        ask, how = delayed(windows_of_part, pure=True), replace(self.estimation, search=search)
        parts = self._cutting.parts(survey=True)

        def of_plane(index: Index) -> dict[str, Any]:
            plane, noise = self.planes.image[index], self._noise(index)
            found = {
                part: ask(plane[part.pixels], part, noise, how, name) for part in chain(*parts)
            }
            return {
                name: assembled(parts, found, shape_of=lambda part: (*part.own_windows, length))
            }

        return self.planes.each(of_plane)[name]


def noise_of_plane(
    plane: Any, given: float | ShotNoise | None, prepared: Callable[[NDArray[Any]], PreparedImage]
) -> Any:
    """Return the noise of a plane as its parts need it: a `Noise`, or a delayed one.

    Parameters
    ----------
    plane : (H, W) or (H, W, C) dask.array.Array
    given : float, ShotNoise or None
        What is known of it.
    prepared : callable
        Makes pixels ready.
    """
    if not (given is None or isinstance(given, ShotNoise)):
        return Noise(given)
    look, (pieces, every) = delayed(look_at_noise, pure=True), _noise_pieces(plane.shape[:2])
    samples = [look(plane[piece], prepared, every) for piece in pieces]
    return delayed(Noise.of_samples, pure=True)(given, samples)


def _noise_pieces(shape: tuple[int, int]) -> tuple[list[tuple[slice, slice]], int]:
    """Return where the noise of a plane is looked at, and at every how many pixels."""
    if shape[0] * shape[1] <= _WHOLE:
        return [(slice(0, shape[0]), slice(0, shape[1]))], 1
    rows, columns = (
        [slice(start, start + _PIECE) for start in _starts(length)] for length in shape
    )
    return [(row, column) for row in rows for column in columns], _EVERY


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
    return dict(_compute(arrays, progress))


def store(arrays: dict[str, Any], writers: dict[str, OmeZarrWriter], progress: Progress) -> None:
    """Compute dask arrays part by part into stores, and finish these.

    What was written before an interruption is not computed again.

    Parameters
    ----------
    arrays : dict of str to dask.array.Array
        From `LazyCandidates.measure` and the like.
    writers : dict of str to OmeZarrWriter
        A new store for each, of its shape.
    progress : callable
        An exception from it ends the work; the stores may be gone on with.
    """
    write = delayed(OmeZarrWriter.write_region, pure=False)
    left = [
        write(writers[name], region, array[region])
        for name, array in arrays.items()
        for region in whole_tiles(array, writers[name].tile)
        if not writers[name].has_region(region)
    ]
    _compute(left, progress)
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


def _compute(tasks: Any, progress: Progress) -> Any:
    progress(_STEP, 0.0)
    with _Reports(progress):
        (done,) = dask.compute(tasks, num_workers=_THREADS)
    progress(_STEP, 1.0)
    return done


class _Reports(Callback):
    """Reports the tasks that dask's own schedulers have done; a cluster's tells nothing."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        super().__init__(posttask=self._done)

    def _done(self, key: Any, result: Any, tasks: Any, state: Any, worker: Any) -> None:
        names = ("ready", "waiting", "running", "finished")
        ready, waiting, running, finished = (len(state[name]) for name in names)
        self._progress(_STEP, finished / max(1, ready + waiting + running + finished))
