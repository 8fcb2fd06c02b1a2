"""The terminal commands about the lens: measure its PSF, and compare what could be its PSF."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import napari_defocus
from napari_defocus.cli.command import Facts, command, last_lines
from napari_defocus.cli.description import (
    file_of_picture,
    intensity_facts,
    intensity_lines,
    picture_lines,
)
from napari_defocus.cli.results import check_endings
from napari_defocus.core.checks import Linearize
from napari_defocus.core.progress import Progress
from napari_defocus.psf import AUTO
from napari_defocus.settings import COMPARED_PSFS, MapSettings

if TYPE_CHECKING:
    from napari_defocus.psf.measured import MeasuredPSF


def _calibration_lines(facts: Facts) -> Iterator[str]:
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


@command(
    _calibration_lines,
    """
    pictures PICTURE...
        One for each setting of the focus, two or more: of point sources, or of anything with
        texture if --sharp is given.
    output -o PATH
        Where to write what --psf reads (.npz).
    scales PX,PX,...
        Scale of each picture in px, if you know it. If left out, it is measured: the radius of the
        disc that is as wide.
    sharp PICTURE
        The same in focus; once for all pictures, or once for each.
    max_scale PX
        Largest scale that is looked for with this lens, in px. If left out, it is the largest one
        that was measured.
    """,
)
def calibrate(
    pictures: list[Path],
    *,
    output: Path,
    scales: str | None = None,
    sharp: list[Path] | None = None,
    max_scale: float | None = None,
    intensity_range: tuple[float, float] | None = None,
    force: bool = False,
    progress: Progress,
) -> dict[str, Any]:
    """Measure the shape that your lens makes of a point.

    It is measured at a few settings of its focus.
    """
    from napari_defocus.core.writing import check_results
    from napari_defocus.io.pictures import read_picture

    given, references = _numbers("scales", scales), sharp or []
    check_endings([output], ".npz")
    for path in (*pictures, *references):
        check_results([output], force=force, source=path)
    planes = [read_picture(path) for path in pictures]
    in_focus = [read_picture(path) for path in references]
    with _files_by_name(pictures, references):
        lens = napari_defocus.calibrate_psf(
            planes,
            scales=given,
            sharp=in_focus[0] if len(in_focus) == 1 else in_focus or None,
            max_scale=max_scale,
            intensity_range=intensity_range,
            names=[path.name for path in pictures],
            progress=progress,
        )
    report = napari_defocus.fit_report(lens, _window(lens))
    check_results([output], force=force)
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


def _comparison_lines(facts: Facts) -> Iterator[str]:
    yield from picture_lines(facts)
    yield from intensity_lines(facts)
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


@command(
    _comparison_lines,
    f"""
    family TEXT
        A lens to compare, as --psf of map takes it. Give it once for each lens.
        [default: {", ".join(COMPARED_PSFS)}]
    """,
)
def compare(
    image: Path,
    *,
    family: list[str] | None = None,
    noise_variance: float | None = MapSettings.noise_variance,
    max_radius: float = MapSettings.max_radius,
    camera_softness: float = MapSettings.camera_softness,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    progress: Progress,
) -> dict[str, Any]:
    """Compare how well lenses explain the blur of IMAGE.

    The best comes first.
    """
    from napari_defocus.io.pictures import read_picture
    from napari_defocus.psf.parsing import psf_of

    if AUTO in (family or ()):
        raise ValueError("family is 'auto', which is not one lens; it takes a lens such as disc")
    text_of = {psf_of(text, max_radius): text for text in family or COMPARED_PSFS}
    picture = read_picture(image)
    comparison = napari_defocus.compare_psf(
        picture,
        list(text_of),
        noise_variance=noise_variance,
        camera_softness=camera_softness,
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
            "softness_px": row.softness,
        }
        for row in comparison
    ]
    return {
        **file_of_picture(image, picture.shape),
        **intensity_facts(comparison.intensities),
        "noise_variance": comparison.noise_variance,
        "windows": comparison.windows,
        "families": rows,
        "best": rows[0]["psf"],
        "files": [],
    }


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
