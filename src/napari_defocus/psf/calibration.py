"""The PSF of a lens, measured from pictures that it took out of focus (Section III-A).

There are two ways. The pictures show point sources, such as a back-lit pinhole or distant lamps:
then every spot is the PSF. Or they show anything with texture, and there is a sharp picture of the
same: then the PSF is what turns the sharp picture into the blurred one. Few settings of the lens
are enough.
"""

from __future__ import annotations

from collections.abc import Sequence, Sized
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

import napari_defocus
from napari_defocus.core.image import given_image, prepare_image
from napari_defocus.core.intensity import IntensityRange, Limits, needs_limits, range_of_values
from napari_defocus.core.known_pixels import limits_of
from napari_defocus.core.progress import Progress, silent
from napari_defocus.psf.checks import real_array
from napari_defocus.psf.families import Disc
from napari_defocus.psf.measured import MeasuredPSF
from napari_defocus.psf.sharp_pairs import kernel_of_pair
from napari_defocus.psf.spots import kernel_of_points

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_SAME_SETTING = 0.05
"""px: pictures whose scales are closer are of one setting of the focus. Chosen by hand."""

_HEADROOM = 1.01
"""For floats, 1 stands for so many times their range, so that no value counts as saturated.
Chosen by hand.
"""


def calibrate_psf(
    pictures: Sequence[ArrayLike],
    *,
    scales: Sequence[float] | None = None,
    sharp: ArrayLike | Sequence[ArrayLike] | None = None,
    max_scale: float | None = None,
    intensity_range: tuple[float, float] | None = None,
    names: Sequence[str] | None = None,
    progress: Progress = silent,
) -> MeasuredPSF:
    r"""Measure the PSF family of a lens from pictures at a few settings of its focus.

    For point sources, the kernel is the picture, moved to its centroid, :math:`h = g / \sum g`.
    For a sharp picture f and a blurred one g, it is

    .. math:: \hat{h} = \underset{h \ge 0}{\text{arg min}} \sum_{\mathbf{x}}
        \left|(h \otimes f)[\mathbf{x}] - g[\mathbf{x}]\right|^2

    normalised to sum 1. This is the calibration of Section III-A.

    Parameters
    ----------
    pictures : sequence of (H, W) or (H, W, 3) or (H, W, 4) array_like
        One picture for each setting, in any order; at least two settings. The luminance counts.
    scales : sequence of float, optional
        Scale of each picture, in px, for instance from a linear focus scale. These are then the
        scales of the family. By default the blur radius is measured, as for all other families:
        that of the disc with the same second moment.
    sharp : picture or sequence of pictures, optional
        The same scene in focus, taken with the same magnification: one for all pictures, or a
        list of one for each. Without it, the pictures show point sources.
    max_scale : float, optional
        Largest scale that is looked for, in px; by default the largest in the pictures.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1. Point sources that reach 1 are left out. By
        default, integers have the range of their type. Floats that leave [0, 1] share a range
        that no picture reaches, unless they are whole numbers of 8 or 16 bits.
    names : sequence of str, optional
        What the pictures are called, for the family's provenance.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    MeasuredPSF
        Settings less than 0.05 px apart are averaged.

    Raises
    ------
    TypeError, ValueError
        If one of them is not a picture (see `estimate_candidates`), or has no usable point
        source. If a sharp picture has another shape than its blurred one. If `scales`, `sharp` or
        `names` are not as many as the pictures, or there are fewer than two settings.

    Notes
    -----
    A point source is usable if it is not saturated, and if neither the picture's border nor another
    source lies within its own width. The usable ones are added, so a brighter one weighs more.
    Those with less than a tenth of the brightest one's light are left out.

    A sharp picture is aligned by whole px; the kernel minimises the squared difference between
    the blurred sharp picture and the blurred one, under the condition that it is nowhere
    negative (Lawson and Hanson's algorithm on the normal equations). In large pictures, the middle
    512 x 512 px are compared, because the PSF of a lens is another one in the corners.

    Kernels are moved to their centroid by cubic splines. Values below twice the noise around them
    are left out.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_defocus import Disc, simulate_defocus
    >>> from napari_defocus.psf.calibration import calibrate_psf
    >>> lamp = np.zeros((41, 41)); lamp[20, 20] = 1.0
    >>> pictures = [simulate_defocus(lamp, np.full((41, 41), radius)) for radius in (5, 1, 3)]
    >>> calibrate_psf(pictures).scales.round(1)
    array([1., 3., 5.])
    """
    try:
        given = list(pictures)
    except TypeError:
        raise TypeError(f"pictures is {pictures!r}; it takes a list of pictures") from None
    if intensity_range is None:
        references_given = sharp if isinstance(sharp, list | tuple) else [sharp]
        intensity_range = _shared_range([*given, *references_given])
    blurred = [
        _luminance(picture, f"pictures[{i}]", intensity_range) for i, picture in enumerate(given)
    ]
    _check_count("scales", scales, len(blurred))
    given_scales = None if scales is None else _numbers_of_pictures(scales)
    _check_count("names", names, len(blurred))
    references = _references(sharp, blurred, intensity_range)
    kernels = []
    for index, picture in enumerate(blurred):
        progress("Measuring the PSF", index / len(blurred))
        name = f"pictures[{index}]"
        kernels.append(
            kernel_of_points(picture, name)
            if references is None
            else kernel_of_pair(picture, references[index], name)
        )
    found = given_scales
    if found is None:
        found = np.array([disc_radius(kernel) for kernel in kernels])
    setting_scales, setting_kernels = _settings(found, kernels)
    progress("Measuring the PSF", 1.0)
    provenance = {
        "made_from": "point sources" if references is None else "sharp and blurred pictures",
        "pictures": len(blurred),
        "names": None if names is None else [str(name) for name in names],
        "scales": found.tolist(),
        "scales_were": "measured" if scales is None else "given",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "version": napari_defocus.__version__,
    }
    return MeasuredPSF(setting_scales, setting_kernels, max_scale=max_scale, provenance=provenance)


