"""Point spread functions: families indexed by one scale, measured ones, and their calibration."""

MAX_RADIUS = 64.0
"""Largest radius, in px, that is looked for by default. Small pictures are searched up to less, see
`napari_defocus.likelihood.scale_space`. It is here because this file imports no SciPy.
"""

MAX_SCALE_OF_FUNCTION = 8.0
"""px: the largest scale that a user's function is called with by default."""

AUTO = "auto"
"""The PSF family that a picture chooses, in text."""

MICROSCOPE = "microscope"
"""The first word of a microscope's text."""

SPECIMENS = ("texture", "points")
"""What may lie before a microscope, in text."""

BLUR_RADIUS = "blur radius (px)"
"""What the scale of a family measures if it is twice the standard deviation along an axis."""


def is_left_open(psf: str) -> bool:
    """Return whether a text leaves to the picture which family made it, or what it shows.

    Examples
    --------
    >>> is_left_open("auto"), is_left_open("microscope:0.8:0.52:0.1"), is_left_open("disc")
    (True, True, False)
    """
    name, *values = psf.strip().lower().split(":")
    return name == AUTO or (name == MICROSCOPE and not {*values} & {*SPECIMENS})


def left_open(psf: str) -> str:
    """Return the text that leaves to the picture what another one says.

    Examples
    --------
    >>> left_open("disc"), left_open("microscope:0.8:0.52:0.1:1:points")
    ('auto', 'microscope:0.8:0.52:0.1:1')
    """
    name, *values = psf.split(":")
    if name != MICROSCOPE:
        return AUTO
    return ":".join([name, *(value for value in values if value not in SPECIMENS)])
