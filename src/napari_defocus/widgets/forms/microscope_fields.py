"""A microscope as fields: numerical aperture, wavelength, pixel size, immersion, specimen."""

from dataclasses import asdict
from pathlib import Path

from magicgui.widgets import ComboBox, FloatSpinBox, PushButton, Widget
from napari.layers import Image
from napari.utils.notifications import show_info, show_warning

from napari_defocus.io.microscope_files import lacks_extra
from napari_defocus.io.microscope_metadata import (
    Noted,
    has_several_wavelengths,
    noted_microscope,
    square_side,
)
from napari_defocus.io.tiff_pixel_size import MICROMETERS
from napari_defocus.psf.microscope import Microscope
from napari_defocus.psf.parsing import psf_from_text, psf_text

_SPECIMENS = {
    "found from the picture": "auto",
    "edges: tissue, nuclei": "texture",
    "points: beads": "points",
}


class MicroscopeFields:
    """The fields of a microscope; 0 is not known.

    Attributes
    ----------
    aperture, wavelength, pixel_size, index : magicgui.widgets.FloatSpinBox
    specimen : magicgui.widgets.ComboBox
    read_button : magicgui.widgets.PushButton
        Fills in what the image's file and layer note; see `attach`.
    """

    def __init__(self) -> None:
        self._image: ComboBox | None = None
        self.read_button = PushButton(
            name="read_microscope",
            text="Read from image",
            tooltip="Fill in what the image's file notes of its microscope (OME-TIFF, OME-Zarr, "
            "CZI, ND2, LIF), and the pixel size of its layer. The other fields stay as they are.",
        )
        self.aperture = _number(
            *("numerical_aperture", "NA", 1.7, 0.05, 3),
            "Numerical aperture of the objective: it is printed on it, such as 40x/0.8.",
        )
        self.wavelength = _number(
            *("wavelength", "wavelength (µm)", 2.0, 0.01, 4),
            "Wavelength of the light in µm: of emission in fluorescence (GFP 0.51), the middle of "
            "the band in bright field (0.55).",
        )
        self.pixel_size = _number(
            *("pixel_size", "pixel size (µm)", 100.0, 0.01, 5),
            "Distance of the picture's pixels in the specimen, in µm: the camera's pixels over the "
            "magnification.",
        )
        self.index = _number(
            *("refractive_index", "refractive index", 2.0, 0.005, 4),
            "Of what is between objective and specimen: air 1, water 1.333, glycerol 1.47, oil "
            "1.515.",
        )
        self.index.value = Microscope.refractive_index
        self.specimen = ComboBox(
            name="specimen",
            label="specimen shows",
            choices=list(_SPECIMENS.items()),
            tooltip="Points have more fine details than things with edges, and would look sharper "
            "than they are.",
        )
        self.read_button.clicked.connect(lambda _: self.read(aloud=True))

    def fields(self) -> list[Widget]:
        """Return all fields, from top to bottom."""
        return [self.read_button, *self._numbers().values(), self.specimen]

    def attach(self, image: ComboBox) -> None:
        """Read from the layer that a choice of images holds, from now on."""
        self._image = image

    @property
    def is_empty(self) -> bool:
        """Whether nothing was filled in yet."""
        return not (self.aperture.value or self.wavelength.value or self.pixel_size.value)

    def text(self) -> str:
        """Return the microscope as `psf_from_text` reads it.

        Raises
        ------
        ValueError
            If a number is missing, or there is no such microscope.
        """
        missing = [str(field.label) for field in self._numbers().values() if not field.value]
        if missing:
            raise ValueError(f"Fill in the microscope's {', '.join(missing)}.")
        values = {name: field.value for name, field in self._numbers().items()}
        return psf_text(Microscope(**values, specimen=self.specimen.value))

    def take(self, text: str) -> None:
        """Fill the fields from a text that `psf_from_text` reads."""
        lens = psf_from_text(text)
        assert isinstance(lens, Microscope)
        self._fill(asdict(lens))
        self.specimen.value = lens.specimen

    def read(self, *, aloud: bool = False) -> None:
        """Fill in what the chosen image notes; say what, if asked to."""
        layer = None if self._image is None else self._image.value
        if layer is None:
            return
        try:
            noted = noted_in_layer(layer)
        except (ValueError, ImportError) as reason:
            if aloud:
                show_warning(str(reason))
            return
        self._fill(noted)
        if aloud:
            found = [str(f.label) for name, f in self._numbers().items() if noted.get(name)]
            told = ", ".join(found) or "nothing of its microscope"
            show_info(f"“{layer.name}” notes {told}.{_told_wavelengths(layer)}")

    def _fill(self, known: Noted) -> None:
        for name, field in self._numbers().items():
            if (value := known.get(name)) is not None:
                field.max = max(field.max, value)
                field.value = round(value, 6)

    def _numbers(self) -> dict[str, FloatSpinBox]:
        return {
            "numerical_aperture": self.aperture,
            "wavelength_um": self.wavelength,
            "pixel_size_um": self.pixel_size,
            "refractive_index": self.index,
        }


def noted_in_layer(layer: Image) -> Noted:
    """Return what the file of a layer notes of its microscope, and the layer's own pixel size.

    Raises
    ------
    UnreadablePicture
        If the layer's file is damaged or not there.
    ValueError
        If pixels are not square.
    """
    path = _readable_path(layer)
    noted: Noted = {} if path is None else noted_microscope(path)
    sides = [
        float(side) * MICROMETERS[str(unit)]
        for side, unit in zip(layer.scale[-2:], layer.units[-2:], strict=True)
        if str(unit) in MICROMETERS
    ]
    if noted.get("pixel_size_um") is None and sides:
        noted["pixel_size_um"] = square_side(f"“{layer.name}”", sides)
    return noted


def _readable_path(layer: Image) -> Path | None:
    """Return the file of a layer; None if there is none, or another plugin has read it."""
    path = layer.source.path
    return None if path is None or lacks_extra(Path(path)) else Path(path)


def _told_wavelengths(layer: Image) -> str:
    path = _readable_path(layer)
    if path is None or not has_several_wavelengths(path):
        return ""
    return " Its channels have different wavelengths: fill in that of the channel you measure."


def _number(
    name: str, label: str, largest: float, step: float, decimals: int, tooltip: str
) -> FloatSpinBox:
    field = FloatSpinBox(
        name=name, label=label, value=0.0, min=0.0, max=largest, step=step, tooltip=tooltip
    )
    field.native.setDecimals(decimals)
    return field
