"""What the three widgets share: choose an image, set, run, watch, cancel."""

from functools import partial
from typing import Any

from magicgui.widgets import ComboBox, Container, Label, ProgressBar, PushButton, Widget
from napari.components import ViewerModel
from napari.layers import Image
from napari.types import LayerDataTuple
from napari.utils.notifications import show_error, show_info, show_warning

from napari_defocus.widgets.analysis import Analysis
from napari_defocus.widgets.kept_candidates import KeptCandidates
from napari_defocus.widgets.layers import (
    METADATA_KEY,
    NotAnalysableError,
    Plane,
    is_blur_map,
    show_results,
    shown_plane,
)
from napari_defocus.widgets.settings_form import SettingsForm
from napari_defocus.widgets.workers import STEPS, Run

KEPT_CANDIDATES = KeptCandidates()
"""Shared by all widgets: the mask reuses what the map has found."""


class DefocusPanel(Container[Widget]):
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
    image : magicgui.widgets.ComboBox
        The image layer to analyse.
    settings : SettingsForm
        The fields below it.
    """

    def __init__(
        self, napari_viewer: ViewerModel, *, blur_map: bool, mask: bool, action: str
    ) -> None:
        self._viewer = napari_viewer
        self._blur_map = blur_map
        self._running: Run | None = None
        self._plane: Plane | None = None
        self._closed = False
        self.image = ComboBox(
            name="image",
            label="image",
            choices=self._images,
            tooltip="The image layer to analyse. Of a stack, the plane that is shown.",
        )
        self.settings = SettingsForm(blur_map=blur_map, mask=mask)
        self.run_button = PushButton(text=action)
        self.cancel_button = PushButton(text="Cancel", enabled=False)
        self.progress_bar = ProgressBar(name="progress", label=" ", min=0, max=STEPS, value=0)
        self.status = Label(name="status", label=" ", value="")
        super().__init__()
        # Only rows that come after the container's own making get labels of equal width.
        self.extend(self._rows())
        self._wire()

    def _rows(self) -> list[Widget]:
        buttons = Container(
            widgets=[self.run_button, self.cancel_button], layout="horizontal", labels=False
        )
        buttons.label = " "
        buttons.margins = (0, 0, 0, 0)
        return [self.image, *self.settings.fields(), buttons, self.progress_bar, self.status]

    def _wire(self) -> None:
        self.run_button.clicked.connect(self.run)
        self.cancel_button.clicked.connect(self.cancel)
        self.progress_bar.hide()
        self.status.native.setWordWrap(True)
        self.native.destroyed.connect(lambda: self._on_closed())
        active = self._viewer.layers.selection.active
        if active in self.image.choices:
            self.image.value = active

    def _images(self, _: Any) -> list[Image]:
        return [
            layer
            for layer in self._viewer.layers
            if isinstance(layer, Image) and not is_blur_map(layer)
        ]

    def analysis(self) -> Analysis:
        """Return what the form asks for now.

        Raises
        ------
        NotAnalysableError
            If the chosen layer shows no plane that can be analysed.
        ValueError
            If a field holds no valid value.
        """
        return Analysis(
            plane=shown_plane(self.image.value, self._viewer.dims),
            estimation=self.settings.map_settings(),
            mask=self.settings.mask_settings(),
            blur_map=self._blur_map,
        )

    def run(self) -> Run | None:
        """Start the analysis, and return it; None if there is nothing to analyse.

        The results are in the viewer when the run's `finished` signal comes. While one runs,
        that one is returned.
        """
        if self._running is not None:
            return self._running
        if self.image.value is None:
            show_warning("There is no image to analyse. Open an image first.")
            return None
        try:
            analysis = self.analysis()
        except NotAnalysableError as reason:
            show_warning(f"Cannot analyse “{self.image.value.name}”: {reason}")
            return None
        except ValueError as reason:
            show_warning(str(reason))
            return None
        return self._start(analysis)

    def cancel(self) -> None:
        """Stop what runs; nothing is added to the viewer."""
        if self._running is not None:
            self._running.cancel()
            self.status.value = "Cancelling"

    def _start(self, analysis: Analysis) -> Run:
        plane = analysis.plane
        run = Run(partial(analysis.run, KEPT_CANDIDATES), f"Defocus of {plane.name}", owner=self)
        # Functions, not methods: PySide6 mixes up the methods of objects that are not Qt's own
        # when one is made at the address of another that has gone, and crashes.
        run.progressed.connect(lambda step, done: self._on_progressed(step, done))
        run.returned.connect(lambda results: self._on_returned(results))
        run.refused.connect(lambda reason: self._on_refused(reason))
        run.finished.connect(lambda: self._on_finished())
        self._viewer.layers.events.removed.connect(self._on_layer_removed)
        self._running, self._plane = run, plane
        self._show_running(True)
        run.start()
        return run

    def _show_running(self, running: bool) -> None:
        self.run_button.enabled = not running
        self.cancel_button.enabled = running
        self.progress_bar.value = 0
        self.progress_bar.visible = running
        if running:
            self.status.value = "Starting"

    def _on_progressed(self, step: str, done: float) -> None:
        if not self._closed:
            self.progress_bar.value = round(STEPS * done)
            self.status.value = step

    def _on_returned(self, results: list[LayerDataTuple]) -> None:
        if self._closed or self._plane is None:
            return
        if self._plane.is_current(self._viewer.layers):
            show_results(self._viewer, results)
            self.status.value = _summary(results)
        elif self._plane.layer() in self._viewer.layers:
            show_info(f"“{self._plane.name}” was changed while it was analysed. Run again.")

    def _on_refused(self, reason: str) -> None:
        if not self._closed and self._plane is not None:
            show_error(f"Cannot analyse “{self._plane.name}”: {reason}")

    def _on_finished(self) -> None:
        self._running = None
        if self._closed:
            return
        self._viewer.layers.events.removed.disconnect(self._on_layer_removed)
        self._show_running(False)

    def _on_layer_removed(self, event: Any) -> None:
        if self._plane is not None and self._plane.layer() in (None, event.value):
            self.cancel()

    def _on_closed(self) -> None:
        self._closed = True
        if self._running is not None:
            self._running.cancel()


def _summary(results: list[LayerDataTuple]) -> str:
    made = results[-1][1]["metadata"][METADATA_KEY]
    how = "found" if made["settings"]["noise_variance"] is None else "given"
    return f"Noise variance {made['noise_variance']:.1e} ({how})"
