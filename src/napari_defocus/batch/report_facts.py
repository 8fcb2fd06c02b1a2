"""What the page of a report shows of fields, wells and settings: numbers and words, no HTML."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

import numpy as np

from napari_defocus.batch.blur_histogram import bin_edges, on_scale
from napari_defocus.batch.flags import SATURATED, WORST_FIRST, Flag, badness, flags_of
from napari_defocus.batch.sources import LARGEST_AT_ONCE
from napari_defocus.batch.table import DONE, Row
from napari_defocus.batch.thumbnails import (
    BLUR,
    DETAIL,
    OUTLINE,
    palette,
    small_size,
)
from napari_defocus.batch.wells import plates_of
from napari_defocus.core.picture_remarks import saturation_remark
from napari_defocus.likelihood.signs import NOTHING_SEEN, ONE_DIRECTION
from napari_defocus.settings import FieldLimits

TICKS = (0, 1, 2, 4, 8, 16, 32, 64)
"""px that are written below histograms and at the colour bar."""

_SAID_BY_FLAGS = (NOTHING_SEEN, ONE_DIRECTION)

_PLOT = (200, 40)
"""Width and height of a histogram in its own units."""

MISSING = "–"


@dataclass(frozen=True, eq=False)
class Field:
    """A row of the table as the page shows it.

    `number` is its place, worst first; `plate` the name of its plate, if there are several.
    """

    number: int
    row: Row
    flags: tuple[Flag, ...]
    plate: str = ""

    @property
    def title(self) -> str:
        """The name of the picture, and the plane of a stack."""
        name = PurePath(self.row["source"]).name
        return " ".join(filter(None, (name, self.row.get("plane"))))

    @property
    def well(self) -> str | None:
        """A01 to P24, if names say wells."""
        return self.row.get("well")

    @property
    def radius(self) -> float | None:
        """The median of the blur that is known, in px."""
        return self.row.get("median_known_radius_px")

    @property
    def in_focus(self) -> str:
        """The share of what is known that is in focus by the limits."""
        return _percent(self.row.get("share_within_limit"))

    @property
    def known(self) -> str:
        """The share of the field whose blur is known."""
        return _percent(self.row.get("share_sure"))

    @property
    def picture_link(self) -> str:
        """The picture itself."""
        return _link(self.row["link"])

    @property
    def map_link(self) -> str | None:
        """The map, if it is a file."""
        place = self.row.get("map")
        return _link(place) if place else None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the thumbnail, in px."""
        height, width = small_size(self.row["height"], self.row["width"])
        return width, height

    @property
    def small(self) -> dict[str, str] | None:
        """The small pictures."""
        place = self.row.get("thumbnail")
        if not place:
            return None
        begin = place.removesuffix(".jpg")
        ends = {"picture": ".jpg", "outline": OUTLINE, "blur": BLUR, "detail": DETAIL}
        return {name: _link(begin + end) for name, end in ends.items()}

    @property
    def notes(self) -> list[str]:
        """What else the reader should know."""
        row, careful = self.row, self.row.get("careful") or ""
        for said in _SAID_BY_FLAGS:
            careful = careful.replace(said, "")
        if SATURATED in (flag.name for flag in self.flags):
            careful = careful.replace(saturation_remark(row["share_saturated"]), "")
        told = [careful.strip()] if careful.strip() else []
        if row["status"] == DONE and row["width"] * row["height"] > LARGEST_AT_ONCE:
            told.append("Motion is not looked for in so large a picture.")
        return told

    @property
    def sort_keys(self) -> dict[str, float | str]:
        """What the columns are sorted by; what is not known comes last."""
        numbers = {
            "blur": self.radius,
            "focus": self.row.get("share_within_limit"),
            "known": self.row.get("share_sure"),
        }
        return {name: -1.0 if value is None else value for name, value in numbers.items()}

    @cached_property
    def bars(self) -> str:
        """The histogram of the blur that is known, as the path of an SVG."""
        counts = self.row.get("blur_histogram") or []
        return bars_of(counts) if sum(counts) else ""


def _percent(share: float | None) -> str:
    return MISSING if share is None else f"{100 * share:.0f} %"


def _link(path: str) -> str:
    return path if ":" in path.partition("/")[0] else quote(path, errors="surrogateescape")


