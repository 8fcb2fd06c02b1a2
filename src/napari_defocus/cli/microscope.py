"""The microscope that terminal commands take from their options and from pictures' files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from napari_defocus.psf import MICROSCOPE
from napari_defocus.settings import MapSettings

if TYPE_CHECKING:
    from napari_defocus.pipeline import Measurement
    from napari_defocus.psf.microscope import Microscope

_OPTIONS = {
    "numerical_aperture": "--numerical-aperture",
    "wavelength_um": "--wavelength",
    "pixel_size_um": "--pixel-size",
    "refractive_index": "--immersion",
}
"""By the parameters of `Microscope`."""


def microscope_text(psf: str, given: Mapping[str, Any], pictures: Sequence[Path]) -> str:
    """Return the text of a PSF, with a microscope's numbers from options and from files.

    Parameters
    ----------
    psf : str
        As --psf has it: "microscope" alone leaves all numbers to options and files.
    given : mapping
        By the parameters of `Microscope`; None for what is not given.
    pictures : sequence of Path
        Which are asked for what is not given. They have to note the same.

    Raises
    ------
    ValueError
        If options belong to a microscope and the PSF is another one, something is missing, or the
        files of pictures note different microscopes.
    """
    typed = {name: value for name, value in given.items() if value is not None}
    name, *values = psf.split(":")
    if name != MICROSCOPE:
        if not typed:
            return psf
        if psf != MapSettings.psf:
            options = ", ".join(_OPTIONS[name] for name in typed)
            raise ValueError(f"psf is {psf!r}, but {options} is given; it takes microscope")
    elif values and not typed:
        return psf
    return _read(_all_given(values if name == MICROSCOPE else [], typed), pictures)


def _all_given(values: list[str], typed: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the text and the options say together; options count more."""
    from napari_defocus.psf.parsing import psf_from_text

    if "refractive_index" in typed:
        typed = {**typed, "refractive_index": _index(typed["refractive_index"])}
    if not values:
        return dict(typed)
    written = psf_from_text(":".join([MICROSCOPE, *values]))
    return {name: getattr(written, name) for name in (*_OPTIONS, "specimen")} | dict(typed)


def _index(immersion: str) -> float:
    from napari_defocus.psf.microscope import IMMERSIONS

    try:
        return IMMERSIONS.get(immersion) or float(immersion)
    except ValueError:
        known = ", ".join(IMMERSIONS)
        raise ValueError(
            f"immersion is {immersion!r}; it takes {known} or a refractive index"
        ) from None


def _read(known: dict[str, Any], pictures: Sequence[Path]) -> str:
    from napari_defocus.io.microscope_metadata import IncompleteMicroscope, read_microscope
    from napari_defocus.psf.microscope import Microscope
    from napari_defocus.psf.parsing import psf_text

    try:
        if {*_OPTIONS} <= {*known}:
            return psf_text(Microscope(**known))
        noted = {psf_text(read_microscope(path, **known)): path for path in pictures}
    except IncompleteMicroscope as error:
        lacking = ", ".join(option for name, option in _OPTIONS.items() if name not in known)
        raise ValueError(f"{error} ({lacking})") from None
    except ValueError as error:  # other arguments have the names of their options
        raise ValueError(str(error).replace("refractive_index", "--immersion")) from None
    if len(noted) > 1:
        (first, one), (second, other), *_ = noted.items()
        raise ValueError(
            f"pictures note different microscopes: {one} {first}, {other} {second}; it takes those "
            "of one, or all numbers as options"
        )
    return next(iter(noted))


def microscope_of(found: Measurement) -> Microscope | None:
    """Return the microscope that a map was measured with; None if it was another lens."""
    from napari_defocus.psf.microscope import Microscope

    return found.psf if isinstance(found.psf, Microscope) else None


def remarks_on_pixels(image: Path, found: Measurement) -> list[str]:
    """Return what to say if pixels cannot be right, or a picture's file notes others."""
    from napari_defocus.io.microscope_metadata import noted_microscope

    lens = microscope_of(found)
    if lens is None:
        return []
    try:
        noted = noted_microscope(image)["pixel_size_um"]
    except ValueError:  # what cannot be read says nothing
        noted = None
    remark = lens.remark_on_pixels(noted)
    return [] if remark is None else [remark]


def defocus_facts(lens: Microscope | None, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is told in um, of facts of a map in px."""
    if lens is None:
        return {}
    um = {
        name.replace("blur_", "defocus_").replace("_px", "_um"): lens.defocus_um(facts[name])
        for name in ("blur_median_px", "blur_p5_px", "blur_p95_px")
    }
    return um | {"depth_of_field_um": lens.depth_of_field_um, "airy_radius_px": lens.airy_radius}


def defocus_lines(facts: Mapping[str, Any]) -> list[str]:
    """Say what `defocus_facts` are."""
    if "defocus_median_um" not in facts:
        return []
    low, median, high = (facts[f"defocus_{name}_um"] for name in ("p5", "median", "p95"))
    half = facts["depth_of_field_um"] / 2
    lines = [
        f"defocus      median {median:.3g} um, "
        f"5 to 95 % of the picture: {low:.3g} to {high:.3g} um",
        "             above or below the focus: one picture cannot tell",
    ]
    if low < half:
        lines.append(
            f"careful      less than {half:.2g} um, half the depth of field, looks in focus: "
            "there, um are rough"
        )
    return lines
