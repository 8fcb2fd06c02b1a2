"""Every default of the method, once: functions, terminal and widgets all read them here."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from napari_defocus.core.checks import (
    Linearize,
    Mode,
    Side,
    Unknown,
    check_aperture,
    check_confidence,
    check_flag,
    check_focus,
    check_linearize,
    check_mode,
    check_noise_variance,
    check_number,
    check_risk,
    check_side,
    check_softness,
    check_threshold_or_auto,
    check_tv_weight,
    check_unknown,
    check_weights,
    check_whole,
)
from napari_defocus.core.picture_remarks import SATURATED
from napari_defocus.psf import MAX_RADIUS, is_left_open

if TYPE_CHECKING:
    from napari_defocus.psf.families import PSFFamily

COMPARED_PSFS = (
    "disc",
    "polygon:5",
    "polygon:6",
    "polygon:8",
    "annulus:0.3",
    "annulus:0.5",
    "gaussian",
)
"""The lenses that are compared by default; each as `psf_from_text` reads it."""

BLOCK_SIZE = 1024
"""Side, in px, of the parts in which large pictures are worked on. It bounds the memory."""

USUAL_THRESHOLD = 2.0
"""px: tau of (18) in the paper; up to it, a pixel is in focus where the picture does not tell."""

THRESHOLD_PLANES = 8
"""Of a stack, in which the threshold of masks is looked for, evenly apart; chosen by hand."""

UNKNOWN = 2
"""In a mask, what is not known; beside 0, blurred, and 1, in focus."""

CONFIDENT = 0.5
"""A pixel counts as sure from this confidence on."""


@dataclass(frozen=True, kw_only=True)
class MapSettings:
    """What shapes a blur map.

    Attributes
    ----------
    noise_variance : float or None
        Variance of the noise in the luminance, intensities in [0, 1]; None finds it from
        the picture.
    psf : str
        The PSF family, as `napari_defocus.psf_from_text` reads it; "auto" lets the picture choose.
    max_radius : float
        Largest blur radius that is looked for, in px, see `psf_of`. Small pictures are searched up
        to less: 32 px if their shorter side is below 656 px, 16 px below 328 px, 8 px below 164 px
        (of windows of 41 px).
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
    camera_softness : float
        Standard deviation, in px, of the blur that the camera has of its own: optics, diffraction,
        pixels, demosaicking. The map is the defocus beyond it.
    shot_noise : bool
        Whether the noise grows with the intensity; how, is found from the picture.
    """

    noise_variance: float | None = None
    psf: str = "disc"
    max_radius: float = MAX_RADIUS
    window: int = 41
    stride: int = 4
    smoothness: float = 20.0
    color_sigma: float = 0.1
    mode: Mode = "curve"
    linearize: Linearize | None = None
    camera_softness: float = 0.35
    shot_noise: bool = False

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        check_noise_variance(self.noise_variance)
        check_weights(self.smoothness, self.color_sigma)
        check_mode(self.mode)
        check_linearize(self.linearize)
        check_softness(self.camera_softness)
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
        from napari_defocus.psf.parsing import psf_of

        return psf_of(self.psf, self.max_radius)

    def settled(self, psf: PSFFamily) -> MapSettings:
        """Return the settings with the family that the picture chose, if it was to choose."""
        if not is_left_open(self.psf):
            return self
        from napari_defocus.psf.parsing import psf_text

        return replace(self, psf=psf_text(psf))


@dataclass(frozen=True, kw_only=True)
class MaskSettings:
    """What shapes an in-focus mask, given the candidates.

    Attributes
    ----------
    threshold : float or "auto"
        tau of (18): the largest blur radius, in px, that counts as in focus; "auto" finds it from
        the picture, see `napari_defocus.focus_threshold`.
    smoothness : float
        lambda_0 of (16) for the mask.
    color_sigma : float
        sigma_lambda of (16) for the mask, as a share of the picture's contrast.
    unknown : {"fill", "leave"}
        What becomes of places without an answer of their own, because the likeliest radius of
        their surroundings has a confidence below 0.5: filled from around, or left, as 2 in the
        mask. The confidence of a map is another one, that of what the map says there.
    """

    threshold: float | Literal["auto"] = "auto"
    smoothness: float = 1000.0
    color_sigma: float = 0.04
    unknown: Unknown = "fill"

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        check_threshold_or_auto(self.threshold, math.inf)
        check_weights(self.smoothness, self.color_sigma)
        check_unknown(self.unknown)


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
    risk: float = 0.3

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
        Decode into linear light, blur there, and encode again. Not the default of `MapSettings`:
        what is measured may be a scan or a microscope's picture, which is linear, but what gets
        another focus is looked at on a screen. One default for both would change pictures, or
        maps, of calls and settings files as they are.
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


@dataclass(frozen=True, kw_only=True)
class FieldLimits:
    """Which fields of a batch are flagged in its table and its report.

    All shares are from 0 to 1. A field is a picture, or a plane of a stack. The defaults are
    chosen by hand, and careful with motion: bricks and stalks have `one_direction` up to 0.9.
    Cells and tissue have up to 0.5 and, after motion, 0.7 or more: 0.6 is a good limit for them.

    Attributes
    ----------
    in_focus_up_to : float
        Largest blur radius, in px, that counts as in focus. A field whose median is above it is
        out of focus.
    min_share_in_focus : float
        A field is partly out of focus if less of what is known is in focus.
    min_share_known : float
        A field is empty if less of it is known, which is a confidence of 0.5 or more.
    max_share_saturated : float
        A field is saturated if more of its pixels are as bright as the picture can be.
    max_one_direction : float
        A field does not look like defocus if its places agree more in the direction of their
        details, as after motion: 0 is not at all, 1 is all in one.

    Examples
    --------
    >>> FieldLimits(in_focus_up_to=2.5).min_share_in_focus
    0.75
    """

    in_focus_up_to: float = 1.5
    min_share_in_focus: float = 0.75
    min_share_known: float = 0.05
    max_share_saturated: float = SATURATED
    max_one_direction: float = 0.95

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        above = "a finite number of px above 0"
        check_number("in_focus_up_to", self.in_focus_up_to, lambda v: 0 < v < math.inf, above)
        shares = ("min_share_in_focus", "min_share_known", "max_share_saturated")
        for name in (*shares, "max_one_direction"):
            check_confidence(name, getattr(self, name))
