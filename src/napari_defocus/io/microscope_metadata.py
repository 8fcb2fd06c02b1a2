"""What a file notes of the microscope that took it: OME-XML, and the pixel size of any TIFF."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from napari_defocus.io.file_kinds import microscope_format
from napari_defocus.io.microscope_files import leica_objective, ome_xml_of, open_microscope_file
from napari_defocus.io.ome_zarr import is_zarr, read_ome_zarr
from napari_defocus.io.pictures import is_tiff, reading
from napari_defocus.io.slides import is_for_openslide, open_slide
from napari_defocus.io.tiff_pixel_size import MICROMETERS, PixelSize, pixel_size_in_tiff, unit_of
from napari_defocus.io.tiff_series import picture_number
from napari_defocus.psf.microscope import IMMERSIONS, Microscope, Specimen

_IMMERSION_OF = {
    "air": "air",
    "oil": "oil",
    "water": "water",
    "waterdipping": "water",
    "glycerol": "glycerol",
}
"""How OME-XML calls what is between an objective and the specimen."""

_NOT_SQUARE = 0.01
"""Pixels whose sides differ by a larger share are not square. By hand."""

_XML_IN_STORES = ("OME/METADATA.ome.xml", "../OME/METADATA.ome.xml")
"""Where bioformats2raw puts OME-XML, from a store's own folder."""

_WHAT = {
    "numerical_aperture": "the numerical aperture",
    "wavelength_um": "the wavelength of emission",
    "pixel_size_um": "the pixel size",
    "refractive_index": "the immersion",
}

Noted = dict[str, float | None]


class IncompleteMicroscope(ValueError):
    """Numbers of a microscope are neither given nor noted."""


def read_microscope(
    path: str | os.PathLike[str],
    *,
    numerical_aperture: float | None = None,
    wavelength_um: float | None = None,
    pixel_size_um: float | None = None,
    refractive_index: float | None = None,
    specimen: Specimen = "auto",
    channel: int | None = None,
) -> Microscope:
    """Take the microscope from what a picture's file notes, and from what you give instead.

    OME-TIFF, OME-XML, CZI, ND2 and the OME-Zarr stores of bioformats2raw note all of it if the
    microscope's program did; LIF files note no wavelength. Of other files, the pixel size is read.

    Parameters
    ----------
    path : path-like
        The picture, or a file of OME-XML that belongs to it.
    numerical_aperture, wavelength_um, pixel_size_um, refractive_index : float, optional
        What the file does not note, or notes wrongly; see `Microscope`. They count more.
    specimen : {"auto", "texture", "points"}, optional
        See `Microscope`.
    channel : int, optional
        Whose emission wavelength is taken, from 0. Needed if those of the channels differ.

    Returns
    -------
    Microscope

    Raises
    ------
    TypeError
        If something given is not a number.
    ValueError
        If the microscope is not known completely: the message names all that is missing. Also if
        the file cannot be read, pixels are not square, or no microscope has these numbers.

    Examples
    --------
    >>> import pathlib, tempfile, tifffile, numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "cells.ome.tif")
    ...     tifffile.imwrite(file, np.zeros((4, 5), np.uint16), metadata={
    ...         "axes": "YX", "PhysicalSizeX": 0.1, "PhysicalSizeY": 0.1,
    ...         "Channel": {"EmissionWavelength": 520}})
    ...     lens = read_microscope(file, numerical_aperture=1.3, refractive_index=1.515)
    >>> lens.wavelength_um, lens.pixel_size_um
    (0.52, 0.1)
    """
    given: Noted = {
        "numerical_aperture": numerical_aperture,
        "wavelength_um": wavelength_um,
        "pixel_size_um": pixel_size_um,
        "refractive_index": refractive_index,
    }
    noted = dict.fromkeys(given) if None not in given.values() else noted_microscope(path, channel)
    known = {name: noted[name] if value is None else value for name, value in given.items()}
    if channel is None and known["wavelength_um"] is None and has_several_wavelengths(path):
        raise IncompleteMicroscope(
            f"the channels of {path} have different wavelengths of emission; give the wavelength"
        )
    missing = [_WHAT[name] for name, value in known.items() if value is None]
    if missing:
        *first, last = missing
        told = f"{', '.join(first)} and {last}" if first else last
        raise IncompleteMicroscope(
            f"{path} does not note {told} of its microscope; give what is missing"
        )
    return Microscope(**known, specimen=specimen)  # type: ignore[arg-type]  # none is None


def has_several_wavelengths(path: str | os.PathLike[str]) -> bool:
    """Return whether the channels of a file have different wavelengths, so that none is taken."""
    alike, first = (noted_microscope(path, channel)["wavelength_um"] for channel in (None, 0))
    return alike is None and first is not None


