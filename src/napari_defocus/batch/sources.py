"""The sources of a batch: which are new, changed or finished, and where their results go."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from napari_defocus.batch.folder import (
    BatchFolder,
    Facts,
    SourceNotes,
    differences,
    distinct_names,
    identity,
)
from napari_defocus.batch.masks_beside import MaskSource
from napari_defocus.batch.planes import (
    KINDS,
    BatchPlan,
    Index,
    PlaneTask,
    Target,
    discard,
    failed,
    go_on_from_whole,
    reason,
)
from napari_defocus.batch.table import DONE, Row, source_facts
from napari_defocus.batch.thumbnails import remove_small_pictures
from napari_defocus.core.intensity import needs_limits
from napari_defocus.io.ome_zarr_writer import new_ome_zarr, part_of
from napari_defocus.io.open import Source
from napari_defocus.psf import AUTO, is_left_open

FileFormat = Literal["auto", "tiff", "ome-zarr"]

LARGEST_IN_A_FILE = 64_000_000
"""px of the largest picture whose map becomes a TIFF if no format is asked for."""

LARGEST_AT_ONCE = 2048 * 2048
"""px of the largest plane that one task measures: that of many cameras on microscopes."""


@dataclass(frozen=True)
class BatchInput:
    """A source by its path, as it was `given`, and by what the names of its results begin with.

    `facts` say what it is, and what it is to be measured with. It is `unchanged` if an earlier run
    has begun it, and nothing of that has changed; `change` says how the source has, else "".
    """

    given: Path
    name: str
    facts: Facts
    unchanged: bool
    change: str
    mask: Path | None = None


def compared_inputs(
    sources: list[Path],
    folder: BatchFolder,
    made_with: Facts,
    masks: Mapping[Path, Path] | None = None,
) -> list[BatchInput]:
    """Return sources, and the masks of what counts, with what has become of them since a run."""
    digest = hashlib.sha256(json.dumps(made_with, sort_keys=True).encode()).hexdigest()[:16]
    inputs = []
    for given, name in zip(sources, distinct_names(sources), strict=True):
        facts = identity(given) | {"settings": digest}
        mask = None if masks is None else masks[given]
        if mask is not None:
            facts["mask"] = identity(mask)
        before = folder.of_source(name).begun_with()
        # What other settings change, the plan of the batch tells.
        changes = differences((before or facts) | {"settings": digest}, facts)
        change = changes and f"of {given}, {changes}"
        inputs.append(BatchInput(given, name, facts, before == facts, change, mask))
    return inputs


def finished_rows(each: BatchInput, folder: BatchFolder, plan: BatchPlan) -> list[Row] | None:
    """Return the rows of a source of which nothing is left to do, else None."""
    notes = folder.of_source(each.name)
    rows = notes.finished() if each.unchanged else None
    if rows is None or any(row["status"] != DONE for row in rows):
        return None
    places = {row[kind] for row in rows for kind in plan.kinds}
    if not all((folder.path / place).exists() for place in places):
        return None
    _remove_stores(notes)
    return [as_named(each, row) for row in rows]


def unopened(each: BatchInput, why: str | BaseException) -> Row:
    """Return the row of a source of which no plane can be measured."""
    told = why if isinstance(why, str) else reason(why)
    return as_named(each, failed(source_facts(str(each.given), {}, {}), told))


def as_named(each: BatchInput, row: Row) -> Row:
    """Return a row that calls its source what the user does: workers have absolute paths."""
    row = row | {"source": str(each.given)}
    if "error" in row:
        row["error"] = row["error"].replace(str(each.given.absolute()), str(each.given))
    return row


def plane_size(source: Source) -> tuple[int, int]:
    """Return the height and width of a source's planes, in px."""
    leading = len(source.plane_axes)
    height, width = source.data.shape[leading : leading + 2]
    return int(height), int(width)


