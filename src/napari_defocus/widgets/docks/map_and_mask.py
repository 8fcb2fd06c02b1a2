"""The widget that does both in one go."""

from napari.components import ViewerModel

from napari_defocus.widgets.forms.panel import DefocusPanel


class MapAndMaskWidget(DefocusPanel):
    """Estimate the blur map of an image layer and segment what is in focus.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, blur_map=True, mask=True, action="Estimate and segment")
