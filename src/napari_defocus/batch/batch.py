"""Many pictures and stacks: maps and a table of them, on any number of workers, resumable."""

from __future__ import annotations

import json
import math
import os
import time
from collections import deque
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import napari_defocus
from napari_defocus.batch.cluster import Job, in_this_process, outcomes
from napari_defocus.batch.flags import judged_rows
from napari_defocus.batch.folder import BatchFolder, path_from
from napari_defocus.batch.masks_beside import masks_of
from napari_defocus.batch.outcome import BatchReport
from napari_defocus.batch.planes import (
    BatchPlan,
    PlaneTask,
    failed,
    finish,
    look_at,
    measure_plane,
    reason,
)
from napari_defocus.batch.report import report_contents
from napari_defocus.batch.sources import (
    BatchInput,
    FileFormat,
    SourceWork,
    as_named,
    begin,
    compared_inputs,
    finished_rows,
    plane_size,
    unopened,
)
from napari_defocus.batch.table import Row, in_csv, in_json_lines, rounded
from napari_defocus.batch.tiled_planes import TiledPlane, TileNote
from napari_defocus.core.checks import (
    check_block_size,
    check_confidence,
    check_flag,
    check_threshold_or_auto,
)
from napari_defocus.core.extras import need_large_extra
from napari_defocus.core.progress import Cancelled, Progress, duration, silent
from napari_defocus.core.writing import NeedsForce, UnwritableResult, write_results
from napari_defocus.io.open import Source
from napari_defocus.io.picture_files import Inputs, PictureFiles, as_paths, look_for_pictures
from napari_defocus.io.settings_file import Settings
from napari_defocus.settings import BLOCK_SIZE, FieldLimits

if TYPE_CHECKING:
    from distributed import Client


