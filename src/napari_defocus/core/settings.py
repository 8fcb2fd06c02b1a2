"""Every default of the method, once: functions, terminal and widgets all read them here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Integral, Rational, Real
from typing import TYPE_CHECKING, Any, Literal, get_args

if TYPE_CHECKING:
    from napari_defocus.psf.families import PSFFamily

Mode = Literal["curve", "paper"]
Spectra = Literal["exact", "fitted"]
Linearize = Literal["srgb"]
Side = Literal["far", "near"]

COMPARED_PSFS = (
    "disc",
    "polygon:5",
    "polygon:6",
    "polygon:8",
    "annulus:0.3",
    "annulus:0.5",
    "gaussian",
)
"""The lenses that are compared unless others are named; each as `psf_from_text` reads it."""

BLOCK_SIZE = 1024
"""Side, in px, of the parts in which large pictures are worked on: memory is bounded by it."""

LEAST_BLOCK_SIZE = 256

CONFIDENT = 0.5
"""The confidence from which on a pixel counts as sure, where shares of a picture are told."""


@dataclass(frozen=True, kw_only=True)
class MapSettings:
    """What shapes a blur map.

    Attributes
    ----------
    noise_variance : float or None
        Variance of the noise in the luminance, intensities in [0, 1]; None finds it from
        the picture.
    psf : str
        The PSF family, as `napari_defocus.psf_from_text` reads it.
    max_radius : float
        Largest blur radius that is looked for, in px; see `psf_of` for families whose scale is
        no radius.
    window : int
        Side N of the analysis window, in px; odd.
    stride : int
        Distance between analysed windows, in px.
    smoothness : float
        lambda_0 of (16), per label step of 0.1 px.
    color_sigma : float
        sigma_lambda of (16), as a share of the picture's contrast.
    mode : {"curve", "paper"}
        The paper's method to the letter, or with what measurements added to it: a
        quasi-likelihood, and its whole curve as data term of (14).
    linearize : {"srgb"} or None
        Estimate on intensities decoded into linear light, in which blur is a convolution.
    shot_noise : bool
        Whether the noise grows with the intensity; how, is found from the picture.
    """

    noise_variance: float | None = None
    psf: str = "disc"
    max_radius: float = 8.0
    window: int = 41
    stride: int = 4
    smoothness: float = 20.0
    color_sigma: float = 0.1
    mode: Mode = "curve"
    linearize: Linearize | None = None
    shot_noise: bool = False

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        check_noise_variance(self.noise_variance)
        check_weights(self.smoothness, self.color_sigma)
        check_mode(self.mode)
        check_linearize(self.linearize)
        check_whole("window", self.window)
        check_whole("stride", self.stride)
        check_flag("shot_noise", self.shot_noise)
        if self.shot_noise and self.noise_variance is not None:
            raise ValueError(
                f"noise_variance is {self.noise_variance} and shot_noise is set; "
                "noise that grows with the intensity is found from the picture"
            )

    def family(self) -> PSFFamily:
        """Return the PSF family that `psf` and `max_radius` say, see `psf_of`."""
        return psf_of(self.psf, self.max_radius)


def psf_of(text: str, max_radius: float) -> PSFFamily:
    """Make a PSF family for blurs up to a radius.

    A disc of radius r has a standard deviation of r / 2 along an axis: families whose scale is
    a standard deviation are looked for up to half of `max_radius`. Measured ones are looked for
    up to their own largest scale if that is smaller.

    Parameters
    ----------
    text : str
        What `napari_defocus.psf_from_text` reads.
    max_radius : float
        Largest radius that is looked for, in px.

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
    Gaussian(max_sigma=3.0)
    """
    # Not above: the families take their defaults from here.
    from napari_defocus.psf.measured import MeasuredPSF
    from napari_defocus.psf.text import psf_from_text

    family = psf_from_text(text)
    if isinstance(family, MeasuredPSF):
        largest = min(max_radius, family.max_scale)
    else:
        largest = max_radius / radius_per_scale(family)
    return psf_from_text(text, largest)


def usual_threshold(family: PSFFamily) -> float:
    """Return the default threshold of a mask in a family's own scale, in px, see `psf_of`."""
    return MaskSettings.threshold / radius_per_scale(family)


