"""The terminal command for distances, and the thin lens that is taken from its options."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import napari_defocus
from napari_defocus.cli.command import check_endings, last_lines, run
from napari_defocus.cli.option_groups import (
    LensOptions,
    MapOrFileOptions,
    Reporting,
    SettingsFiles,
)
from napari_defocus.cli.options import DepthOutputs, Force, ImagePath, MinConfidence, SideOption
from napari_defocus.cli.settings_options import saved_settings, with_settings
from napari_defocus.core.checks import Side, check_confidence
from napari_defocus.core.progress import Progress
from napari_defocus.pipeline import (
    Measurement,
    beside,
    file_facts,
    find_blur,
    lines_of,
    map_facts,
    picture_facts,
    used,
)
from napari_defocus.settings import RefocusSettings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_defocus.optics.thin_lens import ThinLens


_SIDES = {"far": "beyond", "near": "before"}


def depth(
    image: ImagePath,
    *,
    thin_lens: LensOptions,
    side: SideOption = RefocusSettings.side,
    measuring: MapOrFileOptions,
    min_confidence: MinConfidence = 0.0,
    output: DepthOutputs = None,
    settings_files: SettingsFiles,
    force: Force = False,
    reporting: Reporting,
) -> None:
    """Tell from the blur how far away, in m, everything in IMAGE is.

    It takes the lens: what IMAGE notes of it (EXIF), and what you give instead.
    """
    outputs = output or [beside(image, "-depth.tif"), beside(image, "-depth.png")]
    known_map, map_confidence = measuring.known_map, measuring.map_confidence

    def measure(progress: Progress) -> dict[str, Any]:
        from napari_defocus.core import writing
        from napari_defocus.io import pictures

        settings = measuring.settings()
        check_confidence("min_confidence", min_confidence)
        if min_confidence > 0 and known_map is not None and map_confidence is None:
            raise ValueError(
                f"min_confidence is {min_confidence}; with map it takes map_confidence"
            )
        check_endings(outputs, ".tif", ".tiff", ".png")
        picture = pictures.read_picture(image)
        lens = lens_of(image, thin_lens)
        check_side(side, lens)
        for source in (image, known_map, map_confidence):
            writing.check_results(
                with_settings(outputs, settings_files.save_settings), force=force, source=source
            )
        found = find_blur(
            picture, settings, measuring.intensity_range, known_map, map_confidence, progress
        )
        trusted = found.trusted(min_confidence)
        distance = napari_defocus.depth_from_blur(trusted, lens, side=side, psf=found.psf)
        facts = lens_facts(lens, thin_lens) | {"side": side}
        made_with = used(found, settings) | facts | {"min_confidence": min_confidence}
        contents = _encoded(outputs, distance, made_with, min_confidence)
        used_settings = napari_defocus.Settings(map=settings)
        contents |= saved_settings(settings_files.save_settings, "depth", used_settings)
        writing.write_results(contents, force=force)
        facts |= file_facts(found) | map_facts(found, min_confidence) | _depth_facts(distance)
        facts |= {"reach_m": _reach(found, lens, side)}
        return picture_facts(image, outputs, found, settings) | facts

    run(measure, _lines, reporting)


def lens_of(image: Path, options: LensOptions) -> ThinLens:
    """Return the lens that is given; what is not, the picture has to note."""
    given = options.given
    if None in given.values():
        return napari_defocus.ThinLens.from_exif(image, **given)
    # Not every picture that is read here can be asked for EXIF.
    return napari_defocus.ThinLens(**cast("dict[str, float]", given))


def check_side(side: Side, lens: ThinLens) -> None:
    """Refuse points beyond a focus at infinity before any long work."""
    if side == "far" and math.isinf(lens.focus_distance_m):
        raise ValueError("side is 'far', but the lens is focused at infinity; it takes 'near'")


def lens_facts(lens: ThinLens, options: LensOptions) -> dict[str, Any]:
    """Return what is told about a lens; JSON has no number for infinity."""
    given = options.given
    values = {name: getattr(lens, name) for name in given}
    facts: dict[str, Any] = {
        name: value if math.isfinite(value) else "inf" for name, value in values.items()
    }
    facts["from_exif"] = [name for name, value in given.items() if value is None]
    return {"thin_lens": facts}


def lens_line(facts: Mapping[str, Any]) -> str:
    """Say what `lens_facts` are."""
    lens = facts["thin_lens"]
    distance = lens["focus_distance_m"]
    parts = {
        "focal_length_mm": f"{lens['focal_length_mm']:g} mm",
        "f_number": f"f/{lens['f_number']:g}",
        "focus_distance_m": f"focused at {'infinity' if distance == 'inf' else f'{distance:g} m'}",
        "pixel_pitch_um": f"pixels of {lens['pixel_pitch_um']:.4g} um",
    }
    noted = lens["from_exif"]
    told = (part + " (EXIF)" * (name in noted) for name, part in parts.items())
    return f"thin lens    {', '.join(told)}"


def side_line(facts: Mapping[str, Any]) -> str:
    """Say which side was assumed."""
    side = facts["side"]
    return f"side         {side}: all blur is assumed to lie {_SIDES[side]} the plane in focus"


def _encoded(
    outputs: list[Path],
    distance: NDArray[Any],
    made_with: Mapping[str, Any],
    min_confidence: float,
) -> dict[Path, bytes]:
    from napari_defocus.io.encoders import depth_png, depth_tiff

    return {
        path: depth_png(distance, min_confidence)
        if path.suffix.lower() == ".png"
        else depth_tiff(distance, made_with)
        for path in outputs
    }


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
    limit = napari_defocus.depth_from_blur(found.psf.max_scale, lens, side=side, psf=found.psf)
    return float(limit) if math.isfinite(limit) else None


def _lines(facts: Mapping[str, Any]) -> Iterator[str]:
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
            "more blurred than any distance can be"
        )
    if facts["reach_m"] is not None:
        comparison = "farther" if facts["side"] == "far" else "nearer"
        yield (
            f"limit        {facts['reach_m']:.4g} m has the largest blur that is looked for; "
            f"what is {comparison} comes out as that"
        )
    yield from last_lines(facts)
