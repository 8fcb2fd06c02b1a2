"""The widget that leads from a picture to its map, its mask, and what is made of them."""

from typing import Any

from magicgui.widgets import ComboBox, PushButton, Widget
from napari.components import ViewerModel
from napari.layers import Image, Layer

from napari_defocus.core.checks import Linearize
from napari_defocus.widgets.docks.tools import Tools, side_by_side
from napari_defocus.widgets.forms.accessibility import (
    describe,
    set_shortcut,
    tab_in_reading_order,
)
from napari_defocus.widgets.forms.defocus_panel import DefocusPanel
from napari_defocus.widgets.forms.depth_form import DepthForm
from napari_defocus.widgets.forms.pages import Pages
from napari_defocus.widgets.forms.restoration_form import RestorationForm
from napari_defocus.widgets.forms.tour import Tour
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs.distances import Distances
from napari_defocus.widgets.jobs.job import Job
from napari_defocus.widgets.jobs.large_analysis import is_large
from napari_defocus.widgets.jobs.map_source import (
    EstimatedSource,
    MapSource,
    may_be_map_of,
    settings_of_map,
    source_of_layer,
)
from napari_defocus.widgets.jobs.restoration import Restoration
from napari_defocus.widgets.layers.image_layers import Plane, unwrapped
from napari_defocus.widgets.layers.preferences import end_tour, wants_tour
from napari_defocus.widgets.layers.result_metadata import BLUR_MAP, layer_of_result
from napari_defocus.widgets.layers.samples import dandelion

MAP, MASK, RESTORE, DEPTH, MORE = "Map", "In focus", "Restore", "Depth", "More"
STACK, FILES = "Stack", "Save and open"


class MapBox(ComboBox):
    """The choice of another map; None is the one that is measured here."""

    null_string = "measured here"


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
    other_map : MapBox
        Which map these use, where there is a choice.
    restore_button, depth_button : magicgui.widgets.PushButton
    tour : Tour or None
        Shown until it was seen or refused.
    """

    SCROLLS = False  # its sections do, so that its buttons stay in sight

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
        self.tour = Tour(self.open_sample, self.end_tour) if wants_tour() else None
        super().__init__(napari_viewer, action="Measure")

    def _fields(self) -> list[Widget]:
        self.other_map = MapBox(
            name="other_map",
            label="map to use",
            choices=self._other_maps,
            nullable=True,
            tooltip="What “Take the blur away” and “Estimate depth” use: the map that is measured "
            "here, or an image layer of the same height and width that holds radii in px, such as "
            "a map that was opened.",
        )
        return [self.image, self.region, self.planes, self.other_map, self.keep_in]

    def _other_maps(self, _: Any) -> list[Image]:
        """Return the layers that may hold a map of the image and were not measured here."""
        image = self.image.value
        own = self._found.layers_of(image, self._viewer)
        return [
            layer
            for layer in self._viewer.layers
            if image is not None and may_be_map_of(layer, image) and unwrapped(layer) not in own
        ]

    def _offer_other_maps(self) -> None:
        """Ask for the map only where there is a choice."""
        self.other_map.reset_choices()
        self.other_map.visible = len(self.other_map.choices) > 1

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
        tools = self.tools
        self.pages.add(
            STACK,
            "All planes of a stack",
            [side_by_side(tools.curve, tools.sharpest)],
        )
        self.pages.add(
            FILES,
            "Maps, settings and a script",
            [
                side_by_side(tools.save_map, tools.open_map),
                side_by_side(tools.save_settings, tools.load_settings),
                tools.script,
            ],
        )
        self.pages.add(
            MORE,
            "What few people need",
            [
                *(settings.noise_variance, settings.shot_noise),
                *(settings.camera_softness, settings.linear_light),
                *(self.live, self.keep_earlier),
            ],
        )
        if self.tour is not None:
            self.rows.insertWidget(0, self.tour)
        self.rows.addWidget(self.pages.native, 1)
        self.rows.addWidget(self.tools.native)
        self.pages.show(MASK)
        self._serve_the_keyboard()

    def _serve_the_keyboard(self) -> None:
        set_shortcut(self.run_button, "Alt+M")
        set_shortcut(self.seeds_button, "Alt+S")
        set_shortcut(self.tools.probe, "Alt+Y")
        set_shortcut(self.tools.relief, "Alt+D")
        describe([self.tools.row])
        tab_in_reading_order(self.native)

    def _wire(self) -> None:
        super()._wire()
        self.settings.show_more(True)
        self.restore_button.clicked.connect(self.restore)
        self.depth_button.clicked.connect(self.estimate_depth)
        self.depth.attach(self)
        self.image.changed.connect(lambda layer: self._on_image(layer))
        self._on_image(self.image.value)

    def _on_image(self, layer: Image | None) -> None:
        self._offer_other_maps()
        has_planes = layer is not None and layer.ndim > 2
        self.planes.visible = has_planes
        self.pages.sections[STACK].setVisible(has_planes)
        if not has_planes:
            self.planes.value = "shown"
        self.tools.refresh()

    def reset_choices(self, *_: Any) -> None:
        """Look for the viewer's layers again, on all pages."""
        super().reset_choices()
        self.pages.reset_choices()
        self._offer_other_maps()
        self.tools.refresh()

    def _tell(self, _: Any = None) -> None:
        super()._tell()
        if self.tour is not None and not self._closed:
            self.tour.follow(self.state.stage)

    def open_sample(self) -> None:
        """Add the picture that the tour is about."""
        for data in dandelion():
            self._viewer.add_layer(Layer.create(*data))
        self.reset_choices()

    def end_tour(self) -> None:
        """Show the tour no more, in this session and in later ones."""
        if self.tour is not None:
            self.tour.hide()
        self.tour = None
        end_tour()

    def _on_shown(self) -> None:
        self._offer_other_maps()
        self.tools.refresh_probe()

    def add_seeds(self) -> Any:
        """Add a layer for seeds, see `AnalysisPanel.add_seeds`, and show what goes with it."""
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
        """Return where the map comes from: the chosen layer, or for a large plane its own."""
        other = self.other_map.value
        if other is not None:
            known = settings_of_map(other)
            psf = self.settings.lens.text() if known is None else known.psf
            return source_of_layer(other, plane, self._viewer, psf)
        settings = self.settings.map_settings()
        layer = layer_of_result(self._viewer.layers, BLUR_MAP, plane.name, plane.region)
        if is_large(plane) and isinstance(layer, Image) and settings_of_map(layer) == settings:
            return source_of_layer(layer, plane, self._viewer, settings.psf)
        return EstimatedSource(settings=settings)

    def _start_job(self, job: Job, action: str = "") -> Run:
        self._live_labels.stop()
        return super()._start_job(job, action)
