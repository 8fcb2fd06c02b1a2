"""Large pictures measured part by part into stores: no napari, so that other processes can."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.intensity import Intensities
from napari_defocus.core.progress import Progress, duration, within
from napari_defocus.io.lazy_arrays import Carried
from napari_defocus.io.ome_zarr_writer import OmeZarrWriter
from napari_defocus.psf import AUTO
from napari_defocus.settings import BLOCK_SIZE, MapSettings, MaskSettings

_NOISE_SHARE, _WRITTEN_SHARE = 0.04, 0.97
_ESTIMATED_FROM = 0.05
"""How much of the work must be done before the time that is left is told."""

_THREADS = 2
"""Parts at a time: each has all of numba's threads, and takes its share of memory."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TiledJob:
    """What is measured of planes that are too large for memory.

    Attributes
    ----------
    image : Carried
        (..., H, W) or (..., H, W, 3 or 4): numpy, dask, zarr or alike.
    axes : str
        A letter an axis of it: others for planes, y, x, s for colours.
    estimation : MapSettings
    blur_map, confidence : bool
    mask : MaskSettings or None
    seeds : (..., H, W) integer ndarray or None
        What the mask keeps to.
    inside : (H, W) bool ndarray or None
        Which pixels count: what is outside is not in focus, and its confidence is 0.
    """

    image: Carried
    axes: str
    estimation: MapSettings
    blur_map: bool
    confidence: bool
    mask: MaskSettings | None
    seeds: NDArray[np.integer] | None = None
    inside: NDArray[np.bool_] | None = None


def measure_into(
    work: TiledJob, writers: dict[str, OmeZarrWriter], *, progress: Progress
) -> tuple[NDArray[np.float64], list[Intensities], float | None]:
    """Measure planes part by part into stores, and finish these.

    Parameters
    ----------
    work : TiledJob
    writers : dict of str to OmeZarrWriter
        New stores (..., H, W) for "blur_map", "confidence" and "mask", as far as they are wanted.
    progress : callable
        An exception from it ends the work. Steps say how long it will take.

    Returns
    -------
    noise_variance : (...) float64 ndarray
        Of each plane.
    intensities : list of Intensities
        Of each plane, in order.
    threshold : float or None
        Of all masks in px, if it was to be found.
    """
    import dask

    from napari_defocus.io.tiled_stores import store

    # Its end waits for the parts that are still worked on: they write into the stores.
    with ThreadPoolExecutor(_THREADS) as pool, dask.config.set(pool=pool):
        candidates = _candidates(work, progress)
        candidates = candidates.with_noise(within(progress, 0.0, _NOISE_SHARE))
        threshold = _threshold(work, candidates, within(progress, 0.0, _NOISE_SHARE))
        found = _found(work, candidates, threshold)
        timed = with_time_left(within(progress, _NOISE_SHARE, _WRITTEN_SHARE))
        store({name: found[name] for name in writers}, writers, timed)
    return np.asarray(candidates.variances), candidates.intensities, threshold


def _candidates(work: TiledJob, progress: Progress) -> Any:
    from napari_defocus.pipeline import measure_candidates

    image, settings = as_dask(work.image.array, work.axes), work.estimation
    return measure_candidates(image, settings, None, progress, axes=work.axes)


def as_dask(image: Any, axes: str) -> Any:
    """Return an array as one of dask, whose blocks are read when they are computed."""
    import dask.array as da

    from napari_defocus.core.axes import is_lazy

    if is_lazy(image):
        return image
    sides = {"y": BLOCK_SIZE, "x": BLOCK_SIZE, "s": -1}
    return da.from_array(image, chunks=tuple(sides.get(a, 1) for a in axes), name=False)


def _threshold(work: TiledJob, candidates: Any, progress: Progress) -> float | None:
    """Return up to which blur all planes are in focus, if they are to say it."""
    import dask.array as da

    from napari_defocus.tiled.computing import run_tasks

    if work.mask is None or work.mask.threshold != AUTO:
        return None
    within = None
    if work.inside is not None:
        shape = candidates.plane_shape + work.inside.shape
        within = da.broadcast_to(da.from_array(work.inside, chunks=BLOCK_SIZE, name=False), shape)
    return float(run_tasks(candidates.threshold(within), progress, "Finding what is in focus"))


def _found(work: TiledJob, candidates: Any, threshold: float | None) -> dict[str, Any]:
    """Return all that is wanted as dask arrays, looked at once together."""
    import dask.array as da

    from napari_defocus.tiled.tile_tasks import Wanted

    settings = work.estimation
    wanted = Wanted(
        map=settings if work.blur_map else None,
        confidence=work.blur_map and work.confidence,
        mask=work.mask,
    )
    chunks = (1,) * len(candidates.plane_shape) + (BLOCK_SIZE, BLOCK_SIZE)
    seeds = None if work.seeds is None else da.from_array(work.seeds, chunks=chunks, name=False)
    wanted = wanted.settled(threshold)
    found: dict[str, Any] = candidates.measure(wanted, seeds)
    if work.inside is not None:
        inside = da.from_array(work.inside, chunks=BLOCK_SIZE, name=False)
        for name in {"confidence", "mask"} & set(found):
            found[name] = found[name] * inside.astype(found[name].dtype)
    return found


def with_time_left(progress: Progress, clock: Callable[[], float] = time.monotonic) -> Progress:
    """Return a callback whose steps say about how long the work will still take."""
    begun = clock()

    def report(step: str, done: float) -> None:
        passed = clock() - begun
        left = f", {duration(passed * (1 - done) / done)} left" if done > _ESTIMATED_FROM else ""
        progress(step + left, done)

    return report
