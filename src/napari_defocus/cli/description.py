"""What terminal commands tell of pictures, maps and masks: facts, and lines that say them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from napari_defocus.cli.microscope import (
    defocus_facts,
    defocus_lines,
    microscope_of,
    remarks_on_pixels,
)
from napari_defocus.pipeline import Measurement
from napari_defocus.psf import AUTO
from napari_defocus.settings import CONFIDENT, UNKNOWN, MapSettings, MaskSettings

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from napari_defocus.core.intensity import Intensities
    from napari_defocus.likelihood.candidates import BlurCandidates

_HALF = 50.0
_DISAGREEMENT = (
    "The map says otherwise: where the picture cannot tell, the mask follows colours and outlines."
)


def picture_facts(
    image: Path,
    picture: NDArray[Any],
    outputs: list[Path],
    found: BlurCandidates | Measurement,
    settings: MapSettings,
) -> dict[str, Any]:
    """Return what every command tells about a picture."""
    from napari_defocus.core.picture_remarks import picture_remarks

    variance, intensities = found.noise_variance, found.intensities
    remarks = picture_remarks(picture, settings.window)
    if isinstance(found, Measurement):
        remarks = [*remarks, *remarks_on_pixels(image, found)]
    levels = 255.0 if intensities is None else intensities.grey_levels
    return {
        **file_of_picture(image, found.image_shape),
        "psf": settings.settled(found.psf).psf,
        "psf_choice": found.psf_choice and found.psf_choice.facts(),
        "doubt": found.doubt,
        "picture_remarks": remarks,
        "scale": found.psf.scale_name,
        "camera_softness": settings.camera_softness if settings.mode == "curve" else 0.0,
        "noise_variance": variance,
        "noise_sigma_grey_levels": None if variance is None else levels * variance**0.5,
        "grey_levels": levels,
        **intensity_facts(intensities),
        "noise_growth": found.noise_growth,
        "shot_noise": asdict(found.shot_noise) if found.shot_noise else None,
        "files": [str(path) for path in outputs],
    }


def file_of_picture(image: Path, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return what is told of the file that a picture was read from."""
    from napari_defocus.io.pictures import told_choice_in

    height, width = shape[:2]
    return {"image": str(image), "taken": told_choice_in(image), "width": width, "height": height}


def intensity_facts(intensities: Intensities | None) -> dict[str, Any]:
    """Return what is told about intensities, in words, too; nothing if they are not known."""
    return {} if intensities is None else intensities.facts() | {"intensities": str(intensities)}


def map_facts(found: Measurement, min_confidence: float = 0.0) -> dict[str, Any]:
    """Return what is told about a map."""
    import numpy as np

    low, median, high = np.nanpercentile(found.blur_map, [5, 50, 95])
    facts = {
        "blur_median_px": float(median),
        "blur_p5_px": float(low),
        "blur_p95_px": float(high),
        "left_out_percent": 100.0 * float(np.isnan(found.trusted(min_confidence)).mean()),
    }
    facts |= defocus_facts(microscope_of(found), facts)
    if found.confidence is not None:
        facts["confidence_median"] = float(np.median(found.confidence))
        facts["confident_percent"] = 100.0 * float((found.confidence >= CONFIDENT).mean())
    return facts


def mask_facts(
    mask: NDArray[Any],
    judged: NDArray[Any],
    asked: MaskSettings,
    used: MaskSettings,
    within: NDArray[Any] | None = None,
) -> dict[str, Any]:
    """Return what is told about a mask, and about the same with what is not known left in it.

    `asked` and `used` are its settings before and after the picture said its threshold.
    """
    from napari_defocus.labeling.focus_threshold import threshold_in_px
    from napari_defocus.labeling.known import mask_remarks

    counting = judged if within is None else judged[within]
    known, tau = float((counting != UNKNOWN).mean()), threshold_in_px(used)
    found = tau if asked.threshold == AUTO else None
    share = float((counting == 1).sum() / (counting != UNKNOWN).sum()) if known else None
    shown = mask if within is None else mask[within]
    white, said = int((shown == 1).sum()), int((shown != UNKNOWN).sum())
    remarks = mask_remarks(share, known, unknown=used.unknown, threshold_found=found)
    return {
        "threshold_px": tau,
        "threshold_found": found is not None,
        "in_focus_percent": None if share is None else 100.0 * share,
        "mask_percent": 100.0 * white / said if said else None,
        "known_percent": 100.0 * float((judged != UNKNOWN).mean()),
        "mask_remarks": list(remarks),
    }


