"""The terminal command that explains one pixel of a blur map."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import napari_defocus
from napari_defocus.commands import (
    AsJson,
    ColorSigma,
    Force,
    ImagePath,
    IntensityRange,
    LinearizeOption,
    MapSmoothness,
    MaxRadius,
    ModeOption,
    NoiseVariance,
    PSFText,
    Quiet,
    ShotNoiseOption,
    check_endings,
    last_lines,
    run,
)
from napari_defocus.measurement import lines_of, measure_map, picture_facts
from napari_defocus.progress import Progress
from napari_defocus.settings import MapSettings

if TYPE_CHECKING:
    from napari_defocus.explanation import PixelExplanation

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
    psf: PSFText = MapSettings.psf,
    noise_variance: NoiseVariance = MapSettings.noise_variance,
    shot_noise: ShotNoiseOption = MapSettings.shot_noise,
    max_radius: MaxRadius = MapSettings.max_radius,
    smoothness: MapSmoothness = MapSettings.smoothness,
    color_sigma: ColorSigma = MapSettings.color_sigma,
    mode: ModeOption = MapSettings.mode,
    linearize: LinearizeOption = MapSettings.linearize,
    intensity_range: IntensityRange = None,
    output: CurveOutput = None,
    force: Force = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Tell why the blur map of IMAGE says what it says at one pixel."""
    outputs = [output] if output else []

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus import files
        from napari_defocus.candidates import check_place

        settings = MapSettings(
            psf=psf,
            noise_variance=noise_variance,
            shot_noise=shot_noise,
            max_radius=max_radius,
            smoothness=smoothness,
            color_sigma=color_sigma,
            mode=mode,
            linearize=linearize,
        )
        settings.family()
        check_endings(outputs, ".png")
        picture = files.read_picture(image)
        height, width = picture.shape[:2]
        check_place(row, column, (height, width))
        files.check_results(outputs, force=force, source=image)
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
        files.write_results({path: _drawing(told) for path in outputs}, force=force)
        return picture_facts(image, outputs, found, settings) | _facts(told)

    run(measure, _lines, as_json, quiet)


def _drawing(told: PixelExplanation) -> bytes:
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE, dpi=_DPI, layout="constrained")
    napari_defocus.draw_explanation(told, figure.subplots())
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


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
        "carried_in": told.carried_in,
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
