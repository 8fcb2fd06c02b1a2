"""Buttons that look at the results of a panel, and that keep them."""

import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from magicgui.widgets import Container, PushButton
from napari.layers import Image
from napari.utils.notifications import show_error, show_info, show_warning
from qtpy.QtWidgets import QApplication, QFileDialog, QWidget

from napari_defocus import Settings
from napari_defocus.settings import MaskSettings
from napari_defocus.widgets.display.opacity import wanted_opacity
from napari_defocus.widgets.display.region_table import wanted_regions
from napari_defocus.widgets.display.relief import hide_relief, show_made_relief, wanted_relief
from napari_defocus.widgets.display.view_state import view_state
from napari_defocus.widgets.docks.sharpest_plane import SharpestPlaneWidget
from napari_defocus.widgets.export.map_files import TIFF_ENDINGS, open_map, save_map, saving_failure
from napari_defocus.widgets.export.script import script_of
from napari_defocus.widgets.forms.defocus_panel import DefocusPanel
from napari_defocus.widgets.forms.tabs import dock_name
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.layers.image_layers import unwrapped
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    METADATA_KEY,
    STORE,
    layer_of_result,
)

T = TypeVar("T")

PROBE, FOCUS_CURVE, SHARPEST_PLANE = "Why here?", "Focus curve", "Sharpest plane"
FEATURES = "Features table widget"

_IN_3D, _IN_2D = "Show in 3-D", "Back to 2-D"


