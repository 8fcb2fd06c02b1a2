"""Any input array made ready: intensities in [0, 1], luminance, opacity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.settings import Linearize, check_linearize

LUMA_WEIGHTS = (0.299, 0.587, 0.114)
"""ITU-R BT.601: the luminance that JPEG keeps at full resolution."""

MIN_SIDE = 3

_LARGEST = 1e9


@dataclass(frozen=True)
class PreparedImage:
    """A picture in the form that the method works on.

    Attributes
    ----------
    color : (H, W, C) float32 ndarray
        Intensities, nominally in [0, 1]; C is 1 or 3.
    luminance : (H, W) float32 ndarray
        The channel whose spectra are analysed.
    opaque : (H, W) bool ndarray or None
        False at fully transparent pixels, which carry no evidence; None if all are opaque.
    """

    color: NDArray[np.float32]
    luminance: NDArray[np.float32]
    opaque: NDArray[np.bool_] | None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in px."""
        return self.luminance.shape[0], self.luminance.shape[1]

    @property
    def rounding_variance(self) -> float:
        """No noise is smaller: about the square of what single precision rounds away."""
        return float(np.finfo(np.float32).eps * np.abs(self.luminance).max()) ** 2


def prepare_image(
    image: ArrayLike,
    intensity_range: tuple[float, float] | None = None,
    linearize: Linearize | None = None,
) -> PreparedImage:
    """Check a picture and scale it to [0, 1].

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        Any real dtype. Integers are scaled by their dtype's range, floats are taken as they
        are. A fourth channel is opacity: its zeros mark pixels without evidence.
    intensity_range : (float, float), optional
        The intensities that become 0 and 1, instead of the dtype's range.
    linearize : {"srgb"}, optional
        Decode intensities that were encoded for a display into linear light.

    Returns
    -------
    PreparedImage

    Raises
    ------
    TypeError
        If the dtype is not real (object, complex, text).
    ValueError
        If the shape is none of the above, a side is below 3 px, a value is NaN or infinite, or
        beyond 1e9 once it is scaled,
        `intensity_range` is not two increasing finite numbers, or `linearize` is unknown.
    """
    check_linearize(linearize)
    array = _checked_array(image)
    low, high = checked_range(intensity_range, array.dtype)
    opaque = None
    if array.ndim == 3 and array.shape[2] == 4:
        opaque = array[..., 3] > 0
        opaque = None if opaque.all() else opaque
        array = array[..., :3]
    # Differences of large numbers need double precision; 8 and 16 bits fit into single. Row by
    # row, whatever the order was: kernels are compiled for each order that they get.
    intensity: NDArray[np.floating] = array.astype(
        np.float32 if array.dtype.itemsize <= 2 else np.float64, order="C"
    )
    with np.errstate(over="ignore"):
        intensity -= low
        intensity /= high - low
        color = intensity.reshape(*array.shape[:2], -1).astype(np.float32)
        if linearize == "srgb":
            color = decode_srgb(color)
    # Infinity is above it, too. Fourth powers, such as variances of powers, fit below.
    if not (np.abs(color) <= _LARGEST).all():
        raise ValueError(
            f"image has values up to {np.abs(array).max():g}; it takes intensities around [0, 1], "
            "or an intensity_range"
        )
    return PreparedImage(color, _luminance(color), opaque)


def decode_srgb(color: NDArray[np.float32]) -> NDArray[np.float32]:
    """Undo the transfer function of sRGB (IEC 61966-2-1); what is below 0 goes on linearly."""
    curved = ((np.maximum(color, 0) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.where(color <= 0.04045, color / np.float32(12.92), curved)


def encode_srgb(light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Apply the transfer function of sRGB (IEC 61966-2-1); what is below 0 goes on linearly."""
    curved = np.float32(1.055) * np.maximum(light, 0) ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(light <= 0.0031308, np.float32(12.92) * light, curved)


def given_array(name: str, values: ArrayLike) -> NDArray[Any]:
    """Return an argument as an array, whatever its values.

    Raises
    ------
    ValueError
        If it is none, or a masked array with values that are masked: what is behind a mask
        would count as the rest does.
    """
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{name} is no array: {error}") from None
    if np.ma.is_masked(values):
        raise ValueError(f"{name} has masked values; it takes an array without, such as filled()")
    return array


def _checked_array(image: ArrayLike) -> NDArray[Any]:
    array = given_array("image", image)
    if array.dtype.kind not in "buif":
        raise TypeError(
            f"image has dtype {array.dtype}; it takes a real one (integers, floats or bool)"
        )
    if not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (3, 4))):
        raise ValueError(f"image has shape {array.shape}; it takes (H, W), (H, W, 3) or (H, W, 4)")
    if min(array.shape[:2]) < MIN_SIDE:
        raise ValueError(
            f"image is {array.shape[0]} x {array.shape[1]} px; "
            f"it takes at least {MIN_SIDE} px a side"
        )
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError("image has NaN or infinite values; it takes finite ones")
    return array


def checked_range(
    intensity_range: tuple[float, float] | None, dtype: np.dtype[Any]
) -> tuple[float, float]:
    """Return the intensities that become 0 and 1: the given ones, or those of the dtype."""
    if intensity_range is not None:
        try:
            low, high = (float(value) for value in intensity_range)
        except (TypeError, ValueError):
            low, high = np.nan, np.nan
        if not (np.isfinite([low, high]).all() and low < high):
            raise ValueError(
                f"intensity_range is {intensity_range!r}; it takes two finite numbers (low, high)"
            )
        return low, high
    if dtype.kind in "ui":
        limits = np.iinfo(dtype)
        return float(limits.min), float(limits.max)
    return 0.0, 1.0


def _luminance(color: NDArray[np.float32]) -> NDArray[np.float32]:
    if color.shape[2] == 1:
        return color[..., 0]
    # No matrix product: its last bit depends on the picture's size, which parts must not see.
    red, green, blue = (np.float32(weight) * color[..., k] for k, weight in enumerate(LUMA_WEIGHTS))
    return red + green + blue
