"""Any input array made ready: intensities in [0, 1], luminance, which pixels are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from napari_defocus.core.checks import Linearize, check_linearize
from napari_defocus.core.intensity import (
    Intensities,
    IntensityRange,
    Limits,
    found_intensities,
    needs_limits,
)
from napari_defocus.core.known_pixels import check_no_infinity, known_pixels, values_where

LUMA_WEIGHTS = (0.299, 0.587, 0.114)
"""ITU-R BT.601: the luminance that JPEG keeps at full resolution."""

MIN_SIDE = 3
"""px: the least side of a picture, because second differences need three pixels."""

_LARGEST = 1e9
"""Intensity, once it is scaled: its fourth power is still a number in single precision."""

_DARK, _DARKEST = 0.5, 1e-3
"""Pictures whose contrast is less than _DARK of the range are shown brighter: from the quantile
_DARKEST to the opposite one. Chosen by hand, for the eye.
"""


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
        False at pixels that are not known, and carry no evidence: fully transparent, NaN or
        masked. They have the colour of the nearest known pixel. None if all are known.
    intensities : Intensities
        What has become 0 and 1, and the contrast.
    weight : (H, W) float32 ndarray or None
        How much the details at each pixel count, from 0 to 1. None if all do.
    """

    color: NDArray[np.float32]
    luminance: NDArray[np.float32]
    opaque: NDArray[np.bool_] | None
    intensities: Intensities
    weight: NDArray[np.float32] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in px."""
        return self.luminance.shape[0], self.luminance.shape[1]

    @property
    def rounding_variance(self) -> float:
        """No noise is smaller: about the square of what single precision rounds away."""
        return float(np.finfo(np.float32).eps * np.abs(self.luminance).max()) ** 2

    @property
    def evened(self) -> NDArray[np.float32]:
        """The luminance divided by the unit of the intensities: of a contrast of about 1."""
        unit = self.intensities.unit
        return self.luminance if unit == 1 else self.luminance / np.float32(unit)


def prepare_image(
    image: ArrayLike,
    intensity_range: IntensityRange | Intensities | Limits | None = None,
    linearize: Linearize | None = None,
) -> PreparedImage:
    """Check a picture and scale it to [0, 1].

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        Any real dtype; see `found_intensities` for what becomes 0 and 1. A fourth channel is
        opacity: its zeros mark pixels that are not known, as NaN does, and the mask of a masked
        array.
    intensity_range : (float, float), Intensities or Limits, optional
        The intensities that become 0 and 1, instead of those that are found; or all that was
        found before, for a piece of a picture; or the limits that several pictures share.
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
        If the shape is none of the above, a side is below 3 px, a known value is infinite, or
        beyond 1e9 once it is scaled,
        `intensity_range` is not two increasing finite numbers, or `linearize` is unknown.
    """
    check_linearize(linearize)
    array, known = checked_array(image)
    intensities = _intensities(array, known, intensity_range)
    if array.ndim == 3 and array.shape[2] == 4:
        array = array[..., :3]
    # Differences of large numbers need double precision; 8 and 16 bits fit into single. Row by
    # row, whatever the order was: kernels are compiled for each order that they get.
    intensity: NDArray[np.floating] = array.astype(
        np.float32 if array.dtype.itemsize <= 2 else np.float64, order="C"
    )
    with np.errstate(over="ignore", invalid="ignore"):
        intensity -= intensities.low
        intensity /= intensities.span
        color = intensity.reshape(*array.shape[:2], -1).astype(np.float32)
        if known is not None:
            color = nearest_known(color, known)
        if linearize == "srgb":
            color = decode_srgb(color)
    # Infinity is above it, too. Fourth powers, such as variances of powers, fit below.
    if not (np.abs(color) <= _LARGEST).all():
        raise ValueError(
            f"image has values up to {np.nanmax(np.abs(array)):g}; it takes intensities around "
            f"{intensities.low:g} to {intensities.high:g}, or another intensity_range"
        )
    return PreparedImage(color, _luminance(color), known, intensities)


def shown_colors(picture: PreparedImage) -> NDArray[np.float32]:
    """Return the colours of a picture as they are seen best: (H, W, C) in [0, 1].

    What fills little of its range is brightened, and what is not known is black.
    """
    color, known = picture.color, picture.opaque
    if picture.intensities.contrast < _DARK:
        seen = color if known is None else color[known]
        low, high = np.quantile(seen, (_DARKEST, 1 - _DARKEST))
        color = (color - np.float32(low)) / np.float32(high - low or 1)
    color = np.clip(color, 0.0, 1.0)
    return color if known is None else np.where(known[..., None], color, np.float32(0))


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
    array = np.ma.getdata(given_image(name, values))
    if np.ma.is_masked(values):
        raise ValueError(
            f"{name} has masked values; it takes an array without a mask, such as {name}.filled()"
        )
    return array


def given_reals(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return an argument as an array of real numbers in double precision.

    Raises
    ------
    TypeError
        If its dtype is none of integers or floats.
    ValueError
        As `given_array`.
    """
    array = given_array(name, values)
    if array.dtype.kind not in "uif":
        raise TypeError(f"{name} has dtype {array.dtype}; it takes real numbers")
    return array.astype(np.float64)


