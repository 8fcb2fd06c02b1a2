"""Every default of the method, once: functions, terminal and widgets all read them here."""

from dataclasses import dataclass
from typing import Literal

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
