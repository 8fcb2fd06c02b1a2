"""What a lens makes of a point, as a few fields: a text that `psf_from_text` reads."""

from collections.abc import Callable
from pathlib import Path

from magicgui.widgets import ComboBox, FileEdit, FloatSpinBox, SpinBox, Widget

from napari_defocus.psf import AUTO, MICROSCOPE
from napari_defocus.psf.families import Annulus, GeneralizedGaussian, Polygon
from napari_defocus.psf.parsing import psf_from_text, psf_text
from napari_defocus.settings import MapSettings
from napari_defocus.widgets.forms.microscope_fields import MicroscopeFields

MEASURED = "measured"

LENSES = {
    AUTO: "auto: found from the picture",
    "disc": "disc: round aperture",
    "polygon": "polygon: aperture blades",
    "annulus": "ring: mirror lens",
    "gaussian": "Gaussian",
    "generalized-gaussian": "generalized Gaussian",
    MICROSCOPE: "microscope: µm from NA",
    MEASURED: "measured (file)",
}
"""The first word of each lens' text form, and what its users call it."""


class LensForm:
    """The choice of a lens, and only those fields that the choice needs.

    Parameters
    ----------
    last_measured : callable
        Returns the file of the lens that was measured last, "" if there is none.
    """

    def __init__(self, last_measured: Callable[[], str]) -> None:
        self._last_measured = last_measured
        self._shown = True
        self.lens = ComboBox(
            name="lens",
            label="lens",
            choices=[(title, name) for name, title in LENSES.items()],
            tooltip="What the lens makes of a point that is out of focus. A disc suits most "
            "photographs; auto takes a Gaussian or a ring if the picture clearly shows one, and "
            "says so. “Which lens fits?” compares them on the picture.",
        )
        self.blades = SpinBox(
            name="blades",
            label="blades",
            value=Polygon.blades,
            min=3,
            max=20,
            tooltip="How many blades the aperture has: the number of corners of its image.",
        )
        self.rotation = FloatSpinBox(
            name="rotation",
            label="rotation (°)",
            value=Polygon.rotation,
            min=-180.0,
            max=180.0,
            step=5.0,
            tooltip="Direction of one corner of the polygon from its centre, in degrees: 0 "
            "points right, 90 up as the picture is shown.",
        )
        self.obstruction = FloatSpinBox(
            name="obstruction",
            label="obstruction",
            value=Annulus.obstruction,
            min=0.0,
            max=0.95,
            step=0.05,
            tooltip="How much of the aperture's radius the secondary mirror hides: the ring's "
            "inner radius over its outer one.",
        )
        self.exponent = FloatSpinBox(
            name="exponent",
            label="exponent",
            value=GeneralizedGaussian.exponent,
            min=1.0,
            max=50.0,
            step=0.5,
            tooltip="How steep the edge of the spot is: 2 is a Gaussian, larger comes closer to "
            "a disc with a sharp edge.",
        )
        self.file = FileEdit(
            name="lens_file",
            label="file",
            filter="*.npz",
            tooltip="The file that “Calibrate a lens” has written. The last one that was "
            "measured is filled in.",
        )
        self.microscope = MicroscopeFields()
        self.take(MapSettings.psf)
        self.lens.changed.connect(lambda _: self._on_chosen())

    def fields(self) -> list[Widget]:
        """Return all fields, from top to bottom; see `show_needed`."""
        return [
            self.lens,
            self.blades,
            self.rotation,
            self.obstruction,
            self.exponent,
            self.file,
            *self.microscope.fields(),
        ]

    def text(self) -> str:
        """Return the lens as `psf_from_text` reads it.

        Raises
        ------
        ValueError
            If it is a measured one, and no file is given, or a microscope that is not known.
        """
        if self.lens.value == MICROSCOPE:
            return self.microscope.text()
        if self.lens.value == MEASURED:
            if self.file.value in (None, Path()):
                raise ValueError("Choose the file of the measured lens first.")
            return str(self.file.value)
        values = (f"{field.value:g}" for field in self._needed())
        return ":".join([self.lens.value, *values])

    def take(self, text: str) -> None:
        """Fill the fields from a text that `psf_from_text` reads."""
        name, *values = text.split(":")
        if name not in LENSES:
            self.file.value = Path(text)
            self.lens.value = MEASURED
            return
        if name == MICROSCOPE:
            self.microscope.take(text)
        self.lens.value = name
        if name == MICROSCOPE:
            return
        defaults = psf_text(psf_from_text(name)).split(":")[1:]
        for field, value in zip(self._needed(), values + defaults[len(values) :], strict=True):
            field.value = float(value)

    def show_needed(self) -> None:
        """Hide the fields that the chosen lens does not need; only once they are in a form."""
        needed: list[Widget] = [*self._needed()]
        if self.lens.value == MEASURED:
            needed.append(self.file)
        if self.lens.value == MICROSCOPE:
            needed += self.microscope.fields()
        self.lens.visible = self._shown
        for field in self.fields()[1:]:
            field.visible = self._shown and field in needed

    def show(self, shown: bool) -> None:
        """Show or hide the choice of a lens; only once it is in a form."""
        self._shown = shown
        self.show_needed()

    def _needed(self) -> list[SpinBox | FloatSpinBox]:
        fields: dict[str, list[SpinBox | FloatSpinBox]] = {
            "polygon": [self.blades, self.rotation],
            "annulus": [self.obstruction],
            "generalized-gaussian": [self.exponent],
        }
        return fields.get(self.lens.value, [])

    def _on_chosen(self) -> None:
        if self.lens.value == MEASURED and self._last_measured():
            self.file.value = Path(self._last_measured())
        if self.lens.value == MICROSCOPE and self.microscope.is_empty:
            self.microscope.read()
        self.show_needed()