def radius_per_scale(family: PSFFamily) -> int:
    """Return how many px of blur radius a px of a family's scale is: 2 for standard deviations."""
    return 2 if family.scale_name.startswith("standard deviation") else 1


@dataclass(frozen=True, kw_only=True)
class MaskSettings:
    """What shapes an in-focus mask, given the candidates.

    Attributes
    ----------
    threshold : float
        tau of (18): the largest radius, in px, that counts as in focus; for families whose
        scale is no radius, the largest scale, see `usual_threshold`.
    smoothness : float
        lambda_0 of (16) for the mask.
    color_sigma : float
        sigma_lambda of (16) for the mask, as a share of the picture's contrast.
    """

    threshold: float = 2.0
    smoothness: float = 1000.0
    color_sigma: float = 0.04

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        check_threshold(self.threshold, math.inf)
        check_weights(self.smoothness, self.color_sigma)


@dataclass(frozen=True, kw_only=True)
class RestorationSettings:
    """What shapes an all-in-focus picture.

    Attributes
    ----------
    noise_variance : float or None
        Variance of the noise in the luminance, intensities in [0, 1]; None finds it from
        the picture.
    tv_weight : float or None
        lambda of (19), intensities in [0, 1]; None derives it from the noise variance.
    risk : float
        Of taking too much blur away, see `napari_defocus.cautious_blur_map`.
    """

    noise_variance: float | None = None
    tv_weight: float | None = None
    risk: float = 0.1

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        check_noise_variance(self.noise_variance)
        check_tv_weight(self.tv_weight)
        check_risk(self.risk)


@dataclass(frozen=True, kw_only=True)
class RefocusSettings:
    """What shapes a picture with another focus.

    Attributes
    ----------
    focus : float
        The blur, in px, of what shall be sharp; negative on the other side of the old focus.
    aperture : float
        How many times as wide the blur shall be.
    side : {"far", "near"}
        On which side of the old focus everything blurred lies.
    linearize : {"srgb"} or None
        Decode into linear light, blur there, and encode again.
    """

    focus: float = 0.0
    aperture: float = 1.0
    side: Side = "far"
    linearize: Linearize | None = "srgb"

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        check_focus(self.focus)
        check_aperture(self.aperture)
        check_side(self.side)
        check_linearize(self.linearize)


def check_real(name: str, value: Any, takes: str) -> None:
    """Refuse, naming it, what is no real number; comparing it would fail without a name.

    Fractions are none here: NumPy and numba do not count with them.
    """
    fraction = isinstance(value, Rational) and not isinstance(value, Integral)
    if not isinstance(value, Real) or fraction:
        raise TypeError(f"{name} is {value!r}; it takes {takes}")


def check_flag(name: str, value: Any) -> None:
    """Refuse, naming it, what is neither True nor False, NumPy's or Python's."""
    if value is not True and value is not False and type(value).__name__ != "bool":
        raise TypeError(f"{name} is {value!r}; it takes True or False")


def check_whole(name: str, value: Any) -> None:
    """Refuse, naming it, what is no number of px from 1 up."""
    if not isinstance(value, Integral) or int(value) < 1:
        raise ValueError(f"{name} is {value!r}; it takes a whole number of px from 1 up")


def check_focus(focus: Any) -> None:
    """Check the scale that shall be sharp, in px."""
    check_real("focus", focus, "a finite number of px")
    if not math.isfinite(focus):
        raise ValueError(f"focus is {focus}; it takes a finite number of px")


def check_aperture(aperture: Any) -> None:
    """Check the factor of all blur."""
    check_real("aperture", aperture, "a finite number from 0 up")
    if not 0 <= float(aperture) < math.inf:
        raise ValueError(f"aperture is {aperture}; it takes a finite number from 0 up")