def noted_microscope(path: str | os.PathLike[str], channel: int | None = None) -> Noted:
    """Return the numbers of `Microscope` that a file notes; None for those that it does not.

    Without a channel, the wavelength is that of all channels, if they have the same.

    Raises
    ------
    UnreadablePicture
        If there is no such file, or its OME-XML is damaged.
    ValueError
        If pixels are not square.
    """
    path = Path(path)
    (steps, units), text, picture = _notes(path)
    found: Noted = dict.fromkeys(_WHAT)
    if text:
        with reading(path):
            found |= _noted_in_xml(text, picture, channel)
    elif path.is_file():
        with reading(path):
            found |= _noted_by_leica(leica_objective(path))
    sides = [steps[axis] * MICROMETERS[units[axis]] for axis in "xy" if _is_length(axis, units)]
    if sides:
        found["pixel_size_um"] = square_side(path, sides)
    return found


def square_side(source: object, sides: Sequence[float]) -> float:
    """Return the side of the pixels of a source, in um, of their width and height.

    Raises
    ------
    ValueError
        If they are not square.
    """
    if abs(sides[0] - sides[-1]) > _NOT_SQUARE * sides[0]:
        raise ValueError(
            f"the pixels of {source} are {sides[0]:g} x {sides[-1]:g} um; it takes square ones"
        )
    return sides[0]


def _is_length(axis: str, units: Mapping[str, str]) -> bool:
    return units.get(axis) in MICROMETERS


def _notes(path: Path) -> tuple[PixelSize, str | None, int]:
    """Return the pixel size that a file notes, its OME-XML, and the number of its picture there."""
    if is_zarr(path):
        store = read_ome_zarr(path)
        files = [each for name in _XML_IN_STORES if (each := path / name).is_file()]
        text = files[0].read_text("utf-8") if files else None
        return (store.pixel_size, store.units), text, int(path.name) if path.name.isdecimal() else 0
    with reading(path):
        if microscope_format(path):
            scene = open_microscope_file(path, 0)
            return (scene.pixel_size, scene.units), ome_xml_of(path), 0
        if is_for_openslide(path):
            _, steps = open_slide(path)
            return (steps, dict.fromkeys(steps, "micrometer")), None, 0
        if is_tiff(path):
            import tifffile

            with tifffile.TiffFile(path) as tiff:
                number = picture_number(tiff)
                return pixel_size_in_tiff(tiff, number), tiff.ome_metadata, number
        if path.suffix.lower() in (".xml", ".ome"):
            return ({}, {}), path.read_text("utf-8"), 0
    return ({}, {}), None, 0


def _noted_in_xml(text: str, picture: int, channel: int | None) -> Noted:
    """Return what OME-XML notes of the microscope that took a picture, of a channel."""
    root = ElementTree.fromstring(text)
    pictures = [each for each in _within(root, "Image") if _within(each, "Pixels")]
    if not pictures:
        return {}
    image = pictures[min(picture, len(pictures) - 1)]
    settings = _first(_within(image, "ObjectiveSettings"))
    objective = _objective(root, settings)
    pixels = _within(image, "Pixels")[0].attrib
    waves = [_length(each.attrib, "EmissionWavelength", "nm") for each in _within(image, "Channel")]
    index = _number(settings.get("RefractiveIndex"))
    return {
        "numerical_aperture": _number(objective.get("LensNA")),
        "wavelength_um": _of_channel(waves, channel),
        "pixel_size_um": _length(pixels, "PhysicalSizeX", "µm"),
        "refractive_index": index or _index_of(objective.get("Immersion", "")),
    }


def _of_channel(waves: list[float | None], channel: int | None) -> float | None:
    if channel is None:
        return waves[0] if len(set(waves)) == 1 else None
    return waves[channel] if channel < len(waves) else None


def _noted_by_leica(objective: Mapping[str, str]) -> Noted:
    """Return what a LIF file notes of an objective; nothing if it notes none."""
    if not objective:
        return {}
    index = _number(objective.get("RefractionIndex"))
    return {
        "numerical_aperture": _number(objective.get("NumericalAperture")),
        "refractive_index": index or _index_of(objective.get("Immersion", "")),
    }


def _objective(root: ElementTree.Element, settings: Mapping[str, str]) -> Mapping[str, str]:
    """Return the objective that settings name; the only one there is if they name none."""
    all_of_them = [each.attrib for each in _within(root, "Objective")]
    named = [each for each in all_of_them if each.get("ID") == settings.get("ID")]
    return (named or (all_of_them if len(all_of_them) == 1 else [{}]))[0]


def _within(element: ElementTree.Element, name: str) -> list[ElementTree.Element]:
    """Return all elements of a name below one, whatever version of OME's schema they are of."""
    return [each for each in element.iter() if each.tag.rpartition("}")[2] == name]


def _first(elements: list[ElementTree.Element]) -> Mapping[str, Any]:
    return elements[0].attrib if elements else {}


def _index_of(immersion: str) -> float | None:
    return IMMERSIONS.get(_IMMERSION_OF.get(immersion.lower().replace(" ", ""), ""))


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if value > 0 else None


def _length(noted: Mapping[str, str], name: str, default: str) -> float | None:
    """Return a length in um; None if it is not noted, or in no unit of length."""
    value, unit = _number(noted.get(name)), unit_of(noted.get(f"{name}Unit", default))
    return None if value is None or unit not in MICROMETERS else value * MICROMETERS[unit]