@dataclass(eq=False)
class SourceWork:
    """A source at work: all of its planes, and `rows` of those that are finished or were tried.

    `known` is what the rows of all planes say.
    """

    input: BatchInput
    notes: SourceNotes
    known: Row
    planes: tuple[Index, ...]
    labels: dict[Index, str]
    targets: tuple[Target, ...]
    results: dict[str, str]
    rows: dict[Index, Row]
    plane_px: int
    plan: BatchPlan
    folder: BatchFolder

    @property
    def has_stores(self) -> bool:
        """Whether planes become one result together."""
        return any(target.store is not None for target in self.targets)

    @property
    def in_parts(self) -> bool:
        """Whether planes are too large for one task."""
        return self.plane_px > LARGEST_AT_ONCE

    @property
    def any_done(self) -> bool:
        """Whether there is a result of a plane."""
        return any(row["status"] == DONE for row in self.rows.values())

    def rows_in_order(self) -> list[Row]:
        """Return the rows there are, in the order of the planes."""
        return [self.rows[index] for index in self.planes if index in self.rows]

    def known_of(self, index: Index) -> Row:
        """Return what the row of a plane says in any case."""
        return self.known | {"plane": self.labels[index]}

    def tasks(self, source: Source) -> list[PlaneTask]:
        """Return what is left to do."""
        import dask

        return [
            PlaneTask(
                # Without the rest of the stack.
                plane=dask.optimize(source.plane(index))[0],
                index=index,
                known=self.known_of(index),
                results=self._results_of(index),
                targets=self.targets,
                row_path=self.notes.row_path(index),
                plan=self.plan,
                stack=self.input.given.absolute() if self._shares_a_range(source) else None,
                lens_from=self.input.given.absolute() if self._shares_a_lens else None,
                threshold_from=self.input.given.absolute() if self._shares_a_threshold else None,
                within=self._within(source),
                thumbnail=self.thumbnail_of(index),
            )
            for index in self.planes
            if index not in self.rows
        ]

    def thumbnail_of(self, index: Index) -> Path | None:
        """Return where the thumbnail of a plane is, if there are to be any."""
        wanted = self.plan.thumbnails
        return self.folder.thumbnail(self.input.name, index) if wanted else None

    def _results_of(self, index: Index) -> dict[str, str]:
        """Return what the row of a plane says of where its results are."""
        thumbnail = self.thumbnail_of(index)
        if thumbnail is None:
            return self.results
        place = thumbnail.relative_to(self.folder.path).as_posix()
        return self.results | {"thumbnail": place}

    def _within(self, source: Source) -> MaskSource | None:
        mask = self.input.mask
        return None if mask is None else MaskSource(mask.absolute(), source.plane_shape)

    @property
    def _shares_a_lens(self) -> bool:
        """Whether planes have one lens, which is to be found from some of them."""
        return len(self.planes) > 1 and is_left_open(self.plan.settings.map.psf)

    @property
    def _shares_a_threshold(self) -> bool:
        """Whether planes have one threshold, which is to be found from some of them."""
        return len(self.planes) > 1 and self.plan.settings.mask.threshold == AUTO

    def _shares_a_range(self, source: Source) -> bool:
        """Return whether planes are restored in a range that is found from all of them."""
        several = len(self.planes) > 1 and "in_focus" in self.plan.kinds
        return several and needs_limits(source.data.dtype, self.plan.intensity_range)

    def end(self) -> None:
        """Note that every plane was tried, and that the results are in their places."""
        # Parts of a large plane that are finished are gone on with.
        if not self.any_done and not self.in_parts:
            for target in self.targets:
                discard(target)
        rows = self.rows_in_order()
        self.notes.finish(rows)
        # Failed planes are tried again, beside the others.
        if all(row["status"] == DONE for row in rows):
            _remove_stores(self.notes)


