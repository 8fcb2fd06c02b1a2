"""The table of a batch: a row a plane, from counts of its pixels, as CSV and as JSON lines."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.batch.blur_histogram import blur_histogram
from napari_defocus.io.tiff_pixel_size import MICROMETERS
from napari_defocus.psf.families import PSFFamily
from napari_defocus.psf.microscope import Microscope
from napari_defocus.settings import CONFIDENT, UNKNOWN

Row = dict[str, Any]

RADIUS_STEP = 0.01
"""px; percentiles of radii are known to half of it."""

CONFIDENCE_STEP = 0.001

PERCENTILES = (5, 25, 50, 75, 95)

DONE, FAILED = "done", "failed"

_RADII = {
    percent: "median_radius_px" if percent == 50 else f"p{percent}_radius_px"
    for percent in PERCENTILES
}
_IN_UM = {
    _RADII[percent]: _RADII[percent].replace("radius_px", "defocus_um") for percent in (5, 50, 95)
}
"""Columns in um, of microscopes alone, by those in px."""

RESULTS = ("map", "confidence", "mask", "in_focus", "thumbnail")
"""Columns that say where results are; empty for those that were not asked for."""

JUDGED = ("share_within_limit", "flags", "well")
"""Columns that follow from the others, from limits and from names; see `judged_rows`."""

_NOT_UNICODE = "backslashreplace"
"""How names of files that are no Unicode, as old archives have them, are written: a byte becomes
\\udcdc or so, which JSON reads back.
"""

BESIDE = ("blur_histogram", "link")
"""What only the JSON lines have: pixels that are known in each bin of `blur_histogram`, and the
path of the source from the folder of the table.
"""

LEFT = "share_left_as_it_was"
"""Column that says which share of a plane was not restored, as it would get rings."""

COLUMNS = (
    *("source", "plane", "status", "error", "width", "height"),
    *_RADII.values(),
    *_IN_UM.values(),
    *("threshold_px", "share_in_focus", "share_in_mask", "median_confidence", "share_sure", LEFT),
    "careful",
    *("median_known_radius_px", "share_saturated", "one_direction", *JUDGED),
    "noise_variance",
    *("intensity_low", "intensity_high", "contrast"),
    *("pixel_width_um", "pixel_height_um"),
    *RESULTS,
)


@dataclass(frozen=True, eq=False)
class PixelCounts:
    """How many pixels have which radius and which confidence; counts of parts can be added.

    Radii are rounded to 0.01 px and confidences to 0.001. Pixels with a confidence of 0.5 or more
    are `sure`, and have `known_radii`. Of these, so many are in focus by the map. A mask says of so
    many pixels whether they are in focus (`judged`), and that so many are (`in_mask`).
    """

    radii: NDArray[np.int64]
    known_radii: NDArray[np.int64]
    confidences: NDArray[np.int64]
    in_focus: int
    sure: int
    in_mask: int = 0
    judged: int = 0

    def __add__(self, other: PixelCounts) -> PixelCounts:
        """Return the counts of both parts."""
        return PixelCounts(**{name: vars(other)[name] + own for name, own in vars(self).items()})

    def note(self) -> dict[str, Any]:
        """Return the counts as JSON holds them."""
        return {name: np.asarray(counts).tolist() for name, counts in vars(self).items()}

    @classmethod
    def of_note(cls, note: Mapping[str, Any]) -> PixelCounts:
        """Return the counts of a `note`."""
        radii, known, confidences = (
            np.array(note[key], np.int64) for key in ("radii", "known_radii", "confidences")
        )
        numbers = {name: note[name] for name in ("in_focus", "sure", "in_mask", "judged")}
        return cls(radii, known, confidences, **numbers)

    def facts(self) -> Row:
        """Return what a row says of them; None where no pixel counts, and radii if none is sure."""
        count = int(self.radii.sum())
        radii = {
            name: _percentile(self.radii, percent, RADIUS_STEP) if self.sure else None
            for percent, name in _RADII.items()
        }
        return {
            **radii,
            "share_in_focus": self.in_focus / self.sure if self.sure else None,
            "share_in_mask": self.in_mask / self.judged if self.judged else None,
            "median_confidence": _percentile(self.confidences, 50, CONFIDENCE_STEP),
            "share_sure": self.sure / count if count else None,
            "median_known_radius_px": _percentile(self.known_radii, 50, RADIUS_STEP),
            "blur_histogram": blur_histogram(self.known_radii, RADIUS_STEP),
        }


def count_pixels(
    blur_map: NDArray[Any],
    confidence: NDArray[Any],
    mask: NDArray[Any] | None,
    *,
    threshold: float,
    max_scale: float,
    within: NDArray[Any] | None = None,
) -> PixelCounts:
    """Count the pixels of a map, or of a part of it, (H, W) in px.

    What is not finite, or has no confidence, such as where a picture is transparent, does not
    count, nor does what is 0 in `within`. Radii up to `threshold` are in focus; none is above
    `max_scale`. A mask is counted where it says something.

    Examples
    --------
    >>> counts = count_pixels(
    ...     np.array([[1.0, 4.0]]), np.array([[0.9, 0.8]]), None, threshold=2.0, max_scale=8.0)
    >>> counts.facts()["share_in_focus"], (counts + counts).facts()["p95_radius_px"]
    (0.5, 4.0)
    """
    counting = np.isfinite(blur_map) & (confidence > 0)
    if within is not None:
        counting &= within != 0
    radius, sure = blur_map[counting], confidence[counting]
    known = sure >= CONFIDENT
    said = np.full(radius.shape, UNKNOWN) if mask is None else mask[counting]
    bins = math.ceil(max_scale / RADIUS_STEP) + 1
    return PixelCounts(
        _histogram(radius, RADIUS_STEP, bins),
        _histogram(radius[known], RADIUS_STEP, bins),
        _histogram(sure, CONFIDENCE_STEP, round(1 / CONFIDENCE_STEP) + 1),
        in_focus=int((known & (radius <= threshold)).sum()),
        sure=int(known.sum()),
        in_mask=int((said == 1).sum()),
        judged=int((said != UNKNOWN).sum()),
    )


def _histogram(values: NDArray[Any], step: float, bins: int) -> NDArray[np.int64]:
    nearest = np.rint(values.astype(np.float64) / step).astype(np.int64)
    return np.bincount(np.clip(nearest, 0, bins - 1), minlength=bins).astype(np.int64)


def _percentile(counts: NDArray[np.int64], percent: float, step: float) -> float | None:
    """Return the smallest value that so many percent of the pixels do not exceed."""
    total = counts.cumsum()
    if not total[-1]:
        return None
    return step * int(np.searchsorted(total, percent / 100 * total[-1]))


def defocus_facts(row: Row, psf: PSFFamily) -> Row:
    """Return what a row says in um, if a microscope took its picture."""
    if not isinstance(psf, Microscope):
        return {}
    known = {um: row[px] for px, um in _IN_UM.items()}
    return {um: None if px is None else psf.defocus_um(px) for um, px in known.items()}


def source_facts(source: str, pixel_size: Mapping[str, float], units: Mapping[str, str]) -> Row:
    """Return what a row says of where its picture is from."""
    sizes = {
        name: pixel_size[axis] * MICROMETERS[units[axis]]
        for axis, name in (("x", "pixel_width_um"), ("y", "pixel_height_um"))
        if axis in pixel_size and units.get(axis) in MICROMETERS
    }
    return {"source": source, **sizes}


def in_csv(rows: Iterable[Row]) -> bytes:
    """Return rows as a CSV file of all `COLUMNS`; what is not known is empty."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([COLUMNS, *map(_cells, rows)])
    return text.getvalue().encode(errors=_NOT_UNICODE)


def in_json_lines(rows: Iterable[Row]) -> bytes:
    """Return rows as JSON objects, one a line: `COLUMNS` and `BESIDE`; null if not known."""
    objects = (
        dict(zip(COLUMNS, _cells(row), strict=True)) | {name: row.get(name) for name in BESIDE}
        for row in rows
    )
    return "".join(f"{json.dumps(row, ensure_ascii=False)}\n" for row in objects).encode(
        errors=_NOT_UNICODE
    )


def rounded(row: Row) -> Row:
    """Return a row with its numbers as tables have them: to six digits."""
    return {
        name: float(f"{cell:.6g}") if isinstance(cell, float) else cell
        for name, cell in row.items()
    }


def _cells(row: Row) -> list[Any]:
    return [rounded(row).get(column) for column in COLUMNS]
