"""What a camera noted about its lens in a photograph (EXIF)."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any

_EXIF_FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP")
_INFINITELY_FAR = 0xFFFFFFFF
"""The numerator of EXIF's SubjectDistance for infinity."""

_INCH = 2
_MICROMETRES = {_INCH: 25400.0, 3: 10000.0, 4: 1000.0, 5: 1.0}
"""By number of EXIF's FocalPlaneResolutionUnit."""

_DIAGONAL_OF_35_MM = 43.27
"""mm: the diagonal of a frame of 24 x 36 mm."""

_CROPPED = 0.01
"""If the ratio of the sides differs by more than this share, the picture was cropped. By hand."""


FROM_FOCAL_PLANE = "from the resolution of its focal plane"
FROM_35_MM = "worked out from its focal length on 35 mm film, which is rounded"
"""Where a pixel pitch was found, said of a photograph."""

SENSORS_MM = {"full frame": 36.0, "APS-C": 23.5, "Four Thirds": 17.3, "a phone's": 7.5}
"""Widths of common sensors. Those of phones are from 5 to 10 mm."""


@dataclass(frozen=True)
class NotedLens:
    """What a photograph notes of its lens.

    Attributes
    ----------
    values : dict
        Of each parameter of `ThinLens` its value, None if it is not noted.
    pitch_from : str or None
        Where the pixel pitch comes from: `FROM_FOCAL_PLANE` or `FROM_35_MM`.
    image_size : (int, int)
        Height and width in px, or the other way round, of the picture that it is the pitch of.
    """

    values: dict[str, float | None]
    pitch_from: str | None
    image_size: tuple[int, int]


def pitch_advice(image_size: tuple[int, int] | None = None, micro: str = "u") -> str:
    """Return how somebody who does not know the pixel pitch works it out.

    Parameters
    ----------
    image_size : (int, int), optional
        Sides of the picture in px; with them, there are examples.
    micro : str, optional
        How the unit is written.

    Examples
    --------
    >>> print(pitch_advice())
    Pixel pitch in um = 1000 x sensor width in mm / picture width in px, if nothing was cropped
    >>> pitch_advice((4000, 6000)).partition("; ")[2].split(", ")[:2]
    ['for 6000 px that is 6 with 36 mm (full frame)', '3.92 with 23.5 mm (APS-C)']
    """
    rule = (
        f"Pixel pitch in {micro}m = 1000 x sensor width in mm / picture width in px, "
        "if nothing was cropped"
    )
    if image_size is None:
        return rule
    px = max(image_size)
    said = (f"{1000 * mm / px:.3g} with {mm:g} mm ({name})" for name, mm in SENSORS_MM.items())
    return f"{rule}; for {px} px that is {', '.join(said)}"


def noted_lens(
    path: str | os.PathLike[str],
    focal_length_mm: float | None = None,
    image_size: tuple[int, int] | None = None,
) -> NotedLens:
    """Read the parameters of `ThinLens` from a photograph.

    Parameters
    ----------
    path : path-like
        A JPEG, TIFF, PNG, WebP or BMP file.
    focal_length_mm : float, optional
        What the pitch is worked out from if the focal length is not noted.
    image_size : (int, int), optional
        Height and width in px of the picture whose pitch is wanted, if it is not that of the
        file. Upright or not does not matter.

    Returns
    -------
    NotedLens

    Raises
    ------
    TypeError
        If `image_size` is not a pair of whole numbers.
    ValueError
        If its numbers are not above 0, or the file cannot be read.
    """
    if image_size is not None:
        _check_size(image_size)
    exif, stored = _read_exif(Path(path))
    noted_focal_length = _noted(exif, "FocalLength")
    focal_length = noted_focal_length or focal_length_mm
    pitch, pitch_from = _noted_pitch(exif, focal_length, stored, image_size)
    values = {
        "focal_length_mm": noted_focal_length,
        "f_number": _noted_f_number(exif),
        "focus_distance_m": _noted_focus_distance(exif),
        "pixel_pitch_um": pitch,
    }
    return NotedLens(values, pitch_from, image_size or stored)


def _check_size(image_size: object) -> None:
    takes = "it takes two whole numbers from 1 up, the height and the width in px"
    sides = image_size if isinstance(image_size, tuple | list) else ()
    if len(sides) != 2 or not all(isinstance(side, Integral) for side in sides):
        raise TypeError(f"image_size is {image_size!r}; {takes}")
    if min(sides) < 1:
        raise ValueError(f"image_size is {image_size!r}; {takes}")


