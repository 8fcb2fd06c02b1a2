"""Every default of the method, once: functions, terminal and widgets all read them here."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

Mode = Literal["curve", "paper"]
Spectra = Literal["exact", "fitted"]


@dataclass(frozen=True, kw_only=True)
class MapSettings:
    """What shapes a blur map.

    Attributes
    ----------
    noise_variance : float or None
        Variance of the noise in the luminance, intensities in [0, 1]; None finds it from
        the picture.
    max_radius : float
        Largest blur radius that is looked for, in px.
    window : int
        Side N of the analysis window, in px; odd.
    stride : int
        Distance between analysed windows, in px.
    smoothness : float
        lambda_0 of (16), per label step of 0.1 px.
    color_sigma : float
        sigma_lambda of (16), intensities in [0, 1].
    mode : {"curve", "paper"}
        The paper's method to the letter, or with what measurements added to it: a
        quasi-likelihood, and its whole curve as data term of (14).
    """

    noise_variance: float | None = None
    max_radius: float = 8.0
    window: int = 41
    stride: int = 4
    smoothness: float = 20.0
    color_sigma: float = 0.1
    mode: Mode = "curve"

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        check_noise_variance(self.noise_variance)
        check_weights(self.smoothness, self.color_sigma)
        check_mode(self.mode)


@dataclass(frozen=True, kw_only=True)
class MaskSettings:
    """What shapes an in-focus mask, given the candidates.

    Attributes
    ----------
    threshold : float
        tau of (18): the largest radius, in px, that counts as in focus.
    smoothness : float
        lambda_0 of (16) for the mask.
    color_sigma : float
        sigma_lambda of (16) for the mask, intensities in [0, 1].
    """

    threshold: float = 2.0
    smoothness: float = 1000.0
    color_sigma: float = 0.04

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        check_threshold(self.threshold, math.inf)
        check_weights(self.smoothness, self.color_sigma)


def check_noise_variance(noise_variance: float | None) -> None:
    """Check the noise variance of an estimation; None finds it from the picture."""
    if noise_variance is not None and not (math.isfinite(noise_variance) and noise_variance >= 0):
        raise ValueError(
            f"noise_variance is {noise_variance}; it takes a finite number from 0 up, or None"
        )


def check_weights(smoothness: float, color_sigma: float) -> None:
    """Check the parameters of (16)."""
    if not (math.isfinite(smoothness) and smoothness >= 0):
        raise ValueError(f"smoothness is {smoothness}; it takes a finite number from 0 up")
    if not (math.isfinite(color_sigma) and color_sigma > 0):
        raise ValueError(f"color_sigma is {color_sigma}; it takes a finite number above 0")


def check_mode(mode: str) -> None:
    """Check the name of a mode."""
    if mode not in get_args(Mode):
        raise ValueError(f"mode is {mode!r}; it takes one of {get_args(Mode)}")


def check_threshold(threshold: float, max_scale: float) -> None:
    """Check tau of (18) against the largest scale that is looked for, in px."""
    if not 0 <= threshold < max_scale:
        raise ValueError(
            f"threshold is {threshold}; it takes a scale from 0 to below {max_scale:g} px, "
            f"the largest that is looked for"
        )
