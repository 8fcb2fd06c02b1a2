"""What there is to say about a map and a mask that were made: no Qt."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.labeling.known import mask_remarks
from napari_defocus.settings import CONFIDENT, UNKNOWN
from napari_defocus.widgets.jobs.estimation import Picture
from napari_defocus.widgets.layers.image_layers import Plane
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    DEFOCUS,
    IN_FOCUS,
    METADATA_KEY,
    REGION,
    THRESHOLD_FOUND,
    confidence_description,
    noise_description,
)

_LOOKED_AT = 200_000
"""Pixels, spread over the picture, that are counted: the window waits meanwhile."""


def summary_of(
    results: list[LayerDataTuple], confidence: NDArray[np.floating] | None, picture: Picture
) -> str:
    """Return a few lines: what makes the map say little, what was found, and how sure it is."""
    made = results[-1][1]["metadata"][METADATA_KEY]
    lines = [*picture.remarks]
    # What is seen in the picture explains the doubt, too.
    said = ("lens",) if lines else ("doubt", "lens")
    lines += [made[name] for name in said if name in made]
    if REGION in made:
        lines.append(f"Measured: {made[REGION]['of']}")
    share = None if confidence is None else _share_sure(confidence, picture.plane.inside)
    if share != 0:
        lines += _found_lines(results, picture.plane, confidence)
    if share == 0:
        lines.append("Nothing can be known here: it has no texture that tells of blur.")
    elif share is not None:
        lines.append(confidence_description(share))
    given, found = made["settings"]["noise_variance"], [made["noise_variance"]]
    lines.append(noise_description(given, found, made.get("noise_growth", 0.0)))
    return "\n".join(lines)


def _result(layer: LayerDataTuple) -> Any:
    return layer[1]["metadata"][METADATA_KEY]["result"]


def _is_of(layer: LayerDataTuple, plane: Plane) -> bool:
    """Return whether a layer has the pixels of a plane, and not of a stack."""
    return bool(np.size(layer[0]) == np.prod(plane.shape))


def _share_sure(confidence: NDArray[np.floating], inside: NDArray[np.bool_] | None) -> float:
    """Return the share of the pixels that count, as far as the confidence is of them alone."""
    sure = confidence >= CONFIDENT
    return float((sure if inside is None or inside.shape != sure.shape else sure[inside]).mean())


def _found_lines(
    results: list[LayerDataTuple], plane: Plane, confidence: NDArray[np.floating] | None
) -> Iterator[str]:
    """Say how wide the blur is where it counts, and how much is in focus."""
    layer_of = {_result(layer): layer for layer in results}
    of_plane = {name: layer for name, layer in layer_of.items() if _is_of(layer, plane)}
    if BLUR_MAP not in of_plane:
        return
    step = math.ceil(math.sqrt(np.prod(plane.shape) / _LOOKED_AT))
    some = {name: layer[0].reshape(plane.shape)[::step, ::step] for name, layer in of_plane.items()}
    judged = np.isfinite(some[BLUR_MAP])
    if plane.inside is not None:
        judged &= plane.inside[::step, ::step]
    if not judged.any():
        return
    low, median, high = np.percentile(some[BLUR_MAP][judged], [5, 50, 95])
    yield f"Blur: median {median:.1f} px (5 to 95 %: {low:.1f} to {high:.1f} px)"
    if DEFOCUS in some:
        yield _defocus_line(some[DEFOCUS][judged], of_plane[DEFOCUS][1])
    if IN_FOCUS in some:
        known = some[IN_FOCUS][judged] != UNKNOWN
        if confidence is not None and confidence.size == np.prod(plane.shape):
            of_some = confidence.reshape(plane.shape)[::step, ::step]
            known &= of_some[judged] >= CONFIDENT
        yield from _focus_lines(some[IN_FOCUS][judged], known, of_plane[IN_FOCUS][1], plane)


def _focus_lines(
    mask: NDArray[np.integer], known: NDArray[np.bool_], keywords: dict[str, Any], plane: Plane
) -> Iterator[str]:
    """Say how much is in focus, of what is known, and why that may be less than it seems."""
    said = mask != UNKNOWN
    if not said.any():
        return
    made = keywords["metadata"][METADATA_KEY]
    threshold, unknown = (made["settings"][name] for name in ("threshold", "unknown"))
    whole = "the part" if plane.is_part or plane.inside is not None else "the picture"
    of = whole if said.all() else "what is known"
    share = float((mask[said] == 1).mean())
    yield f"In focus: {share:.0%} of {of} (blur up to {threshold:g} px)"
    found = threshold if made.get(THRESHOLD_FOUND) else None
    yield from mask_remarks(share, float(known.mean()), unknown=unknown, threshold_found=found)


def _defocus_line(defocus: NDArray[np.floating], keywords: dict[str, Any]) -> str:
    """Return the defocus of a picture in a line, and what one picture cannot tell of it."""
    low, median, high = np.nanpercentile(defocus, [5, 50, 95])
    side = keywords["metadata"][METADATA_KEY]["side"]
    return f"Defocus {median:.3g} µm (5 to 95 %: {low:.3g} to {high:.3g} µm), {side}"
