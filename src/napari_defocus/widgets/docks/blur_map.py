"""The widget that estimates a blur map."""

from napari.components import ViewerModel

from napari_defocus.widgets.forms.panel import DefocusPanel


class BlurMapWidget(DefocusPanel):
    """Estimate how wide the blur is at every pixel of an image layer.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, blur_map=True, mask=False, action="Estimate blur map")
