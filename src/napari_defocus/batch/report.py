"""The report of a batch: a page that any browser opens from disk, worst fields first."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import napari_defocus
from napari_defocus.batch.flags import judged_rows
from napari_defocus.batch.folder import BatchFolder, read_note
from napari_defocus.batch.outcome import BatchReport
from napari_defocus.batch.plate_facts import plate_of
from napari_defocus.batch.report_facts import fields_of, name_of, settings_told, summary_of
from napari_defocus.batch.table import Row, in_csv, in_json_lines
from napari_defocus.batch.thumbnails import BLUR, OUTLINE, beside, outline_png, radii_in
from napari_defocus.core.extras import need_large_extra
from napari_defocus.core.writing import write_results
from napari_defocus.io.pictures import UnreadablePicture
from napari_defocus.settings import FieldLimits


def write_report(
    folder: str | os.PathLike[str], *, limits: FieldLimits | None = None
) -> BatchReport:
    """Write the report of a batch anew, for instance by other limits; nothing is measured.

    The flags in the table follow, so that table and report say the same.

    Parameters
    ----------
    folder : path-like
        That `measure_batch` wrote into. Fields that were measured without a report have no
        thumbnails.
    limits : FieldLimits, optional
        Which fields are flagged; the defaults if left out, whatever the batch was started with.

    Returns
    -------
    BatchReport
        Its `report` is `report.html` in that folder. The page needs the folder `thumbnails` beside
        it and nothing else.

    Raises
    ------
    TypeError
        If `limits` is something else.
    UnreadablePicture
        If no batch has written a table there, or it is damaged.
    UnwritableResult
        If a file cannot be written, or a batch is at work in the folder.
    ImportError
        If the extra "large" is not installed.

    Examples
    --------
    >>> from napari_defocus import FieldLimits, write_report
    >>> write_report("measured", limits=FieldLimits(in_focus_up_to=2.5))  # doctest: +SKIP
    """
    need_large_extra()
    if limits is not None and not isinstance(limits, FieldLimits):
        raise TypeError(f"limits is {limits!r}; it takes FieldLimits")
    place, judging = BatchFolder(Path(folder).absolute()), limits or FieldLimits()
    if not place.notes.is_dir():
        raise UnreadablePicture(f"cannot read {folder}: no batch has written there")
    with place.held():
        rows = judged_rows(_rows_in(place.tables[1]), judging)
        csv, json_lines = place.tables
        contents = {csv: in_csv(rows), json_lines: in_json_lines(rows)}
        write_results(contents | report_contents(place, rows, judging), force=True)
    return BatchReport.of_rows(rows, csv, report=place.report)


def _rows_in(path: Path) -> list[Row]:
    try:
        lines = path.read_text("utf-8").splitlines()
    except OSError as error:
        raise UnreadablePicture(f"cannot read {path}: no batch has written a table") from error
    try:
        rows = [json.loads(line) for line in lines]
        if all({"source", "status", "blur_histogram", "link"} <= row.keys() for row in rows):
            return rows
    except (AttributeError, ValueError) as error:
        raise UnreadablePicture(f"cannot read {path}: it is damaged") from error
    raise UnreadablePicture(
        f"cannot read {path}: an early version wrote it, without what a report needs; measure again"
    )


def report_contents(folder: BatchFolder, rows: list[Row], limits: FieldLimits) -> dict[Path, bytes]:
    """Return the files of a report: the page, and the outlines that are not there yet.

    Parameters
    ----------
    folder : BatchFolder
    rows : list of dict
        Of the table, judged by the limits.
    limits : FieldLimits
    """
    made_with = read_note(folder.plan) or {}
    page = page_of(rows, limits, made_with)
    return {folder.report: page.encode()} | _outlines(folder, rows, limits)


def _outlines(folder: BatchFolder, rows: list[Row], limits: FieldLimits) -> dict[Path, bytes]:
    changed = {}
    for row in rows:
        if not row.get("thumbnail"):
            continue
        thumbnail = folder.path / row["thumbnail"]
        try:
            radii = radii_in(beside(thumbnail, BLUR).read_bytes())
        except OSError:  # somebody removed it; the page says so by itself
            continue
        path, content = beside(thumbnail, OUTLINE), outline_png(radii, limits.in_focus_up_to)
        if not path.exists() or path.read_bytes() != content:
            changed[path] = content
    return changed


def page_of(rows: list[Row], limits: FieldLimits, made_with: dict[str, Any]) -> str:
    """Return a report as HTML.

    Parameters
    ----------
    rows : list of dict
        Of the table, judged by the limits.
    limits : FieldLimits
    made_with : dict
        The facts of the batch's plan.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    pages = Environment(
        loader=PackageLoader("napari_defocus.batch", "report_page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    fields = fields_of(rows, limits)
    return pages.get_template("page.html").render(
        name=name_of(fields),
        version=napari_defocus.__version__,
        fields=fields,
        summary=summary_of(fields, limits),
        plate=plate_of(fields),
        settings=settings_told(made_with),
        limits=limits,
        within=made_with.get("within"),
    )
