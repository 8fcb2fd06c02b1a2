"""What ``--help`` says of the options that terminal commands share, and how such texts are read."""

from __future__ import annotations

import inspect
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple

import typer

from napari_defocus.cli.settings_options import options_from_file

Encoding = Literal["srgb", "linear"]
"""How files hold light; "linear" is None to the functions."""

_CALLBACKS = {"settings_file": options_from_file}


class Entry(NamedTuple):
    """What a text says of a parameter: its names in the terminal, its value's, and the help."""

    names: tuple[str, ...]
    metavar: str | None
    told: str


def entries_in(text: str) -> dict[str, Entry]:
    """Return the entries of a text, by the names of parameters.

    Parameters
    ----------
    text : str
        For each parameter a line, and its help below, indented. The line has the parameter's name,
        its names in the terminal that do not follow from that, and what stands for its value.
    """
    told_of: dict[str, list[str]] = {}
    for line in filter(None, inspect.cleandoc(text).splitlines()):
        if not line.startswith(" "):
            told = told_of.setdefault(line, [])
        else:
            told.append(line.strip())
    entries = {}
    for line, told in told_of.items():
        name, *words = line.split()
        names = [word for word in words if word.startswith("-")]
        metavar = " ".join(word for word in words if word not in names)
        if not any(each.startswith("--") for each in names):
            names.insert(0, f"--{name.replace('_', '-')}")
        entries[name] = Entry(tuple(names), metavar or None, " ".join(told))
    return entries


@cache  # commands share most of them, and start faster
def shown(
    name: str, annotation: Any, default: Any, entry: Entry, *, is_option: bool = True
) -> inspect.Parameter:
    """Return a parameter as typer takes it."""
    about: dict[str, Any] = {"metavar": entry.metavar, "help": entry.told}
    about["show_default"] = default is not inspect.Parameter.empty
    taken = (
        typer.Option(*entry.names, callback=_CALLBACKS.get(name), **about)
        if is_option
        else typer.Argument(**about)
    )
    kind, annotation = inspect.Parameter.KEYWORD_ONLY, Annotated[annotation, taken]
    return inspect.Parameter(name, kind, default=default, annotation=annotation)


SHARED = entries_in("""
image IMAGE
    PNG, JPEG, TIFF, WebP, BMP or GIF; HEIC and raw files with the extras heic and raw; CZI, ND2 and
    LIF of one plane with the extra microscopes. Of a slide (.svs, .ndpi, .scn, .qptiff; .mrxs and
    .vms with the extra slides), the largest level is read.
psf TEXT
    The shape that the lens makes of a point: disc, polygon:BLADES[:ROTATION], annulus:OBSTRUCTION,
    gaussian, generalized-gaussian:EXPONENT, microscope, or the .npz file that calibrate wrote. auto
    lets the picture choose, and says what it chose. microscope takes the options below, or
    microscope:NA:WAVELENGTH:PIXEL:INDEX in um, and tells the defocus in um, too.
numerical_aperture NA
    Numerical aperture of a microscope's objective. What is not given of the microscope is read from
    IMAGE (OME-TIFF, OME-Zarr, CZI, ND2, LIF).
wavelength UM
    Wavelength of the light in um: 0.52 for green. In fluorescence, that of emission.
immersion NAME|INDEX
    What is between objective and specimen: air, water, glycerol, oil, or a refractive index.
pixel_size UM
    Distance of the pixels of IMAGE in the specimen, in um.
noise_variance NUMBER
    Variance of the noise in the luminance, for intensities from 0 to 1. If left out, it is found
    from the picture.
shot_noise
    Look for noise that grows with the intensity, as that of counted photons, even if the picture
    does not plainly show it.
camera_softness PX
    Standard deviation of the camera's own blur, in px. Radii are the defocus beyond it.
max_radius PX
    Largest blur radius that is looked for, in px. Small pictures are searched up to less: 32 px
    if their shorter side is below 656 px, 16 px below 328 px, 8 px below 164 px. For a Gaussian,
    the largest standard deviation is half of it.
window PX
    Side of the window that decides about a place, in px; odd.
stride PX
    Distance between analysed windows, in px.
mode
    Use the whole likelihood curve, or only three candidates as in the paper.
linearize
    Decode the intensities into linear light first: srgb for pictures that a camera made for
    screens.
intensity_range LOW HIGH
    Intensities that mean black and white, such as 0 4095 for 12-bit data. They are the units of the
    noise and of restored pictures; maps do not depend on them. If left out, they are found, and the
    line intensities has them.
smoothness NUMBER
    Cost of a change of the radius by 0.1 px.
color_sigma NUMBER
    How much colours must differ until the blur may easily change: a share of the contrast.
known_map --map PATH
    The blur map of IMAGE as map wrote it (.tif), or as you corrected it: float32, in px, NaN where
    it is not known. If left out, it is measured. With a map, options that only shape a measurement
    do nothing.
map_confidence PATH
    What map --confidence wrote (.tif) together with the --map.
min_confidence NUMBER
    Leave pixels of a lower confidence out of the map: NaN in the values, grey in the drawing.
threshold PX|auto
    Largest blur radius that counts as in focus, in px; auto finds it from the picture, or from the
    planes of a stack, and says it.
unknown
    What becomes of places whose own surroundings tell no radius, such as those without texture:
    they are filled from around, or left, grey in the mask.
tv_weight NUMBER
    How smooth the picture in focus is: large for less noise, small for more detail. If left out, it
    follows from the noise, and from how badly the picture fits its map.
risk NUMBER
    The risk of taking more blur away than there is, which makes rings. A small one leaves more blur
    where the map is not sure, 1 takes away what the map says. It has no effect with --map.
focal_length MM
    Focal length, in mm; not its 35 mm equivalent.
f_number NUMBER
    The f-number, such as 2.8.
focus_distance M
    Distance, in m, that the lens was focused at when the picture was taken; inf for infinitely
    far. Few cameras note it.
pixel_pitch UM
    How far the pixels of IMAGE are apart on the sensor, in um: 1000 x the sensor's width in mm /
    the width of IMAGE in px, if nothing was cropped. Sensors are 36 mm wide (full frame), 23.5 mm
    (APS-C), 17.3 mm (Four Thirds), 5 to 10 mm (phones). If left out, it is what IMAGE notes, and
    the line thin lens says where from.
side
    Where the blurred things are: beyond the plane in focus (far) or before it (near). One picture
    cannot tell.
in_focus_up_to PX
    Largest blur radius, in px, that the report counts as in focus. A field whose median is above it
    is flagged as out of focus.
min_share_in_focus SHARE
    A field is flagged as partly out of focus if less of what is known is in focus, from 0 to 1.
min_share_known SHARE
    A field is flagged as empty if the blur of less of it is known.
max_share_saturated SHARE
    A field is flagged as saturated if more of its pixels are as bright as can be.
max_one_direction NUMBER
    A field is flagged as not defocus if its details agree more in one direction, as after motion:
    0 is not at all, 1 is all in one. For cells and tissue, 0.6 finds more than the default.
settings_file --settings PATH
    A file that --save-settings wrote (.json), or that you edited. Options that you give here count
    more than the file.
save_settings PATH
    Where to write the settings that were used (.json), for --settings.
force
    Overwrite results that exist.
as_json --json
    Print one JSON object instead of text.
quiet -q
    Print nothing but errors (and --json).
""")
