"""The widget that measures a lens."""

from pathlib import Path
from typing import Any

from magicgui.types import FileDialogMode
from magicgui.widgets import CheckBox, ComboBox, FileEdit, Label, LineEdit
from napari.components import ViewerModel
from napari.layers import Image
from napari.types import LayerDataTuple
from napari.utils.notifications import show_warning

from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.forms.run_panel import RunPanel, wrap
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs.calibration import Calibration, numbers, planes_of
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, Plane
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY, pictures_in

POINT_SOURCES = "none: point sources"


class SharpBox(ComboBox):
    """The choice of a sharp picture; None if there is none."""

    null_string = POINT_SOURCES


class CalibrateWidget(RunPanel):
    """Measure what a lens makes of a point, from the selected image layers.

    Attributes
    ----------
    pictures : magicgui.widgets.Label
        Which layers are selected.
    sharp, scales, file, overwrite : magicgui widgets
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, action="Measure the lens")
        self.pictures = Label(
            name="pictures",
            label="pictures",
            tooltip="The selected image layers, from the bottom of the layer list up, or all "
            "planes of a selected stack: each at another setting of the focus.",
        )
        self.sharp = SharpBox(
            name="sharp",
            label="sharp picture",
            choices=self._images,
            nullable=True,
            tooltip="The same scene in focus, as a picture or as a stack with one for each "
            "setting. Without it, the pictures show point sources, such as distant lamps or "
            "beads, not saturated and not close to each other.",
        )
        self.scales = LineEdit(
            name="scales",
            label="scales (px)",
            tooltip="Blur of each picture in px, with commas between, if you know it. Leave it "
            "empty to have it measured: the radius of the disc that is as wide.",
        )
        self.scales.native.setPlaceholderText("measured")
        self.file = FileEdit(
            name="file",
            label="save as",
            mode=FileDialogMode.OPTIONAL_FILE,
            filter="*.npz",
            tooltip="Where the lens is saved (.npz). The other widgets take it as their "
            "measured lens, and the terminal command as --psf.",
        )
        self.overwrite = CheckBox(
            name="overwrite",
            text="overwrite",
            tooltip="Replace the file if there is one of that name already.",
        )
        self._finish_form([self.pictures, self.sharp, self.scales, self.file, self.overwrite])
        wrap(self.pictures)
        self._viewer.layers.selection.events.changed.connect(self._show_selected)
        self.sharp.changed.connect(lambda _: self._show_selected())
        self._show_selected()

    def _images(self, _: Any = None) -> list[Image]:
        return pictures_in(self._viewer.layers)

    def _selected(self) -> list[Image]:
        chosen = self._viewer.layers.selection
        return [
            layer for layer in self._images() if layer in chosen and layer is not self.sharp.value
        ]

    def _show_selected(self, _: Any = None) -> None:
        if not self._closed:
            names = [layer.name for layer in self._selected()]
            self.pictures.value = ", ".join(names) or "select their layers"

    def calibration(self) -> Calibration:
        """Return what the form asks for now.

        Raises
        ------
        NotAnalysableError
            If a layer has too many axes.
        ValueError
            If a field holds no valid value, or too few layers are selected.
        """
        planes = [plane for layer in self._selected() for plane in planes_of(layer)]
        return Calibration(
            planes=planes,
            sharp=[] if self.sharp.value is None else planes_of(self.sharp.value),
            scales=numbers(self.scales.value),
            file=Path(str(self.file.value or "")),
            overwrite=self.overwrite.value,
        )

    def run(self) -> Run | None:
        """Start the measurement, and return it; None if there is nothing to measure.

        The lens is saved and its kernels are in the viewer when the run's `finished` signal
        comes. While one runs, that one is returned.
        """
        if self._running is not None:
            return self._running
        try:
            calibration = self.calibration()
        except (NotAnalysableError, ValueError) as reason:
            show_warning(str(reason))
            return None
        planes: list[Plane] = [*calibration.planes, *calibration.sharp]
        return self._start(calibration.run, self._show_lens, planes, "Measuring the lens")

    def _show_lens(self, results: list[LayerDataTuple]) -> None:
        selected = set(self._viewer.layers.selection)
        add_results(self._viewer, results)
        self._viewer.layers.selection = selected
        made = results[0][1]["metadata"][METADATA_KEY]
        scales = ", ".join(f"{scale:.2f}" for scale in made["scales"])
        self.say(f"Scales {scales} px\nSaved in {Path(made['file']).name}")

    def _on_closed(self) -> None:
        super()._on_closed()
        self._viewer.layers.selection.events.changed.disconnect(self._show_selected)
