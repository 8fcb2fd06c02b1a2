"""The terminal command for many pictures and stacks: maps, and a table of them, resumable."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import typer

import napari_defocus
from napari_defocus.cli.command import Facts, command
from napari_defocus.cli.console import complain
from napari_defocus.cli.option_groups import (
    LimitOptions,
    MapOptions,
    RestorationOptions,
    said_threshold,
)
from napari_defocus.cli.report import flagged_line
from napari_defocus.core.checks import Unknown
from napari_defocus.core.progress import Progress
from napari_defocus.settings import BLOCK_SIZE, MaskSettings

SOME_FAILED = 1
"""The exit code if the work was done, but not for all planes."""


def _lines(facts: Facts) -> Iterator[str]:
    from napari_defocus.io.picture_files import told_left_out

    what = "pictures" if facts["planes"] == facts["sources"] else "planes"
    yield f"{what:<12} {facts['planes'] - facts['failed']} of {facts['planes']} measured"
    if facts["left_out"]:
        yield f"left out     {told_left_out(facts['left_out'])}"
    if facts["doubtful"]:
        yield f"careful      {facts['doubtful']} may tell little of their blur; the table says why"
    if facts["flagged"]:
        yield flagged_line(facts)
    yield f"time         {facts['seconds']:.1f} s"
    yield f"wrote        {facts['table']}"
    if facts["report"]:
        yield f"wrote        {facts['report']}"


def _end(facts: Facts) -> None:
    if facts["failed"]:
        for source, error in facts["failures"].items():
            complain(error if source in error else f"{source}: {error}")
        complain(f"{facts['failed']} could not be measured; the table says why")
        raise typer.Exit(SOME_FAILED)


@command(
    _lines,
    """
    inputs INPUTS...
        Pictures (PNG, JPEG, TIFF, WebP, BMP, GIF, HEIC), stacks and slides (TIFF, .svs, .ndpi,
        .scn, .qptiff, .lsm, .stk and the like, OME-Zarr), folders of them, and patterns such as
        'photos/**/*.tif'. Results of napari-defocus are left out of folders and patterns.
    output -o FOLDER
        Where to write: report.html, table.csv and table.jsonl, and the folders thumbnails and
        maps. It is made if missing.
        Started again with the same folder, the batch goes on where it was ended.
    confidence
        Also write how sure each map is: NAME-confidence.
    mask
        Also write what is in focus: NAME-mask.
    restore
        Also write each picture all in focus: NAME-in-focus.
    within PATH
        A folder of masks or labels with the names of the pictures (.png, .tif), or one mask for
        all: only where it is not 0 is anything counted.
    report --report/--no-report
        Write report.html: all fields, worst first, with thumbnails, and the plate if names say
        wells such as A01.
    file_format --format
        The format of the results. auto: TIFF (PNG for masks and restored pictures) for single
        pictures of up to 64 megapixels, OME-Zarr for stacks and larger ones.
    block_size PX
        Side of the parts in which planes of more than 4 megapixels are worked on. It bounds the
        memory.
    scheduler ADDRESS
        A dask scheduler, such as tcp://10.0.0.5:8786, whose workers do the work. They must have
        this version of napari-defocus, and see INPUTS and FOLDER under the same paths. [default:
        processes on this machine]
    workers NUMBER
        How many processes to start on this machine. [default: one a core]
    tv_weight NUMBER
        For --restore: large for less noise, small for more detail. If left out, it follows from
        the noise.
    risk NUMBER
        For --restore: the risk of taking more blur away than there is, which makes rings.
    force
        Measure again what has changed since FOLDER was begun, or was measured with other settings.
    """,
    end=_end,
)
def batch(
    inputs: list[Path],
    *,
    output: Path,
    confidence: bool = False,
    mask: bool = False,
    restore: bool = False,
    within: Path | None = None,
    report: bool = True,
    flagging: LimitOptions,
    file_format: Literal["auto", "tiff", "ome-zarr"] = "auto",
    block_size: int = BLOCK_SIZE,
    scheduler: str | None = None,
    workers: int | None = None,
    measuring: MapOptions,
    min_confidence: float = 0.0,
    threshold: str = str(MaskSettings.threshold),
    unknown: Unknown = MaskSettings.unknown,
    restoring: RestorationOptions,
    settings_file: Path | None = None,
    force: bool = False,
    progress: Progress,
) -> dict[str, Any]:
    """Measure many pictures and stacks: a map and a table row each.

    End it whenever you like: the same command goes on from there. A picture that cannot be
    measured is a row of the table that says why, and the exit code is then 1.
    """
    from napari_defocus.batch.cluster import dask_client
    from napari_defocus.batch.masks_beside import masks_of
    from napari_defocus.io.open import find_sources

    pictures = find_sources(inputs)  # what is not there is told before workers start
    if within is not None:
        masks_of(pictures, within)
    limits = flagging.limits()
    restoration, map_settings = restoring.settings(), measuring.settings(*pictures)
    mask_settings = _mask_settings(settings_file, threshold, unknown)
    settings = napari_defocus.Settings(
        map=map_settings, mask=mask_settings, restoration=restoration
    )
    try:
        with dask_client(scheduler, workers=workers) as client:
            done = napari_defocus.measure_batch(
                inputs,
                output,
                settings=settings,
                confidence=confidence,
                mask=mask,
                restore=restore,
                min_confidence=min_confidence,
                intensity_range=measuring.intensity_range,
                within=within,
                limits=limits,
                report=report,
                file_format=file_format,
                block_size=block_size,
                force=force,
                client=client,
                progress=progress,
            )
    except KeyboardInterrupt as interruption:
        interruption.add_note("what is finished stays; the same command goes on from there")
        raise
    return {
        "table": str(done.table),
        "report": done.report and str(done.report),
        "planes": done.planes,
        "failed": done.failed,
        "sources": done.sources,
        "failures": done.failures,
        "left_out": done.left_out,
        "doubtful": done.doubtful,
        "flagged": done.flagged,
        "flags": done.flags,
        "limits": asdict(limits),
    }


def _mask_settings(settings_file: Path | None, threshold: str, unknown: Unknown) -> MaskSettings:
    """Return what shapes masks: what options do not say is in the settings' file alone."""
    from napari_defocus.io.settings_file import Settings

    mask = MaskSettings() if settings_file is None else Settings.load(settings_file).mask
    return replace(mask, threshold=said_threshold(threshold), unknown=unknown)
