"""Planes of a batch that are too large for one task: measured and written tile by tile."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce
from itertools import groupby
from operator import add
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import napari_defocus
from napari_defocus.batch.folder import read_note, write_note
from napari_defocus.batch.planes import BatchPlan, PlaneTask, Target, failed
from napari_defocus.batch.table import DONE, LEFT, PixelCounts, Row, defocus_facts
from napari_defocus.batch.tile_thumbnails import small_pictures_of_tiles, tile_sample
from napari_defocus.core.picture_remarks import brightest_pixels
from napari_defocus.core.progress import silent
from napari_defocus.core.writing import write_results
from napari_defocus.io.ome_zarr_writer import whole_tiles
from napari_defocus.pipeline import measure_candidates
from napari_defocus.psf import AUTO
from napari_defocus.settings import CONFIDENT

Region = tuple[slice, slice]


class TooLarge(ValueError):
    """Something is wanted that is not known of planes of this size."""


@dataclass(frozen=True)
class TileNote:
    """What is noted of a tile: that it is finished, and what the plane's row needs of it."""

    px: int
    counts: PixelCounts
    noise: Row
    brightest: tuple[float, int, int]
    left: float | None = None
    """Share left as it was; None if it was not restored."""


@dataclass(frozen=True)
class _TileTask:
    """A tile to be written, once it is measured."""

    region: Region
    index: tuple[int, ...]
    targets: tuple[Target, ...]
    note: Path
    plan: BatchPlan
    plane_shape: tuple[int, int]

    @property
    def sample(self) -> Path:
        """Where the pixels for the thumbnail are."""
        return self.note.with_suffix(".npz")


class TiledPlane:
    """A large plane, of which tiles are worked on one by one; all of its targets have stores.

    TooLarge is raised if something is wanted that is not made of tiles.
    """

    def __init__(self, task: PlaneTask) -> None:
        plan = task.plan
        if plan.settings.map.shot_noise:
            raise TooLarge(
                "noise that grows with the intensity is not looked for in so large a plane"
            )
        self.task, self._plane = task, task.plane
        self.error: str | None = None
        self._parts = [
            self._part(region) for region in whole_tiles(task.plane.shape[:2], plan.block_size)
        ]
        known = [(tile, _finished(tile)) for tile in self._parts]
        self._left = [tile for tile, note in known if note is None]
        self.notes = [note for _, note in known if note is not None]

    def graph(self) -> list[list[Any]]:
        """Return rows of delayed tasks, one for each tile that is not finished."""
        from dask import delayed

        from napari_defocus.tiled.tile_graph import cut_together

        if not self._left:
            return []
        found, noise, threshold = self._measured()
        write = delayed(_write, pure=False)
        pieces = iter(cut_together(found, [tile.region for tile in self._left]))
        return [
            [write(tile, noise, threshold, next(pieces)) for tile in row]
            for _, row in groupby(self._left, key=lambda tile: tile.region[0].start)
        ]

    def row(self) -> Row:
        """Return the plane's row, now that every tile was tried; note it if all are finished."""
        known = self.task.known
        if self.error is not None:
            return failed(known, self.error)
        counts = reduce(add, (note.counts for note in self.notes))
        facts = counts.facts()
        facts |= defocus_facts(facts, self.task.plan.settings.map.family())
        row = known | {"status": DONE} | facts | self.notes[0].noise | self.task.results
        row[LEFT] = _share_left(self.notes)
        row["share_saturated"] = self._share_saturated()
        if not self._write_thumbnail():
            row.pop("thumbnail", None)
        write_note(self.task.row_path, row)
        for tile in self._parts:
            tile.note.unlink(missing_ok=True)
            tile.sample.unlink(missing_ok=True)
        return row

    def _share_saturated(self) -> float | None:
        most = max(note.brightest[0] for note in self.notes)
        alike = sum(note.brightest[1] for note in self.notes if note.brightest[0] == most)
        counted = sum(note.brightest[2] for note in self.notes)
        return alike / counted if counted and alike < counted else None

    def _write_thumbnail(self) -> bool:
        """Write the small pictures; return whether an earlier run left what they need."""
        thumbnail, samples = self.task.thumbnail, [tile.sample for tile in self._parts]
        if thumbnail is None or not all(sample.exists() for sample in samples):
            return False
        parts = (sample.read_bytes() for sample in samples)
        limits = self.task.plan.intensity_range
        thumbnail.parent.mkdir(parents=True, exist_ok=True)
        contents = small_pictures_of_tiles(thumbnail, self._plane, parts, limits)
        write_results(contents, force=True)
        return True

    def _part(self, region: Region) -> _TileTask:
        task, (rows, columns) = self.task, region
        name = f"{task.row_path.stem}-at-{rows.start}-{columns.start}.json"
        note = task.row_path.with_name(name)
        shape = task.plane.shape[:2]
        return _TileTask(region, task.index, task.targets, note, task.plan, shape)

    def _measured(self) -> tuple[dict[str, Any], Any, Any]:
        """Return dask arrays of all that is wanted, the noise, delayed, and the threshold."""
        from napari_defocus.tiled.tile_tasks import Wanted

        plan, plane = self.task.plan, self._plane
        settings = self.task.map_settings()
        limits, block_size = plan.intensity_range, plan.block_size
        lazy: Any = measure_candidates(plane, settings, limits, silent, block_size=block_size)
        restoration = plan.settings.restoration if "in_focus" in plan.kinds else None
        asked = Wanted(
            map=settings,
            confidence=True,
            risk=None if restoration is None else restoration.risk,
            mask=plan.settings.mask if "mask" in plan.kinds else None,
        )
        within = self._within()
        threshold = self._threshold(lazy, within)
        found = lazy.measure(asked, within=within, threshold=threshold)
        found["picture"] = plane
        if within is not None:
            found["within"] = within
        if restoration is not None:
            noise = restoration.noise_variance
            how = plan.restoration(lazy.psf, settings.noise_variance if noise is None else noise)
            found["in_focus"], fit = napari_defocus.restore_all_in_focus(
                plane,
                found.pop("cautious"),
                **vars(how),
                confidence=found["confidence"],
                block_size=block_size,
                return_fit=True,
            )
            found[LEFT] = fit.left_as_it_was
        return found, lazy.noise(()), threshold

    def _within(self) -> Any:
        """Return the mask of what counts, a dask array, if there is one."""
        task = self.task
        return task.within and task.within.lazy_plane(task.plane.shape, task.index)

    def _threshold(self, lazy: Any, within: Any) -> Any:
        """Return the threshold of masks: as given, that of the stack, or of the plane, delayed."""
        threshold = self.task.plan.settings.mask.threshold
        if threshold != AUTO:
            return threshold
        task = self.task
        return lazy.threshold(within) if task.threshold_from is None else task.threshold_of_stack()


