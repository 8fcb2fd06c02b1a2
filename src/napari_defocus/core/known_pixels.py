"""Which pixels of a picture are known: not NaN, not masked, not fully transparent."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.intensity import Limits


def known_pixels(image: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Return which pixels of a picture, (..., H, W[, 3 or 4]), have colours; None if all do.

    Those that are fully transparent, NaN in a channel or masked do not.
    """
    array = np.ma.getdata(image)
    unknown: list[NDArray[np.bool_]] = []
    if np.ma.is_masked(image):
        unknown.append(np.ma.getmaskarray(image))
    if array.dtype.kind == "f":
        unknown.append(np.isnan(array))
    if array.ndim == 3:
        unknown = [np.asarray(channels.any(axis=2)) for channels in unknown]
        if array.shape[2] == 4:
            unknown.append(array[..., 3] == 0)
    known = ~np.any(unknown, axis=0) if unknown else None
    return None if known is None or known.all() else np.asarray(known)


def known_values(image: NDArray[Any], every: int = 1) -> NDArray[Any]:
    """Return the intensities of the known pixels of a picture: (N,), of its colours.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) ndarray
        It may be masked.
    every : int, optional
        Only of every so many pixels.
    """
    return values_where(np.ma.getdata(image), known_pixels(image), every)


def values_where(
    array: NDArray[Any], known: NDArray[np.bool_] | None, every: int = 1
) -> NDArray[Any]:
    """Return the intensities of a picture where it is known, see `known_values`."""
    colors = array[..., :3] if array.ndim == 3 else array[..., None]
    values = (colors.reshape(-1, colors.shape[2]) if known is None else colors[known])[::every]
    # Quantiles are counted with, which bool is not made for, and half precision too coarse.
    counted = {"?": np.uint8, "e": np.float32}.get(array.dtype.char)
    return (values if counted is None else values.astype(counted)).ravel()


def limits_of(image: NDArray[Any]) -> Limits:
    """Return the smallest and the largest known intensity of a picture, or of a piece of one."""
    return Limits.of(known_values(image))


def check_no_infinity(array: NDArray[Any], known: NDArray[np.bool_] | None) -> None:
    """Refuse a picture with infinite values where it is known."""
    if array.dtype.kind != "f":
        return
    infinite = np.isinf(array if known is None else array[known])
    if infinite.any():
        raise ValueError("image has infinite values; it takes finite ones, NaN where unknown")
