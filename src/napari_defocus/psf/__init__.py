"""Point spread functions: families indexed by one scale, measured ones, and their calibration."""

MAX_RADIUS = 64.0
"""Largest radius, in px, that is looked for unless another one is said; small pictures are searched
up to less, see `napari_defocus.likelihood.scale_space`. Here, where it costs no import of SciPy."""

MAX_SCALE_OF_FUNCTION = 8.0
"""px: largest scale that a function of the user is asked for, unless another one is said."""

AUTO = "auto"
"""The PSF family that a picture chooses, in text."""

BLUR_RADIUS = "blur radius (px)"
"""What the scale of a family measures if it is twice the standard deviation along an axis."""
