"""What can be asked of an image layer and of its planes, as fields; and which lens fits it."""

from typing import Any

from napari.components import ViewerModel
from napari.layers import Labels
from napari.utils.notifications import show_warning

from napari_defocus import PSFEvidence
from napari_defocus.widgets.forms.image_panel import ImagePanel
from napari_defocus.widgets.forms.lens_comparison import LensComparison
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
from napari_defocus.widgets.jobs.large_analysis import LargeAnalysis, is_large
from napari_defocus.widgets.jobs.stack_analysis import StackAnalysis, may_be_large
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, Plane
from napari_defocus.widgets.layers.preferences import preferred_display, preferred_settings
from napari_defocus.widgets.layers.seeds import Seeds, add_seeds_layer, shown_seeds


class AnalysisPanel(ImagePanel):
    """The fields of an analysis: what is asked for.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel
        Where the images come from and the results go.
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

    def __init__(self, napari_viewer: ViewerModel, *, action: str) -> None:
        super().__init__(napari_viewer, action=action)
        display = preferred_display()
        self.planes, self.keep_in = PlanesField(), keep_in_field()
        self.settings = SettingsForm(blur_map=True, mask=True, last_measured=self._last_measured)
        self.seeds, self.seeds_button = seeds_field(napari_viewer), seeds_button()
        self.live, self.keep_earlier = live_field(display), keep_earlier_field(display)
        self.comparison = LensComparison()

    def _take_preferences(self) -> None:
        """Fill in what the user prefers; once the fields are in a form."""
        preferred = preferred_settings()
        self.settings.take(preferred.map, preferred.mask)
        self.settings.min_confidence.value = preferred_display().min_confidence

    def _wire(self) -> None:
        """Let the fields act; once they are in a form."""
        self.settings.lens.microscope.attach(self.image)
        self.settings.lens.show_needed()
        self.settings.show_more(False)
        self.comparison.forget()
        self.seeds_button.clicked.connect(self.add_seeds)
        self.comparison.button.clicked.connect(self.compare)
        self.comparison.best_button.clicked.connect(self.take_best)
        self.image.changed.connect(lambda _: self.comparison.forget())
        for choice in (self.image, self.region, self.planes):
            choice.changed.connect(lambda _: self._show_keep_in())

    def _asked(self) -> Any:
        """Return what the form asks for; None while somebody is typing."""
        try:
            return self.settings.map_settings(), self.settings.mask_settings()
        except ValueError:
            return None

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
            "seeds": self.seeds.value,
            "confidence": self.settings.confidence.value,
            "place": place_of(self.keep_in),
        }
        if is_large(plane):
            return LargeAnalysis(**wanted, all_planes=self.planes.all_planes)
        return StackAnalysis(**wanted)

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
            self.planes.all_planes and may_be_large(plane, blur_map=True, mask=True)
        )

    def _chosen_seeds(self, plane: Plane) -> Seeds | None:
        if self.seeds.value is None:
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
        self.say(
            "Paint label 1 where it is in focus, and 2 where it is blurred. You choose the label "
            "on the left, in “layer controls”."
        )
        return layer

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

    def _show_comparison(self, rows: list[tuple[str, PSFEvidence]]) -> None:
        self.comparison.show(rows)
        self.say("The nearer the evidence is to 0, the better the lens fits.")

    def take_best(self) -> None:
        """Fill the lens' fields with the best of the comparison."""
        if self.comparison.best:
            self.settings.lens.take(self.comparison.best)
