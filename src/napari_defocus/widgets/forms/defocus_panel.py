"""What the widgets of the map and the mask share: choose an image and a lens, set, run."""

from collections.abc import Iterator
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
from napari_defocus.settings import CONFIDENT
from napari_defocus.widgets.display.add_results import add_results, add_results_stepwise
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
from napari_defocus.widgets.layers.result_layers import not_trusted_layer
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    METADATA_KEY,
    NOT_TRUSTED,
    THRESHOLD_FOUND,
    Results,
    confidence_description,
    layer_of_result,
    made_by_us,
    noise_description,
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
        self._shown = ShownLabels()
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
        self.settings.lens.show_needed()
        self.settings.show_more(False)
        self.comparison.forget()
        self.seeds_button.clicked.connect(self.add_seeds)
        self.comparison.button.clicked.connect(self.compare)
        self.comparison.best_button.clicked.connect(self.take_best)
        self.image.changed.connect(lambda _: self.comparison.forget())
        self.settings.min_confidence.changed.connect(self._on_min_confidence)
        for field in self.settings.weights():
            field.number.changed.connect(lambda _: self.update_labels(ask=True))
        for box in (self.settings.threshold_fields.found, self.settings.leave_unknown):
            box.changed.connect(lambda _: self.update_labels(ask=True))
        self.live.changed.connect(lambda _: self.update_labels())
        # napari may tell of a stroke before it is on the layer.
        self._seeds_watch = SeedsWatch(lambda: QTimer.singleShot(0, lambda: self._on_stroke()))
        self.seeds.changed.connect(lambda layer: self._on_seeds(layer))
        self._live_labels = LiveLabels(self.cache, self._show_live, self.native)
        for choice in (self.image, self.region, self.planes):
            choice.changed.connect(lambda _: self._show_keep_in())
        self._choose_active()
        self._show_keep_in()

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
        self.status.value = "Paint label 1 where it is in focus and 2 where it is blurred."
        return layer

    def _on_seeds(self, layer: Labels | None) -> None:
        self._seeds_watch.watch(layer)
        self.update_labels()

    def _on_stroke(self) -> None:
        if not self._closed:
            self.update_labels()

    def update_labels(self, *, ask: bool = False) -> None:
        """Label again what was measured, if the form asks for other labels than those shown.

        Nothing happens while something runs, or if the picture has to be measured first.

        Parameters
        ----------
        ask : bool, optional
            Whether to say so then, if there are results that do not follow.
        """
        if not self.live.value or self._running is not None or self.image.value is None:
            return
        if self.planes.all_planes:
            self._ask_to_run(ask)
            return
        try:
            analysis = self.analysis()
        except ValueError:
            return  # somebody is still typing
        analysed = self.cache.analysed.latest(self.image.value)
        if analysed is None or not analysis.fits(analysed):
            self._ask_to_run(ask)
            return
        changed = self._shown.changed(analysed, analysis)
        if changed is not None:
            self.status.value = "Updating"
            self._live_labels.want(analysed, changed)
        elif self._live_labels.is_busy:
            self._live_labels.stop()

    def _ask_to_run(self, ask: bool) -> None:
        if ask and self._last_word:
            self.status.value = f"Press “{self.run_button.text}” to apply what was changed."

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
        yield from self._showing_below_brush(results.layers, keep_earlier)
        self._show_threshold(results.layers)
        self._on_min_confidence(self.settings.min_confidence.value)
        self._choose_first(results.layers)
        self._last_word = self.status.value = results.summary
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
        super()._on_finished()
        if not self._closed:
            for layer in self._rough & set(self._viewer.layers):
                self._viewer.layers.remove(layer)
        self._rough.clear()

    def _on_closed(self) -> None:
        self._live_labels.stop()
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
        yield from self._showing_below_brush(results, keep_earlier)
        self._shown.note(analysed, analysis, whole=whole)
        self._show_threshold(results)
        if whole:
            self._on_min_confidence(self.settings.min_confidence.value)
            self._last_word = _summary(results, self._confidence(results))
            self.status.value = self._last_word
            self._on_shown()

    def _show_threshold(self, results: list[LayerDataTuple]) -> None:
        """Let the slider show the threshold that was found from the picture, if it was."""
        for _, keywords, _ in results:
            made = keywords["metadata"][METADATA_KEY]
            if made.get(THRESHOLD_FOUND) and self.settings.threshold_fields.found.value:
                self.settings.threshold_fields.show_found(made["settings"]["threshold"])

    def _confidence(self, results: list[LayerDataTuple]) -> NDArray[np.floating] | None:
        """Return the confidence that is shown of what results are of, if it is."""
        source = results[0][1]["metadata"][METADATA_KEY]["source"]
        layer = layer_of_result(self._viewer.layers, CONFIDENCE, source)
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
            selection.active = painted

    def _choose_first(self, results: list[LayerDataTuple]) -> None:
        """Make the map the active layer, or the mask, unless somebody paints seeds."""
        selection, made = self._viewer.layers.selection, results[0][1]["metadata"][METADATA_KEY]
        first = layer_of_result(self._viewer.layers, made["result"], made["source"])
        if first is not None and (selection.active is None or selection.active != self.seeds.value):
            selection.active = first

    def _show_comparison(self, rows: list[tuple[str, PSFEvidence]]) -> None:
        self.comparison.show(rows)
        self.status.value = "The nearer the evidence is to 0, the better the lens fits."

    def _on_min_confidence(self, min_confidence: float) -> None:
        """Cover what is not trusted by the confidence layer of the chosen image, if any."""
        name = getattr(self.image.value, "name", "")
        confidence = layer_of_result(self._viewer.layers, CONFIDENCE, name)
        covered = layer_of_result(self._viewer.layers, NOT_TRUSTED, name)
        if confidence is None or (covered is None and min_confidence == 0):
            return
        cover = not_trusted_layer(confidence.as_layer_data_tuple(), min_confidence)
        add_results(self._viewer, [cover])


def _summary(results: list[LayerDataTuple], confidence: NDArray[np.floating] | None) -> str:
    made = results[-1][1]["metadata"][METADATA_KEY]
    lines = [made[name] for name in ("doubt", "lens") if name in made]
    lines.append(noise_description(made["settings"]["noise_variance"], [made["noise_variance"]]))
    if confidence is not None:
        share = (confidence >= CONFIDENT).mean()
        lines.append(confidence_description(share))
        if share == 0:
            lines.append("Nothing can be known here: it has no texture that tells of blur.")
    return "\n".join(lines)