def measure_batch(
    inputs: Inputs,
    output: str | os.PathLike[str],
    *,
    settings: Settings | None = None,
    confidence: bool = False,
    mask: bool = False,
    restore: bool = False,
    min_confidence: float = 0.0,
    intensity_range: tuple[float, float] | None = None,
    within: str | os.PathLike[str] | None = None,
    limits: FieldLimits | None = None,
    report: bool = True,
    file_format: FileFormat = "auto",
    block_size: int = BLOCK_SIZE,
    force: bool = False,
    client: Client | None = None,
    progress: Progress = silent,
) -> BatchReport:
    """Measure many pictures and stacks: a map of each plane, a table of all, and a report.

    It can be ended at any moment, even killed, and called again. What is finished is not done
    again. The results are the same as those of an undisturbed run, byte for byte, with any number
    of workers. A picture that cannot be read or measured is a row that says why, and is tried
    again the next time.

    Parameters
    ----------
    inputs : path-like, or iterable of path-like
        Files, folders and patterns, as `napari_defocus.io.open.find_sources` takes them:
        photographs, TIFF, slides and OME-Zarr, with one plane or many. Results of this package,
        such as maps, are left out, whatever their names are.
    output : path-like
        A folder; it is made if its parent is there. It gets `table.csv` and `table.jsonl`, whose
        rows are in the order of the inputs; `report.html` with a folder `thumbnails`; a folder
        `maps`; and, hidden, notes of what is finished.
    settings : Settings, optional
        All but `refocus` is used. The threshold of masks also decides what counts as in focus in
        the table.
    confidence, mask, restore : bool, optional
        Whether to write the confidence, the in-focus mask, and the picture all in focus beside
        each map.
    min_confidence : float, optional
        Maps are NaN where the confidence is lower; the table still counts all pixels.
    intensity_range : (float, float), optional
        The intensities that mean black and white, of all pictures.
    within : path-like, optional
        A folder of masks or labels with the names of the pictures, or one mask for all of them:
        integers, as large as the pictures. Shares, medians and flags count only what is not 0.
    limits : FieldLimits, optional
        Which fields are flagged. Other limits are no reason to measure again: `write_report`
        applies them to a table.
    report : bool, optional
        Whether to write `report.html`, a page that any browser opens from disk: all fields, worst
        first, with thumbnails, and the plate if names say wells.
    file_format : {"auto", "tiff", "ome-zarr"}, optional
        The format of the results. "auto" is TIFF, and PNG for masks and restored pictures, if it
        is a single picture of up to 64 megapixels. It is OME-Zarr for others.
    block_size : int, optional
        Side, in px, of the parts in which planes of more than 4 megapixels are worked on. Their
        maps differ from those of the whole plane by 0.02 px or less. Smaller planes are measured
        in one part.
    force : bool, optional
        Whether pictures that have changed, or were measured with other settings, are measured
        again. Otherwise they are an error.
    client : distributed.Client, optional
        Its workers do the work, see `napari_defocus.batch.cluster.dask_client`. They have to find
        inputs and output under the same paths. Without a client, the work is done in this
        process, plane after plane.
    progress : callable, optional
        Called with a step's name, which says how much time is left, and the share that is done.

    Returns
    -------
    BatchReport

    Raises
    ------
    UnreadablePicture
        If an input names nothing, or a map, a mask or a drawing of this package, or a mask of
        `within` is missing.
    UnwritableResult
        If the output cannot be written, or a result is an input, or another batch is at work in
        the folder. Without `force`, also if the folder holds files that no batch made, or a batch
        with other settings or of other pictures.
    ValueError
        If a setting is beyond its range.
    ConnectionError
        If a worker has no access to the output, has another version, or the scheduler is gone.
    ImportError
        If the extra "large" is not installed.

    Examples
    --------
    >>> import pathlib, tempfile, numpy as np, PIL.Image
    >>> from skimage.data import camera
    >>> from napari_defocus import measure_batch
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name, top in (("sky", 0), ("grass", 400)):
    ...         picture = PIL.Image.fromarray(camera()[top : top + 96, :96])
    ...         picture.save(pathlib.Path(folder, f"{name}.png"))
    ...     report = measure_batch(folder, pathlib.Path(folder, "measured"))
    ...     rows = report.table.read_text().splitlines()
    >>> report.planes, report.failed, [row.split(",")[2] for row in rows]
    (2, 0, ['status', 'done', 'done'])
    """
    need_large_extra()
    switches = {"confidence": confidence, "mask": mask, "restore": restore, "force": force}
    for name, value in (switches | {"report": report}).items():
        check_flag(name, value)
    if limits is not None and not isinstance(limits, FieldLimits):
        raise TypeError(f"limits is {limits!r}; it takes FieldLimits")
    asked = {"map": True, "confidence": confidence, "mask": mask, "in_focus": restore}
    plan = _checked(
        BatchPlan(
            settings=settings or Settings(),
            kinds=tuple(kind for kind, is_asked in asked.items() if is_asked),
            min_confidence=min_confidence,
            intensity_range=intensity_range,
            block_size=block_size,
            within=None if within is None else os.fspath(within),
            thumbnails=report,
        )
    )
    if not isinstance(file_format, str) or file_format not in get_args(FileFormat):
        raise ValueError(f"file_format is {file_format!r}; it takes one of {get_args(FileFormat)}")
    if not isinstance(output, str | os.PathLike):
        raise TypeError(f"output is {type(output).__name__}; it takes the path of a folder")
    folder = BatchFolder(Path(output).absolute())
    looked = _sources(inputs, folder)
    made_with = json.loads(json.dumps(plan.facts() | {"file_format": file_format}))
    masks = None if within is None else masks_of(looked.pictures, within)
    found = compared_inputs(looked.pictures, folder, made_with, masks)
    if not force:
        _refuse_changed(found, folder)
    judging = limits or FieldLimits()
    batch = _Batch(folder, plan, file_format, found, looked.left_out, judging, _Counter(progress))
    lending = nullcontext(client) if client is not None else in_this_process()
    with folder.begun(made_with, force=force), lending as lent:
        try:
            _check_workers(lent, folder)
            batch.run(lent)
        except (KeyboardInterrupt, Cancelled):
            batch.write_tables()
            raise
        return batch.write_tables()


# Before the work.


def _checked(plan: BatchPlan) -> BatchPlan:
    """Refuse what cannot be; name a lens so that workers in other folders find it."""
    settings = plan.settings
    check_confidence("min_confidence", plan.min_confidence)
    check_threshold_or_auto(settings.mask.threshold, settings.map.family().max_scale)
    check_block_size(plan.block_size)
    if settings.map.psf.lower().endswith(".npz"):
        lens = str(Path(settings.map.psf).absolute())
        settings = replace(settings, map=replace(settings.map, psf=lens))
    return replace(plan, settings=settings)


def _sources(inputs: Inputs, folder: BatchFolder) -> PictureFiles:
    """Return the sources, without the results of an earlier run that a pattern finds."""
    given, results = as_paths(inputs), {folder.results.resolve(), folder.thumbnails.resolve()}
    for one in given:
        if results & {one.resolve(), *one.resolve().parents}:
            raise UnwritableResult(f"cannot write {one}: it is a result and an input")
    looked = look_for_pictures(given, besides=folder.path)
    pictures = [path for path in looked.pictures if not results & {*path.resolve().parents}]
    return PictureFiles(pictures, looked.left_out)


