"""Widgets that do one step each: `viewer.window.add_dock_widget(BlurMapWidget(viewer))`.

The menus do not name them, as the Defocus widget does what they do.
"""

from magicgui.widgets import Widget
from napari.components import ViewerModel

from napari_defocus.core.checks import Linearize
from napari_defocus.widgets.forms.defocus_panel import DefocusPanel
from napari_defocus.widgets.forms.depth_form import DepthForm
from napari_defocus.widgets.forms.from_map_panel import FromMapPanel
from napari_defocus.widgets.forms.restoration_form import RestorationForm
from napari_defocus.widgets.jobs.distances import Distances
from napari_defocus.widgets.jobs.restoration import Restoration


class BlurMapWidget(DefocusPanel):
    """Estimate how wide the blur is at every pixel of an image layer."""

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, blur_map=True, mask=False, action="Estimate blur map")


class InFocusWidget(DefocusPanel):
    """Segment what is in focus in an image layer."""

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, blur_map=False, mask=True, action="Segment in focus")


class MapAndMaskWidget(DefocusPanel):
    """Estimate the blur map of an image layer and segment what is in focus."""

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, blur_map=True, mask=True, action="Estimate and segment")


class AllInFocusWidget(FromMapPanel):
    """Take the blur away wherever it is known, so that all is in focus."""

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, action="Make all in focus")
        self.restoration = RestorationForm()
        self._finish_form(self.restoration.fields())

    def _always_needed(self) -> list[Widget]:
        return [self.settings.noise_variance, self.settings.linear_light]

    def work(self) -> Restoration:
        """Return what the form asks for now, see `FromMapPanel.work`."""
        plane = self.shown_plane()
        linearize: Linearize | None = "srgb" if self.settings.linear_light.value else None
        return self.restoration.restoration(
            plane, self.source(plane), self.noise_variance(), linearize
        )


class DepthWidget(FromMapPanel):
    """Turn the blur of a picture into distances, for a lens that is known."""

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, action="Estimate depth")
        self.depth = DepthForm()
        self._finish_form(self.depth.fields())
        self.depth.attach(self)

    def work(self) -> Distances:
        """Return what the form asks for now, see `FromMapPanel.work`."""
        plane = self.shown_plane()
        return self.depth.distances(plane, self.source(plane))
