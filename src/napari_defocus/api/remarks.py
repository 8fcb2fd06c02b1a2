"""Why a picture tells little of its blur, by its values alone: before anything is measured."""

from __future__ import annotations

from numpy.typing import ArrayLike

from napari_defocus.core import picture_remarks as of_arrays
from napari_defocus.core.checks import check_whole
from napari_defocus.core.image import checked_array, given_image
from napari_defocus.settings import MapSettings


def picture_remarks(image: ArrayLike, *, window: int = MapSettings.window) -> list[str]:
    """Say why a picture tells little of its blur, as terminal, tables and napari do.

    It takes milliseconds, and looks at the values alone. That details lie in one direction, or that
    there is only noise, is known after the estimation: see `BlurCandidates.doubt`.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        As `estimate_candidates` takes it. Compression is looked for in uint8 alone.
    window : int, optional
        Side of the windows that the picture is measured with, in px.

    Returns
    -------
    list of str
        A sentence for each reason. It is small, flat or a mask, has a palette, was compressed
        strongly, or many of its pixels are saturated. Empty if nothing is odd.

    Raises
    ------
    TypeError, ValueError
        If `image` is not a picture, or `window` is not a whole number above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_defocus import picture_remarks
    >>> picture_remarks(np.full((100, 120), 90, np.uint8))
    ['All pixels have the same value, so there is no blur to see.']
    """
    checked_array(image)
    check_whole("window", window)
    return of_arrays.picture_remarks(given_image("image", image), int(window))
