"""The terminal commands about the lens: measure its PSF, and compare what could be its PSF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import napari_defocus
from napari_defocus.cli.command import check_endings, last_lines, run
from napari_defocus.cli.option_groups import Reporting
from napari_defocus.cli.options import (
    Force,
    ImagePath,
    IntensityRange,
    LinearizeOption,
    MaxRadius,
    NoiseVariance,
)
from napari_defocus.core.progress import Progress
from napari_defocus.pipeline import intensity_facts
from napari_defocus.psf.text import psf_of
from napari_defocus.settings import COMPARED_PSFS, MapSettings

if TYPE_CHECKING:
    from napari_defocus.psf.measured import MeasuredPSF


def calibrate(
    *,
    pictures: Annotated[
        list[Path],
        typer.Argument(
            metavar="PICTURE...",
            help="One for each setting of the focus, two or more: of point sources, or of "
            "anything with texture if --sharp is given.",
            show_default=False,
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="PATH",
            help="Where to write what --psf reads (.npz).",
            show_default=False,
        ),
    ],
    scales: Annotated[
        str | None,
        typer.Option(
            metavar="PX,PX,...",
            help="Scale of each picture in px, if you know it. Measured if left out: the radius "
            "of the disc that is as wide.",
        ),
    ] = None,
    sharp: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="PICTURE",
            help="The same in focus; once for all pictures, or once for each.",
        ),
    ] = None,
    max_scale: Annotated[
        float | None,
        typer.Option(
            metavar="PX",
            help="Largest scale that the lens can be looked for with, in px. "
            "The largest measured one if left out.",
        ),
    ] = None,
    intensity_range: IntensityRange = None,
    force: Force = False,
    reporting: Reporting,
) -> None:
    """Measure what your lens makes of a point, from PICTUREs at a few settings of its focus."""

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus.core import writing
        from napari_defocus.io.pictures import read_picture

        given = _numbers("scales", scales)
        check_endings([output], ".npz")
        for path in (*pictures, *(sharp or [])):
            writing.check_results([output], force=force, source=path)
        planes = [read_picture(path) for path in pictures]
        references = [read_picture(path) for path in sharp or []]
        with _files_by_name(pictures, sharp or []):
            lens = napari_defocus.calibrate_psf(
                planes,
                scales=given,
                sharp=references[0] if len(references) == 1 else references or None,
                max_scale=max_scale,
                intensity_range=intensity_range,
                names=[path.name for path in pictures],
                progress=progress,
            )
        report = napari_defocus.fit_report(lens, _window(lens))
        writing.check_results([output], force=force)
        lens.save(output)
        return {
            "pictures": [str(path) for path in pictures],
            "scales_px": lens.provenance["scales"],
            "scales_were": lens.provenance["scales_were"],
            "settings_px": lens.scales.tolist(),
            "max_scale_px": lens.max_scale,
            "kernel_side_px": lens.kernels.shape[1],
            "fit_rms_log_error": report.rms,
            "fit_largest_log_error": report.maximum,
            "files": [str(output)],
        }

    run(measure, _calibration_lines, reporting)


def compare(
    image: ImagePath,
    *,
    family: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TEXT",
            help="A lens to compare, as --psf of map takes it; can be given many times. "
            f"[default: {', '.join(COMPARED_PSFS)}]",
            show_default=False,
        ),
    ] = None,
    noise_variance: NoiseVariance = MapSettings.noise_variance,
    max_radius: MaxRadius = MapSettings.max_radius,
    linearize: LinearizeOption = MapSettings.linearize,
    intensity_range: IntensityRange = None,
    reporting: Reporting,
) -> None:
    """Compare how well lenses explain the blur of IMAGE, the best first."""

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus.io.pictures import read_picture, told_choice_in

        text_of = {psf_of(text, max_radius): text for text in family or COMPARED_PSFS}
        picture = read_picture(image)
        comparison = napari_defocus.compare_psf(
            picture,
            list(text_of),
            noise_variance=noise_variance,
            linearize=linearize,
            intensity_range=intensity_range,
            progress=progress,
        )
        rows = [
            {
                "psf": text_of[row.psf],
                "log_evidence": row.log_evidence,
                "best_in_percent": 100.0 * row.share,
                "median_px": row.median_scale,
                "scale": row.psf.scale_name,
            }
            for row in comparison
        ]
        return {
            "image": str(image),
            "taken": told_choice_in(image),
            "width": picture.shape[1],
            "height": picture.shape[0],
            **intensity_facts(comparison.intensities),
            "noise_variance": comparison.noise_variance,
            "windows": comparison.windows,
            "families": rows,
            "best": rows[0]["psf"],
            "files": [],
        }

    run(measure, _comparison_lines, reporting)


def _calibration_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    for picture, scale in zip(facts["pictures"], facts["scales_px"], strict=True):
        yield f"{facts['scales_were']:<12} {scale:.2f} px in {picture}"
    side = facts["kernel_side_px"]
    yield (
        f"lens         {len(facts['settings_px'])} kernels of {side} x {side} px, "
        f"scales up to {facts['max_scale_px']:.2f} px"
    )
    yield (
        f"fit          log error of the spectra {facts['fit_rms_log_error']:.3f} rms, "
        f"{facts['fit_largest_log_error']:.2f} at most"
    )
    yield from last_lines(facts)


def _comparison_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    yield f"picture      {facts['image']}, {facts['width']} x {facts['height']} px"
    if facts["taken"]:
        yield f"taken        {facts['taken']}"
    if facts.get("intensities"):
        yield f"intensities  {facts['intensities']}"
    yield f"noise        variance {facts['noise_variance']:.2g}"
    yield f"windows      {facts['windows']} with texture"
    width = max(len(row["psf"]) for row in facts["families"])
    yield f"{'lens':<{width}} {'log evidence':>13} {'best in':>8}   median"
    for row in facts["families"]:
        yield (
            f"{row['psf']:<{width}} {row['log_evidence']:>13.3f} {row['best_in_percent']:>6.0f} %"
            f"   {row['scale'].replace('(px)', '')}{row['median_px']:.1f} px"
        )
    yield from last_lines(facts)


@contextmanager
def _files_by_name(pictures: list[Path], sharp: list[Path]) -> Iterator[None]:
    """Let an error say which file it means, instead of which entry."""
    names = {f"pictures[{i}]": str(path) for i, path in enumerate(pictures)}
    names |= {f"sharp[{i}]": str(path) for i, path in enumerate(sharp)}
    if len(sharp) == 1:
        names["sharp:"] = f"{sharp[0]}:"
    try:
        yield
    except (TypeError, ValueError) as error:
        message = str(error)
        for entry, name in names.items():
            message = message.replace(entry, name)
        raise type(error)(message) from None


def _numbers(name: str, text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(f"{name} is {text!r}; it takes numbers with commas between") from None


def _window(lens: MeasuredPSF) -> int:
    """Return the side of the smallest window, from the default on, that takes a lens."""
    return max(MapSettings.window, 2 * int(lens.max_scale) + 3)
