"""Where a picture says whether it is in focus, and where it does not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.image import given_array
from napari_defocus.labeling.confidence import at_pixels
from napari_defocus.labeling.focus_threshold import likeliest_scales
from napari_defocus.labeling.problem import LabelingProblem
from napari_defocus.settings import CONFIDENT, UNKNOWN, MaskSettings

_MOSTLY_KNOWN = 0.5
"""Share of a picture. In photographs, 0.85 or more is known. Chosen by hand."""

_ALL_IN_FOCUS, _CLEAR_THRESHOLD = 0.99, 2.5
"""A share of what is known, and px: larger thresholds are found if the sharpest places are clearly
blurred. Chosen by hand.
"""


def mask_remarks(
    in_focus: float | None, known: float, *, unknown: str, threshold_found: float | None
) -> Iterator[str]:
    """Yield a sentence for each reason why a mask says less than it seems to.

    Parameters
    ----------
    in_focus : float or None
        The share of what is known that the mask calls in focus; None if nothing is known.
    known : float
        The share of the picture that is known.
    unknown : {"fill", "leave"}
        What was done with what is not known.
    threshold_found : float or None
        The threshold, in px, if it was found from the picture.

    Examples
    --------
    >>> next(mask_remarks(0.5, 0.18, unknown="fill", threshold_found=2.0))[:44]
    'The blur is not known on 82 % of the picture'
    """
    if in_focus is None:
        yield "The blur is not known anywhere, so the mask says nothing."
    elif unknown == "fill" and known < _MOSTLY_KNOWN:
        yield (
            f"The blur is not known on {100 * (1 - known):.0f} % of the picture: the mask is "
            "filled there from around, unless you leave what is unknown."
        )
    blurred = threshold_found is not None and threshold_found >= _CLEAR_THRESHOLD
    if blurred and in_focus is not None and in_focus >= _ALL_IN_FOCUS:
        yield (
            "All that is known counts as in focus, by the sharpest places of this picture. If all "
            "of it may be blurred, give a threshold in px."
        )


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
