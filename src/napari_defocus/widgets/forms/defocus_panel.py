"""What the widgets of the map and the mask share: choose an image and a lens, set, run."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from magicgui.widgets import Widget
from napari.components import ViewerModel
from napari.layers import Labels, Layer
from napari.types import LayerDataTuple
from napari.utils.notifications import show_warning
from numpy.typing import NDArray
from qtpy.QtCore import QTimer

from napari_defocus import PSFEvidence
from napari_defocus.widgets.display.add_results import add_results_stepwise, move_to_top
from napari_defocus.widgets.display.covers import covers_of
from napari_defocus.widgets.display.dock_state import DockState, Notice
from napari_defocus.widgets.display.found_results import FoundResults
from napari_defocus.widgets.display.see_through import SeeThrough
from napari_defocus.widgets.display.summaries import summary_of
from napari_defocus.widgets.forms.image_panel import ImagePanel
from napari_defocus.widgets.forms.lens_comparison import LensComparison
from napari_defocus.widgets.forms.live_labels import LiveLabels
from napari_defocus.widgets.forms.planes_field import PlanesField
from napari_defocus.widgets.forms.result_fields import (
    keep_earlier_field,
    keep_in_field,
    live_field,
    place_of,
    seeds_button,
    seeds_field,
)
from napari_defocus.widgets.forms.settings_form import SettingsForm
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs.analysis import Analysis, Comparison
from napari_defocus.widgets.jobs.estimation import Analysed
from napari_defocus.widgets.jobs.large_analysis import LargeAnalysis, is_large
from napari_defocus.widgets.jobs.shown_labels import ShownLabels
from napari_defocus.widgets.jobs.stack_analysis import StackAnalysis, may_be_large
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, Plane
from napari_defocus.widgets.layers.preferences import preferred_display, preferred_settings
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    METADATA_KEY,
    REGION,
    THRESHOLD_FOUND,
    Results,
    layer_of_result,
    made_by_us,
)
from napari_defocus.widgets.layers.seeds import Seeds, SeedsWatch, add_seeds_layer, shown_seeds


class DefocusPanel(ImagePanel):
    """An analysis of one image layer in a worker thread.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel
        Where the images come from and the results go.
    blur_map : bool
        Whether a blur map is made.
    mask : bool
        Whether an in-focus mask is made.
    action : str
        What the run button says.

    Attributes
    ----------
    settings : SettingsForm
        The fields below the image.
    planes : PlanesField
        Of a stack, the one that is shown or all.
    keep_in : magicgui.widgets.FileEdit
        Where results too large for memory are kept; only shown then.
    seeds : magicgui.widgets.ComboBox
        The labels layer that the mask keeps to, or none.
    seeds_button : magicgui.widgets.PushButton
        Makes a new one.
    live : magicgui.widgets.CheckBox
        Whether map and mask follow the sliders and the seeds.
    keep_earlier : magicgui.widgets.CheckBox
        Whether the results of earlier runs stay.
    comparison : LensComparison
        Which lens fits the picture.
    """

    def __init__(
        self, napari_viewer: ViewerModel, *, blur_map: bool, mask: bool, action: str
    ) -> None:
        super().__init__(napari_viewer, action=action)
        self._blur_map = blur_map
        self._mask = mask
        self._shown, self._found = ShownLabels(), FoundResults()
        self._notice: Notice | None = None
        self.planes, self.keep_in = PlanesField(), keep_in_field()
        display = preferred_display()
        self._rough: set[Layer] = set()
        self.settings = SettingsForm(
            blur_map=blur_map, mask=mask, last_measured=self._last_measured
        )
        self.seeds, self.seeds_button = seeds_field(napari_viewer), seeds_button()
        self.live, self.keep_earlier = live_field(display), keep_earlier_field(display)
        self.comparison = LensComparison()
        self._finish_form(self._fields())
        preferred = preferred_settings()
        self.settings.take(preferred.map, preferred.mask)
        self.settings.min_confidence.value = display.min_confidence if blur_map else 0.0
        self._wire()

    def _fields(self) -> list[Widget]:
        settings = self.settings
        return [
            self.image,
            self.region,
            self.planes,
            self.keep_in,
            *settings.lens.fields(),
            *self.comparison.fields(),
            *settings.main_fields(),
            *([self.seeds, self.seeds_button] if self._mask else []),
            self.live,
            settings.more,
            *settings.more_fields(),
            self.keep_earlier,
        ]

    def _wire(self) -> None:
        self.settings.lens.microscope.attach(self.image)
        self.settings.lens.show_needed()
        self.settings.show_more(False)
        self.comparison.forget()
        self.seeds_button.clicked.connect(self.add_seeds)
        self.comparison.button.clicked.connect(self.compare)
        self.comparison.best_button.clicked.connect(self.take_best)
        self.image.changed.connect(lambda _: self.comparison.forget())
        self.settings.min_confidence.changed.connect(self._on_min_confidence)
        for field in self.settings.weights():
            field.number.changed.connect(lambda _: self.update_labels())
        for box in (self.settings.threshold_fields.found, self.settings.leave_unknown):
            box.changed.connect(lambda _: self.update_labels())
        self.live.changed.connect(lambda _: self.update_labels())
        # napari may tell of a stroke before it is on the layer.
        self._see_through = SeeThrough(self._viewer)
        self._seeds_watch = SeedsWatch(lambda: QTimer.singleShot(0, lambda: self._on_stroke()))
        self.seeds.changed.connect(lambda layer: self._on_seeds(layer))
        self._live_labels = LiveLabels(
            self.cache, self._show_live, self.native, at_rest=lambda: self._tell()
        )
        for choice in (self.image, self.region, self.planes):
            choice.changed.connect(lambda _: self._show_keep_in())
        self._choose_active()
        self._show_keep_in()
        self._tell_changes()

    def _tell_changes(self) -> None:
        """Let the status follow whatever it speaks of."""
        for field in (self.image, self.planes, *self.settings.all_fields()):
            field.changed.connect(lambda _: self._tell())
        for signal in self._viewer_signals():
            signal.connect(self._tell)
        self._tell()

    def _viewer_signals(self) -> list[Any]:
        layers, dims = self._viewer.layers.events, self._viewer.dims.events
        return [layers.inserted, layers.removed, dims.current_step, dims.ndisplay, dims.order]

    @property
    def state(self) -> DockState:
        """What is so, and what the status says of it."""
        state = self._found.state(
            self._viewer,
            self.image.value,
            self._asked(),
            all_planes=self.planes.all_planes,
            updating=self._live_labels.is_busy,
        )
        action = str(self.run_button.text)
        return replace(state, step=self._step, notice=self._notice, action=action)

    def _asked(self) -> Any:
        """Return what the form asks for; None while somebody is typing."""
        try:
            return self.settings.map_settings(), self.settings.mask_settings()
        except ValueError:
            return None

    def _text(self) -> str:
        return self.state.text

    def say(self, text: str) -> None:
        """Say what was done, as long as what it was done to is there."""
        self._notice = Notice(text, self.state.situation)
        self._tell()

    def analysis(self) -> Analysis:
        """Return what the form asks for now.

        Raises
        ------
        NotAnalysableError
            If the chosen layer shows no plane that can be analysed.
        ValueError
            If a field holds no valid value, or the seeds do not fit the plane.
        """
        plane = self.shown_plane()
        return Analysis(
            plane=plane,
            estimation=self.settings.map_settings(),
            mask=self.settings.mask_settings(),
            seeds=self._chosen_seeds(plane),
            blur_map=self._blur_map,
            confidence=self.settings.confidence.value,
        )

    def stack_analysis(self) -> StackAnalysis | LargeAnalysis:
        """Return what the form asks for of all planes, or of one too large for memory.

        Raises
        ------
        NotAnalysableError, ValueError
            As `analysis`, and if there is no room for the results.
        """
        plane = self.shown_plane()
        wanted: dict[str, Any] = {
            "plane": plane,
            "estimation": self.settings.map_settings(),
            "mask": self.settings.mask_settings(),
            "seeds": self._painted_seeds(),
            "blur_map": self._blur_map,
            "confidence": self.settings.confidence.value,
            "place": place_of(self.keep_in),
        }
        if is_large(plane):
            return LargeAnalysis(**wanted, all_planes=self.planes.all_planes)
        return StackAnalysis(**wanted)

    def _painted_seeds(self) -> Labels | None:
        return self.seeds.value if self._mask else None

    @property
    def _is_large(self) -> bool:
        """Whether the plane that is chosen now is too large for memory."""
        try:
            return is_large(self.shown_plane())
        except NotAnalysableError:
            return False

    def _show_keep_in(self) -> None:
        """Ask for a folder only where results are kept on the disk."""
        try:
            plane = self.shown_plane()
        except NotAnalysableError:
            self.keep_in.visible = False
            return
        self.keep_in.visible = is_large(plane) or (
            self.planes.all_planes and may_be_large(plane, blur_map=self._blur_map, mask=self._mask)
        )

    def _chosen_seeds(self, plane: Plane) -> Seeds | None:
        if not self._mask or self.seeds.value is None:
            return None
        return shown_seeds(self.seeds.value, plane, self._viewer.dims)

    def add_seeds(self) -> Labels | None:
        """Add a layer for seeds of the chosen image, choose it and return it; None without one."""
        if self.image.value is None:
            show_warning("There is no image to paint seeds on. Open an image first.")
            return None
        layer = add_seeds_layer(self._viewer, self.image.value)
        self.reset_choices()
        self.seeds.value = layer
        self.say("Paint label 1 where it is in focus and 2 where it is blurred.")
        return layer

    def _on_seeds(self, layer: Labels | None) -> None:
        self._seeds_watch.watch(layer)
        self._see_through.watch(layer)
        self.update_labels()

    def _on_stroke(self) -> None:
        if not self._closed:
            self.update_labels()

    def update_labels(self) -> None:
        """Label again what was measured, if the form asks for other labels than those shown.

        Nothing happens while something runs, or if the picture has to be measured first.
        """
        if not self.live.value or self._running is not None or self.image.value is None:
            return
        if self.planes.all_planes or not self._found.layers_of(self.image.value, self._viewer):
            return
        try:
            analysis = self.analysis()
        except ValueError:
            return  # somebody is still typing
        analysed = self.cache.analysed.latest(self.image.value)
        if analysed is None or not analysis.fits(analysed):
            return
        changed = self._shown.changed(analysed, analysis)
        if changed is not None:
            self._live_labels.want(analysed, changed)
        elif self._live_labels.is_busy:
            self._live_labels.stop()
        self._tell()

    def _show_live(
        self, results: list[LayerDataTuple], analysed: Analysed, analysis: Analysis, whole: bool
    ) -> None:
        if not self._closed and analysed.picture.plane.is_current(self._viewer.layers):
            steps = self._showing(results, analysed, analysis, whole=whole)
            self._go_through(steps, lambda: None)

    def run(self) -> Run | None:
        """Start the analysis that the form asks for, and return it; None if it cannot be done.

        The results are in the viewer when the run's `finished` signal comes. While one runs,
        that one is returned.
        """
        if self._running is not None:
            return self._running
        if self.planes.all_planes or self._is_large:
            return self._run_stack()
        analysis = self._asked_for(self.analysis)
        if analysis is None:
            return None
        self._live_labels.stop()
        self.region.uncover()
        keep = bool(self.keep_earlier.value)

        def take(results: list[LayerDataTuple], whole: bool) -> Iterator[Layer]:
            return self._show_analysis(results, analysis, whole, keep)

        return self._start(
            partial(analysis.run, self.cache),
            lambda results: take(results, whole=True),
            [analysis.plane],
            f"Defocus of {analysis.plane.name}",
            # A rough map beside earlier ones would get a confidence in the place of theirs.
            take_preview=None if keep else lambda results: take(results, whole=False),
        )

    def _run_stack(self) -> Run | None:
        analysis = self._asked_for(self.stack_analysis)
        if analysis is None:
            return None
        self._live_labels.stop()
        self.region.uncover()
        keep = self.keep_earlier.value
        return self._start(
            partial(analysis.run, self.cache),
            lambda results: self._show_stack(results, analysis, keep),
            [analysis.plane],
            f"Defocus of {'all planes of ' * self.planes.all_planes}{analysis.plane.name}",
        )

    def _show_stack(
        self, results: Results, analysis: StackAnalysis | LargeAnalysis, keep_earlier: bool
    ) -> Iterator[Layer]:
        if not self._still_current():
            return
        shown = []
        for layer in self._showing_below_brush(results.layers, keep_earlier):
            shown.append(layer)
            yield layer
        self._show_threshold(results.layers)
        self._on_min_confidence(self.settings.min_confidence.value)
        self._choose_first(results.layers)
        self._found.note(
            analysis.plane,
            results.summary,
            shown,
            (analysis.estimation, analysis.mask),
            all_planes=isinstance(analysis, StackAnalysis) or analysis.all_planes,
        )
        self._tell()
        analysed = self.cache.analysed.latest(self.image.value)
        if analysed is not None and isinstance(analysis, StackAnalysis):
            # The plane that was shown can follow the sliders.
            self._shown.note(analysed, analysis.of_plane(analysis.plane))

    def _keeps_earlier(self) -> bool:
        return bool(self.keep_earlier.value)

    def compare(self) -> Run | None:
        """Start a comparison of lenses on the chosen image, and return it, like `run`."""
        if self._running is not None:
            return self._running
        analysis = self._asked_for(self.analysis)
        if analysis is None:
            return None
        plane = analysis.plane
        comparison = Comparison(plane=plane, estimation=analysis.estimation)
        return self._start(
            comparison.run, self._show_comparison, [plane], f"Lenses for {plane.name}"
        )

    def take_best(self) -> None:
        """Fill the lens' fields with the best of the comparison."""
        if self.comparison.best:
            self.settings.lens.take(self.comparison.best)

    def _show_running(self, running: bool) -> None:
        super()._show_running(running)
        self.comparison.button.enabled = not running
        if not running:
            self.update_labels()  # for whoever has moved a slider meanwhile

    def cancel(self) -> None:
        """Stop what runs and what follows the sliders; nothing is added to the viewer."""
        self._live_labels.stop()
        super().cancel()

    def _on_finished(self) -> None:
        if not self._closed:
            for layer in self._rough & set(self._viewer.layers):
                self._viewer.layers.remove(layer)
        self._rough.clear()
        super()._on_finished()

    def _on_closed(self) -> None:
        self._live_labels.stop()
        self._see_through.end()
        for signal in self._viewer_signals():
            signal.disconnect(self._tell)
        super()._on_closed()

    def _show_analysis(
        self, results: list[LayerDataTuple], analysis: Analysis, whole: bool, keep_earlier: bool
    ) -> Iterator[Layer]:
        analysed = self.cache.analysed.latest(self.image.value)
        if analysed is None or not self._still_current():
            return
        before = set(self._viewer.layers)
        steps = self._showing(results, analysed, analysis, whole=whole, keep_earlier=keep_earlier)
        for layer in steps:
            if not whole and layer not in before:
                self._rough.add(layer)
            yield layer
        if whole:
            self._rough.clear()
            self._choose_first(results)
            self._live_labels.prepare(analysed, analysis)

    def _showing(
        self,
        results: list[LayerDataTuple],
        analysed: Analysed,
        analysis: Analysis,
        *,
        whole: bool,
        keep_earlier: bool = False,
    ) -> Iterator[Layer]:
        """Show results step by step; a preview of them has no confidence and is no last word."""
        shown = self._found.layers_of(self.image.value, self._viewer)
        for layer in self._showing_below_brush(results, keep_earlier):
            shown.append(layer)
            yield layer
        self._shown.note(analysed, analysis, whole=whole)
        self._show_threshold(results)
        if whole:
            self._on_min_confidence(self.settings.min_confidence.value)
            lines = summary_of(results, self._confidence(results), analysed.picture)
            asked = analysis.estimation, analysis.mask or self.settings.mask_settings()
            plane = analysed.picture.plane
            self._found.note(plane, lines, shown, asked, all_planes=False)
            self._tell()
            self._on_shown()

    def _show_threshold(self, results: list[LayerDataTuple]) -> None:
        """Let the slider show the threshold that was found from the picture, if it was."""
        for _, keywords, _ in results:
            made = keywords["metadata"][METADATA_KEY]
            if made.get(THRESHOLD_FOUND) and self.settings.threshold_fields.found.value:
                self.settings.threshold_fields.show_found(made["settings"]["threshold"])

    def _confidence(self, results: list[LayerDataTuple]) -> NDArray[np.floating] | None:
        """Return the confidence that is shown of what results are of, if it is."""
        made = results[0][1]["metadata"][METADATA_KEY]
        layer = self._shown_result(CONFIDENCE, made)
        if layer is None:
            return None
        # Of a pyramid, the smallest level tells enough, and is read at once.
        return np.asarray(layer.data[-1] if layer.multiscale else layer.data)

    def _on_shown(self) -> None:
        """Tell whoever explains results that there are new ones."""

    def _showing_below_brush(
        self, results: list[LayerDataTuple], keep_earlier: bool
    ) -> Iterator[Layer]:
        """Show results; whoever paints seeds goes on painting on their layer."""
        selection = self._viewer.layers.selection
        painted = selection.active
        for layer in add_results_stepwise(self._viewer, results, keep_earlier=keep_earlier):
            # Other widgets hide the map that they make on the way.
            if made_by_us(layer) == BLUR_MAP and not layer.visible:
                layer.visible = True
            yield layer
        if painted is not None and painted == self.seeds.value:
            move_to_top(self._viewer, painted)
            selection.active = painted

    def _choose_first(self, results: list[LayerDataTuple]) -> None:
        """Make the map the active layer, or the mask, unless somebody paints seeds."""
        selection, made = self._viewer.layers.selection, results[0][1]["metadata"][METADATA_KEY]
        first = self._shown_result(made["result"], made)
        if first is not None and (selection.active is None or selection.active != self.seeds.value):
            selection.active = first

    def _shown_result(self, result: str, made: dict[str, Any]) -> Layer | None:
        """Return the newest layer of a result of the same part of the same picture."""
        region = (made.get(REGION) or {}).get("of", "")
        return layer_of_result(self._viewer.layers, result, made["source"], region)

    def _show_comparison(self, rows: list[tuple[str, PSFEvidence]]) -> None:
        self.comparison.show(rows)
        self.say("The nearer the evidence is to 0, the better the lens fits.")

    def _on_min_confidence(self, min_confidence: float) -> None:
        """Cover what is not trusted by the confidence layers of the chosen image and its parts."""
        name = getattr(self.image.value, "name", "")
        for cover in covers_of(self._viewer.layers, name, min_confidence):
            for _ in self._showing_below_brush([cover], keep_earlier=False):
                pass
