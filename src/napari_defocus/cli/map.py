"""The terminal command for blur maps."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from napari_defocus.cli.command import Facts, command, last_lines
from napari_defocus.cli.description import lines_of, map_facts, picture_facts
from napari_defocus.cli.option_groups import MapOptions
from napari_defocus.cli.results import Files, beside, check_endings, encoded_defocus, encoded_maps
from napari_defocus.core.checks import check_confidence
from napari_defocus.core.progress import Progress
from napari_defocus.pipeline import measure_map
from napari_defocus.psf import MICROSCOPE


def _lines(facts: Facts) -> Iterator[str]:
    yield from lines_of(facts)
    yield from last_lines(facts)


@command(
    _lines,
    """
    output -o PATH
        Where to write: values in px (.tif) or a drawing with a colour bar (.png). Can be given
        twice. [default: NAME-blur.tif and NAME-blur.png beside IMAGE]
    confidence PATH
        Where to write how sure the map is at every pixel, from 0 to 1: values (.tif) or a drawing
        (.png).
    defocus PATH
        Where to write the defocus in um (.tif), of a microscope. [default: NAME-defocus.tif beside
        IMAGE, if --psf is microscope and --output is left out]
    """,
)
def map_picture(
    image: Path,
    *,
    measuring: MapOptions,
    output: list[Path] | None = None,
    confidence: Path | None = None,
    defocus: Path | None = None,
    min_confidence: float = 0.0,
    files: Files,
    progress: Progress,
) -> dict[str, Any]:
    """Measure how wide the blur is, in px, at every pixel of IMAGE."""
    maps = output or beside(image, "-blur.tif", "-blur.png")
    confidences = [confidence] if confidence else []
    settings = measuring.settings(image)
    in_um = _in_um(image, output, defocus, settings.psf)
    outputs = [*maps, *confidences, *in_um]
    check_confidence("min_confidence", min_confidence)
    check_endings(outputs, ".tif", ".tiff", ".png")
    check_endings(in_um, ".tif", ".tiff")
    picture = files.read(image, outputs)
    found = measure_map(picture, settings, measuring.intensity_range, progress)
    facts = picture_facts(image, picture, outputs, found, settings) | map_facts(
        found, min_confidence
    )
    contents = encoded_maps(maps, confidences, found, settings, min_confidence)
    contents |= encoded_defocus(in_um, found, settings, min_confidence)
    files.write(contents, "map", map=settings)
    return facts


def _in_um(image: Path, output: list[Path] | None, defocus: Path | None, psf: str) -> list[Path]:
    """Return where the defocus in um is written: nowhere for a lens that is no microscope."""
    if psf.split(":")[0] != MICROSCOPE:
        if defocus is not None:
            raise ValueError(f"defocus is {defocus}, but psf is {psf}; um take psf microscope")
        return []
    if defocus is not None:
        return [defocus]
    return [] if output else beside(image, "-defocus.tif")