def _refuse_changed(inputs: list[BatchInput], folder: BatchFolder) -> None:
    changes = [each.change for each in inputs if each.change]
    if changes:
        more = f", and so have {len(changes) - 1} others" if len(changes) > 1 else ""
        raise NeedsForce(
            f"cannot go on with {folder.path}: inputs have changed: {changes[0]}{more}",
            "give another folder, or {force} to measure them again",
        )


def _check_workers(client: Client, folder: BatchFolder) -> None:
    """Raise ConnectionError if a worker could not take part."""
    answers = client.run(
        _objection, str(folder.plan), napari_defocus.__version__, on_error="return"
    )
    for worker, objection in sorted(answers.items()):
        if objection is not None:
            told = objection if isinstance(objection, str) else reason(objection)
            raise ConnectionError(f"the dask worker {worker} cannot take part: {told}")


def _objection(plan: str, version: str) -> str | None:
    """Return why this worker cannot take part in a batch, if it cannot."""
    if version != napari_defocus.__version__:
        return f"it has napari-defocus {napari_defocus.__version__}, and {version} is at work"
    path = Path(plan)
    if not path.is_file():
        return f"it does not see {path}; workers need inputs and output under the same paths"
    if not os.access(path.parent, os.W_OK):
        return f"it may not write into {path.parent.parent}"
    return None


# The work.


@dataclass
class _Counter:
    """How far a batch is, and for how long it will go on, by px measured since it was started."""

    progress: Progress
    sources: int = 0
    planes: int = 0
    planes_done: int = 0
    px: int = 0
    px_done: int = 0
    px_before: int = 0
    started: float = field(default_factory=time.monotonic)

    def expect(self, planes: int, px: int) -> None:
        """Count a source that is there."""
        self.sources += 1
        self.planes, self.px = self.planes + planes, self.px + px

    def skip(self, planes: int, px: int) -> None:
        """Count what an earlier run has finished."""
        self.px_before += px
        self.count(planes, px)

    def count(self, planes: int, px: int) -> None:
        self.planes_done, self.px_done = self.planes_done + planes, self.px_done + px

    def tell(self) -> None:
        measured, left = self.px_done - self.px_before, self.px - self.px_done
        what = "pictures" if self.planes == self.sources else "planes"
        text = f"{self.planes_done} of {self.planes} {what}"
        if measured and left:
            text += f", {duration((time.monotonic() - self.started) * left / measured)} left"
        self.progress(text, self.px_done / self.px if self.px else 1.0)


