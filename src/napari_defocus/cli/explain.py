"""The terminal command that explains one pixel of a blur map."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import napari_defocus
from napari_defocus.cli.command import check_endings, last_lines, run
from napari_defocus.cli.option_groups import MapOptions, Reporting
from napari_defocus.cli.options import Force, ImagePath, SettingsFile
from napari_defocus.core.progress import Progress
from napari_defocus.pipeline import lines_of, measure_map, picture_facts

if TYPE_CHECKING:
    from napari_defocus.labeling.explanation import PixelExplanation

Row = Annotated[int, typer.Argument(metavar="ROW", help="From the top, in px; the first is 0.")]
Column = Annotated[
    int, typer.Argument(metavar="COLUMN", help="From the left, in px; the first is 0.")
]
CurveOutput = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="Where to draw the likelihood of every radius (.png). Nothing is written if left out.",
    ),
]

_SIZE, _DPI = (6.4, 4.0), 140
"""Of the drawing, in inches and pixels an inch."""


def explain(
    image: ImagePath,
    row: Row,
    column: Column,
    *,
    measuring: MapOptions,
    output: CurveOutput = None,
    settings_file: SettingsFile = None,  # read by SettingsCommand
    force: Force = False,
    reporting: Reporting,
) -> None:
    """Tell why the blur map of IMAGE says what it says at one pixel."""
    outputs = [output] if output else []

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus.core import writing
        from napari_defocus.io import pictures
        from napari_defocus.likelihood.candidates import check_place

        settings = measuring.settings()
        check_endings(outputs, ".png")
        picture = pictures.read_picture(image)
        height, width = picture.shape[:2]
        check_place(row, column, (height, width))
        writing.check_results(outputs, force=force, source=image)
        found = measure_map(picture, settings, measuring.intensity_range, progress)
        assert found.candidates is not None
        told = napari_defocus.explain_pixel(
            found.candidates,
            row,
            column,
            blur_map=found.blur_map,
            confidence=found.confidence,
            image=picture,
            intensity_range=measuring.intensity_range,
        )
        writing.write_results({path: _drawing(told) for path in outputs}, force=force)
        return picture_facts(image, outputs, found, settings) | _facts(told)

    run(measure, _lines, reporting)


def _drawing(told: PixelExplanation) -> bytes:
    from matplotlib.figure import Figure

    from napari_defocus.io.provenance import marked_png

    figure = Figure(figsize=_SIZE, dpi=_DPI, layout="constrained")
    napari_defocus.draw_explanation(told, figure.subplots())
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return marked_png(buffer.getvalue(), "drawing: likelihood of every radius")


def _facts(told: PixelExplanation) -> dict[str, Any]:
    """Return what is told about a pixel; None for what is not known or is not so."""
    own = told.own_log_likelihood
    return {
        "row": int(told.row),
        "column": int(told.column),
        "blur_px": told.blur,
        "confidence": told.confidence,
        "candidates_px": told.radii.tolist(),
        "candidates_log_likelihood": told.heights.tolist(),
        "extrapolated": told.extrapolated,
        "carried_in": told.extrapolated,  # its name before 0.2
        "window": list(told.window),
        "own_window": None if told.own_window is None else list(told.own_window),
        "scales_px": told.scales.tolist(),
        "log_likelihood": told.log_likelihood.tolist(),
        "own_log_likelihood": None if own is None else own.tolist(),
        "summary": told.summary(),
        "remarks": told.remarks(),
    }


def _lines(facts: Mapping[str, Any]) -> Iterator[str]:
    yield from lines_of(facts)
    top, left, bottom, right = facts["window"]
    yield f"pixel        row {facts['row']}, column {facts['column']}"
    yield f"window       rows {top:g} to {bottom:g}, columns {left:g} to {right:g}"
    yield f"blur         {facts['summary']}"
    for remark in facts["remarks"]:
        yield f"             {remark}"
    yield from last_lines(facts)
