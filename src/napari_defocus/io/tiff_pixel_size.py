"""How large a pixel of a TIFF is, how far its planes are apart: from what programs note in it."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from typing import Any

SYMBOLS_OF_UNIT = {
    "angstrom": ("Å",),
    "nanometer": ("nm",),
    "micrometer": ("µm", "micron", "microns", "micrometer"),
    "millimeter": ("mm",),
    "centimeter": ("cm",),
    "meter": ("m", "meter"),
    "inch": ("in", "inch"),
    "microsecond": ("µs",),
    "millisecond": ("ms", "msec"),
    "second": ("s", "sec"),
    "minute": ("min",),
    "hour": ("h", "hr"),
    "day": ("d",),
}
"""How OME-XML writes each unit, and then others. The keys are the names of UDUNITS and OME-Zarr."""

MICROMETERS = {
    **{"angstrom": 1e-4, "nanometer": 1e-3, "micrometer": 1.0, "millimeter": 1e3},
    **{"centimeter": 1e4, "inch": 25_400.0, "meter": 1e6},
}
"""The length of each unit, in micrometers."""

_CENTIMETERS = 3
_ESCAPED_MICRO = "\\u00B5"

PixelSize = tuple[dict[str, float], dict[str, str]]


def unit_of(symbol: str) -> str | None:
    """Return a unit in the spelling of UDUNITS; None for what is none, such as "pixel".

    Examples
    --------
    >>> unit_of("µm"), unit_of("sec"), unit_of("pixel")
    ('micrometer', 'second', None)
    """
    plain = _plain(symbol.replace(_ESCAPED_MICRO, "u").strip())
    spelt = ((unit, map(_plain, known)) for unit, known in SYMBOLS_OF_UNIT.items())
    return next((unit for unit, symbols in spelt if plain in symbols), None)


def _plain(symbol: str) -> str:
    return symbol.lower().replace("\u00b5", "u").replace("\u03bc", "u")


def pixel_size_in_tiff(tiff: Any, series: int = 0) -> PixelSize:
    """Return the pixel size along the axes, y, x, z and t, that have one, and their units.

    OME-XML is asked first, of the picture of that number, then what LSM says, then ImageJ's
    description, then the resolution tags. A resolution in dots an inch is the size of a print, and
    does not count.
    """
    if tiff.ome_metadata:
        return _ome_pixel_size(tiff.ome_metadata, series)
    if tiff.lsm_metadata:
        return _lsm_pixel_size(tiff.lsm_metadata)
    if tiff.imagej_metadata:
        return _imagej_pixel_size(tiff.imagej_metadata, tiff.pages.first)
    page = tiff.pages.first
    if page.tags.valueof("ResolutionUnit") == _CENTIMETERS:
        steps = {axis: 1e4 * step for axis, step in _steps_of_pixels(page).items()}
        return steps, dict.fromkeys(steps, "micrometer")
    return {}, {}


def _ome_pixel_size(text: str, series: int) -> PixelSize:
    all_pixels = [e for e in ElementTree.fromstring(text).iter() if e.tag.endswith("}Pixels")]
    if not all_pixels:
        return {}, {}
    noted = all_pixels[min(series, len(all_pixels) - 1)].attrib
    found = [(axis, f"PhysicalSize{axis.upper()}", "µm") for axis in "zyx"]
    steps = {
        axis: (_number(noted.get(name)), noted.get(f"{name}Unit", default))
        for axis, name, default in [*found, ("t", "TimeIncrement", "s")]
    }
    return _with_units(steps)


def _lsm_pixel_size(noted: Mapping[str, Any]) -> PixelSize:
    steps = {axis: 1e6 * float(noted.get(f"VoxelSize{axis.upper()}", 0.0)) for axis in "zyx"}
    return _with_units({axis: (step, "um") for axis, step in steps.items()})


def _imagej_pixel_size(noted: Mapping[str, Any], page: Any) -> PixelSize:
    length = str(noted.get("unit", ""))
    steps = {axis: (step, length) for axis, step in _steps_of_pixels(page).items()}
    steps["z"] = (_number(noted.get("spacing")), str(noted.get("zunit", length)))
    steps["t"] = (_number(noted.get("finterval")), str(noted.get("tunit", "s")))
    return _with_units(steps)


def _number(noted: Any) -> float:
    """Return a number as a file notes it; 0 if it notes none, or what is no number."""
    try:
        value = float(noted or 0)
    except (TypeError, ValueError):
        return 0.0
    return value if math.isfinite(value) else 0.0


def _steps_of_pixels(page: Any) -> dict[str, float]:
    steps = {}
    for axis, tag in (("y", "YResolution"), ("x", "XResolution")):
        pixels, length = page.tags.valueof(tag, default=(0, 1))
        if pixels and length:
            steps[axis] = length / pixels
    return steps


def _with_units(steps: Mapping[str, tuple[float, str]]) -> PixelSize:
    told = {axis: unit_of(unit) for axis, (step, unit) in steps.items() if step > 0}
    units = {axis: unit for axis, unit in told.items() if unit}
    return {axis: steps[axis][0] for axis in units}, units