@dataclass
class _Batch:
    """A run over all inputs."""

    folder: BatchFolder
    plan: BatchPlan
    file_format: FileFormat
    inputs: list[BatchInput]
    left_out: dict[str, int]
    limits: FieldLimits
    counter: _Counter
    rows: dict[str, list[Row]] = field(default_factory=dict)
    works: dict[str, SourceWork] = field(default_factory=dict)
    opened: dict[str, Source] = field(default_factory=dict)
    came_up: deque[Job] = field(default_factory=deque)

    def run(self, client: Client) -> None:
        """Measure what is not finished."""
        self._work_off(client, self._openings())
        self.counter.started = time.monotonic()
        self.counter.tell()
        self._work_off(client, self._measurements())

    def write_tables(self) -> BatchReport:
        """Write the table of all planes that were tried, and the report that shows it."""
        for name, work in self.works.items():
            self.rows[name] = work.rows_in_order()
        linked = (
            self._linked(row, each) for each in self.inputs for row in self.rows.get(each.name, [])
        )
        rows = judged_rows(linked, self.limits)
        csv, json_lines = self.folder.tables
        contents = {csv: in_csv(rows), json_lines: in_json_lines(rows)}
        if self.plan.thumbnails:
            contents |= report_contents(self.folder, rows, self.limits)
        write_results(contents, force=True)
        page = self.folder.report if self.plan.thumbnails else None
        return BatchReport.of_rows(rows, csv, left_out=self.left_out, report=page)

    def _linked(self, row: Row, each: BatchInput) -> Row:
        """Return a row as tables have it, with the path of its source from their folder."""
        return rounded(row) | {"link": path_from(self.folder.path, each.given)}

    def _work_off(self, client: Client, jobs: Iterator[Job]) -> None:
        """Do jobs, and those that come of them; what was at work when a worker died, alone."""

        def next_job() -> Job | None:
            return self.came_up.popleft() if self.came_up else next(jobs, None)

        suspects = []
        for job, result in outcomes(client, next_job):
            if isinstance(result, BaseException) and not job.divided:
                suspects.append(job)
            else:
                job.done(result)
        jobs = iter(suspects)
        for job, result in outcomes(client, next_job, at_a_time=1):
            job.done(result)

    def _openings(self) -> Iterator[Job]:
        """Yield the jobs that open what is not finished."""
        for each in self.inputs:
            rows = finished_rows(each, self.folder, self.plan)
            if rows is None:
                yield Job.call(look_at, each.given.absolute(), partial(self._keep, each))
                continue
            self.rows[each.name] = rows
            px = sum(row["width"] * row["height"] for row in rows)
            self.counter.expect(len(rows), px)
            self.counter.skip(len(rows), px)

    def _keep(self, each: BatchInput, result: Source | str | BaseException) -> None:
        if isinstance(result, Source):
            self.opened[each.name] = result
            planes = math.prod(result.plane_shape)
            self.counter.expect(planes, planes * math.prod(plane_size(result)))
        else:
            self.rows[each.name] = [unopened(each, result)]
        share = len(self.opened | self.rows) / len(self.inputs)
        self.counter.progress("Opening the inputs", share)

    def _measurements(self) -> Iterator[Job]:
        """Yield the jobs that measure planes."""
        for each in self.inputs:
            if (source := self.opened.pop(each.name, None)) is None:
                continue
            # What is wrong with one source, such as axes that a format has not, is its own.
            try:
                work = begin(each, source, self.folder, self.plan, self.file_format)
            except (OSError, TypeError, ValueError) as error:
                self.rows[each.name] = [unopened(each, error)]
                continue
            self.works[each.name] = work
            self.counter.skip(len(work.rows), len(work.rows) * work.plane_px)
            yield from self._plane_jobs(work, source)

    def _plane_jobs(self, work: SourceWork, source: Source) -> Iterator[Job]:
        tasks = work.tasks(source)
        if not tasks:
            self._end(work)
        for task in tasks:
            if work.in_parts:
                yield from self._part_jobs(work, task)
            else:
                yield Job.call(measure_plane, task, partial(self._note, work, task))

    def _part_jobs(self, work: SourceWork, task: PlaneTask) -> Iterator[Job]:
        """Yield the job of a large plane, unless that is finished or cannot be done."""
        try:
            plane = TiledPlane(task)
            parts = plane.graph()
        except (TypeError, ValueError) as error:
            self._note(work, task, error)
            return
        self.counter.skip(0, sum(note.px for note in plane.notes))
        if parts:
            left = iter(reversed(range(sum(map(len, parts)))))
            yield Job.graph(parts, lambda result: self._note_part(work, plane, next(left), result))
        else:
            self._note(work, task, plane.row())

    def _note_part(
        self, work: SourceWork, plane: TiledPlane, left: int, result: TileNote | BaseException
    ) -> None:
        if isinstance(result, TileNote):
            plane.notes.append(result)
            self.counter.count(0, result.px)
            self.counter.tell()
        else:
            plane.error = reason(result)
        if not left:
            self._note(work, plane.task, plane.row())

    def _note(self, work: SourceWork, task: PlaneTask, result: Row | BaseException) -> None:
        row = result if isinstance(result, dict) else failed(task.known, reason(result))
        work.rows[task.index] = as_named(work.input, row)
        self.counter.count(1, 0 if work.in_parts else work.plane_px)
        self.counter.tell()
        if len(work.rows) == len(work.planes):
            self._end(work)

    def _end(self, work: SourceWork) -> None:
        """Make the results of a source whole, now that each of its planes was tried."""
        targets = work.targets if work.has_stores and work.any_done else ()
        errors: list[str | BaseException | None] = []

        def ended(error: str | BaseException | None) -> None:
            errors.append(error)
            if len(errors) == len(targets):
                self._ended(work, next((each for each in errors if each is not None), None))

        for target in targets:
            self.came_up.append(Job.call(finish, target, ended))
        if not targets:
            self._ended(work, None)

    def _ended(self, work: SourceWork, error: str | BaseException | None) -> None:
        if error is None:
            work.end()
        else:
            told = error if isinstance(error, str) else reason(error)
            work.rows = {index: failed(work.known_of(index), told) for index in work.planes}