def check_side(side: str) -> None:
    """Check the name of a side of the focus."""
    if not isinstance(side, str) or side not in get_args(Side):
        raise ValueError(f"side is {side!r}; it takes one of {get_args(Side)}")


def check_tv_weight(tv_weight: float | None) -> None:
    """Check lambda of (19); None derives it from the noise variance."""
    if tv_weight is None:
        return
    check_real("tv_weight", tv_weight, "a finite number above 0, or None")
    if not (math.isfinite(tv_weight) and tv_weight > 0):
        raise ValueError(f"tv_weight is {tv_weight}; it takes a finite number above 0, or None")


def check_noise_variance(noise_variance: float | None) -> None:
    """Check the noise variance of an estimation; None finds it from the picture."""
    if noise_variance is None:
        return
    check_real("noise_variance", noise_variance, "a finite number from 0 up, or None")
    if not 0 <= noise_variance <= 1e15:
        raise ValueError(
            f"noise_variance is {noise_variance}; it takes a finite number from 0 up (to 1e15), "
            "or None"
        )


def check_block_size(block_size: Any) -> None:
    """Check the side of the parts in which large pictures are worked on, in px."""
    if not isinstance(block_size, Integral) or int(block_size) < LEAST_BLOCK_SIZE:
        raise ValueError(
            f"block_size is {block_size}; it takes a whole number of px from {LEAST_BLOCK_SIZE} up"
        )


def check_stride(stride: Any, window: int) -> None:
    """Check the distance between analysed windows against their side, in px."""
    if not isinstance(stride, Integral) or not 1 <= int(stride) <= window:
        raise ValueError(f"stride is {stride}; it takes a whole number of px from 1 to {window}")


def check_weights(smoothness: float, color_sigma: float) -> None:
    """Check the parameters of (16)."""
    check_real("smoothness", smoothness, "a finite number from 0 up")
    check_real("color_sigma", color_sigma, "a finite number above 0")
    # In single precision, larger ones are infinite; the square of color_sigma is divided by.
    if not 0 <= smoothness <= 1e15:
        raise ValueError(
            f"smoothness is {smoothness}; it takes a finite number from 0 up (to 1e15)"
        )
    if not 1e-15 <= color_sigma <= 1e15:
        raise ValueError(
            f"color_sigma is {color_sigma}; it takes a finite number above 0 (1e-15 to 1e15)"
        )


def check_mode(mode: str) -> None:
    """Check the name of a mode."""
    if not isinstance(mode, str) or mode not in get_args(Mode):
        raise ValueError(f"mode is {mode!r}; it takes one of {get_args(Mode)}")


def check_threshold(threshold: float, max_scale: float) -> None:
    """Check tau of (18) against the largest scale that is looked for, in px."""
    check_real("threshold", threshold, "a number of px")
    if not 0 <= threshold < max_scale:
        raise ValueError(
            f"threshold is {threshold}; it takes a scale from 0 to below {max_scale:g} px, "
            f"the largest that is looked for"
        )


def check_risk(risk: float) -> None:
    """Check the risk of taking too much blur away."""
    check_real("risk", risk, "a number from 0 to 1")
    if not 0 <= risk <= 1:
        raise ValueError(f"risk is {risk}; it takes a number from 0 to 1")


def check_confidence(name: str, confidence: float) -> None:
    """Check a limit for the confidence."""
    check_real(name, confidence, "a number from 0 to 1")
    if not 0 <= confidence <= 1:
        raise ValueError(f"{name} is {confidence}; it takes a number from 0 to 1")


def check_linearize(linearize: str | None) -> None:
    """Check the name of an encoding; None leaves intensities as they are."""
    if linearize is None:
        return
    if not isinstance(linearize, str) or linearize not in get_args(Linearize):
        raise ValueError(
            f"linearize is {linearize!r}; it takes one of {get_args(Linearize)}, or None"
        )
