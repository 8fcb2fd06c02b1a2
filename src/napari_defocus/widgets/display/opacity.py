"""The opacity of what is in focus, from its mask, as a layer of its own: no Qt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image, Layer
from napari.types import LayerDataTuple
from napari.utils.notifications import show_warning
from numpy.typing import NDArray

from napari_defocus.core.extras import need_matting_extra
from napari_defocus.core.progress import Progress, silent
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.display.region_table import shown_result
from napari_defocus.widgets.jobs.estimation import Picture
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, Plane, shown_plane
from napari_defocus.widgets.layers.result_layers import CONFIDENCE_COLOR_MAP
from napari_defocus.widgets.layers.result_metadata import IN_FOCUS, METADATA_KEY, result_layer

OPACITY = "opacity in focus"


@dataclass(frozen=True, eq=False)
class WantedOpacity:
    """What is made soft: a plane, and its mask."""

    plane: Plane
    mask_layer: Layer
    mask: NDArray[np.uint8]

    def made(self, progress: Progress = silent) -> LayerDataTuple:
        """Return the opacity as an image layer that lies on the plane."""
        from napari_defocus import matte_in_focus

        picture = Picture.of(self.plane)
        alpha = picture.call(matte_in_focus, picture.image, self.mask, progress=progress)
        settings = self.mask_layer.metadata[METADATA_KEY].get("settings", {})
        return result_layer(
            *(self.plane, OPACITY, alpha, settings, {"mask": self.mask_layer.name}),
            colormap=CONFIDENCE_COLOR_MAP,
            contrast_limits=(0.0, 1.0),
        )

    def add(self, viewer: ViewerModel, made: LayerDataTuple) -> Layer:
        """Add it to a viewer, or renew it."""
        return add_results(viewer, [made])[0]


def wanted_opacity(viewer: ViewerModel, image: Image) -> WantedOpacity | None:
    """Return what is to be made soft; None, and a message, if there is no mask or no PyMatting."""
    try:
        need_matting_extra()
        plane = shown_plane(image, viewer.dims)
    except (ImportError, NotAnalysableError) as reason:
        show_warning(f"Cannot find the opacity of “{image.name}”: {reason}")
        return None
    mask_layer, mask = shown_result(viewer, plane, IN_FOCUS)
    if mask_layer is None or mask is None or mask.shape != plane.shape:
        show_warning(
            f"“{plane.name}” has no in-focus mask of the whole plane shown. Measure it first."
        )
        return None
    return WantedOpacity(plane, mask_layer, np.asarray(mask, np.uint8))
