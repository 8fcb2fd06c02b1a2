"""What is in focus as a table: one row a region, and one for what is blurred."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import check_real
from napari_defocus.core.image import given_array
from napari_defocus.core.writing import write_results
from napari_defocus.labeling.known import checked_within
from napari_defocus.settings import CONFIDENT, UNKNOWN

MIN_AREA = 16
"""Smaller regions, in px, are left out unless another area is asked for: one block of the map."""

BLURRED, IN_FOCUS = "blurred", "in focus"

_EIGHT_NEIGHBOURS = 2
_CSV_DIGITS = 6


@dataclass(frozen=True, eq=False)
class RegionTable:
    """Measurements of regions, one row each.

    Attributes
    ----------
    columns : mapping of str to (N,) ndarray
        ``index``, the label; ``part``, "blurred" or "in focus"; ``area_px``, and ``area_um2`` or
        the like if the size of the pixels is known; ``share_percent`` of all that is known;
        ``row`` and ``column`` of the centroid, in px; ``top``, ``left``, ``bottom``, ``right``, the
        bounding box, in px, whose ends are not in it. With a blur map ``blur_median_px``,
        ``blur_p5_px``, ``blur_p95_px``, its median and percentiles. With a confidence
        ``confidence_mean``, and ``confident_percent``, how much of the region has 0.5 or more.
        NaN is unknown: a region of no area, or where the map has no values.
    """

    columns: Mapping[str, NDArray[Any]]

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.columns["index"])

    def as_csv(self) -> bytes:
        """Return the table as text in UTF-8, values separated by commas; unknown ones are empty."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(
            [_cell(value) for value in row] for row in zip(*self.columns.values(), strict=True)
        )
        return text.getvalue().encode()

    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> None:
        """Write the table to a CSV file, whole or not at all.

        Parameters
        ----------
        path : path-like
        force : bool, optional
            Whether a file that exists is overwritten.

        Raises
        ------
        TypeError
            If `force` is neither True nor False.
        OSError
            If it cannot be written, or exists and `force` is not set.
        """
        write_results({Path(path): self.as_csv()}, force=force)


def measure_regions(
    in_focus: ArrayLike,
    blur_map: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
    *,
    pixel_size: float | Sequence[float] | None = None,
    unit: str = "unit",
    min_area: int = MIN_AREA,
    within: ArrayLike | None = None,
) -> tuple[NDArray[np.int32], RegionTable]:
    """Number the regions that are in focus, and measure them.

    Pixels in focus that touch, also diagonally, are one region. The largest one is number 1.

    Parameters
    ----------
    in_focus : (H, W) array_like of bool or integers
        From `segment_in_focus`: 0 blurred, 2 not known, else in focus. What is not known is in no
        row.
    blur_map : (H, W) array_like, optional
        From `label_blur_map`, in px; NaN is not known.
    confidence : (H, W) array_like, optional
        From `confidence_map`.
    pixel_size : float or (float, float), optional
        Height and width of a pixel, in `unit`; one number for both.
    unit : str, optional
        The unit of `pixel_size`, such as "um". It becomes part of the column's name.
    min_area : int, optional
        Regions of fewer px are left out: they get the label 0 and no row.
    within : (H, W) array_like of bool or integers, optional
        What counts, where it is not 0, such as tissue or cells.

    Returns
    -------
    labels : (H, W) int32 ndarray
        0 where blurred, and the number of the region where in focus.
    table : RegionTable
        The first row is all that is blurred (index 0). Then each region has a row.

    Raises
    ------
    TypeError
        If `in_focus` holds neither bool nor integers, or the others no real numbers.
    ValueError
        If arrays differ in shape, `blur_map` or `confidence` is out of range, or `pixel_size` or
        `min_area` is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> in_focus = np.zeros((40, 50), np.uint8)
    >>> in_focus[5:15, 10:40] = in_focus[30:35, :10] = 1
    >>> labels, table = measure_regions(in_focus, np.where(in_focus, 0.5, 4.0))
    >>> table.columns["area_px"].tolist(), table.columns["blur_median_px"].tolist()
    ([1650, 300, 50], [4.0, 0.5, 0.5])
    """
    from skimage.measure import label

    mask, known = _checked_mask(in_focus, within)
    check_real("min_area", min_area, "a whole number of px from 1 up")
    if not 1 <= min_area < math.inf or min_area != int(min_area):
        raise ValueError(f"min_area is {min_area!r}; it takes a whole number of px from 1 up")
    measures = _Measures.of(mask.shape, blur_map, confidence, pixel_size, unit)
    found = label(mask, connectivity=_EIGHT_NEIGHBOURS)
    labels = _by_area(found, int(min_area))
    left_out = (mask & (labels == 0)) | ~known
    numbers = range(int(labels.max()) + 1)
    parts = [BLURRED] + [IN_FOCUS] * (len(numbers) - 1)
    rows = np.where(left_out, -1, labels)
    return labels, _table(rows, numbers, parts, measures, int(known.sum()))


def measure_focus(
    in_focus: ArrayLike,
    blur_map: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
    *,
    pixel_size: float | Sequence[float] | None = None,
    unit: str = "unit",
    within: ArrayLike | None = None,
) -> RegionTable:
    """Measure what is blurred (index 0) and what is in focus (index 1), as `measure_regions`."""
    mask, known = _checked_mask(in_focus, within)
    measures = _Measures.of(mask.shape, blur_map, confidence, pixel_size, unit)
    labels = np.where(known, mask.astype(np.int32), -1)
    return _table(labels, range(2), [BLURRED, IN_FOCUS], measures, int(known.sum()))


