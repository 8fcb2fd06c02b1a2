"""The widget that turns blur into distance."""

from pathlib import Path

from magicgui.widgets import CheckBox, FloatSpinBox
from napari.components import ViewerModel
from napari.utils.notifications import show_warning

from napari_defocus.settings import CONFIDENT
from napari_defocus.widgets.distances import Distances
from napari_defocus.widgets.from_map_panel import FromMapPanel
from napari_defocus.widgets.layers import NotAnalysableError
from napari_defocus.widgets.run_panel import wrap
from napari_defocus.widgets.side_field import side_field, side_note
from napari_defocus.widgets.thin_lens_form import ThinLensForm


class DepthWidget(FromMapPanel):
    """Turn the blur of a picture into distances, for a lens that is known.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel

    Attributes
    ----------
    thin_lens : ThinLensForm
    side, min_confidence, surface : magicgui widgets
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, action="Estimate depth")
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
        self._finish_form(
            [
                *self._map_fields(),
                *self.thin_lens.fields(),
                self.side,
                self.side_note,
                self.min_confidence,
                self.surface,
                self.settings.more,
                *self.settings.more_fields(),
            ]
        )
        wrap(self.side_note)
        self.thin_lens.read_button.clicked.connect(lambda _: self.read_lens())
        self.image.changed.connect(lambda _: self._offer_file())
        self._offer_file()

    def _offer_file(self) -> None:
        """Fill in the file that the image came from, unless another one was chosen."""
        path = getattr(getattr(self.image.value, "source", None), "path", None)
        if self.thin_lens.file.value in (None, self._offered):
            self.thin_lens.file.value = None if path is None else Path(path)
            self._offered = self.thin_lens.file.value

    def read_lens(self) -> None:
        """Fill in what the photograph's file notes about its lens."""
        try:
            size = None if self.image.value is None else self._shown_plane().shape
        except NotAnalysableError:
            size = None
        try:
            self.status.value = self.thin_lens.read(size)
        except ValueError as reason:
            show_warning(str(reason))

    def work(self) -> Distances:
        """Return what the form asks for now, see `FromMapPanel.work`."""
        plane = self._shown_plane()
        return Distances(
            plane=plane,
            lens=self.thin_lens.lens(),
            source=self.source(plane),
            side=self.side.value,
            min_confidence=self.min_confidence.value,
            surface=self.surface.value,
        )
