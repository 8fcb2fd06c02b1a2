"""The widget that takes the blur away."""

from magicgui.widgets import Widget
from napari.components import ViewerModel

from napari_defocus.widgets.forms.from_map_panel import FromMapPanel
from napari_defocus.widgets.forms.restoration_form import RestorationForm
from napari_defocus.widgets.jobs.restoration import Restoration


class AllInFocusWidget(FromMapPanel):
    """Take the blur away wherever it is known, so that all is in focus.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel

    Attributes
    ----------
    restoration : RestorationForm
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, action="Make all in focus")
        self.restoration = RestorationForm()
        settings = self.settings
        self._finish_form(
            [
                *self._map_fields(),
                *self.restoration.fields(),
                settings.more,
                *settings.more_fields(),
            ]
        )

    def _always_needed(self) -> list[Widget]:
        return [self.settings.noise_variance, self.settings.linear_light]

    def work(self) -> Restoration:
        """Return what the form asks for now, see `FromMapPanel.work`."""
        plane = self._shown_plane()
        return Restoration(
            plane=plane,
            source=self.source(plane),
            settings=self.restoration.settings(self.noise_variance()),
            linearize="srgb" if self.settings.linear_light.value else None,
            protect=self.restoration.protect.value,
        )
