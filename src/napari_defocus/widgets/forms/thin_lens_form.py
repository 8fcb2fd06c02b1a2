"""What took the picture, as fields: focal length, f-number, focus distance, pixel pitch."""

import math
from contextlib import suppress
from pathlib import Path

from magicgui.widgets import FileEdit, LineEdit, PushButton, Widget

from napari_defocus import ThinLens

INFINITY = "inf"

_NAMES = {
    "focal_length_mm": "focal length",
    "f_number": "f-number",
    "focus_distance_m": "focus distance",
    "pixel_pitch_um": "pixel pitch",
}
_EXAMPLES = {
    "focal_length_mm": "50",
    "f_number": "2.8",
    "focus_distance_m": "1.5, or inf",
    "pixel_pitch_um": "4.3",
}
_ANY_LENS: dict[str, float] = {
    "focal_length_mm": 1.0,
    "f_number": 1.0,
    "focus_distance_m": math.inf,
    "pixel_pitch_um": 1.0,
}


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
        self.focal_length = _field(
            "focal_length_mm",
            "focal length (mm)",
            "The real focal length, not that of a 35 mm camera with the same view.",
        )
        self.f_number = _field(
            "f_number",
            "f-number",
            "The focal length over the diameter of the aperture: 2.8 for f/2.8.",
        )
        self.focus_distance = _field(
            "focus_distance_m",
            "focus distance (m)",
            "From the lens to what was in focus, in metres; inf for infinity. Most cameras do "
            "not note it: measure or estimate it. All distances grow with it.",
        )
        self.pixel_pitch = _field(
            "pixel_pitch_um",
            "pixel pitch (µm)",
            "How far the pixels of this picture are apart on the sensor, in µm. A picture scaled "
            "down to a half has twice the pitch of the sensor.",
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
        return [self.file, self.read_button, *self._numbers().values()]

    def _numbers(self) -> dict[str, LineEdit]:
        fields = self.focal_length, self.f_number, self.focus_distance, self.pixel_pitch
        return dict(zip(_NAMES, fields, strict=True))

    def lens(self) -> ThinLens:
        """Return what the fields say.

        Raises
        ------
        ValueError
            If a field is empty or holds no number, or there is no such lens.
        """
        empty = [_NAMES[name] for name, field in self._numbers().items() if not field.value.strip()]
        if empty:
            raise ValueError(
                f"Fill in the {_enumerated(empty)} of the lens: distances cannot be told without."
            )
        values = {name: _number(name, field.value) for name, field in self._numbers().items()}
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
        noted = noted_in(path, image_size, _number("focal_length_mm", typed) if typed else None)
        for name, value in noted.items():
            self._numbers()[name].value = INFINITY if math.isinf(value) else f"{value:.6g}"
        found = [_NAMES[name] for name in noted]
        missing = [_NAMES[name] for name in _NAMES if name not in noted]
        lines = [f"{path.name} notes {_enumerated(found) if found else 'nothing'}."]
        if missing:
            lines.append(f"Not noted: {_enumerated(missing)}. Please fill in.")
        return "\n".join(lines)


def noted_in(
    path: Path, image_size: tuple[int, int] | None, focal_length_mm: float | None
) -> dict[str, float]:
    """Return what a photograph's file notes of its lens, by the names of `ThinLens`.

    Parameters
    ----------
    path : Path
    image_size : (int, int) or None
        See `ThinLens.from_exif`.
    focal_length_mm : float or None
        What is known without the file: some pitches follow from it.

    Raises
    ------
    ValueError
        If the file cannot be read.
    """

    def read(**given: float) -> ThinLens:
        return ThinLens.from_exif(path, **given, image_size=image_size)

    read(**_ANY_LENS)
    noted: dict[str, float] = {}
    for name in _NAMES:
        # A pitch that follows from the focal length is not known without it.
        known = noted.get("focal_length_mm", focal_length_mm)
        lengths = (1.0, 2.0) if known is None else (known,)
        others = {other: _ANY_LENS[other] for other in _NAMES if other != name}
        # What is missing raises.
        with suppress(ValueError):
            if name == "pixel_pitch_um":
                found = {read(**others | {"focal_length_mm": f}).pixel_pitch_um for f in lengths}
            else:
                found = {getattr(read(**others), name)}
            if len(found) == 1:
                noted[name] = found.pop()
    return noted


def _field(name: str, label: str, tooltip: str) -> LineEdit:
    field = LineEdit(name=name, label=label, value="", tooltip=tooltip)
    field.native.setPlaceholderText(f"such as {_EXAMPLES[name]}")
    return field


def _number(name: str, text: str) -> float:
    unit = name.rpartition("_")[2]
    try:
        value = math.inf if text.strip().lower() in ("∞", "infinity") else float(text)
    except ValueError:
        value = math.nan
    if not value > 0 or (math.isinf(value) and name != "focus_distance_m"):
        in_unit = "" if name == "f_number" else f" in {unit.replace('um', 'µm')}"
        raise ValueError(
            f"The {_NAMES[name]} is “{text}”. Type a number above 0{in_unit}, such as "
            f"{_EXAMPLES[name]}."
        )
    return value


def _enumerated(names: list[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
