"""What the widgets share that make something of an image and its blur map."""

from typing import Any

from magicgui.widgets import ComboBox, Widget
from napari.components import ViewerModel
from napari.layers import Image

from napari_defocus.widgets.forms.image_panel import ImagePanel
from napari_defocus.widgets.forms.settings_form import SettingsForm
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs.job import Job
from napari_defocus.widgets.jobs.map_source import (
    EstimatedSource,
    MapSource,
    may_be_map_of,
    settings_of_map,
    source_of_layer,
)
from napari_defocus.widgets.layers.image_layers import Plane

ESTIMATE = "estimate it"


class MapBox(ComboBox):
    """The choice of a map's layer; None estimates it."""

    null_string = ESTIMATE


class FromMapPanel(ImagePanel):
    """Make something of an image layer and its blur map.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel
        Where the images come from and the results go.
    action : str
        What the run button says.

    Attributes
    ----------
    blur_map : magicgui.widgets.ComboBox
        The layer of the blur map, or none to estimate it.
    settings : SettingsForm
        What it is estimated with, as in the widget of the blur map.
    """

    def __init__(self, napari_viewer: ViewerModel, *, action: str) -> None:
        super().__init__(napari_viewer, action=action)
        self.blur_map = MapBox(
            name="blur_map",
            label="blur map",
            choices=self._maps,
            nullable=True,
            tooltip="How wide the blur is at every pixel: estimated from the picture, or an image "
            "layer of the same height and width that holds its radius in px.",
        )
        self.settings = SettingsForm(blur_map=True, mask=False, last_measured=self._last_measured)

    def _maps(self, _: Any) -> list[Image]:
        image = self.image.value
        if image is None:
            return []
        return [layer for layer in self._viewer.layers if may_be_map_of(layer, image)]

    def _finish_form(self, fields: list[Widget]) -> None:
        """Put fields between those that say where the map comes from, and those few need."""
        settings = self.settings
        fields = [
            *(self.image, self.region, self.blur_map, *settings.lens.fields(), settings.max_radius),
            *fields,
            *(settings.more, *settings.more_fields()),
        ]
        super()._finish_form(fields)
        self.image.changed.connect(lambda _: self.blur_map.reset_choices())
        settings.lens.microscope.attach(self.image)
        self.blur_map.changed.connect(lambda _: self._show_needed())
        self._choose_active()
        self.blur_map.reset_choices()
        self.settings.show_more(False)
        self._show_needed()

    def _show_needed(self) -> None:
        """Hide the fields that a map from a layer does not need."""
        layer = self.blur_map.value
        self.settings.show_needed(
            estimating=layer is None,
            lens=layer is None or settings_of_map(layer) is None,
            more=self._always_needed(),
        )

    def _always_needed(self) -> list[Widget]:
        """Return those of the further settings that are needed with a map from a layer, too."""
        return []

    def source(self, plane: Plane) -> MapSource:
        """Return where the form says that the blur map of a plane comes from.

        Raises
        ------
        ValueError
            If a field holds no valid value, or the chosen layer does not fit the plane.
        """
        layer = self.blur_map.value
        if layer is None:
            return EstimatedSource(settings=self.settings.map_settings())
        known = settings_of_map(layer)
        psf = self.settings.lens.text() if known is None else known.psf
        return source_of_layer(layer, plane, self._viewer, psf)

    def noise_variance(self) -> float | None:
        """Return the noise variance that was typed, None if it is to be found.

        Raises
        ------
        ValueError
            If it is no number.
        """
        settings = self.settings
        if self.blur_map.value is None and settings.shot_noise.value:
            return None
        return settings.given_noise_variance()

    def work(self) -> Job:
        """Return what the form asks for now.

        Raises
        ------
        NotAnalysableError
            If the chosen layer shows no plane that can be analysed.
        ValueError
            If a field holds no valid value, or the map does not fit the plane.
        """
        raise NotImplementedError

    def run(self) -> Run | None:
        """Start the work that the form asks for, and return it; None if it cannot be done."""
        return self._run_job(self.work)
