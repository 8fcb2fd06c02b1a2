"""The terminal command for masks of what is in focus."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import napari_defocus
from napari_defocus import pipeline
from napari_defocus.cli.command import Facts, command, last_lines
from napari_defocus.cli.description import lines_of, mask_facts, picture_facts
from napari_defocus.cli.option_groups import EvidenceOptions, said_threshold
from napari_defocus.cli.results import Files, beside, check_endings, encoded_masks
from napari_defocus.core.checks import Unknown, check_threshold_or_auto
from napari_defocus.core.extras import need_matting_extra
from napari_defocus.core.progress import Progress
from napari_defocus.core.progress import within as share_of
from napari_defocus.pipeline import label_map, measure_candidates, shares
from napari_defocus.settings import MaskSettings

if TYPE_CHECKING:
    from numpy.typing import NDArray


def _lines(facts: Facts) -> Iterator[str]:
    yield from lines_of(facts)
    if "regions" in facts:
        yield f"regions      {facts['regions']} in focus"
    if facts["seeds"]:
        known = facts["seeds"]
        yield (
            f"seeds        {known['in_focus_px']} px in focus, {known['blurred_px']} px blurred, "
            f"from {known['file']}"
        )
    yield from last_lines(facts)


@command(
    _lines,
    """
    smoothness NUMBER
        Cost of the border of the mask.
    seeds PATH
        A grey picture of integers (.png, .tif) as large as IMAGE: 1 where it is known to be in
        focus, 2 where it is known to be blurred, 0 elsewhere. The mask keeps to it.
    within PATH
        A grey picture of integers (.png, .tif) as large as IMAGE, such as a mask of the tissue or
        labels of cells: only where it is not 0 is anything judged, and counted.
    output -o PATH
        Where to write the mask (.png): white in focus, black not, grey not known. [default:
        NAME-mask.png beside IMAGE, and the overlay too]
    overlay PATH
        Where to write the picture with the rest dimmed (.png). [default: NAME-overlay.png beside
        IMAGE, and the mask too]
    alpha PATH
        Where to write IMAGE with what is blurred transparent (.png): hair and fur have soft edges.
        It needs pymatting.
    regions PATH
        Where to write a table of the regions in focus (.csv): area, place, and how wide their blur
        is and how sure. The map is measured for it, too.
    """,
)
def segment_picture(
    image: Path,
    *,
    threshold: str = str(MaskSettings.threshold),
    unknown: Unknown = MaskSettings.unknown,
    within: Path | None = None,
    measuring: EvidenceOptions,
    smoothness: float = MaskSettings.smoothness,
    color_sigma: float = MaskSettings.color_sigma,
    seeds: Path | None = None,
    output: Path | None = None,
    overlay: Path | None = None,
    alpha: Path | None = None,
    regions: Path | None = None,
    files: Files,
    progress: Progress,
) -> dict[str, Any]:
    """Find what is in focus in IMAGE."""
    if output is None and overlay is None and alpha is None:
        output, overlay = beside(image, "-mask.png", "-overlay.png")
    if alpha is not None:
        need_matting_extra()
    masks, overlays, alphas, tables = (
        [path] if path else [] for path in (output, overlay, alpha, regions)
    )
    outputs = [*masks, *overlays, *alphas, *tables]
    settings, intensity_range = measuring.settings(image), measuring.intensity_range
    mask_settings = MaskSettings(
        threshold=said_threshold(threshold),
        smoothness=smoothness,
        color_sigma=color_sigma,
        unknown=unknown,
    )
    check_threshold_or_auto(mask_settings.threshold, settings.family().max_scale)
    check_endings([*masks, *overlays, *alphas], ".png")
    check_endings(tables, ".csv")
    picture = files.read(image, outputs, seeds, within)
    known = None if seeds is None else _seeds(seeds, picture)
    where = None if within is None else _within(within, picture)
    first, second = shares(progress)
    candidates = measure_candidates(picture, settings, intensity_range, first)
    masked = 0.5 if tables else 1.0
    report = share_of(second, 0.0, masked)
    limits = intensity_range
    used = pipeline.settled_mask(candidates, picture, mask_settings, limits, within=where)
    given: dict[str, Any] = {"seeds": known, "within": where}
    mask = pipeline.segment(candidates, picture, used, limits, **given, progress=report)
    judged = pipeline.judged_mask(candidates, picture, used, limits, mask=mask, **given)
    contents = encoded_masks(masks, overlays, picture, mask, limits)
    if alpha is not None:
        from napari_defocus.io.encoders import alpha_png

        contents[alpha] = alpha_png(picture, napari_defocus.matte_in_focus(picture, mask), limits)
    facts = picture_facts(image, picture, outputs, candidates, settings)
    facts |= mask_facts(mask, judged, mask_settings, used, where)
    facts["within"] = within and str(within)
    facts["seeds"] = None if known is None else {"file": str(seeds)} | _seeds_facts(known)
    if regions:
        third = share_of(second, masked, 1.0)
        found = label_map(candidates, picture, settings, limits, third)
        _, table = napari_defocus.measure_regions(
            mask, found.blur_map, found.confidence, within=where
        )
        contents[regions] = table.as_csv()
        facts["regions"] = len(table) - 1
    files.write(contents, "segment", map=settings, mask=mask_settings)
    return facts


def _seeds(path: Path, picture: NDArray[Any]) -> NDArray[Any]:
    from napari_defocus.io.pictures import read_picture
    from napari_defocus.labeling.seeds import checked_seeds

    return checked_seeds(read_picture(path), picture.shape[:2])


def _within(path: Path, picture: NDArray[Any]) -> NDArray[Any]:
    from napari_defocus.io.pictures import read_picture
    from napari_defocus.labeling.known import checked_within

    return checked_within(read_picture(path), picture.shape[:2])


def _seeds_facts(seeds: NDArray[Any]) -> dict[str, int]:
    from napari_defocus.labeling.seeds import BLURRED, IN_FOCUS

    marks = {"in_focus_px": IN_FOCUS, "blurred_px": BLURRED}
    return {name: int((seeds == mark).sum()) for name, mark in marks.items()}