def fields_of(rows: Sequence[Row], limits: FieldLimits) -> list[Field]:
    """Return the fields of judged rows, worst first; alike ones as the table has them."""
    ranked = sorted(rows, key=badness)
    plates = plates_of(row["source"] for row in rows)
    return [
        Field(at + 1, row, flags_of(row, limits), plates.get(row["source"], ""))
        for at, row in enumerate(ranked)
    ]


def name_of(fields: Sequence[Field], place: PurePath) -> str:
    """Return the name of the folder of the pictures, or how many folders there are.

    Links of the fields begin at `place`, the folder of the batch.
    """
    folders = {os.path.normpath(place / PurePath(field.row["link"]).parent) for field in fields}
    if len(folders) != 1:
        return f"{len(folders)} folders"
    return PurePath(folders.pop()).name or "one folder"


def bars_of(counts: Sequence[int]) -> str:
    """Return a histogram as the outline of its bars, two bins each, for an SVG of `_PLOT` units.

    Examples
    --------
    >>> bars_of([1, 2, 0, 0])
    'M0 40V0H100V40H200V40Z'
    """
    width, height = _PLOT
    pairs = [sum(counts[at : at + 2]) for at in range(0, len(counts), 2)]
    step, most = width / len(pairs), max(pairs)
    tops = [height - math.ceil(height * count / most) for count in pairs]
    ends = [round(step * (at + 1), 1) for at in range(len(pairs))]
    bars = "".join(f"V{top}H{end:g}" for top, end in zip(tops, ends, strict=True))
    return f"M0 {height}{bars}V{height}Z"


def place_on_plot(radius: float) -> float:
    """Return where a radius in px is along a histogram, in its units."""
    return round(_PLOT[0] * float(on_scale(radius)), 1)


# The top of the page.


@dataclass(frozen=True)
class Summary:
    """How many fields have which flag, and how their medians are distributed."""

    total: int
    flagged: int
    counts: dict[str, int]
    by_limit: dict[str, str]
    bars: str
    median: float | None
    ticks: list[tuple[int, float]]
    limit_at: float
    colors: list[str]


def summary_of(fields: Sequence[Field], limits: FieldLimits) -> Summary:
    """Return the numbers of all fields."""
    counts = Counter(flag.name for field in fields for flag in field.flags)
    radii = [field.radius for field in fields if field.radius is not None]
    held, _ = np.histogram(radii, bin_edges())
    return Summary(
        total=len(fields),
        flagged=sum(bool(field.flags) for field in fields),
        counts={name: counts[name] for name in WORST_FIRST},
        by_limit=_limits_told(limits),
        bars=bars_of(held.tolist()) if radii else "",
        median=float(np.median(radii)) if radii else None,
        ticks=[(tick, place_on_plot(tick)) for tick in TICKS],
        limit_at=place_on_plot(limits.in_focus_up_to),
        colors=[css_color(color) for color in palette()[1::6]],
    )


def _limits_told(limits: FieldLimits) -> dict[str, str]:
    """Return when each of the flags is set, in words."""
    percent = {
        name: f"{100 * getattr(limits, name):g} %"
        for name in ("min_share_in_focus", "min_share_known", "max_share_saturated")
    }
    radius = f"{limits.in_focus_up_to:g} px"
    words = (
        "the picture could not be read or measured",
        "nearly all details lie in one direction, as after motion, or agree in it by more than "
        f"{limits.max_one_direction:g} of 1: the radii say little",
        f"the median of the known blur is above {radius}",
        f"less than {percent['min_share_in_focus']} of what is known is blurred by at most "
        f"{radius}",
        f"more than {percent['max_share_saturated']} of the pixels are as bright as can be",
        f"the blur is known on less than {percent['min_share_known']}, or there is only noise",
    )
    return dict(zip(WORST_FIRST, words, strict=True))


def settings_told(made_with: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return what the batch was made with, name by name."""
    flat: list[tuple[str, str]] = []
    for name, value in made_with.items():
        if isinstance(value, Mapping):
            flat += [(f"{name}: {key}", _told(held)) for key, held in value.items()]
        else:
            flat.append((name, _told(value)))
    return [(name.replace("_", " "), value) for name, value in flat]


def _told(value: Any) -> str:
    return "not given" if value is None else str(value)


def css_color(color: Sequence[int]) -> str:
    """Return a colour of 8 bits a channel as CSS has it.

    Examples
    --------
    >>> css_color((255, 0, 16))
    '#ff0010'
    """
    return "#" + "".join(f"{int(channel):02x}" for channel in color[:3])
