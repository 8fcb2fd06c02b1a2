"""What the page of a report shows of a plate: wells with their fields, numbers and colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from napari_defocus.batch.blur_histogram import on_scale
from napari_defocus.batch.flags import PARTLY
from napari_defocus.batch.report_facts import MISSING, TICKS, Field, css_color
from napari_defocus.batch.thumbnails import palette
from napari_defocus.batch.wells import PlateLayout


@dataclass(frozen=True)
class Well:
    """A well of a plate: its fields, worst first."""

    name: str
    fields: tuple[Field, ...]

    @property
    def flagged(self) -> int:
        """How many of its fields have a flag."""
        return sum(bool(field.flags) for field in self.fields)

    @property
    def radius(self) -> float | None:
        """The median of the fields' blur, in px."""
        radii = [field.radius for field in self.fields if field.radius is not None]
        return float(np.median(radii)) if radii else None

    @property
    def mark(self) -> str:
        """A letter for the worst flag of its fields; empty if there is none."""
        flags = self.fields[0].flags
        return {PARTLY: "½"}.get(flags[0].name, flags[0].name[0].upper()) if flags else ""

    @property
    def colors(self) -> tuple[str, str]:
        """The colours of the cell and of its text."""
        if self.radius is None:
            return "#8a8a8a", "#000"
        level = 1 + round(254 * float(on_scale(min(self.radius, TICKS[-1]))))
        color = palette()[level]
        bright = float(color @ (0.299, 0.587, 0.114)) > 120
        return css_color(color), "#000" if bright else "#fff"

    @property
    def shown(self) -> str:
        """The number in the cell."""
        if self.radius is None:
            return MISSING
        return f"{self.radius:.0f}" if self.radius >= 9.95 else f"{self.radius:.1f}"

    @property
    def told(self) -> str:
        """What the cell says to those who do not see it."""
        radius = "not known" if self.radius is None else f"{self.radius:.1f} px"
        flags = sorted({flag.name for field in self.fields for flag in field.flags})
        many = f"{len(self.fields)} field{'s' * (len(self.fields) > 1)}"
        return f"{self.name}: {many}, blur {radius}, {', '.join(flags) or 'no flag'}"


@dataclass(frozen=True)
class Plate:
    """A plate: rows of wells, None where nothing was measured."""

    layout: PlateLayout
    rows: list[tuple[str, list[Well | None]]]
    elsewhere: int


def plate_of(fields: Sequence[Field]) -> Plate | None:
    """Return the plate that names of fields say; None if they say none."""
    held: dict[str, list[Field]] = {}
    for field in fields:
        if field.well is not None:
            held.setdefault(field.well, []).append(field)
    if not held:
        return None
    wells = {name: Well(name, tuple(those)) for name, those in held.items()}
    layout = PlateLayout.of(wells)
    rows = [
        (row, [wells.get(f"{row}{column:02d}") for column in layout.columns]) for row in layout.rows
    ]
    return Plate(layout, rows, len(fields) - sum(map(len, held.values())))
