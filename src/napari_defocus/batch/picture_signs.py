"""What a row says of a plane beside its blur: saturation, one direction, reasons to be careful."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.batch.table import Row
from napari_defocus.core.picture_remarks import picture_remarks, share_saturated
from napari_defocus.likelihood.signs import one_direction
from napari_defocus.pipeline import Measurement
from napari_defocus.psf.microscope import Microscope

NOTHING_MARKED = "The mask marks nothing in this picture, so no pixel counts."


def signs_of_picture(
    picture: NDArray[Any], found: Measurement, within: NDArray[np.bool_] | None, row: Row
) -> Row:
    """Return the columns `share_saturated`, `one_direction` and `careful` of a plane.

    Parameters
    ----------
    picture : (H, W) or (H, W, 3) or (H, W, 4) ndarray
    found : Measurement
        Of this picture.
    within : (H, W) bool ndarray or None
        What counts.
    row : dict
        What is known of the plane so far, such as the size of a pixel.
    """
    candidates = found.candidates
    assert candidates is not None
    counting = picture if within is None else _masked(picture, within)
    marked = within is None or bool(within.any())
    remarks = [*picture_remarks(counting, candidates.window)] if marked else [NOTHING_MARKED]
    remarks.append(found.doubt or "")
    if isinstance(found.psf, Microscope):
        remarks.append(found.psf.remark_on_pixels(row.get("pixel_width_um")) or "")
    strength = candidates.strength
    if strength is not None and within is not None:
        strength = np.where(_at_windows(within, strength.shape), strength, np.float32(0))
    return {
        "share_saturated": share_saturated(counting),
        "one_direction": one_direction(strength, candidates.direction),
        "careful": " ".join(filter(None, remarks)) or None,
    }


def _masked(picture: NDArray[Any], within: NDArray[np.bool_]) -> NDArray[Any]:
    outside = ~within if picture.ndim == 2 else ~within[..., None]
    hidden = np.broadcast_to(outside, picture.shape) | np.ma.getmaskarray(picture)
    return np.ma.masked_array(np.ma.getdata(picture), hidden)


def _at_windows(within: NDArray[np.bool_], windows: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return whether the block of each window has its centre within: (R, C)."""
    places = (
        ((np.arange(few) + 0.5) * many / few).astype(int)
        for few, many in zip(windows, within.shape, strict=True)
    )
    return within[np.ix_(*places)]
