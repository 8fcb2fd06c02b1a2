"""Where a picture says whether it is in focus, and where it does not."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.image import given_array
from napari_defocus.labeling.confidence import at_pixels
from napari_defocus.labeling.focus_threshold import likeliest_scales
from napari_defocus.labeling.problem import LabelingProblem
from napari_defocus.settings import CONFIDENT, UNKNOWN, MaskSettings


def with_unknown_left(
    mask: NDArray[np.uint8],
    problem: LabelingProblem,
    settings: MaskSettings,
    *,
    seeds: ArrayLike | None = None,
    within: NDArray[np.bool_] | None = None,
) -> NDArray[np.uint8]:
    """Return a mask with 2 where it is not known, if that is to be left; outside else 0.

    Somebody who has painted seeds knows.
    """
    leave = settings.unknown == "leave"
    if leave:
        known = known_places_of(problem)
        if seeds is not None:
            known |= np.asarray(seeds) != 0
        mask = np.where(known, mask, UNKNOWN).astype(np.uint8)
    if within is not None:
        mask = np.where(within, mask, UNKNOWN if leave else 0).astype(np.uint8)
    return mask


def known_places_of(problem: LabelingProblem) -> NDArray[np.bool_]:
    """Return where the likeliest radius has a confidence of 0.5 or more: (H, W)."""
    _, confidence = likeliest_scales(problem.own)
    known: NDArray[np.bool_] = at_pixels(confidence, problem.own) >= CONFIDENT
    opaque = problem.picture.opaque
    return known if opaque is None else known & opaque


def checked_within(within: ArrayLike, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Check what shall be judged against the height and width of its picture.

    Raises
    ------
    TypeError
        If it holds neither bool nor integers.
    ValueError
        If it has another shape, or marks nothing.
    """
    array = given_array("within", within)
    if array.dtype.kind not in "bui":
        raise TypeError(f"within has dtype {array.dtype}; it takes bool or integers")
    if array.shape != tuple(shape):
        raise ValueError(
            f"within has shape {array.shape}; it takes the height and width of the picture, "
            f"{tuple(shape)}"
        )
    if not array.any():
        raise ValueError("within is 0 everywhere; it takes a mask or labels that mark something")
    return np.asarray(array != 0)