def begin(
    each: BatchInput,
    source: Source,
    folder: BatchFolder,
    plan: BatchPlan,
    file_format: FileFormat,
) -> SourceWork:
    """Begin with a source, or go on with what an earlier run has left.

    Raises
    ------
    OSError, TypeError, ValueError
        If a result cannot be begun.
    """
    notes = folder.of_source(each.name)
    if not each.unchanged:
        _remove_results(folder, each.name)
        notes.begin(each.facts)
    notes.resume()
    planes = tuple(source.planes())
    rows = {index: row for index in planes if (row := notes.row(index)) is not None}
    targets = tuple(
        _with_writer(
            _target(kind, each.name, source, folder, file_format),
            source,
            plan,
            complete=len(rows) == len(planes),
        )
        for kind in plan.kinds
    )
    height, width = plane_size(source)
    known = source_facts(str(each.given), source.pixel_size, source.units)
    return SourceWork(
        input=each,
        notes=notes,
        known=known | {"width": width, "height": height},
        planes=planes,
        labels={index: source.label_of(index) for index in planes},
        targets=targets,
        results={t.kind: t.path.relative_to(folder.path).as_posix() for t in targets},
        rows={
            index: as_named(each, row)
            for index, row in rows.items()
            if all(target.has(index) for target in targets)
        },
        plane_px=height * width,
        plan=plan,
        folder=folder,
    )


def _target(
    kind: str, name: str, source: Source, folder: BatchFolder, file_format: FileFormat
) -> Target:
    """Return where a kind of result of a source goes."""
    single, px = not source.plane_axes, math.prod(plane_size(source))
    place = folder.results / f"{name}{KINDS[kind].ending}"
    if file_format == "auto":
        file_format = "tiff" if single and px <= LARGEST_IN_A_FILE else "ome-zarr"
    if file_format == "ome-zarr":
        store = _ending_in(place, ".ome.zarr")
        return Target(kind, store, store)
    if single and px <= LARGEST_AT_ONCE:
        return Target(kind, _ending_in(place, KINDS[kind].suffix))
    path = _ending_in(place, ".tif" if single else ".ome.tif")
    return Target(kind, path, folder.of_source(name).store(kind))


def _ending_in(place: Path, suffix: str) -> Path:
    return place.with_name(place.name + suffix)


def _with_writer(target: Target, source: Source, plan: BatchPlan, *, complete: bool) -> Target:
    """Return a target with what writes its store, unless that is whole already."""
    store = target.store
    if store is None:
        return target
    if complete and store.exists() and not part_of(store).exists():
        return target
    axes = f"{source.plane_axes}yx"
    shape = source.data.shape[: len(axes)]
    if target.kind == "in_focus" and source.axes.endswith("s"):
        axes, shape = source.axes, source.data.shape
    writer = new_ome_zarr(
        store,
        shape=shape,
        dtype=KINDS[target.kind].dtype,
        axes=axes,
        pixel_size={axis: step for axis, step in source.pixel_size.items() if axis in axes},
        units={axis: unit for axis, unit in source.units.items() if axis in axes},
        attributes=plan.description(target.kind),
        labels=target.kind == "mask",
        resume=True,
        force=True,
    )
    begun_again = replace(target, writer=writer)
    go_on_from_whole(begun_again)
    return begun_again


def _remove_results(folder: BatchFolder, name: str) -> None:
    """Remove what was made of a source before it, or what it is measured with, has changed."""
    for kind in KINDS.values():
        place = folder.results / f"{name}{kind.ending}"
        for suffix in {".tif", ".ome.tif", kind.suffix}:
            _ending_in(place, suffix).unlink(missing_ok=True)
        store = _ending_in(place, ".ome.zarr")
        for path in (store, part_of(store)):
            shutil.rmtree(path, ignore_errors=True)
    remove_small_pictures(folder.thumbnail(name, ()))
    shutil.rmtree(folder.thumbnails / name, ignore_errors=True)


def _remove_stores(notes: SourceNotes) -> None:
    for kind in KINDS:
        shutil.rmtree(notes.store(kind), ignore_errors=True)
