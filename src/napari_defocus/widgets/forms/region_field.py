"""The choice of what part of a picture is analysed."""

from typing import Any

from magicgui.widgets import ComboBox
from napari.components import ViewerModel
from napari.layers import Labels, Shapes

from napari_defocus.widgets.layers.image_layers import Plane
from napari_defocus.widgets.layers.labels_region import region_of_labels
from napari_defocus.widgets.layers.region import Choice, empty_shapes, plane_in, region_of
from napari_defocus.widgets.layers.result_metadata import made_by_us


class RegionField(ComboBox):
    """All of a picture, what is in view, what shapes enclose, or what labels mark.

    Its choices follow the viewer's layers wherever those of other fields do.
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        self._viewer = napari_viewer
        super().__init__(
            name="region",
            label="region",
            choices=self._regions,
            tooltip="Analyse the whole picture, only what you see of it now, or only what the "
            "shapes of a layer enclose: all of them, or the selected ones if any are selected. "
            "A region is faster, and its results lie where it lies. With labels, such as of tissue "
            "or cells, the whole picture is analysed, and only what has a label is judged.",
        )

    def _regions(self, _: Any) -> list[tuple[str, Choice | Labels]]:
        return [
            ("whole picture", "whole"),
            ("visible field", "visible"),
            *(
                (f"shapes: {layer.name}", layer)
                for layer in self._viewer.layers
                if isinstance(layer, Shapes)
            ),
            *(
                (f"labels: {layer.name}", layer)
                for layer in self._viewer.layers
                if isinstance(layer, Labels) and made_by_us(layer) is None
            ),
        ]

    def uncover(self) -> None:
        """Let the chosen shapes cover nothing of what was measured inside of them."""
        if isinstance(self.value, Shapes):
            empty_shapes(self.value)

    def part_of(self, plane: Plane) -> Plane:
        """Return the part of the shown plane that is chosen, or the plane itself.

        Raises
        ------
        NotAnalysableError
            If the choice holds no part of it, see `region_of` and `region_of_labels`.
        """
        layer = plane.layer()
        if layer is None:
            return plane
        if isinstance(self.value, Labels):
            return plane_in(plane, region_of_labels(plane, self.value, self._viewer.dims))
        return plane_in(plane, region_of(layer, self._viewer, self.value))
