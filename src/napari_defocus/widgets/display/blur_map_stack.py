"""A stack of blur maps in a viewer, as its focus curve needs it: no Qt, any thread.

The planes of a stack lie along some of its axes, "its sliders": those that were not displayed
when it was analysed, or all but the last two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from napari.components import Dims, ViewerModel
from napari.layers import Image, Labels, Layer

from napari_defocus.core.progress import Progress, silent
from napari_defocus.widgets.layers.image_layers import finest, shown_position
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    IN_FOCUS,
    METADATA_KEY,
    PLANES,
    layer_of_result,
    made_by_us,
    region_of_result,
)

if TYPE_CHECKING:
    from napari_defocus import FocusCurve


@dataclass(frozen=True, eq=False, kw_only=True)
class BlurMapStack:
    """Blur maps of all planes, and what goes with them; nothing is read yet.

    Attributes
    ----------
    maps : (..., H, W) array
        In px; numpy, dask or alike.
    masks : (..., H, W) array or None
        Not 0 in focus.
    confidence : (..., H, W) array or None
    threshold : float
        In px: up to which radius a pixel is in focus, if there are no masks.
    """

    maps: Any
    masks: Any
    confidence: Any
    threshold: float

    @classmethod
    def of(
        cls, layer: Image, mask: Labels | None, confidence: Image | None, threshold: float
    ) -> BlurMapStack:
        """Return what layers of one shape hold, with the axes of the planes first."""
        axes = sliders_of(layer)
        stacks = (
            None if found is None else _planes_first(finest(found), axes)
            for found in (layer, mask, confidence)
        )
        maps, masks, sure = stacks
        return cls(maps=maps, masks=masks, confidence=sure, threshold=threshold)

    def curve(self, progress: Progress = silent) -> FocusCurve:
        """Read the stack, plane by plane, and return its focus curve."""
        from napari_defocus import focus_curve

        return focus_curve(
            self.maps,
            in_focus=self.masks,
            confidence=self.confidence,
            threshold=self.threshold,
            progress=progress,
        )


def _planes_first(data: Any, axes: tuple[int, ...]) -> Any:
    first = tuple(range(len(axes)))
    return data if axes == first else np.moveaxis(data, axes, first)


def may_have_curve(layer: Layer) -> bool:
    """Tell whether a layer is a stack that may hold blur maps."""
    if not isinstance(layer, Image) or layer.rgb or layer.ndim < 3:
        return False
    return made_by_us(layer) in (None, BLUR_MAP) and np.dtype(layer.dtype).kind == "f"


def sliders_of(layer: Image) -> tuple[int, ...]:
    """Return along which axes of a stack its planes lie."""
    made = layer.metadata[METADATA_KEY] if made_by_us(layer) == BLUR_MAP else {}
    axes = tuple(made.get(PLANES, {}).get("axes", ()))
    return axes if len(axes) == layer.ndim - 2 else tuple(range(layer.ndim - 2))


def slider_names(layer: Image) -> list[str]:
    """Return what the axes are called that the planes of a stack lie along."""
    return [str(layer.axis_labels[axis]) for axis in sliders_of(layer)]


def mask_of(viewer: ViewerModel, layer: Image) -> Labels | None:
    """Return the layer with the in-focus masks that were made along with blur maps, if any."""
    return _made_along_with(viewer, layer, IN_FOCUS)


def confidence_of(viewer: ViewerModel, layer: Image) -> Image | None:
    """Return the layer with the confidence that was made along with blur maps, if any."""
    return _made_along_with(viewer, layer, CONFIDENCE)


def _made_along_with(viewer: ViewerModel, layer: Image, result: str) -> Any:
    if made_by_us(layer) != BLUR_MAP:
        return None
    source, region = layer.metadata[METADATA_KEY].get("source"), region_of_result(layer)
    found = layer_of_result(viewer.layers, result, source, region)
    return found if found is not None and _same_shape(found, layer) else None


def _same_shape(layer: Layer, other: Layer) -> bool:
    return bool(tuple(finest(layer).shape) == tuple(finest(other).shape))


def may_be_mask_of(layer: Layer, maps: Image | None) -> bool:
    """Tell whether a layer may say what is in focus in a stack of blur maps."""
    return isinstance(layer, Labels) and maps is not None and _same_shape(layer, maps)


def shown_planes(layer: Image, dims: Dims) -> tuple[int, ...]:
    """Return where the sliders of a viewer stand in a stack, each at the nearest plane."""
    at = shown_position(layer, dims)
    return tuple(
        int(np.clip(at[axis], 0, finest(layer).shape[axis] - 1)) for axis in sliders_of(layer)
    )


def curve_along(curve: FocusCurve, layer: Image, dims: Dims, slider: int) -> FocusCurve | None:
    """Return the part of a stack's curve along one of `sliders_of`, where the others stand.

    It has one axis; it is None if the stack has got another shape since.
    """
    from napari_defocus import FocusCurve

    if curve.share_in_focus.shape != tuple(finest(layer).shape[n] for n in sliders_of(layer)):
        return None
    at: list[int | slice] = list(shown_planes(layer, dims))
    at[slider] = slice(None)
    parts: dict[str, Any] = {
        name: None if values is None else values[tuple(at)] for name, values in vars(curve).items()
    }
    return FocusCurve(**parts)
