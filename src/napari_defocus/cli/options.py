"""The options that terminal commands share, one by one; `option_groups` has them by the group."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from napari_defocus.core.checks import Linearize, Mode, Side
from napari_defocus.settings import MapSettings, MaskSettings, RefocusSettings

Encoding = Literal["srgb", "linear"]
"""How files hold light; "linear" is None to the functions."""

ImagePath = Annotated[
    Path,
    typer.Argument(
        metavar="IMAGE",
        help="PNG, JPEG, TIFF, WebP or BMP; of a slide (.svs, .ndpi, .scn, .qptiff and the like), "
        "the largest level.",
        show_default=False,
    ),
]
NoiseVariance = Annotated[
    float | None,
    typer.Option(
        metavar="NUMBER",
        help="Variance of the noise in the luminance, intensities from 0 to 1. "
        "Found from the picture if left out.",
    ),
]
ShotNoiseOption = Annotated[
    bool,
    typer.Option(
        "--shot-noise",
        help="The noise grows with the intensity, as that of counted photons; how much, is found "
        "from the picture.",
    ),
]
_PSF_HELP = (
    "What a lens makes of a point: disc, polygon:BLADES[:ROTATION], annulus:OBSTRUCTION, "
    "gaussian, generalized-gaussian:EXPONENT, or the .npz file that calibrate wrote."
)
PSFText = Annotated[str, typer.Option("--psf", metavar="TEXT", help=_PSF_HELP)]
PSFTextOrMaps = Annotated[
    str | None,
    typer.Option(
        "--psf",
        metavar="TEXT",
        help=f"{_PSF_HELP} [default: {MapSettings.psf}, or that of the map that is given]",
    ),
]
LinearizeOption = Annotated[
    Linearize | None,
    typer.Option(
        help="Decode the intensities into linear light first: srgb for pictures that a camera "
        "made for screens."
    ),
]
MaxRadius = Annotated[
    float,
    typer.Option(
        metavar="PX",
        help="Largest blur radius that is looked for, in px. A Gaussian is looked for up to a "
        "standard deviation of half of it, as a disc of that radius has.",
    ),
]
MapSmoothness = Annotated[
    float, typer.Option(metavar="NUMBER", help="Cost of a change of the radius by 0.1 px.")
]
MaskSmoothness = Annotated[
    float, typer.Option(metavar="NUMBER", help="Cost of the border of the mask.")
]
ColorSigma = Annotated[
    float,
    typer.Option(
        metavar="NUMBER",
        help="How much colours differ where the blur may change easily: a share of the contrast.",
    ),
]
Window = Annotated[
    int,
    typer.Option(
        metavar="PX",
        help="Side of the window whose spectrum speaks for a place, in px; odd.",
    ),
]
Stride = Annotated[
    int, typer.Option(metavar="PX", help="Distance between analysed windows, in px.")
]
ModeOption = Annotated[
    Mode,
    typer.Option(help="Weigh the whole likelihood curve, or the three candidates of the paper."),
]
Threshold = Annotated[
    float | None,
    typer.Option(
        metavar="PX",
        help="Largest radius that counts as in focus, in px; for a Gaussian, the largest "
        f"standard deviation. [default: {MaskSettings.threshold:g}, or half of it for a Gaussian]",
    ),
]
SeedsPath = Annotated[
    Path | None,
    typer.Option(
        metavar="PATH",
        help="A grey picture of integers (.png, .tif) as large as IMAGE: 1 where it is known to be "
        "in focus, 2 where it is known to be blurred, 0 elsewhere. The mask keeps to it.",
    ),
]
IntensityRange = Annotated[
    tuple[float, float] | None,
    typer.Option(
        metavar="LOW HIGH",
        help="Intensities that mean black and white, such as 0 4095 for 12-bit data: units of "
        "noise, and of pictures that are restored. Found if left out, and told; maps do not "
        "depend on it.",
    ),
]
MapOutputs = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="Where to write: values in px (.tif) or a drawing with a colour bar (.png). "
        "Can be given twice. [default: NAME-blur.tif and NAME-blur.png beside IMAGE]",
    ),
]
ConfidenceOutput = Annotated[
    Path | None,
    typer.Option(
        "--confidence",
        metavar="PATH",
        help="Where to write how sure the map is at every pixel, from 0 to 1: values (.tif) or "
        "a drawing (.png).",
    ),
]
MinConfidence = Annotated[
    float,
    typer.Option(
        metavar="NUMBER",
        help="Leave pixels of a lower confidence out of the map: NaN in the values, grey in the "
        "drawing.",
    ),
]
MaskOutput = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="Where to write the mask (.png): white in focus, black not. "
        "[default: NAME-mask.png beside IMAGE, and the overlay too]",
    ),
]
OverlayOutput = Annotated[
    Path | None,
    typer.Option(
        "--overlay",
        metavar="PATH",
        help="Where to write the picture with the rest dimmed (.png). "
        "[default: NAME-overlay.png beside IMAGE, and the mask too]",
    ),
]
RegionsOutput = Annotated[
    Path | None,
    typer.Option(
        "--regions",
        metavar="PATH",
        help="Where to write a table of the regions in focus (.csv): area, place, and how wide "
        "their blur is and how sure. The map is measured for it, too.",
    ),
]
KnownMap = Annotated[
    Path | None,
    typer.Option(
        "--map",
        metavar="PATH",
        help="The blur map of IMAGE as map wrote it (.tif), or as you corrected it: float32, in "
        "px, NaN where it is not known. It is measured if left out; if not, what only shapes a "
        "measurement does nothing.",
    ),
]
KnownConfidence = Annotated[
    Path | None,
    typer.Option(
        "--map-confidence",
        metavar="PATH",
        help="What map --confidence wrote (.tif) together with the --map.",
    ),
]
TVWeight = Annotated[
    float | None,
    typer.Option(
        metavar="NUMBER",
        help="How smooth the picture in focus is: large for less noise, small for more detail. "
        "Derived from the noise if left out.",
    ),
]
Risk = Annotated[
    float,
    typer.Option(
        metavar="NUMBER",
        help="Of taking more blur away than there is, which makes rings: small leaves more blur "
        "where it is not sure, 1 takes away what the map says. Without effect with --map.",
    ),
]
SideOption = Annotated[
    Side,
    typer.Option(
        help="Where everything lies that is blurred: beyond the plane in focus (far) or before it "
        "(near). One picture cannot tell."
    ),
]
FocalLength = Annotated[
    float | None,
    typer.Option(metavar="MM", help="Focal length, in mm; not its 35 mm equivalent."),
]
FNumber = Annotated[float | None, typer.Option(metavar="NUMBER", help="The f-number, such as 2.8.")]
FocusDistance = Annotated[
    float | None,
    typer.Option(
        metavar="M",
        help="Distance, in m, that the lens was focused at when the picture was taken; inf for "
        "infinitely far. Few cameras note it.",
    ),
]
PixelPitch = Annotated[
    float | None,
    typer.Option(
        metavar="UM",
        help="How far the pixels of IMAGE are apart on the sensor, in um: twice the sensor's "
        "pitch if IMAGE was scaled down to a half.",
    ),
]
DepthOutputs = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help="Where to write: values in m (.tif) or a drawing with a colour bar (.png). "
        "Can be given twice. [default: NAME-depth.tif and NAME-depth.png beside IMAGE]",
    ),
]
_PICTURES_HELP = (
    "Where to write: a picture of 8 bits, or 16 if IMAGE has more (.png), or float32 from 0 to 1 "
    "(.tif). Can be given twice."
)
RestoredOutputs = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help=f"{_PICTURES_HELP} [default: NAME-in-focus.png beside IMAGE]",
    ),
]
RefocusedOutputs = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        metavar="PATH",
        help=f"{_PICTURES_HELP} [default: NAME-refocused.png beside IMAGE]",
    ),
]
FocusOption = Annotated[
    float | None,
    typer.Option(
        metavar="PX",
        help="What shall be sharp: that which is blurred by so many px, in the scale of --psf and "
        "the map; negative on the other side of the focus than --side. "
        f"[default: {RefocusSettings.focus:g}, the focus stays]",
    ),
]
SharpAt = Annotated[
    float | None,
    typer.Option(
        metavar="M",
        help="What shall be sharp: that which is so far away, in m; instead of --focus. It takes "
        "the lens: --focal-length, --f-number, --focus-distance and --pixel-pitch, as far as "
        "IMAGE does not note them.",
    ),
]
Aperture = Annotated[
    float,
    typer.Option(
        metavar="FACTOR",
        help="How many times as wide the aperture shall be, and so the blur: 2 for two stops more, "
        "0 for everything in focus.",
    ),
]
EncodingOption = Annotated[
    Encoding,
    typer.Option(
        help="How IMAGE holds light: srgb if a camera made it for screens, linear if its numbers "
        "are proportional to light, as those of microscopes and raw data. Lenses blur light: "
        "IMAGE is restored and blurred again in it. --noise-variance is taken for that, too, if "
        "--linearize is the same or --map is given; else the noise is found again."
    ),
]
SettingsFile = Annotated[
    Path | None,
    typer.Option(
        "--settings",
        metavar="PATH",
        help="A file that --save-settings wrote (.json), or that you edited: it says what the "
        "options of this command do not.",
    ),
]
SavedSettings = Annotated[
    Path | None,
    typer.Option(
        "--save-settings",
        metavar="PATH",
        help="Where to write the settings that were used (.json), for --settings.",
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite results that exist.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print nothing but errors (and --json).")
]