def _by_area(found: NDArray[Any], min_area: int) -> NDArray[np.int32]:
    """Renumber labels from the largest to the smallest that is large enough; 0 stays."""
    areas = np.bincount(found.ravel())
    areas[0] = 0
    ordered = np.argsort(-areas, kind="stable")
    ordered = ordered[areas[ordered] >= min_area]
    number_of = np.zeros(len(areas), np.int32)
    number_of[ordered] = np.arange(1, len(ordered) + 1)
    return number_of[found]


@dataclass(frozen=True, eq=False)
class _Measures:
    """What is measured of every region; None is left out of the table."""

    blur_map: NDArray[Any] | None
    confidence: NDArray[Any] | None
    pixel_area: float | None
    unit: str

    @classmethod
    def of(
        cls,
        shape: tuple[int, ...],
        blur_map: ArrayLike | None,
        confidence: ArrayLike | None,
        pixel_size: float | Sequence[float] | None,
        unit: str,
    ) -> _Measures:
        return cls(
            _checked_values("blur_map", blur_map, shape, math.inf, "finite scales from 0 px up"),
            _checked_values("confidence", confidence, shape, 1.0, "values from 0 to 1"),
            _pixel_area(pixel_size),
            _checked_unit(unit).replace("µ", "u").replace("μ", "u"),
        )

    def at(self, where: NDArray[np.bool_], box: tuple[slice, ...]) -> dict[str, float]:
        """Return the blur and the confidence of pixels within a box."""
        measured: dict[str, float] = {}
        if self.blur_map is not None:
            low, median, high = _percentiles(self.blur_map[box][where])
            measured |= {"blur_median_px": median, "blur_p5_px": low, "blur_p95_px": high}
        if self.confidence is not None:
            sure = self.confidence[box][where]
            sure = sure[~np.isnan(sure)]
            measured["confidence_mean"] = float(sure.mean()) if sure.size else math.nan
            share = float((sure >= CONFIDENT).mean()) if sure.size else math.nan
            measured["confident_percent"] = 100.0 * share
        return measured


def _percentiles(values: NDArray[Any]) -> NDArray[Any]:
    known = values[~np.isnan(values)]
    return np.percentile(known, [5, 50, 95]) if known.size else np.full(3, np.nan)


def _table(
    labels: NDArray[Any], numbers: range, parts: list[str], measures: _Measures, known: int
) -> RegionTable:
    """Measure labels from 0 up; -1 is none. Shares are those of so many known px."""
    from skimage.measure import regionprops

    found = {region.label - 1: region for region in regionprops(labels + 1)}
    rows = [
        {"index": number, "part": part} | _row(found.get(number), known, measures)
        for number, part in zip(numbers, parts, strict=True)
    ]
    return RegionTable({name: np.array([row[name] for row in rows]) for name in rows[0]})


def _row(region: Any, size: int, measures: _Measures) -> dict[str, Any]:
    area = 0 if region is None else int(region.area)
    row: dict[str, Any] = {"area_px": area}
    if measures.pixel_area is not None:
        row[f"area_{measures.unit}2"] = area * measures.pixel_area
    row["share_percent"] = 100.0 * area / size if size else math.nan
    row["row"], row["column"] = (math.nan, math.nan) if region is None else region.centroid
    box = (0, 0, 0, 0) if region is None else region.bbox
    row |= dict(zip(("top", "left", "bottom", "right"), box, strict=True))
    if region is None:
        return row | measures.at(np.zeros((0, 0), np.bool_), np.s_[:0, :0])
    return row | measures.at(region.image, region.slice)


def _checked_mask(
    in_focus: ArrayLike, within: ArrayLike | None
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return what is in focus, and what is known and counts."""
    mask = given_array("in_focus", in_focus)
    if mask.dtype.kind not in "bui":
        raise TypeError(f"in_focus has dtype {mask.dtype}; it takes bool or integers")
    if mask.ndim != 2 or not mask.size:
        raise ValueError(f"in_focus has shape {mask.shape}; it takes a mask of (height, width)")
    known = mask != UNKNOWN if mask.dtype.kind != "b" else np.ones(mask.shape, np.bool_)
    if within is not None:
        known &= checked_within(within, mask.shape)
    return (mask != 0) & known, known


def _checked_values(
    name: str, given: ArrayLike | None, shape: tuple[int, ...], highest: float, takes: str
) -> NDArray[Any] | None:
    if given is None:
        return None
    values = given_array(name, given)
    if values.dtype.kind not in "uif":
        raise TypeError(f"{name} has dtype {values.dtype}; it takes real numbers")
    if values.shape != shape:
        raise ValueError(f"{name} has shape {values.shape}; it takes that of in_focus, {shape}")
    known = values[~np.isnan(values)]
    if known.size and not (0 <= known.min() <= known.max() <= highest and known.max() < math.inf):
        raise ValueError(
            f"{name} has values from {known.min():g} to {known.max():g}; it takes {takes}"
        )
    return values


def _checked_unit(unit: str) -> str:
    if not isinstance(unit, str):
        raise TypeError(f"unit is {unit!r}; it takes a text such as 'um'")
    return unit


def _pixel_area(pixel_size: float | Sequence[float] | None) -> float | None:
    if pixel_size is None:
        return None
    try:
        sides = np.atleast_1d(np.asarray(pixel_size, np.float64))
    except (TypeError, ValueError):
        raise TypeError(
            f"pixel_size is {pixel_size!r}; it takes a number, or two for height and width"
        ) from None
    if sides.shape not in ((1,), (2,)) or not ((sides > 0) & np.isfinite(sides)).all():
        raise ValueError(
            f"pixel_size is {pixel_size}; it takes a positive number, or two for height and width"
        )
    return float(sides[0] * sides[-1])


def _cell(value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    return "" if math.isnan(value) else f"{value:.{_CSV_DIGITS}g}"
