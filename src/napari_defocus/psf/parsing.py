"""PSF families as one line of text, for the terminal, forms and settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, fields, replace
from typing import Any

from napari_defocus.psf import AUTO, MICROSCOPE
from napari_defocus.psf.families import (
    Annulus,
    AutomaticPSF,
    Disc,
    Gaussian,
    GeneralizedGaussian,
    Polygon,
    PSFFamily,
)
from napari_defocus.psf.measured import MeasuredPSF
from napari_defocus.psf.microscope import Microscope

_Written = AutomaticPSF | Disc | Gaussian | GeneralizedGaussian | Polygon | Annulus | Microscope

_SPELLED: dict[str, tuple[Callable[..., _Written], tuple[Callable[[str], float | str], ...]]] = {
    AUTO: (AutomaticPSF, ()),
    "disc": (Disc, ()),
    "gaussian": (Gaussian, ()),
    "generalized-gaussian": (GeneralizedGaussian, (float,)),
    "polygon": (Polygon, (int, float)),
    "annulus": (Annulus, (float,)),
    MICROSCOPE: (Microscope, (float, float, float, float, str)),
}

_NUMBERS_OF_MICROSCOPE = 3
"""NA, wavelength and pixel size, which have no defaults."""

PSF_TEXTS = (
    "disc, gaussian, generalized-gaussian:EXPONENT, polygon:BLADES[:ROTATION], "
    "annulus:OBSTRUCTION, microscope:NA:WAVELENGTH:PIXEL[:INDEX[:SPECIMEN]] with um, auto, "
    "or the path of a saved .npz"
)
"""What `psf_from_text` takes, for help and errors."""


def psf_from_text(text: str, max_scale: float | None = None) -> PSFFamily:
    """Make a PSF family from a line of text.

    Parameters
    ----------
    text : str
        "auto" (the picture chooses), "disc", "gaussian", "generalized-gaussian:1.5", "polygon:6",
        "polygon:6:15" (rotation in degrees), "annulus:0.5", "microscope:1.3:0.52:0.1:1.515:points"
        (NA, wavelength and pixel size in um, refractive index, specimen), or the path of a .npz
        file that `MeasuredPSF.save` wrote.
        Parameters that are left out have the family's defaults.
    max_scale : float, optional
        Largest scale that is looked for, in px; by default the family's own.

    Returns
    -------
    PSFFamily

    Raises
    ------
    TypeError
        If it is not text.
    ValueError
        If the text says none of these, a parameter is out of its range, or the file cannot be
        read.

    Examples
    --------
    >>> psf_from_text("polygon:6:15", max_scale=5.0)
    Polygon(blades=6, rotation=15.0, max_radius=5.0)
    """
    if not isinstance(text, str):
        raise TypeError(f"text is {text!r}; it takes {PSF_TEXTS}")
    if text.lower().endswith(".npz"):
        measured = MeasuredPSF.load(text)
        return measured if max_scale is None else replace(measured, max_scale=max_scale)
    name, *parts = text.strip().lower().split(":")
    try:
        family, kinds = _SPELLED[name]
        values = [kind(part) for kind, part in zip(kinds, parts, strict=False)]
        if len(parts) > len(kinds) or (name == MICROSCOPE and len(parts) < _NUMBERS_OF_MICROSCOPE):
            raise ValueError
    except (KeyError, ValueError):
        raise ValueError(f"psf is {text!r}; it takes {PSF_TEXTS}") from None
    psf = family(*values)
    if max_scale is None:
        return psf
    largest: dict[str, Any] = {fields(psf)[-1].name: max_scale}
    return replace(psf, **largest)


def psf_text(psf: PSFFamily) -> str:
    """Write a family as `psf_from_text` reads it, without its largest scale.

    Raises
    ------
    ValueError
        If the family cannot be written as text: measured ones, functions and your own.

    Examples
    --------
    >>> psf_text(Polygon(5, rotation=18.0))
    'polygon:5:18'
    """
    for name, (family, _) in _SPELLED.items():
        if isinstance(psf, _Written) and type(psf) is family:
            values = (str(value).removesuffix(".0") for value in astuple(psf)[:-1])
            return ":".join([name, *values]).removesuffix(f":{AUTO}")
    raise ValueError(f"psf is {psf!r}, which has no text form; it takes {PSF_TEXTS}")


def psf_of(text: str, max_radius: float) -> PSFFamily:
    """Make a PSF family for blurs up to a radius.

    Measured ones are looked for up to their own largest scale if that is smaller.

    Parameters
    ----------
    text : str
        What `napari_defocus.psf_from_text` reads.
    max_radius : float
        Largest blur radius that is looked for, in px.

    Returns
    -------
    PSFFamily

    Raises
    ------
    ValueError
        If the text names no family, or the largest scale comes out below 1 px.

    Examples
    --------
    >>> psf_of("gaussian", 6.0)
    Gaussian(max_radius=6.0)
    """
    family = psf_from_text(text)
    measured = isinstance(family, MeasuredPSF)
    return psf_from_text(text, min(max_radius, family.max_scale) if measured else max_radius)
