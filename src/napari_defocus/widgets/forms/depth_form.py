"""What distances need beside a blur map, as fields."""

from pathlib import Path
from typing import Any

from magicgui.widgets import CheckBox, FloatSpinBox, Widget
from napari.utils.notifications import show_warning

from napari_defocus.settings import CONFIDENT
from napari_defocus.widgets.forms.image_panel import ImagePanel
from napari_defocus.widgets.forms.run_panel import wrap
from napari_defocus.widgets.forms.side_field import side_field, side_note
from napari_defocus.widgets.forms.thin_lens_form import ThinLensForm
from napari_defocus.widgets.jobs.distances import Distances
from napari_defocus.widgets.jobs.map_source import MapSource
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, Plane


class DepthForm:
    """The fields of a lens, of the side of its focus, and of what is made of it."""

    def __init__(self) -> None:
        self.thin_lens = ThinLensForm()
        self._offered: Path | None = None
        self.side = side_field("far")
        self.side_note = side_note()
        self.min_confidence = FloatSpinBox(
            name="depth_min_confidence",
            label="unknown below confidence",
            value=CONFIDENT,
            min=0.0,
            max=1.0,
            step=0.05,
            tooltip="Pixels whose blur is less sure than this get no distance (NaN). It uses the "
            "map's confidence, or its confidence layer.",
        )
        self.surface = CheckBox(
            name="surface",
            text="surface in 3-D",
            value=False,
            tooltip="Add a surface layer, too: a relief in the colours of the picture. Switch the "
            "viewer to 3-D to look at it.",
        )

    def fields(self) -> list[Widget]:
        """Return the fields, from top to bottom; see `attach`."""
        return [
            *self.thin_lens.fields(),
            self.side,
            self.side_note,
            self.min_confidence,
            self.surface,
        ]

    def attach(self, panel: ImagePanel) -> None:
        """Follow the image of a panel; once the fields are in its form."""
        wrap(self.side_note)
        self.thin_lens.read_button.clicked.connect(lambda _: self._read_lens(panel))
        panel.image.changed.connect(lambda image: self._offer_file(image))
        self._offer_file(panel.image.value)

    def _offer_file(self, image: Any) -> None:
        """Fill in the file that an image layer came from, unless another one was chosen."""
        path = getattr(getattr(image, "source", None), "path", None)
        if self.thin_lens.file.value in (None, self._offered):
            self.thin_lens.file.value = None if path is None else Path(path)
            self._offered = self.thin_lens.file.value

    def _read_lens(self, panel: ImagePanel) -> None:
        """Fill in what the photograph's file notes about its lens."""
        try:
            size = panel.shown_plane().whole_shape
        except NotAnalysableError:
            size = None
        try:
            panel.say(self.thin_lens.read(size))
        except ValueError as reason:
            show_warning(str(reason))

    def distances(self, plane: Plane, source: MapSource) -> Distances:
        """Return what the fields ask for.

        Raises
        ------
        ValueError
            If a field holds no valid value.
        """
        return Distances(
            plane=plane,
            lens=self.thin_lens.lens(plane.whole_shape),
            source=source,
            side=self.side.value,
            min_confidence=self.min_confidence.value,
            surface=self.surface.value,
        )
