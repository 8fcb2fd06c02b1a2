"""The thin lens that terminal commands take, what they tell of it, and its change of focus."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import napari_defocus
from napari_defocus.cli.option_groups import OptionGroup
from napari_defocus.core.checks import Side
from napari_defocus.optics.exif import noted_lens
from napari_defocus.settings import RefocusSettings

if TYPE_CHECKING:
    from napari_defocus.optics.thin_lens import ThinLens

_SIDES = {"far": "beyond", "near": "before"}


@dataclass(frozen=True, kw_only=True)
class LensOptions(OptionGroup):
    """A thin lens."""

    focal_length: float | None = None
    f_number: float | None = None
    focus_distance: float | None = None
    pixel_pitch: float | None = None

    @property
    def given(self) -> dict[str, Any]:
        """What is given of it, by the names of `ThinLens`; None is left to the picture's EXIF."""
        return {
            "focal_length_mm": self.focal_length,
            "f_number": self.f_number,
            "focus_distance_m": self.focus_distance,
            "pixel_pitch_um": self.pixel_pitch,
        }


def lens_of(image: Path, options: LensOptions) -> ThinLens:
    """Return the lens that is given; what is not, the picture has to note."""
    given = options.given
    if None in given.values():
        return napari_defocus.ThinLens.from_exif(image, **given)
    # Not every picture that is read here can be asked for EXIF.
    return napari_defocus.ThinLens(**given)


def check_side(side: Side, lens: ThinLens) -> None:
    """Refuse points beyond a focus at infinity before any long work."""
    if side == "far" and math.isinf(lens.focus_distance_m):
        raise ValueError("side is 'far', but the lens is focused at infinity; it takes 'near'")


def lens_facts(image: Path, lens: ThinLens, options: LensOptions) -> dict[str, Any]:
    """Return what is told about the lens of a picture; JSON has no number for infinity."""
    given = options.given
    values = {name: getattr(lens, name) for name in given}
    facts: dict[str, Any] = {
        name: value if math.isfinite(value) else "inf" for name, value in values.items()
    }
    facts["from_exif"] = [name for name, value in given.items() if value is None]
    if options.pixel_pitch is None:
        facts["pixel_pitch_from"] = noted_lens(image, options.focal_length).pitch_from
    return {"thin_lens": facts}


def lens_line(facts: Mapping[str, Any]) -> str:
    """Say what `lens_facts` are."""
    lens = facts["thin_lens"]
    distance = lens["focus_distance_m"]
    parts = {
        "focal_length_mm": f"{lens['focal_length_mm']:g} mm",
        "f_number": f"f/{lens['f_number']:g}",
        "focus_distance_m": f"focused at {'infinity' if distance == 'inf' else f'{distance:g} m'}",
        "pixel_pitch_um": f"pixels of {lens['pixel_pitch_um']:.4g} um",
    }
    noted = lens["from_exif"]
    told = [part + " (EXIF)" * (name in noted) for name, part in parts.items()]
    if "pixel_pitch_from" in lens:
        told[-1] = f"{parts['pixel_pitch_um']} (EXIF: {lens['pixel_pitch_from']})"
    return f"thin lens    {', '.join(told)}"


def side_line(facts: Mapping[str, Any]) -> str:
    """Say which side was assumed."""
    side = facts["side"]
    return f"side         {side}: all blur is assumed to lie {_SIDES[side]} the plane in focus"


def check_change(
    focus: float | None, sharp_at: float | None, aperture: float, thin_lens: LensOptions
) -> None:
    """Check what shall change, as far as that goes without the lens."""
    if focus is not None and sharp_at is not None:
        raise ValueError(f"focus is {focus} and sharp_at is {sharp_at}; one of them is enough")
    if sharp_at is None:
        for name, value in thin_lens.given.items():
            if value is not None:
                raise ValueError(f"{name} is {value}, but only sharp_at takes a lens")
        if focus in (None, RefocusSettings.focus) and aperture == RefocusSettings.aperture:
            raise ValueError("nothing would change; give --focus, --sharp-at or --aperture")
    elif not sharp_at > 0:
        raise ValueError(f"sharp_at is {sharp_at}; it takes a distance above 0 m")
    RefocusSettings(focus=focus or 0.0, aperture=aperture)


def focus_facts(
    image: Path,
    focus: float | None,
    sharp_at: float | None,
    side: Side,
    thin_lens: LensOptions,
) -> dict[str, Any]:
    """Return the blur of what shall be sharp, and how it was found."""
    if sharp_at is None:
        return {"focus_px": RefocusSettings.focus if focus is None else focus}
    lens = lens_of(image, thin_lens)
    check_side(side, lens)
    blur = float(napari_defocus.blur_from_depth(sharp_at, lens))
    if not math.isfinite(blur):
        raise ValueError(f"sharp_at is {sharp_at}; nothing so near can be made sharp")
    beyond = sharp_at > lens.focus_distance_m
    told = {"sharp_at_m": sharp_at if math.isfinite(sharp_at) else "inf"}
    return (
        {"focus_px": blur if beyond == (side == "far") else -blur}
        | told
        | lens_facts(image, lens, thin_lens)
    )
