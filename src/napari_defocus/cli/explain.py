"""The terminal command that explains one pixel of a blur map."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import napari_defocus
from napari_defocus.cli.command import Facts, command, last_lines
from napari_defocus.cli.description import lines_of, picture_facts
from napari_defocus.cli.option_groups import MapOptions
from napari_defocus.cli.results import Files, check_endings
from napari_defocus.core.progress import Progress
from napari_defocus.pipeline import measure_map

if TYPE_CHECKING:
    from napari_defocus.labeling.explanation import PixelExplanation

_SIZE, _DPI = (6.4, 4.0), 140
"""Size of the drawing in inches, and its pixels per inch."""


def _lines(facts: Facts) -> Iterator[str]:
    yield from lines_of(facts)
    top, left, bottom, right = facts["window"]
    yield f"pixel        row {facts['row']}, column {facts['column']}"
    yield f"window       rows {top:g} to {bottom:g}, columns {left:g} to {right:g}"
    yield f"blur         {facts['summary']}"
    for remark in facts["remarks"]:
        yield f"             {remark}"
    yield from last_lines(facts)


@command(
    _lines,
    """
    row ROW
        From the top, in px; the first is 0.
    column COLUMN
        From the left, in px; the first is 0.
    output -o PATH
        Where to draw the likelihood of every radius (.png). Nothing is written if left out.
    """,
)
def explain(
    image: Path,
    row: int,
    column: int,
    *,
    measuring: MapOptions,
    output: Path | None = None,
    settings_file: Path | None = None,
    force: bool = False,
    progress: Progress,
) -> dict[str, Any]:
    """Explain the blur map of IMAGE at one pixel."""
    from napari_defocus.likelihood.candidates import check_place

    outputs, files = [output] if output else [], Files(force=force)
    settings, intensity_range = measuring.settings(image), measuring.intensity_range
    check_endings(outputs, ".png")
    picture = files.read(image, outputs)
    height, width = picture.shape[:2]
    check_place(row, column, (height, width))
    found = measure_map(picture, settings, intensity_range, progress)
    assert found.candidates is not None
    told = napari_defocus.explain_pixel(
        found.candidates,
        row,
        column,
        blur_map=found.blur_map,
        confidence=found.confidence,
        image=picture,
        intensity_range=intensity_range,
    )
    files.write({path: _drawing(told) for path in outputs})
    return picture_facts(image, picture, outputs, found, settings) | _facts(told)


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