def picture_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    """Say what `file_of_picture` are."""
    yield f"picture      {facts['image']}, {facts['width']} x {facts['height']} px"
    if facts["taken"]:
        yield f"taken        {facts['taken']}"


def intensity_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    """Say what `intensity_facts` are."""
    if facts.get("intensities"):
        yield f"intensities  {facts['intensities']}"


def _choice_text(choice: Mapping[str, Any]) -> str:
    return (
        f"{choice['psf']} ({'found from' if choice['found'] else 'cannot be told by'} the picture)"
    )


def _mask_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    found = ", found from the picture" if facts["threshold_found"] else ""
    share, known = facts["in_focus_percent"], facts["known_percent"]
    if share is None:
        yield f"in focus     not known anywhere, blur up to {facts['threshold_px']:.4g} px"
        return
    yield (
        f"in focus     {facts['mask_percent']:.1f} % of the mask, {share:.1f} % of what is known "
        f"({known:.1f} % of the picture); blur up to {facts['threshold_px']:.4g} px{found}"
    )


def lines_of(facts: Mapping[str, Any]) -> Iterator[str]:
    """Say what `picture_facts`, `file_facts`, `map_facts` and `mask_facts` are."""
    yield from picture_lines(facts)
    softness = f"camera softness {facts['camera_softness']:g} px"
    chosen = facts["psf_choice"]
    lens = facts["psf"] if chosen is None else _choice_text(chosen)
    yield f"lens         {lens}, scale: {facts['scale']}; {softness}"
    yield from intensity_lines(facts)
    if facts["noise_variance"] is not None:
        variance, sigma = facts["noise_variance"], facts["noise_sigma_grey_levels"]
        levels = f"{facts['grey_levels']:.6g} grey levels"
        yield f"noise        variance {variance:.2g} (sigma {sigma:.3g} of {levels})"
    if facts.get("noise_growth"):
        times = 1 + facts["noise_growth"]
        yield f"             in the corners {times:.1f} times that of the centre"
    if facts["shot_noise"]:
        read, gain, offset = (
            facts["shot_noise"][key] for key in ("read_variance", "gain", "offset")
        )
        light = f"(intensity - {offset:.3g})" if offset else "intensity"
        yield f"             variance {read:.2g} + {gain:.2g} x {light}"
    if facts.get("map"):
        yield f"map          {facts['map']}"
    # Where nothing is known, a median would look like something that was measured.
    unknown = facts.get("confident_percent") == 0
    if "blur_median_px" in facts:
        low, high = facts["blur_p5_px"], facts["blur_p95_px"]
        yield (
            f"blur         {'not known anywhere; the map says: ' if unknown else ''}"
            f"median {facts['blur_median_px']:.1f} px, "
            f"5 to 95 % of the picture: {low:.1f} to {high:.1f} px"
        )
    if not unknown:
        yield from defocus_lines(facts)
    if "confidence_median" in facts:
        yield (
            f"confidence   median {facts['confidence_median']:.2f}, {CONFIDENT:g} or more on "
            f"{facts['confident_percent']:.1f} % of the picture"
        )
    for remark in filter(None, [*facts.get("picture_remarks", ()), facts.get("doubt")]):
        yield f"careful      {remark}"
    if facts.get("left_out_percent"):
        yield f"left out     {facts['left_out_percent']:.1f} % of the picture"
    if "in_focus_percent" in facts:
        yield from _mask_lines(facts)
        for remark in facts["mask_remarks"]:
            yield f"careful      {remark}"
        yield from _mask_against_map(facts)


def _mask_against_map(facts: Mapping[str, Any]) -> Iterator[str]:
    """Say if the mask covers most of a picture that the map calls blurred, or the other way."""
    if "blur_median_px" not in facts or facts["in_focus_percent"] is None:
        return
    by_map = facts["blur_median_px"] <= facts["threshold_px"]
    by_mask = facts["in_focus_percent"] >= _HALF
    if by_map != by_mask:
        yield "             " + _DISAGREEMENT
