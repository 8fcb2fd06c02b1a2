"""The terminal command for distances."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import napari_defocus
from napari_defocus.cli.command import Facts, command, last_lines
from napari_defocus.cli.description import lines_of, map_facts, picture_facts
from napari_defocus.cli.option_groups import MapOrFileOptions
from napari_defocus.cli.results import Files, beside, check_endings, encoded
from napari_defocus.cli.thin_lens import (
    LensOptions,
    check_side,
    lens_facts,
    lens_line,
    lens_of,
    side_line,
)
from napari_defocus.core.checks import Side, check_confidence
from napari_defocus.core.progress import Progress
from napari_defocus.pipeline import Measurement, file_facts, used
from napari_defocus.settings import RefocusSettings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_defocus.optics.thin_lens import ThinLens


def _lines(facts: Facts) -> Iterator[str]:
    yield from lines_of(facts)
    yield lens_line(facts)
    yield side_line(facts)
    if facts["depth_median_m"] is not None:
        low, high = facts["depth_p5_m"], facts["depth_p95_m"]
        yield (
            f"depth        median {facts['depth_median_m']:.4g} m, "
            f"5 to 95 % of what is finite: {low:.4g} to {high:.4g} m"
        )
    if facts["infinite_percent"]:
        yield (
            f"infinite     {facts['infinite_percent']:.1f} % of the picture, "
            "with more blur than any distance can have"
        )
    if facts["reach_m"] is not None:
        comparison = "farther" if facts["side"] == "far" else "nearer"
        yield (
            f"limit        {facts['reach_m']:.4g} m has the largest blur that is looked for; "
            f"what is {comparison} comes out as that"
        )
    yield from last_lines(facts)


@command(
    _lines,
    """
    output -o PATH
        Where to write: values in m (.tif) or a drawing with a colour bar (.png). Can be given
        twice. [default: NAME-depth.tif and NAME-depth.png beside IMAGE]
    """,
)
def depth(
    image: Path,
    *,
    thin_lens: LensOptions,
    side: Side = RefocusSettings.side,
    measuring: MapOrFileOptions,
    min_confidence: float = 0.0,
    output: list[Path] | None = None,
    files: Files,
    progress: Progress,
) -> dict[str, Any]:
    """Compute how far away, in m, everything in IMAGE is.

    It takes the lens: what IMAGE notes of it (EXIF), and what you give instead.
    """
    from napari_defocus.io.encoders import depth_png, depth_tiff

    outputs = output or beside(image, "-depth.tif", "-depth.png")
    settings = measuring.settings(image)
    check_confidence("min_confidence", min_confidence)
    if min_confidence > 0 and measuring.known_map and not measuring.map_confidence:
        raise ValueError(f"min_confidence is {min_confidence}; with map it needs map_confidence")
    check_endings(outputs, ".tif", ".tiff", ".png")
    picture = files.read(image, outputs, *measuring.files)
    lens = lens_of(image, thin_lens)
    check_side(side, lens)
    found = measuring.find(picture, settings, progress)
    trusted = found.trusted(min_confidence)
    distance = napari_defocus.depth_from_blur(trusted, lens, side=side)
    facts = lens_facts(image, lens, thin_lens) | {"side": side}
    made_with = used(found, settings) | facts | {"min_confidence": min_confidence}
    contents = encoded(
        outputs,
        lambda: depth_png(distance, min_confidence),
        lambda: depth_tiff(distance, made_with),
    )
    files.write(contents, "depth", map=settings)
    facts |= file_facts(found) | map_facts(found, min_confidence) | _depth_facts(distance)
    facts |= {"reach_m": _reach(found, lens, side)}
    return picture_facts(image, picture, outputs, found, settings) | facts


def _depth_facts(distance: NDArray[Any]) -> dict[str, Any]:
    """Return what is told about distances; None if none of them is finite."""
    import numpy as np

    finite = distance[np.isfinite(distance)]
    low, median, high = np.percentile(finite, [5, 50, 95]) if finite.size else [None] * 3
    values = {"depth_median_m": median, "depth_p5_m": low, "depth_p95_m": high}
    facts = {name: value if value is None else float(value) for name, value in values.items()}
    return facts | {"infinite_percent": 100.0 * float(np.isposinf(distance).mean())}


def _reach(found: Measurement, lens: ThinLens, side: Side) -> float | None:
    """Return the distance of the largest blur that was looked for.

    None if that is infinity, or nobody knows what was looked for.
    """
    if found.map_file is not None:
        return None
    limit = napari_defocus.depth_from_blur(found.psf.max_scale, lens, side=side)
    return float(limit) if math.isfinite(limit) else None