def disc_radius(kernel: ArrayLike) -> float:
    """Return the radius of the `Disc` that has the second moment of a kernel.

    Parameters
    ----------
    kernel : (K, K) array_like
        Non-negative, of any positive sum.

    Returns
    -------
    float
        In px; 0 for a point.

    Examples
    --------
    >>> from napari_defocus import Disc
    >>> round(disc_radius(Disc().kernel(2.5)), 3)
    2.5
    """
    wanted = _second_moment(np.asarray(kernel, float))
    if wanted == 0:
        return 0.0
    beyond = 2 * np.sqrt(wanted) + 1
    return brentq(lambda radius: _second_moment(Disc().kernel(radius)) - wanted, 0.5, beyond)


def _second_moment(kernel: Float64) -> float:
    """Return the variance along an axis, in px^2, the mean of both axes."""
    place = np.indices(kernel.shape, float)
    center = np.sum(kernel * place, axis=(1, 2)) / kernel.sum()
    spread = np.sum(kernel * (place - center[:, None, None]) ** 2) / kernel.sum()
    return float(spread / 2)


def _shared_range(pictures: list[Any]) -> IntensityRange | None:
    """Return a range for all pictures if it is to be found from their values, else None.

    What reaches 1 is saturated, so that there is room above numbers that say no limit.
    """
    seen = [given_image("picture", picture) for picture in pictures if picture is not None]
    # What is not a picture is told with its name, later.
    floats = [
        one for one in seen if one.dtype.kind in "uif" and one.ndim in (2, 3) and one.size > 0
    ]
    if (
        not floats
        or len(floats) < len(seen)
        or not all(needs_limits(one.dtype, None) for one in floats)
    ):
        return None
    limits = Limits.joined([limits_of(one) for one in floats])
    low, high = min(limits.least, 0.0), limits.largest
    if not np.isfinite([low, high]).all() or (low == 0 and high <= 1):
        return None
    found = range_of_values(limits, floats[0].dtype)
    if found.high > high:
        return found.low, found.high
    return low, low + _HEADROOM * (high - low)


def _luminance(
    picture: ArrayLike, name: str, intensity_range: tuple[float, float] | None
) -> Float32:
    try:
        return prepare_image(picture, intensity_range).luminance
    except (TypeError, ValueError) as error:
        raise type(error)(f"{name}: {error}") from None


def _numbers_of_pictures(scales: Any) -> Float64:
    takes = "it takes a number of px for each picture"
    if isinstance(scales, str):
        raise TypeError(f"scales is {scales!r}; {takes}")
    array = real_array(scales, "scales are")
    if array.ndim != 1:
        raise ValueError(f"scales have shape {array.shape}; {takes}")
    return array


def _check_count(name: str, values: Sequence[object] | None, count: int) -> None:
    if values is None:
        return
    if not isinstance(values, Sized) or getattr(values, "shape", None) == ():
        raise TypeError(f"{name} is {values!r}; it takes one entry a picture")
    if len(values) != count:
        raise ValueError(f"{name} has {len(values)} entries; it takes one a picture, {count}")


def _references(
    sharp: ArrayLike | Sequence[ArrayLike] | None,
    blurred: list[Float32],
    intensity_range: tuple[float, float] | None,
) -> list[Float32] | None:
    """Return the sharp picture of each blurred one."""
    if sharp is None:
        return None
    if isinstance(sharp, (list, tuple)):
        _check_count("sharp", sharp, len(blurred))
        references = [_luminance(s, f"sharp[{i}]", intensity_range) for i, s in enumerate(sharp)]
    else:
        references = [_luminance(np.asarray(sharp), "sharp", intensity_range)] * len(blurred)
    for index, (picture, reference) in enumerate(zip(blurred, references, strict=True)):
        if picture.shape != reference.shape:
            raise ValueError(
                f"pictures[{index}] has {picture.shape[0]} x {picture.shape[1]} px; it takes "
                f"those of its sharp picture, {reference.shape[0]} x {reference.shape[1]}"
            )
    return references


def _settings(scales: Float64, kernels: list[Float64]) -> tuple[Float64, Float64]:
    """Sort by scale, average what has the same, and put all kernels into one frame."""
    order = np.argsort(scales)
    begins = np.flatnonzero(np.diff(scales[order]) >= _SAME_SETTING) + 1
    groups = np.split(order, begins) if len(order) else []
    if len(groups) < 2:
        raise ValueError(
            f"pictures show {len(groups)} setting{'s' * (len(groups) != 1)} of the focus, "
            f"scales {[round(scale, 2) for scale in scales.tolist()]} px; it takes at least 2"
        )
    side = max(len(kernel) for kernel in kernels)
    frames = np.array([np.pad(kernel, (side - len(kernel)) // 2) for kernel in kernels])
    used = np.abs(np.argwhere(frames.sum(axis=0)) - side // 2).max()
    inner = slice(side // 2 - used, side // 2 + used + 1)
    means = np.array([frames[group].mean(axis=0) for group in groups])
    return np.array([scales[group].mean() for group in groups]), means[:, inner, inner]