def given_image(name: str, values: ArrayLike) -> NDArray[Any]:
    """Return a picture as an array, with its mask if it has one.

    Raises
    ------
    ValueError
        If it is none.
    """
    if isinstance(values, np.ma.MaskedArray):
        return values
    try:
        return np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{name} is not an array: {error}") from None


def prepare_light(
    image: ArrayLike, intensity_range: IntensityRange | None, linearize: Linearize | None = None
) -> PreparedImage:
    """Prepare a picture for a forward model: floats as they are, and without opacity.

    Light may be much brighter than white, and what it becomes is told in the same unit.
    """
    given = given_image("image", image)
    if given.ndim == 3 and given.shape[2] == 4:
        given = given[..., :3]
    if intensity_range is None and given.dtype.kind == "f":
        intensity_range = 0.0, 1.0
    return prepare_image(given, intensity_range, linearize)


def with_unknown(result: NDArray[np.float32], image: ArrayLike) -> NDArray[np.float32]:
    """Return a picture that is NaN where the one that it was made of is NaN or masked.

    Parameters
    ----------
    result : (H, W) or (H, W, C) float32 ndarray
        Changed in place. Its opacity, if it has four channels, stays.
    image : (H, W) or (H, W, C) array_like
    """
    given = given_image("image", image)
    known = known_pixels(given[..., :3] if given.ndim == 3 else given)
    if known is not None:
        colors = result[..., :3] if result.ndim == 3 else result
        colors[~known] = np.nan
    return result


def _intensities(
    array: NDArray[Any],
    known: NDArray[np.bool_] | None,
    intensity_range: IntensityRange | Intensities | Limits | None,
) -> Intensities:
    if isinstance(intensity_range, Intensities):
        return intensity_range
    values = values_where(array, known)
    if isinstance(intensity_range, Limits):
        return found_intensities(array.dtype, None, intensity_range, values)
    given = checked_range(intensity_range)
    limits = Limits.of(values) if needs_limits(array.dtype, given) else None
    return found_intensities(array.dtype, given, limits, values)


def nearest_known(values: NDArray[Any], known: NDArray[np.bool_]) -> NDArray[Any]:
    """Give each pixel that is not known the value of the nearest one: no edge, no noise.

    Parameters
    ----------
    values : (H, W) or (H, W, C) ndarray
    known : (H, W) bool ndarray

    Returns
    -------
    ndarray
        Of the same shape and dtype; zeros if nothing is known.
    """
    if not known.any():
        return np.zeros_like(values)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled: NDArray[Any] = values[tuple(nearest)]
    return filled


def checked_array(image: ArrayLike) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
    """Return a picture's values, and which of its pixels are known; None if all are."""
    given = given_image("image", image)
    if given.dtype.kind not in "buif":
        raise TypeError(
            f"image has dtype {given.dtype}; it takes a real one (integers, floats or bool); "
            "read_picture reads a file"
        )
    if not (given.ndim == 2 or (given.ndim == 3 and given.shape[2] in (3, 4))):
        raise ValueError(f"image has shape {given.shape}; it takes (H, W), (H, W, 3) or (H, W, 4)")
    if min(given.shape[:2]) < MIN_SIDE:
        raise ValueError(
            f"image is {given.shape[0]} x {given.shape[1]} px; "
            f"it takes at least {MIN_SIDE} px a side"
        )
    known, array = known_pixels(given), np.ma.getdata(given)
    check_no_infinity(array, known)
    return array, known


def checked_range(intensity_range: IntensityRange | None) -> IntensityRange | None:
    """Return the intensities that are given as 0 and 1, checked; None if they are to be found."""
    if intensity_range is None:
        return None
    try:
        low, high = (float(value) for value in intensity_range)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not (np.isfinite([low, high]).all() and low < high):
        raise ValueError(
            f"intensity_range is {intensity_range!r}; "
            "it takes two finite numbers (low, high), the higher one last"
        )
    return low, high


def _luminance(color: NDArray[np.float32]) -> NDArray[np.float32]:
    if color.shape[2] == 1:
        return color[..., 0]
    # No matrix product: its last bit depends on the picture's size, which parts must not see.
    red, green, blue = (np.float32(weight) * color[..., k] for k, weight in enumerate(LUMA_WEIGHTS))
    return red + green + blue
