"""The widget that turns blur into distance."""

from napari.components import ViewerModel

from napari_defocus.widgets.forms.depth_form import DepthForm
from napari_defocus.widgets.forms.from_map_panel import FromMapPanel
from napari_defocus.widgets.jobs.distances import Distances


class DepthWidget(FromMapPanel):
    """Turn the blur of a picture into distances, for a lens that is known.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel

    Attributes
    ----------
    depth : DepthForm
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, action="Estimate depth")
        self.depth = DepthForm()
        self._finish_form(
            [
                *self._map_fields(),
                *self.depth.fields(),
                self.settings.more,
                *self.settings.more_fields(),
            ]
        )
        self.depth.wrap_note()
        self.depth.thin_lens.read_button.clicked.connect(lambda _: self.read_lens())
        self.image.changed.connect(lambda layer: self.depth.offer_file(layer))
        self.depth.offer_file(self.image.value)

    def read_lens(self) -> None:
        """Fill in what the photograph's file notes about its lens."""
        description = self.depth.read_lens(self._shown_plane)
        if description is not None:
            self.status.value = description

    def work(self) -> Distances:
        """Return what the form asks for now, see `FromMapPanel.work`."""
        plane = self._shown_plane()
        return self.depth.distances(plane, self.source(plane))
