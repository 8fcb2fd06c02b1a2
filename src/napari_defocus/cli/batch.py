"""The terminal command for many pictures and stacks: maps, and a table of them, resumable."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import napari_defocus
from napari_defocus.cli.command import run
from napari_defocus.cli.console import INTERRUPTED
from napari_defocus.cli.option_groups import MapOptions, Reporting
from napari_defocus.cli.options import MinConfidence, SettingsFile, Threshold
from napari_defocus.core.checks import check_risk, check_tv_weight
from napari_defocus.core.progress import Progress
from napari_defocus.settings import (
    BLOCK_SIZE,
    MapSettings,
    MaskSettings,
    RestorationSettings,
    usual_threshold,
)

SOME_FAILED = 1
"""The exit code if the work was done, but not for all planes."""

Inputs = Annotated[
    list[Path],
    typer.Argument(
        metavar="INPUTS...",
        help="Pictures (PNG, JPEG, TIFF, WebP, BMP), stacks and slides (TIFF, .svs, .ndpi, .scn, "
        ".qptiff, .lsm, .stk and the like, OME-Zarr), folders of them, and patterns such as "
        "'photos/**/*.tif'. Results of napari-defocus are left out of folders and patterns.",
        show_default=False,
    ),
]
Output = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="FOLDER",
        help="Where to write: table.csv and table.jsonl, and the folder maps. It is made if "
        "missing. Started again with the same folder, the batch goes on where it was ended.",
        show_default=False,
    ),
]
WithConfidence = Annotated[
    bool, typer.Option("--confidence", help="Write, too, how sure each map is: NAME-confidence.")
]
WithMask = Annotated[bool, typer.Option("--mask", help="Write, too, what is in focus: NAME-mask.")]
WithRestored = Annotated[
    bool,
    typer.Option("--restore", help="Write, too, each picture all in focus: NAME-in-focus."),
]
Format = Annotated[
    Literal["auto", "tiff", "ome-zarr"],
    typer.Option(
        "--format",
        help="Of maps and the like. auto: TIFF (masks and restored pictures: PNG) for single "
        "pictures of up to 64 megapixels, OME-Zarr for stacks and larger ones.",
    ),
]
BlockSize = Annotated[
    int,
    typer.Option(
        metavar="PX",
        help="Side of the parts in which planes of more than 4 megapixels are worked on; memory "
        "is bounded by it.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="A dask scheduler, such as tcp://10.0.0.5:8786, whose workers do the work. They "
        "must have this version of napari-defocus, and see INPUTS and FOLDER under the same "
        "paths. [default: processes on this machine]",
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        metavar="NUMBER",
        help="How many processes to start on this machine. [default: one a core]",
    ),
]
TVWeight = Annotated[
    float | None,
    typer.Option(
        metavar="NUMBER",
        help="Of --restore: large for less noise, small for more detail. Derived from the noise "
        "if left out.",
    ),
]
Risk = Annotated[
    float,
    typer.Option(
        metavar="NUMBER",
        help="Of --restore: of taking more blur away than there is, which makes rings.",
    ),
]
Again = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Measure again what has changed since FOLDER was begun, or was measured with other "
        "settings.",
    ),
]


def batch(
    inputs: Inputs,
    *,
    output: Output,
    confidence: WithConfidence = False,
    mask: WithMask = False,
    restore: WithRestored = False,
    file_format: Format = "auto",
    block_size: BlockSize = BLOCK_SIZE,
    scheduler: Scheduler = None,
    workers: Workers = None,
    measuring: MapOptions,
    min_confidence: MinConfidence = 0.0,
    threshold: Threshold = None,
    tv_weight: TVWeight = RestorationSettings.tv_weight,
    risk: Risk = RestorationSettings.risk,
    settings_file: SettingsFile = None,
    force: Again = False,
    reporting: Reporting,
) -> None:
    """Measure many pictures and stacks: a map of each plane, and a table with a row a plane.

    End it whenever you like: the same command goes on from there. A picture that cannot be
    measured is a row of the table that says why, and the exit code is then 1.
    """
    failures = []

    def work(progress: Progress) -> dict[str, Any]:
        from napari_defocus.batch.cluster import dask_client
        from napari_defocus.io.open import find_sources

        find_sources(inputs)  # what is not there is told before workers start
        check_tv_weight(tv_weight)
        check_risk(risk)
        map_settings = measuring.settings()
        settings = napari_defocus.Settings(
            map=map_settings,
            mask=_mask_settings(settings_file, threshold, map_settings),
            restoration=RestorationSettings(tv_weight=tv_weight, risk=risk),
        )
        with dask_client(scheduler, workers=workers) as client:
            report = napari_defocus.measure_batch(
                inputs,
                output,
                settings=settings,
                confidence=confidence,
                mask=mask,
                restore=restore,
                min_confidence=min_confidence,
                intensity_range=measuring.intensity_range,
                file_format=file_format,
                block_size=block_size,
                force=force,
                client=client,
                progress=progress,
            )
        failures.append(report.failed)
        return {
            "table": str(report.table),
            "planes": report.planes,
            "failed": report.failed,
            "left_out": report.left_out,
        }

    try:
        run(work, _lines, reporting)
    except typer.Exit as end:
        if end.exit_code == INTERRUPTED:
            _say("what is finished stays; the same command goes on from there")
        raise
    if any(failures):
        _say(f"{failures[0]} could not be measured; the table says why")
        raise typer.Exit(SOME_FAILED)


def _mask_settings(
    settings_file: Path | None, threshold: float | None, map_settings: MapSettings
) -> MaskSettings:
    """Return what shapes masks: what options do not say is in the settings' file alone."""
    from napari_defocus.io.settings_file import Settings

    mask = MaskSettings() if settings_file is None else Settings.load(settings_file).mask
    usual = usual_threshold(map_settings.family())
    return replace(mask, threshold=usual if threshold is None else threshold)


def _lines(facts: Mapping[str, Any]) -> Iterator[str]:
    from napari_defocus.io.picture_files import told_left_out

    yield f"planes       {facts['planes'] - facts['failed']} of {facts['planes']} measured"
    if facts["left_out"]:
        yield f"left out     {told_left_out(facts['left_out'])}"
    yield f"time         {facts['seconds']:.1f} s"
    yield f"wrote        {facts['table']}"


def _say(what: str) -> None:
    typer.echo(f"napari-defocus: {what}", err=True)
