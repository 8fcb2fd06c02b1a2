"""What took the picture, as fields: focal length, f-number, focus distance, pixel pitch."""

import math
from dataclasses import dataclass
from pathlib import Path

from magicgui.widgets import FileEdit, LineEdit, PushButton, Widget

from napari_defocus import ThinLens
from napari_defocus.optics.exif import noted_lens, pitch_advice

INFINITY = "inf"


@dataclass(frozen=True)
class _Number:
    """What a field asks for: its label begins with the number's name."""

    name: str
    unit: str
    example: str
    tooltip: str

    def field(self, parameter: str) -> LineEdit:
        label = f"{self.name} ({self.unit})" if self.unit else self.name
        field = LineEdit(name=parameter, label=label, value="", tooltip=self.tooltip)
        field.native.setPlaceholderText(f"such as {self.example}")
        return field


_NUMBERS = {
    "focal_length_mm": _Number(
        *("focal length", "mm", "50"),
        "The real focal length, not that of a 35 mm camera with the same view.",
    ),
    "f_number": _Number(
        *("f-number", "", "2.8"),
        "The focal length over the diameter of the aperture: 2.8 for f/2.8.",
    ),
    "focus_distance_m": _Number(
        *("focus distance", "m", "1.5, or inf"),
        "From the lens to what was in focus, in metres; inf for infinity. Most cameras do not note "
        "it: measure or estimate it. All distances grow with it.",
    ),
    "pixel_pitch_um": _Number(
        *("pixel pitch", "µm", "4.3"),
        "How far the pixels of this picture are apart on the sensor, in µm: 1000 × the sensor's "
        "width in mm / the picture's width in px, if nothing was cropped. Sensors are 36 mm wide "
        "(full frame), 23.5 mm (APS-C), 17.3 mm (Four Thirds), 5 to 10 mm (phones).",
    ),
}
"""By the parameters of `ThinLens`."""

_PITCH = _NUMBERS["pixel_pitch_um"].name


class ThinLensForm:
    """The fields of a lens; empty ones are not known.

    Attributes
    ----------
    focal_length, f_number, focus_distance, pixel_pitch : magicgui.widgets.LineEdit
    file : magicgui.widgets.FileEdit
        The photograph as the camera saved it.
    read_button : magicgui.widgets.PushButton
    """

    def __init__(self) -> None:
        self._numbers = {name: number.field(name) for name, number in _NUMBERS.items()}
        self.focal_length, self.f_number, self.focus_distance, self.pixel_pitch = (
            self._numbers.values()
        )
        self.file = FileEdit(
            name="photograph",
            label="photograph",
            nullable=True,
            filter="Photographs (*.jpg *.jpeg *.tif *.tiff *.png *.webp *.bmp)",
            tooltip="The file as the camera saved it. It says how the picture was taken (EXIF), "
            "unless a program has taken that away.",
        )
        self.read_button = PushButton(
            name="read_exif",
            text="Read from file",
            tooltip="Fill in the fields below that the photograph's file notes; the others stay "
            "as they are.",
        )

    def fields(self) -> list[Widget]:
        """Return all fields, from top to bottom."""
        return [self.file, self.read_button, *self._numbers.values()]

    def lens(self, image_size: tuple[int, int] | None = None) -> ThinLens:
        """Return what the fields say.

        Parameters
        ----------
        image_size : (int, int), optional
            Height and width of the picture that is analysed, for an example in an error.

        Raises
        ------
        ValueError
            If a field is empty or holds no number, or there is no such lens.
        """
        empty = [
            _NUMBERS[name].name for name, field in self._numbers.items() if not field.value.strip()
        ]
        if empty:
            advice = _advice(image_size) if _PITCH in empty else ""
            raise ValueError(
                f"Fill in the {_enumerated(empty)} of the lens: distances cannot be told without."
                f"{advice}"
            )
        values = {name: _number(name, field.value) for name, field in self._numbers.items()}
        focal_length_m, distance = values["focal_length_mm"] / 1000, values["focus_distance_m"]
        if distance <= focal_length_m:
            raise ValueError(
                f"The focus distance is {distance:g} m, which is not beyond the focal length, "
                f"{focal_length_m:g} m. Is it in metres?"
            )
        return ThinLens(**values)

    def read(self, image_size: tuple[int, int] | None) -> str:
        """Fill in what a photograph's file notes, and return what it does and what it lacks.

        Parameters
        ----------
        image_size : (int, int) or None
            Height and width of the picture that is analysed.

        Raises
        ------
        ValueError
            If no file is chosen, or it cannot be read.
        """
        if self.file.value is None:
            raise ValueError("Choose the photograph's file first, as the camera saved it.")
        path = Path(str(self.file.value))
        typed = self.focal_length.value.strip()
        known = noted_lens(path, _number("focal_length_mm", typed) if typed else None, image_size)
        noted = {name: value for name, value in known.values.items() if value is not None}
        for name, value in noted.items():
            self._numbers[name].value = INFINITY if math.isinf(value) else f"{value:.6g}"
        found = [_NUMBERS[name].name for name in noted]
        missing = [number.name for name, number in _NUMBERS.items() if name not in noted]
        lines = [f"{path.name} notes {_enumerated(found) if found else 'nothing'}."]
        if known.pitch_from is not None:
            lines.append(f"The pixel pitch is {known.pitch_from}.")
        if missing:
            advice = _advice(known.image_size) if _PITCH in missing else ""
            lines.append(f"Not noted: {_enumerated(missing)}. Please fill in.{advice}")
        return "\n".join(lines)


def _advice(image_size: tuple[int, int] | None) -> str:
    return f" {pitch_advice(image_size, 'µ')}."


def _number(parameter: str, text: str) -> float:
    asked = _NUMBERS[parameter]
    try:
        value = math.inf if text.strip().lower() in ("∞", "infinity") else float(text)
    except ValueError:
        value = math.nan
    if not value > 0 or (math.isinf(value) and parameter != "focus_distance_m"):
        in_unit = f" in {asked.unit}" if asked.unit else ""
        raise ValueError(
            f"The {asked.name} is “{text}”. Type a number above 0{in_unit}, such as "
            f"{asked.example}."
        )
    return value


def _enumerated(names: list[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