class Tools:
    """The buttons, each of which is a method of the same meaning.

    Parameters
    ----------
    panel : DefocusPanel
        Whose image and settings they work with.

    Attributes
    ----------
    row : magicgui.widgets.Container
        What is always in sight: the probe and 3-D.
    native : QWidget
        The row's.
    probe, relief : magicgui.widgets.PushButton
        Those in the row.
    curve, sharpest, save_map, open_map, script : magicgui.widgets.PushButton
    regions, opacity, load_settings, save_settings : magicgui.widgets.PushButton
        Those that belong elsewhere in the panel.
    """

    def __init__(self, panel: DefocusPanel) -> None:
        self._panel = panel
        self._viewer = panel._viewer
        self._probe: weakref.ref[Any] | None = None
        self.probe = _button(
            PROBE,
            "Open a dock that explains the map: how likely each blur is at the place under the "
            "mouse, and what part of the picture says so.",
            self.open_probe,
        )
        self.relief = _button(
            _IN_3D, "Show the picture as a relief of its blur, and go back again.", self.toggle_3d
        )
        self.curve = _button(
            FOCUS_CURVE,
            "For stacks that were measured as a whole: how much of each plane is in focus.",
            self.open_focus_curve,
        )
        self.sharpest = _button(
            SHARPEST_PLANE,
            "For stacks through focus: in which plane each place is in focus, and one picture of "
            "the sharpest pixels.",
            self.open_sharpest_plane,
        )
        self.save_map = _button(
            "Save map…", "Save the blur map as a TIFF in px, with what made it.", self.save_blur_map
        )
        self.open_map = _button(
            "Open map…", "Open a blur map that was saved here or by the terminal.", self.open_saved
        )
        self.script = _button(
            "Copy as Python",
            "Put a script on the clipboard that gives the same map and mask without napari.",
            self.copy_script,
        )
        self.regions = _button(
            "Table of regions",
            "Number the regions in focus, and measure each: area, blur, confidence.",
            self.add_regions,
        )
        self.opacity = _button(
            "Soft edges",
            "Add the opacity of what is in focus, from 0 to 1, for hair and fur: an image from the "
            "mask. It needs the package pymatting.",
            self.add_opacity,
        )
        self.load_settings = _button(
            "Load settings…", "Fill the form from a JSON file of settings.", self.load
        )
        self.save_settings = _button(
            "Save settings…",
            "Save the form as a JSON file, which the terminal reads too.",
            self.save,
        )
        self.row = side_by_side(self.probe, self.relief)
        self.native: QWidget = self.row.native

    def refresh(self) -> None:
        """Let the buttons and the status say what is so now."""
        self._panel._tell()
        self.relief.text = _IN_2D if view_state(self._viewer) is not None else _IN_3D
        image = self._panel.image.value
        self.curve.enabled = self.sharpest.enabled = image is not None and image.ndim > 2

    def open_probe(self) -> None:
        """Open the probe of the chosen image beside the panel."""
        from napari_defocus.widgets.docks.probe import ProbeWidget  # loads matplotlib

        widget = self._opened(PROBE, ProbeWidget)
        widget.set_image(self._panel.image.value)
        self._probe = weakref.ref(widget)

    def refresh_probe(self) -> None:
        """Let the probe that was opened here explain its place again."""
        probe = None if self._probe is None else self._probe()
        if probe is not None:
            probe.refresh()

    def open_focus_curve(self) -> None:
        """Open the curve of the stack that was measured."""
        from napari_defocus.widgets.docks.focus_curve import FocusCurveWidget  # and so does this

        self._opened(FOCUS_CURVE, FocusCurveWidget)

    def open_sharpest_plane(self) -> None:
        """Open the widget that compares the planes of a stack."""
        self._opened(SHARPEST_PLANE, SharpestPlaneWidget)

    def _opened(self, name: str, widget_class: type[Any]) -> Any:
        """Return a widget of ours in a dock, which may be there already."""
        window = getattr(self._viewer, "window", None)
        if window is None:
            return widget_class(self._viewer)
        # However it was opened, its name has another end.
        there = [each for each in window.dock_widgets.values() if isinstance(each, widget_class)]
        if there:
            widget = unwrapped(there[-1])
            dock = widget.native.parent()
        else:
            widget = widget_class(self._viewer)
            dock = window.add_dock_widget(widget, name=dock_name(name), tabify=True)
        dock.show()
        dock.raise_()  # it may be there already, behind another tab
        return widget

    def toggle_3d(self) -> Run | None:
        """Show the picture as a relief, or what was seen before; return the run that makes it."""
        if view_state(self._viewer) is not None:
            hide_relief(self._viewer)
            self.refresh()
            return None
        image = self._panel.image.value
        make = self._panel._asked_for(lambda: wanted_relief(self._viewer, image))
        if make is None:
            return None

        def show(surface: Any) -> None:
            show_made_relief(self._viewer, image, surface)
            self.refresh()

        return self._quickly(lambda _: make(), show)

    def add_opacity(self) -> Run | None:
        """Add the opacity of what is in focus; return the run that makes it."""
        image = self._panel.image.value
        if image is None:
            show_warning("There is no image. Open an image first.")
            return None
        wanted = wanted_opacity(self._viewer, image)
        if wanted is None:
            return None

        def show(made: Any) -> None:
            wanted.add(self._viewer, made)
            self._panel.status.value = "Opacity: white is in focus, grey is mixed."

        return self._quickly(wanted.made, show)

    def add_regions(self) -> Run | None:
        """Measure the regions in focus, and open their table; return the run that does."""
        image = self._panel.image.value
        if image is None:
            show_warning("There is no image to measure. Open an image first.")
            return None
        plane = self._panel._asked_for(self._panel.shown_plane)
        wanted = None if plane is None else wanted_regions(self._viewer, image, plane)
        if wanted is None:
            return None

        def show(measured: Any) -> None:
            wanted.show(self._viewer, measured)
            self._panel.say(wanted.description(measured))
            window = getattr(self._viewer, "window", None)
            if window is not None:
                window.add_plugin_dock_widget("napari", FEATURES, tabify=True)

        return self._quickly(wanted.measured, show)

    def copy_script(self) -> Run | None:
        """Put a script that does what the form asks for on the clipboard; return the run."""
        analysis = self._panel._asked_for(self._panel.analysis)
        if analysis is None:
            return None

        def take(script: str) -> None:
            QApplication.clipboard().setText(script)
            self._panel.say("The script is on the clipboard.")
            of_one = " It does the plane that is shown." if self._panel.planes.all_planes else ""
            show_info(
                f"A Python script that gives the same map and mask is on the clipboard.{of_one}"
            )

        return self._quickly(lambda _: script_of(analysis), take)

    def _quickly(self, work: Callable[..., Any], take: Callable[[Any], None]) -> Run | None:
        """Start work that is done soon; nothing if something runs."""
        panel = self._panel
        if panel._running is not None:
            show_info("Something runs already. Wait for it, or cancel it.")
            return None
        return panel._start(work, take, [panel.shown_plane()], "")

    def save_blur_map(self, path: Path | None = None, *, force: bool = False) -> None:
        """Save the newest blur map of the chosen image; a dialog asks for the file.

        Parameters
        ----------
        path : Path, optional
            Without, the dialog asks.
        force : bool, optional
            Whether a file that exists is replaced; the dialog asks that too.
        """
        image = self._panel.image.value
        layer = image and layer_of_result(self._viewer.layers, BLUR_MAP, image.name)
        if not isinstance(layer, Image):
            show_warning("There is no blur map to save yet. Measure the picture first.")
            return
        if path is None:
            ending, kind = ".tif", "Blur maps (*.tif *.tiff)"
            if STORE in layer.metadata[METADATA_KEY]:
                ending, kind = ".ome.zarr", "Large blur maps (*.zarr)"
            path = self._asked_to_save(f"{image.name}-blur{ending}", kind)
            # The dialog knows nothing of an ending that the name gets in `save_map`, and asks
            # about files only.
            force = path is not None and path.suffix.lower() in TIFF_ENDINGS
        if path is not None:
            self._try(lambda: save_map(layer, path, force=force), lambda file: f"Saved {file.name}")

    def open_saved(self, path: Path | None = None) -> None:
        """Open a saved blur map; without a path, a dialog asks for it."""
        path = path or self._asked_to_open("Blur maps (*.tif *.tiff)")
        if path is not None:
            self._try(lambda: open_map(self._viewer, path), lambda _: f"Opened {path.name}")

    def save(self, path: Path | None = None, *, overwrite: bool = False) -> None:
        """Save the form's settings, as `save_blur_map` saves the map."""
        settings = self._panel._asked_for(self._settings)
        if settings is None:
            return
        if path is None:
            path, overwrite = self._asked_to_save("defocus.json", "Settings (*.json)"), True
        if path is not None:
            self._try(lambda: settings.save(path, force=overwrite), lambda _: f"Saved {path.name}")

    def _settings(self) -> Settings:
        form = self._panel.settings
        return Settings(map=form.map_settings(), mask=form.mask_settings() or MaskSettings())

    def load(self, path: Path | None = None) -> None:
        """Fill the form with settings from a file; without a path, a dialog asks for it."""
        path = path or self._asked_to_open("Settings (*.json)")
        if path is not None:
            self._try(lambda: self._take(Settings.load(path)), lambda _: f"Settings of {path.name}")

    def _take(self, settings: Settings) -> None:
        self._panel.settings.take(settings.map, settings.mask)

    def _try(self, work: Callable[[], T], description: Callable[[T], str]) -> None:
        try:
            done = work()
        except (OSError, ValueError, TypeError) as reason:
            show_error(saving_failure(reason))
        else:
            self._panel.say(description(done))

    def _asked_to_save(self, suggested: str, kind: str) -> Path | None:
        chosen, _ = QFileDialog.getSaveFileName(self._panel.native, "Save", suggested, kind)
        return Path(chosen) if chosen else None

    def _asked_to_open(self, kind: str) -> Path | None:
        chosen, _ = QFileDialog.getOpenFileName(self._panel.native, "Open", "", kind)
        return Path(chosen) if chosen else None


def _button(text: str, tooltip: str, press: Callable[[], Any]) -> PushButton:
    button = PushButton(text=text, tooltip=tooltip)
    button.clicked.connect(lambda _: press())
    return button


def side_by_side(*buttons: PushButton) -> Container[PushButton]:
    """Return buttons in a row."""
    row: Container[PushButton] = Container(widgets=buttons, layout="horizontal", labels=False)
    row.margins = (0, 0, 0, 0)
    return row
