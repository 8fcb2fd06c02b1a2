"""What the dock of map and mask does: run, show what was found, follow the sliders."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from magicgui.widgets import Widget
from napari.components import ViewerModel
from napari.layers import Labels, Layer
from napari.types import LayerDataTuple
from qtpy.QtCore import QTimer

from napari_defocus.widgets.display.dock_state import DockState, Notice
from napari_defocus.widgets.display.found_results import FoundResults
from napari_defocus.widgets.display.results_display import ResultsDisplay
from napari_defocus.widgets.display.see_through import SeeThrough
from napari_defocus.widgets.display.summaries import summary_of
from napari_defocus.widgets.forms.analysis_panel import AnalysisPanel
from napari_defocus.widgets.forms.live_labels import LiveLabels
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.estimation import Analysed
from napari_defocus.widgets.jobs.large_analysis import LargeAnalysis
from napari_defocus.widgets.jobs.shown_labels import ShownLabels
from napari_defocus.widgets.jobs.stack_analysis import StackAnalysis
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY, THRESHOLD_FOUND, Results
from napari_defocus.widgets.layers.seeds import SeedsWatch


class DefocusPanel(AnalysisPanel):
    """An analysis of one image layer in a worker thread; map and mask follow the sliders.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel
        Where the images come from and the results go.
    action : str
        What the run button says.
    """

    def __init__(self, napari_viewer: ViewerModel, *, action: str) -> None:
        super().__init__(napari_viewer, action=action)
        self._shown, self._found = ShownLabels(), FoundResults()
        self._display = ResultsDisplay(napari_viewer, lambda: self.seeds.value)
        self._notice: Notice | None = None
        self._rough: set[Layer] = set()
        self._finish_form(self._fields())
        self._take_preferences()
        self._wire()

    def _fields(self) -> list[Widget]:
        """Return the fields above the buttons."""
        raise NotImplementedError

    def _wire(self) -> None:
        super()._wire()
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

    def _text(self) -> str:
        return self.state.text

    def say(self, text: str) -> None:
        """Say what was done, as long as what it was done to is there."""
        self._notice = Notice(text, self.state.situation)
        self._tell()

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
        for layer in self._showing_layers(results.layers, keep_earlier):
            shown.append(layer)
            yield layer
        self._show_threshold(results.layers)
        self._on_min_confidence(self.settings.min_confidence.value)
        self._display.choose_first(results.layers)
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
            self._display.choose_first(results)
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
        for layer in self._showing_layers(results, keep_earlier):
            shown.append(layer)
            yield layer
        self._shown.note(analysed, analysis, whole=whole)
        self._show_threshold(results)
        if whole:
            self._on_min_confidence(self.settings.min_confidence.value)
            beside = self._display.shown_beside(results)
            sure = self._display.confidence(results)
            lines = summary_of([*beside, *results], sure, analysed.picture)
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

    def _on_shown(self) -> None:
        """Tell whoever explains results that there are new ones."""

    def _on_min_confidence(self, min_confidence: float) -> None:
        """Cover what is not trusted of the chosen image and its parts."""
        name = getattr(self.image.value, "name", "")
        self._display.cover(name, min_confidence)

    def _showing_layers(self, results: list[LayerDataTuple], keep_earlier: bool) -> Iterator[Layer]:
        return self._display.showing(results, keep_earlier=keep_earlier)
