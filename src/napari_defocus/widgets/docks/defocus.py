"""The widget that leads from a picture to its map, its mask, and what is made of them."""

from typing import Any

from magicgui.widgets import PushButton, Widget
from napari.components import ViewerModel
from napari.layers import Image

from napari_defocus.core.checks import Linearize
from napari_defocus.widgets.docks.tools import Tools
from napari_defocus.widgets.forms.defocus_panel import DefocusPanel
from napari_defocus.widgets.forms.depth_form import DepthForm
from napari_defocus.widgets.forms.pages import Pages
from napari_defocus.widgets.forms.restoration_form import RestorationForm
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs.distances import Distances
from napari_defocus.widgets.jobs.job import Job
from napari_defocus.widgets.jobs.large_analysis import is_large
from napari_defocus.widgets.jobs.map_source import (
    EstimatedSource,
    MapSource,
    settings_of_map,
    source_of_layer,
)
from napari_defocus.widgets.jobs.restoration import Restoration
from napari_defocus.widgets.layers.image_layers import Plane
from napari_defocus.widgets.layers.result_metadata import BLUR_MAP, layer_of_result

MAP, MASK, RESTORE, DEPTH, MORE = "Map", "In focus", "Restore", "Depth", "More"

_FIRST_STEPS = "Choose an image and press “Measure”."


class DefocusWidget(DefocusPanel):
    """Measure the blur of a picture, correct what is in focus, take the blur away, tell distances.

    Attributes
    ----------
    pages : Pages
        What can be changed, and done with the map.
    tools : Tools
        What looks at the results, and what keeps them.
    restoration : RestorationForm
    depth : DepthForm
    restore_button, depth_button : magicgui.widgets.PushButton
    """

    SCROLLS = False  # its pages are, so that its buttons stay in sight

    def __init__(self, napari_viewer: ViewerModel) -> None:
        self.pages = Pages()
        self.restoration = RestorationForm()
        self.depth = DepthForm()
        self.restore_button = PushButton(
            name="restore",
            text="Take the blur away",
            tooltip="Add the picture without its blur, as far as the map is sure. A map that is "
            "there already is used.",
        )
        self.depth_button = PushButton(
            name="estimate_depth",
            text="Estimate depth",
            tooltip="Add the distances that the blur stands for, with the lens above.",
        )
        super().__init__(napari_viewer, blur_map=True, mask=True, action="Measure")

    def _fields(self) -> list[Widget]:
        return [self.image, self.region, self.planes, self.keep_in]

    def _finish_form(self, fields: list[Widget]) -> None:
        super()._finish_form(fields)
        self.run_button.tooltip = (
            "Measure the blur: a map of it in px, how sure it is, and what is in focus."
        )
        settings = self.settings
        self.tools = Tools(self)
        self.pages.add(
            MAP,
            "How the blur is measured, and how smooth its map is",
            [
                *settings.lens.fields(),
                *self.comparison.fields(),
                *(settings.max_radius, settings.map_smoothness, settings.map_color_sigma),
                *(settings.confidence, settings.min_confidence),
            ],
        )
        self.pages.add(
            MASK,
            "What counts as in focus, and where you know better",
            [
                *(settings.threshold, settings.threshold_fields.found),
                *(settings.mask_smoothness, settings.mask_color_sigma, settings.leave_unknown),
                *(self.seeds, self.seeds_button, self.tools.regions, self.tools.opacity),
            ],
        )
        self.pages.add(
            RESTORE, "The picture without blur", [*self.restoration.fields(), self.restore_button]
        )
        self.pages.add(DEPTH, "From blur to distance", [*self.depth.fields(), self.depth_button])
        self.pages.add(
            MORE,
            "What few people need",
            [
                *(settings.noise_variance, settings.shot_noise),
                *(settings.camera_softness, settings.linear_light),
                *(self.live, self.keep_earlier),
                *(self.tools.load_settings, self.tools.save_settings),
            ],
        )
        self.rows.addWidget(self.pages.native)
        self.rows.addWidget(self.tools.native)
        self.rows.addStretch(1)
        self.status.value = _FIRST_STEPS

    def _wire(self) -> None:
        super()._wire()
        self.settings.show_more(True)
        self.restore_button.clicked.connect(self.restore)
        self.depth_button.clicked.connect(self.estimate_depth)
        self.depth.attach(self)
        self.image.changed.connect(lambda layer: self._on_image(layer))
        self._on_image(self.image.value)

    def _on_image(self, layer: Image | None) -> None:
        self.planes.visible = layer is not None and layer.ndim > 2
        self.tools.refresh()

    def reset_choices(self, *_: Any) -> None:
        """Look for the viewer's layers again, on all pages."""
        super().reset_choices()
        self.pages.reset_choices()
        self.tools.refresh()

    def _on_shown(self) -> None:
        self.tools.refresh_probe()

    def add_seeds(self) -> Any:
        """Add a layer for seeds, see `DefocusPanel.add_seeds`, and show what goes with it."""
        self.pages.show(MASK)
        return super().add_seeds()

    def restore(self) -> Run | None:
        """Start to take the blur away, and return the run; None if it cannot be done."""
        return self._run_job(self._restoration, self.restore_button.text)

    def estimate_depth(self) -> Run | None:
        """Start to tell distances, and return the run; None if it cannot be done."""
        return self._run_job(self._distances, self.depth_button.text)

    def _distances(self) -> Distances:
        plane = self.shown_plane()
        return self.depth.distances(plane, self._source(plane))

    def _restoration(self) -> Restoration:
        settings, plane = self.settings, self.shown_plane()
        noise = None if settings.shot_noise.value else settings.given_noise_variance()
        linearize: Linearize | None = "srgb" if settings.linear_light.value else None
        return self.restoration.restoration(plane, self._source(plane), noise, linearize)

    def _source(self, plane: Plane) -> MapSource:
        """Return where the map comes from: of a large plane, the one that was measured."""
        settings = self.settings.map_settings()
        layer = layer_of_result(self._viewer.layers, BLUR_MAP, plane.name)
        if is_large(plane) and isinstance(layer, Image) and settings_of_map(layer) == settings:
            return source_of_layer(layer, plane, self._viewer, settings.psf)
        return EstimatedSource(settings=settings)

    def _start_job(self, job: Job, action: str = "") -> Run:
        self._live_labels.stop()
        return super()._start_job(job, action)
