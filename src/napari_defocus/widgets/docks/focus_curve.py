"""The widget that shows in which planes of a stack how much is in focus."""

from pathlib import Path
from typing import Any

from magicgui.widgets import PushButton
from napari.components import ViewerModel
from napari.layers import Labels, Layer
from napari.utils.notifications import show_error, show_warning
from qtpy.QtCore import QTimer

from napari_defocus import FocusCurve
from napari_defocus.widgets.display.blur_map_stack import curve_along, shown_planes, sliders_of
from napari_defocus.widgets.export.map_files import saving_failure
from napari_defocus.widgets.forms.file_dialogs import asked_where
from napari_defocus.widgets.forms.focus_curve_form import FocusCurveForm
from napari_defocus.widgets.forms.focus_curve_plot import FocusCurvePlot
from napari_defocus.widgets.forms.run_panel import RunPanel
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.layers.image_layers import move_slider, plane_at

WAIT_MS = 100
"""Changes that follow each other more quickly are read once."""

NO_STACK = (
    "Choose a stack of blur maps. If there is none, estimate the blur map of all planes of a stack."
)


class FocusCurveWidget(RunPanel):
    """Draw how much of each plane of a stack is in focus, and go to the planes.

    The curve follows its layers; it is read in a thread.

    Attributes
    ----------
    form : FocusCurveForm
        The stack, what is in focus in it, and which of its sliders the curve runs along.
    plot : FocusCurvePlot
    best_button, save_button : magicgui.widgets.PushButton
    curve : FocusCurve or None
        Of the whole stack; None as long as none was read.
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, action="Read again")
        self.curve: FocusCurve | None = None
        self._again = False
        self._followed: list[Layer] = []
        self._soon = QTimer(self.native)
        self.form = FocusCurveForm(
            napari_viewer, read=lambda: self._soon.start(), draw=lambda: self._draw()
        )
        self.best_button = PushButton(
            name="best",
            text="Go to the sharpest plane",
            tooltip="Show the plane with the most in focus; of several with about as much, the "
            "least blurred one.",
        )
        self.save_button = PushButton(
            name="save_curve",
            text="Save as CSV",
            tooltip="Save the values of every plane as a table: share in focus, median radius, "
            "and the confidence if there is one.",
        )
        fields = self.form.fields()
        self._finish_form([*fields, self.best_button, self.save_button])
        self.plot = FocusCurvePlot(napari_viewer.theme)
        self.rows.insertWidget(len(fields), self.plot, 1)
        self._wire()

    def _wire(self) -> None:
        self._soon.setSingleShot(True)
        self._soon.setInterval(WAIT_MS)
        self._soon.timeout.connect(lambda: self.run())
        self.plot.chosen.connect(lambda plane: self.go_to(plane))
        self.best_button.clicked.connect(lambda _: self.go_to_sharpest())
        self.save_button.clicked.connect(lambda _: self.save())
        self._viewer.layers.events.inserted.connect(self._on_layers)
        self._viewer.layers.events.removed.connect(self._on_layers)
        self._viewer.dims.events.point.connect(self._on_dims)
        self._viewer.dims.events.order.connect(self._on_dims)
        self._viewer.events.theme.connect(self._on_theme)
        self.form.choose_usual()
        self.form.blur_maps.changed.connect(lambda _: self._on_stack())
        self._on_stack()

    def _on_stack(self) -> None:
        self.curve = None
        self.form.begin()
        self._draw()
        self._soon.start()

    def _follow(self, layers: list[Layer]) -> None:
        """Read again whenever one of these layers gets other data, and for no other layer."""
        for before in self._followed:
            for event in _data_events(before):
                event.disconnect(self._on_data)
        self._followed = layers
        for layer in layers:
            for event in _data_events(layer):
                event.connect(self._on_data)

    def _on_data(self, _: Any = None) -> None:
        self._soon.start()

    def _on_layers(self, event: Any) -> None:
        # What is not part of the curve may come and go.
        if self.form.layer is None or event.value in self._followed:
            self._soon.start()

    def run(self) -> Run | None:
        """Start reading the stack, and return the run; None if there is none.

        The curve is drawn when the run's `finished` signal comes. While one runs, that one is
        ended first, and the stack read again.
        """
        if self._closed:
            return None
        if self._running is not None:
            self._again = True
            self._running.cancel()
            return self._running
        asked = self.form.asked()
        self._soon.stop()
        if asked is None:
            self._follow([])
            self._draw()
            self.say(NO_STACK)
            return None
        stack, layers = asked
        self._follow(layers)
        whole = plane_at(layers[0], (slice(None),) * layers[0].ndim)
        return self._start(stack.curve, self._take, [whole], f"Focus of {layers[0].name}")

    def _take(self, curve: FocusCurve) -> None:
        if not self._again:
            self.curve = curve
            # Data of another shape may have other sliders.
            if self.form.along.choices != tuple(range(len(self.form.names()))):
                self.form.begin()
            self._draw()

    def cancel(self) -> None:
        """Stop reading; the curve stays what it was."""
        self._again = False
        super().cancel()

    def _on_finished(self) -> None:
        super()._on_finished()
        if self._closed:
            return
        if self._again:
            self._again = False
            self.run()
        else:
            self._describe_sharpest()

    def _on_layer_removed(self, event: Any) -> None:
        self._again = False
        super()._on_layer_removed(event)

    def _shown_curve(self) -> FocusCurve | None:
        """Return the curve along the chosen slider, where the others stand."""
        layer = self.form.layer
        if self.curve is None or layer is None:
            return None
        return curve_along(self.curve, layer, self._viewer.dims, self.form.slider)

    def _draw(self) -> None:
        curve = self._shown_curve()
        self.best_button.enabled = curve is not None and curve.best is not None
        self.save_button.enabled = curve is not None
        if curve is None:
            self.plot.clear_curve()
            return
        names = self.form.names()
        axis = f"plane along {names[self.form.slider]}" if len(names) > 1 else "plane"
        self.plot.show_curve(curve.share_in_focus, curve.median_radius, axis)
        self._mark()
        self._describe_sharpest()

    def _mark(self) -> None:
        planes = shown_planes(self.form.layer, self._viewer.dims)
        self.plot.mark(planes[self.form.slider])

    def _describe_sharpest(self) -> None:
        """Say which plane is the sharpest."""
        curve = self._shown_curve()
        if curve is None:
            return
        if curve.best is None:
            self.say("Nothing is known of these planes.")
            return
        share, radius = curve.share_in_focus[curve.best], curve.median_radius[curve.best]
        found = f"Sharpest: plane {curve.best[0]}, {share:.0%} in focus, median {radius:.2f} px"
        self.say(f"{found}\nIt rests on {curve.rests_on}.")

    def _on_dims(self, _: Any = None) -> None:
        if self._closed or self._shown_curve() is None:
            return
        # Another slider than the curve's changes the curve.
        if len(self.form.names()) > 1:
            self._draw()
        else:
            self._mark()

    def _on_theme(self, _: Any = None) -> None:
        if not self._closed:
            self.plot.set_theme(self._viewer.theme)

    def go_to(self, plane: int) -> None:
        """Show a plane of the stack.

        Parameters
        ----------
        plane : int
            From 0, along the chosen slider.
        """
        if self.form.layer is not None:
            axis = sliders_of(self.form.layer)[self.form.slider]
            move_slider(self.form.layer, self._viewer.dims, axis, plane)

    def go_to_sharpest(self) -> None:
        """Show the plane with the most in focus along the chosen slider."""
        curve = self._shown_curve()
        if curve is not None and curve.best is not None:
            self.go_to(curve.best[0])

    def save(self, path: Path | None = None, *, overwrite: bool = False) -> None:
        """Write the curve of the whole stack as a table, see `FocusCurve.save`.

        Parameters
        ----------
        path : Path, optional
            Without, a dialog asks for it.
        overwrite : bool, optional
            Whether a file that exists is replaced; the dialog asks that too.
        """
        if self.curve is None:
            show_warning("There is no curve to save yet.")
            return
        if path is None:
            suggested = f"{self.form.blur_maps.current_choice} focus.csv"
            path, overwrite = asked_where(
                self.native, "Save the focus curve", suggested, "Tables (*.csv)"
            )
        if path is None:
            return
        try:
            self.curve.save(path, force=overwrite)
        except OSError as reason:
            show_error(saving_failure(reason))
        else:
            self.say(f"Saved in {path.name}")

    def _on_closed(self) -> None:
        super()._on_closed()
        self._follow([])
        self._viewer.layers.events.inserted.disconnect(self._on_layers)
        self._viewer.layers.events.removed.disconnect(self._on_layers)
        self._viewer.dims.events.point.disconnect(self._on_dims)
        self._viewer.dims.events.order.disconnect(self._on_dims)
        self._viewer.events.theme.disconnect(self._on_theme)


def _data_events(layer: Layer) -> list[Any]:
    """Return the events of a layer that tell of other data, in place or not."""
    painted = [layer.events.paint] if isinstance(layer, Labels) else []
    return [layer.events.data, *painted]
