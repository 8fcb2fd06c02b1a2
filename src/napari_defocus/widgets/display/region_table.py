"""Regions in focus as a labels layer whose features are their table.

napari shows the row under the cursor, and all rows in its own features table. No Qt here, as in
`layers`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image, Labels, Layer
from napari.types import LayerDataTuple
from napari.utils.notifications import show_info, show_warning
from numpy.typing import NDArray

from napari_defocus.core.progress import Progress, silent
from napari_defocus.labeling.regions import RegionTable, measure_focus, measure_regions
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.layers.image_layers import (
    NotAnalysableError,
    Plane,
    check_pixels,
    finest,
    picture_axes,
    shown_index,
    shown_plane,
)
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    IN_FOCUS,
    METADATA_KEY,
    layer_of_result,
    region_of_result,
    result_layer,
)

Measured = tuple[NDArray[np.int32], RegionTable, RegionTable]

REGIONS = "regions"
OPACITY = 0.5

NO_MASK = (
    "“{name}” has no in-focus mask here whose regions could be measured. "
    "Press “Measure” in the dock “Measure defocus” first."
)
TABLE_HINT = "Their table is in the menu Layers > Metadata > Features table widget."


def add_regions(viewer: ViewerModel, image: Image) -> Labels | None:
    """Measure the regions in focus of the plane of an image that a viewer shows, and add them.

    The mask, the blur map and its confidence are those that our widgets have made of the image.
    Without a map the table has no radii, without a confidence it does not say how sure they are:
    a message says so. The mask itself gets a table of two rows: blurred, and in focus. Without a
    mask, a message says that, and nothing is added.
    """
    wanted = wanted_regions(viewer, image)
    if wanted is None:
        return None
    measured = wanted.measured()
    show_info(f"{wanted.description(measured)} {TABLE_HINT}")
    return wanted.show(viewer, measured)


@dataclass(frozen=True, eq=False)
class WantedRegions:
    """Regions that are wanted of a plane, see `add_regions`; measured in any thread.

    Attributes
    ----------
    plane : Plane
    mask_layer : napari.layers.Layer
    mask : (H, W) array
        Of numpy, or of dask, read when it is measured.
    maps : dict
        The blur map and the confidence by their names, alike; None where there is none.
    """

    plane: Plane
    mask_layer: Layer
    mask: Any
    maps: dict[str, Any]

    def measured(self, progress: Progress = silent) -> Measured:
        """Return the labels, the table of the regions, and that of the mask."""
        progress("Measuring regions", 0.0)
        mask = np.asarray(self.mask)
        maps = {name: None if m is None else np.asarray(m) for name, m in self.maps.items()}
        measures: dict[str, Any] = {"blur_map": maps[BLUR_MAP], "confidence": maps[CONFIDENCE]}
        measures |= _pixels(self.plane)
        return *measure_regions(mask, **measures), measure_focus(mask, **measures)

    def show(self, viewer: ViewerModel, measured: Measured) -> Labels:
        """Add what was measured to a viewer, or renew it."""
        labels, table, of_mask = measured
        if finest(self.mask_layer).size == self.mask.size:
            self.mask_layer.features = _features(of_mask)
        made = regions_layer(self.plane, labels, table, self.mask_layer)
        [layer] = add_results(viewer, [made])
        # Those of an earlier run are not updated by `add_results`.
        layer.features = _features(table)
        return layer

    def description(self, measured: Measured) -> str:
        """Return what there is to say about it in words."""
        counted = _counted(measured[1], region_of_result(self.mask_layer))
        return " ".join([counted, *_missing(self.plane.name, self.maps)])


def wanted_regions(
    viewer: ViewerModel, image: Image, plane: Plane | None = None
) -> WantedRegions | None:
    """Return what `add_regions` measures; None, and a message, if there is no mask.

    With a `plane`, such as a part of the one that is shown, the results of that.
    """
    try:
        plane = plane or shown_plane(image, viewer.dims)
    except NotAnalysableError as reason:
        show_warning(f"Cannot measure the regions of “{image.name}”: {reason}")
        return None
    mask_layer, mask = shown_result(viewer, plane, IN_FOCUS)
    if mask_layer is None or mask is None:
        show_warning(NO_MASK.format(name=plane.name))
        return None
    try:
        check_pixels(plane.shape)
    except NotAnalysableError as reason:
        show_warning(f"Cannot measure the regions of “{image.name}”: {reason}")
        return None
    maps = {name: shown_result(viewer, plane, name)[1] for name in (BLUR_MAP, CONFIDENCE)}
    return WantedRegions(plane, mask_layer, mask, maps)


def regions_layer(
    plane: Plane, labels: NDArray[np.int32], table: RegionTable, mask: Layer
) -> LayerDataTuple:
    """Return regions in focus as a labels layer that lies on the plane that the mask was made from.

    The table's columns become the features: row n is that of label n.
    """
    settings = mask.metadata[METADATA_KEY].get("settings", {})
    return result_layer(
        *(plane, REGIONS, labels, settings, {"mask": mask.name}),
        kind="labels",
        opacity=OPACITY,
        features=_features(table),
    )


def _features(table: RegionTable) -> dict[str, Any]:
    """Return the columns but for the number of the region, which napari writes before each row."""
    return {name: column for name, column in table.columns.items() if name != "index"}


def shown_result(viewer: ViewerModel, plane: Plane, result: str) -> tuple[Layer | None, Any]:
    """Return the layer of a result of an image, and its values on the plane; None if missing."""
    layer = layer_of_result(viewer.layers, result, plane.name, plane.region)
    if layer is None:
        return None, None
    data = finest(layer)
    try:
        values = data[shown_index(layer, viewer.dims, data.shape)]
    except NotAnalysableError:
        return layer, None
    return layer, values if values.shape == plane.shape else None


def _pixels(plane: Plane) -> dict[str, Any]:
    """Return the size of a pixel, and its unit; nothing if units are no lengths."""
    across = picture_axes(plane.index)
    units = [plane.placement["units"][axis] for axis in across]
    if not all(unit.is_compatible_with("meter") for unit in units):
        return {}
    sides = [
        abs(float((plane.placement["scale"][axis] * unit).to(units[-1]).magnitude))
        for axis, unit in zip(across, units, strict=True)
    ]
    return {"pixel_size": sides, "unit": f"{units[-1]:~}"}


def _counted(table: RegionTable, part: str) -> str:
    count = len(table) - 1
    if not count:
        return "Nothing is in focus."
    share = table.columns["share_percent"][1]
    whole = "part" if part else "picture"
    regions = "1 region is" if count == 1 else f"{count} regions are"
    return f"{regions} in focus; the largest is {share:.1f} % of the {whole}."


def _missing(name: str, maps: dict[str, Any]) -> list[str]:
    if maps[BLUR_MAP] is None:
        return [f"It has no radii: measure “{name}” first to have them."]
    if maps[CONFIDENCE] is None:
        return [f"It does not say how sure it is: “{name}” has no confidence layer."]
    return []