def _px(region: Region) -> int:
    return math.prod(tile.stop - tile.start for tile in region)


def _finished(tile: _TileTask) -> TileNote | None:
    known = read_note(tile.note)
    if known is None or not all(t.has((*tile.index, *tile.region)) for t in tile.targets):
        return None
    counts = PixelCounts.of_note(known["counts"])
    brightest = tuple(known["brightest"])
    return TileNote(_px(tile.region), counts, known["noise"], brightest, known.get(LEFT))


def _write(
    tile: _TileTask, noise: Any, threshold: float, found: dict[str, NDArray[Any]]
) -> TileNote:
    """Write what was found of a tile, note that it is finished, and return the note."""
    plan, confidence = tile.plan, found["confidence"]
    of_counts = (found.get("mask"), threshold, found.get("within"))
    counts = plan.counts(found["blur_map"], confidence, *of_counts)
    untrusted = confidence < plan.min_confidence
    made = found | {"map": np.where(untrusted, np.float32(np.nan), found["blur_map"])}
    for target in tile.targets:
        assert target.writer is not None
        target.writer.write_region((*tile.index, *tile.region, ...), made[target.kind])
    # A plane of one tile keeps its noise and its intensities to itself.
    variance = None if noise.known is None else float(noise.known)
    known = {"noise_variance": variance, "threshold_px": threshold}
    known |= {} if noise.intensities is None else noise.intensities.facts()
    brightest = brightest_pixels(found["picture"])
    if plan.thumbnails:
        write_results({tile.sample: _sample(tile, found)}, force=True)
    left = float(found[LEFT].mean()) if LEFT in found else None
    note = {"counts": counts.note(), "noise": known, "brightest": brightest, LEFT: left}
    write_note(tile.note, note)
    return TileNote(_px(tile.region), counts, known, brightest, left)


def _sample(tile: _TileTask, found: dict[str, NDArray[Any]]) -> bytes:
    known = found["confidence"] >= CONFIDENT
    if "within" in found:
        known &= found["within"] != 0
    return tile_sample(tile.region, tile.plane_shape, found["picture"], found["blur_map"], known)


def _share_left(notes: list[TileNote]) -> float | None:
    """Return the share of a plane that was left as it was; None if it was not restored."""
    shares = [note.left for note in notes if note.left is not None]
    if len(shares) < len(notes):
        return None
    return sum(note.px * share for note, share in zip(notes, shares, strict=True)) / sum(
        note.px for note in notes
    )
