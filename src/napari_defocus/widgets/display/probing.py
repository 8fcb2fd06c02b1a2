"""What is known at one place of the picture.

No Qt here, as in `layers`.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image, Layer
from numpy.typing import NDArray

from napari_defocus.widgets.jobs.estimation import Analysed, JobCache
from napari_defocus.widgets.layers.image_layers import corner, picture_axes, unwrapped
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    IN_FOCUS,
    METADATA_KEY,
    STORE,
    layer_of_result,
    pictures_in,
    results_of,
)

if TYPE_CHECKING:
    from napari_defocus import PixelExplanation

_NOT_KEPT = (
    "This picture was measured part by part, and what led to its map was not kept. Measure a "
    "region of it, such as the visible field, to have that explained."
)
_OUTSIDE = "This place is outside of the picture."
_OUTSIDE_OF_PART = (
    "This place is outside of the {part}, which was measured last. To explain it, measure the "
    "whole picture again."
)


class NothingKnownError(ValueError):
    """Nothing is known at that place; the message says why."""


class OutsideError(NothingKnownError):
    """The place is outside of what was measured."""


@dataclass(frozen=True, eq=False)
class Probed:
    """What is known at a place.

    Attributes
    ----------
    explanation : PixelExplanation
    image : napari.layers.Image
    corners : (4, D) float64 ndarray
        Of the analysed window, in the layer's data coordinates.
    """

    explanation: "PixelExplanation"
    image: Image
    corners: NDArray[np.floating]


def probed(
    viewer: ViewerModel, layer: Image | None, position: tuple[float, ...], cache: JobCache
) -> Probed:
    """Tell what is known of an image layer at a place in the world; nothing is estimated for it.

    Raises
    ------
    NothingKnownError
        If there is no image, nothing was analysed or another plane, the picture was exchanged
        since, or the place is outside of it.
    """
    from napari_defocus import explain_pixel

    known = _known(viewer, layer, cache)
    image, plane, candidates = unwrapped(layer), known.picture.plane, known.candidates
    try:
        row, column = pixel_at(image, plane.index, candidates.image_shape, position)
    except OutsideError:
        if not plane.region:
            raise
        raise NothingKnownError(_OUTSIDE_OF_PART.format(part=plane.region)) from None
    found = known.blur_map
    explanation = explain_pixel(
        candidates,
        row,
        column,
        blur_map=None if found is None else found.values,
        confidence=None if found is None else found.confidence,
        image=known.picture.image,
    )
    corners = corners_of(explanation.window, plane.index, candidates.image_shape)
    return Probed(explanation, image, corners)


def _known(viewer: ViewerModel, layer: Image | None, cache: JobCache) -> Analysed:
    if layer is None:
        raise NothingKnownError("There is no image. Open one and measure it first.")
    known = cache.analysed.latest(unwrapped(layer))
    if known is None:
        of_layer = (results_of(viewer.layers, name, layer.name) for name in (BLUR_MAP, IN_FOCUS))
        if any(STORE in result.metadata[METADATA_KEY] for found in of_layer for result in found):
            raise NothingKnownError(_NOT_KEPT)
        raise NothingKnownError("Nothing is known here yet: measure the picture first.")
    if not known.picture.plane.is_current(viewer.layers):
        raise NothingKnownError("The picture was changed since it was measured: measure it again.")
    if viewer.dims.ndisplay != 2:
        raise NothingKnownError("The viewer shows a volume: switch it to 2-D.")
    return known


def pixel_at(
    layer: Image,
    index: tuple[int | slice, ...],
    shape: tuple[int, int],
    position: tuple[float, ...],
) -> tuple[int, int]:
    """Return the row and the column of a plane's pixel at world coordinates.

    Those of the last axes count, if the layer has fewer. The index picks the plane out of the
    layer's data, and the shape is its height and width.

    Raises
    ------
    NothingKnownError
        If they are on another plane or outside of this one.
    """
    at = np.asarray(layer.world_to_data(position))
    if not np.isfinite(at).all():
        raise OutsideError(_OUTSIDE)
    nearest = np.floor(at + 0.5).astype(int)
    if any(isinstance(i, int) and i != k for i, k in zip(index, nearest, strict=True)):
        measured = ", ".join(str(i) for i in index if isinstance(i, int))
        raise NothingKnownError(f"This plane was not measured; plane {measured} was.")
    row, column = (nearest - corner(index))[picture_axes(index)]
    if not (0 <= row < shape[0] and 0 <= column < shape[1]):
        raise OutsideError(_OUTSIDE)
    return int(row), int(column)


def corners_of(
    window: tuple[float, float, float, float],
    index: tuple[int | slice, ...],
    shape: tuple[int, int],
) -> NDArray[np.floating]:
    """Return the corners of a window of a plane in its layer's data coordinates: (4, D).

    Not beyond the centres of the plane's outer pixels: a layer that reaches farther than all
    others would change the range of the viewer's sliders.
    """
    height, width = shape
    top, left, bottom, right = np.clip(window, 0, [height - 1, width - 1] * 2)
    corners = np.tile(np.array(corner(index), float), (4, 1))
    corners[:, picture_axes(index)] += [(top, left), (top, right), (bottom, right), (bottom, left)]
    return corners


def image_of(layers: Any, layer: Layer | None) -> Image | None:
    """Return the image layer that a layer is or is a result of; None if there is none."""
    if layer is None:
        return None
    if pictures_in([layer]):
        return layer
    made = layer.metadata.get(METADATA_KEY, {})
    source = made.get("source") if isinstance(made, dict) else None
    return next((image for image in pictures_in(layers) if image.name == source), None)


def image_to_probe(viewer: ViewerModel, cache: JobCache) -> Image | None:
    """Return the image layer to begin with: one that was analysed, rather the active one."""
    active = image_of(viewer.layers, viewer.layers.selection.active)
    # The active one last, so that it is taken if several will do.
    ordered = sorted(pictures_in(viewer.layers), key=lambda image: image is active)
    known = [image for image in ordered if cache.analysed.latest(unwrapped(image)) is not None]
    return (known or ordered or [None])[-1]


def lay_down_tools(viewer: ViewerModel, image: Image | None) -> None:
    """Let the brush of the active layer rest, and select the map of an image, else the image."""
    active = viewer.layers.selection.active
    if active is None or str(active.mode) == "pan_zoom":
        return
    active.mode = "pan_zoom"
    if image is None or image not in viewer.layers:
        return
    results = (layer_of_result(viewer.layers, name, image.name) for name in (BLUR_MAP, IN_FOCUS))
    viewer.layers.selection.active = next((layer for layer in results if layer is not None), image)


def may_pin(viewer: ViewerModel) -> bool:
    """Tell whether a click means nothing else: no brush and no other tool is at work."""
    active = viewer.layers.selection.active
    return active is None or str(active.mode) == "pan_zoom"
