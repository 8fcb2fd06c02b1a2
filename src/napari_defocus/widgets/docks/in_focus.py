"""The widget that segments what is in focus."""

from napari.components import ViewerModel

from napari_defocus.widgets.forms.panel import DefocusPanel


class InFocusWidget(DefocusPanel):
    """Segment what is in focus in an image layer.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, blur_map=False, mask=True, action="Segment in focus")