def _read_exif(path: Path) -> tuple[Mapping[int, Any], tuple[int, int]]:
    """Return what a camera noted, and the size of the picture in px."""
    from PIL import ExifTags, Image, UnidentifiedImageError

    try:
        with Image.open(path, formats=_EXIF_FORMATS) as image:
            exif: Mapping[int, Any] = {}
            # Damaged bytes raise anything; what cannot be read is not noted.
            with suppress(Exception):
                exif = image.getexif().get_ifd(ExifTags.IFD.Exif)
            return exif, image.size
    except FileNotFoundError:
        reason = "there is no such file"
    except IsADirectoryError:
        reason = "it is a folder"
    except UnidentifiedImageError:
        noted = _read_heic_exif(path)
        if noted is not None:
            return noted
        reason = (
            "no EXIF is read from this kind of file (only PNG, JPEG, TIFF, WebP, BMP, and HEIC "
            "with the extra heic)"
        )
    except Exception as error:
        reason = " ".join((getattr(error, "strerror", None) or str(error)).split())
    raise ValueError(f"cannot read {path}: {reason}")


def _read_heic_exif(path: Path) -> tuple[Mapping[int, Any], tuple[int, int]] | None:
    """Return what `_read_exif` does of a HEIC picture; None if it is none, or cannot be read."""
    from PIL import ExifTags, Image

    with suppress(Exception):
        import pillow_heif

        picture = pillow_heif.open_heif(path)
        exif = Image.Exif()
        exif.load(picture.info.get("exif") or b"")
        return exif.get_ifd(ExifTags.IFD.Exif), picture.size
    return None


def _noted(exif: Mapping[int, Any], name: str) -> float | None:
    """Return what is noted under a name if it is a positive finite number."""
    from PIL import ExifTags

    value = exif.get(ExifTags.Base[name])
    number = math.nan
    if isinstance(value, Real):
        with suppress(ArithmeticError):
            number = float(value)
    return number if 0 < number < math.inf else None


def _noted_f_number(exif: Mapping[int, Any]) -> float | None:
    """Return the f-number N, noted as such or as the aperture value 2 log2 N."""
    aperture = _noted(exif, "ApertureValue")
    f_number = _noted(exif, "FNumber")
    if f_number is None and aperture is not None:
        with suppress(OverflowError):
            f_number = 2 ** (aperture / 2)
    return f_number


def _noted_focus_distance(exif: Mapping[int, Any]) -> float | None:
    from PIL import ExifTags

    value = exif.get(ExifTags.Base.SubjectDistance)
    if getattr(value, "numerator", None) == _INFINITELY_FAR:
        return math.inf
    return _noted(exif, "SubjectDistance")


def _noted_pitch(
    exif: Mapping[int, Any],
    focal_length_mm: float | None,
    stored: tuple[int, int],
    image_size: tuple[int, int] | None,
) -> tuple[float | None, str | None]:
    """Return the pixel pitch, in um, of a picture of `image_size` px, and where it comes from.

    Sides are compared by their length: cameras and programs do not agree on whether what they
    note is turned with the picture.
    """
    width, height = _noted(exif, "ExifImageWidth"), _noted(exif, "ExifImageHeight")
    captured = stored if width is None or height is None else (width, height)
    short_captured, long_captured = sorted(captured)
    short, long = sorted(image_size or stored)
    fitting = long * short_captured / long_captured
    if abs(short - fitting) > 1 + _CROPPED * fitting:
        return None, None
    pitch = _noted_photosite_pitch(exif)
    if pitch is not None:
        return pitch * long_captured / long, FROM_FOCAL_PLANE
    in_35_mm = _noted(exif, "FocalLengthIn35mmFilm")
    if in_35_mm is None or focal_length_mm is None:
        return None, None
    diagonal_mm = _DIAGONAL_OF_35_MM * focal_length_mm / in_35_mm
    return 1000 * diagonal_mm / math.hypot(long, short), FROM_35_MM


def _noted_photosite_pitch(exif: Mapping[int, Any]) -> float | None:
    """Return the pixel pitch at capture, in um."""
    from PIL import ExifTags

    per_unit = _noted(exif, "FocalPlaneXResolution")
    unit = _MICROMETRES.get(exif.get(ExifTags.Base.FocalPlaneResolutionUnit, _INCH))
    return None if per_unit is None or unit is None else unit / per_unit
