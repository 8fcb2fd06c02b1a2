"""What arguments may be: their choices, and checks that name what they refuse."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from numbers import Integral, Rational, Real
from typing import Any, Literal, TypeVar, get_args

T = TypeVar("T")

Mode = Literal["curve", "paper"]
Spectra = Literal["exact", "fitted"]
Linearize = Literal["srgb"]
Side = Literal["far", "near"]
Unknown = Literal["fill", "leave"]

LARGEST_SOFTNESS = 5.0
"""px; a camera that is softer than that resolves nothing of a window."""

LEAST_BLOCK_SIZE = 256
"""px; smaller tiles see more of their neighbours than of themselves."""


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
    """Refuse, naming it, what is not a number of px from 1 up."""
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


def check_unknown(unknown: str) -> None:
    """Check what becomes of places that are not known."""
    if not isinstance(unknown, str) or unknown not in get_args(Unknown):
        raise ValueError(f"unknown is {unknown!r}; it takes one of {get_args(Unknown)}")


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


def renamed(old: str, given: T | None, new: str, value: T | None) -> T | None:
    """Return the value of an argument that may be given by its old name, with a warning."""
    if given is None:
        return value
    warnings.warn(f"{old} is called {new} now", FutureWarning, stacklevel=3)
    return given


def check_softness(softness: float) -> None:
    """Check the standard deviation of a camera's own blur, in px."""
    check_real("camera_softness", softness, "a number of px from 0 to 5")
    if not 0 <= softness <= LARGEST_SOFTNESS:
        raise ValueError(f"camera_softness is {softness}; it takes a number of px from 0 to 5")


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
        largest = f"to below {max_scale:g} px, the largest radius that is looked for"
        takes = "0 px up" if math.isinf(max_scale) else f"0 {largest}"
        raise ValueError(f"threshold is {threshold}; it takes a blur radius from {takes}")


def check_threshold_or_auto(threshold: float | str, max_scale: float) -> None:
    """Check tau of (18), or the word that lets the picture say it."""
    if isinstance(threshold, str):
        if threshold != "auto":
            raise ValueError(f"threshold is {threshold!r}; it takes a number of px, or 'auto'")
        return
    check_threshold(threshold, max_scale)


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


def check_number(
    name: str, value: Any, fits: Callable[[Any], bool], takes: str, kind: type = Real
) -> None:
    """Refuse, naming it, what is of another type or does not fit."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} is {value!r}; it takes {takes}")
    check_real(name, value, takes)
    if not fits(value):
        raise ValueError(f"{name} is {value}; it takes {takes}")
