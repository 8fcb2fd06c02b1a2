"""Point spread functions: families indexed by one scale, measured ones, and their calibration."""

MAX_RADIUS = 64.0
"""Largest radius, in px, that is looked for by default. Small pictures are searched up to less, see
`napari_defocus.likelihood.scale_space`. It is here because this file imports no SciPy.
"""

MAX_SCALE_OF_FUNCTION = 8.0
"""px: the largest scale that a user's function is called with by default."""

AUTO = "auto"
"""The PSF family that a picture chooses, in text."""

BLUR_RADIUS = "blur radius (px)"
"""What the scale of a family measures if it is twice the standard deviation along an axis."""
