"""The PSF of a lens, measured from pictures that it took out of focus (Section III-A).

Either the pictures show point sources, such as a back-lit pinhole or distant lamps, and every
spot is the PSF; or they show anything with texture, and a sharp picture of the same is given,
so that the PSF is what turns the one into the other. Few settings of the lens are enough.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence, Sized
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import brentq, nnls
from scipy.signal import correlate

import napari_defocus
from napari_defocus.core.image import given_image, prepare_image
from napari_defocus.core.intensity import IntensityRange, Limits, needs_limits, range_of_values
from napari_defocus.core.known_pixels import limits_of
from napari_defocus.core.progress import Progress, silent
from napari_defocus.psf.families import Disc, real_array
from napari_defocus.psf.measured import MeasuredPSF

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_SAME_SETTING = 0.05

_SATURATED = 1 - 1e-6
_HEADROOM = 1.01
_DETECTED_NOISE, _DETECTED_SHARE = 6.0, 0.05
_FAINT = 0.1
_MARGIN = 3
_KEPT_SMOOTH, _KEPT, _KEPT_SHARE = 3.0, 2.0, 1e-3
_OFF_CENTER = 0.02

_MIDDLE = 512
_REACHES = (4, 8, 12, 17, 23)
_DARK = 0.05
_EXPLAINED = 0.5
_RIDGE = 1e-5


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
    """Measure the PSF family of a lens from pictures at a few settings of its focus.

    Parameters
    ----------
    pictures : sequence of (H, W) or (H, W, 3) or (H, W, 4) array_like
        One picture for each setting, in any order; at least two settings. The luminance counts.
    scales : sequence of float, optional
        Scale of each picture, in px, for instance from a linear focus scale. By default it is
        measured: the radius of the disc with the same second moment.
    sharp : picture or sequence of pictures, optional
        The same scene in focus, taken with the same magnification: one for all pictures, or a
        list of one for each. Without it, the pictures show point sources.
    max_scale : float, optional
        Largest scale that is looked for, in px; by default the largest in the pictures.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1. Point sources that reach 1 are left out. By
        default integers have the range of their type; of floats that leave [0, 1] all pictures
        share a range that none of them reaches, unless they are whole numbers of 8 or 16 bits.
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
        If a picture is none (see `estimate_candidates`), if one has no usable point source, if
        a sharp picture has another shape than its blurred one, if `scales`, `sharp` or `names`
        are not as many as the pictures, or if there are fewer than two settings.

    Notes
    -----
    A point source is usable if it is not saturated, and neither the picture's border nor
    another one is within its own width. The usable ones are added, so that each weighs as much
    as its light; those with less than a tenth of the brightest one's light are left out.

    A sharp picture is aligned by whole px; the kernel minimises the squared difference between
    the blurred sharp picture and the blurred one, under the condition that it is nowhere
    negative (Lawson and Hanson's algorithm on the normal equations). Of large pictures, the
    middle 512 x 512 px are compared: a lens' PSF is not the same in its corners.

    Kernels are moved to their centroid by cubic splines. What lies below twice the noise around
    them is left out.

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
            _kernel_of_points(picture, name)
            if references is None
            else _kernel_of_pair(picture, references[index], name)
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
    # What is no picture is told with its name, later.
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


def _kernel_of_points(picture: Float32, name: str) -> Float64:
    """Average the spots of all usable point sources: (K, K), sum 1."""
    level = float(np.median(picture))
    light = picture - level
    seen = ndimage.gaussian_filter(light, 1.0)
    threshold = max(_DETECTED_NOISE * _noise(seen), _DETECTED_SHARE * seen.max())
    spots, _ = ndimage.label(seen > threshold, np.ones((3, 3)))
    verdicts = Counter[str]()
    usable = []
    for number, box in enumerate(ndimage.find_objects(spots), 1):
        spot = light[box] * (spots[box] == number)
        corner = np.array([side.start for side in box])
        center = np.rint(corner + ndimage.center_of_mass(spot)).astype(int)
        reach = max(spot.shape) + _MARGIN
        verdict = _verdict(spots, number, center, reach)
        if verdict == "usable" and level + spot.max() >= _SATURATED:
            verdict = "saturated"
        verdicts[verdict] += 1
        if verdict == "usable":
            usable.append((spot.sum(), center, reach))
    if not usable:
        found = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
        raise ValueError(f"{name} shows no usable point source ({found or 'nothing stands out'})")
    least = _FAINT * max(flux for flux, _, _ in usable)
    widest = max(reach for _, _, reach in usable)
    cut_out = [_window(light, center, widest) for flux, center, _ in usable if flux >= least]
    return _cleaned(np.sum([_centered(spot) for spot in cut_out if spot is not None], axis=0))


def _verdict(spots: NDArray[np.int32], number: int, center: NDArray[np.int64], reach: int) -> str:
    surroundings = _window(spots, center, reach)
    if surroundings is None:
        return "at the border"
    return "usable" if np.isin(surroundings, (0, number)).all() else "too close to another"


def _window(values: NDArray[Any], center: NDArray[np.int64], reach: int) -> NDArray[Any] | None:
    """Return what lies up to `reach` px around a pixel, if all of that is in the picture."""
    if (center < reach).any() or (center + reach >= values.shape).any():
        return None
    row, column = center
    return values[row - reach : row + reach + 1, column - reach : column + reach + 1]


def _noise(values: NDArray[np.floating]) -> float:
    """Return the standard deviation of most values, whatever the few others are."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _border(kernel: Float64) -> Float64:
    """Return the pixels of a frame 2 px wide."""
    inside = np.zeros(kernel.shape, bool)
    inside[2:-2, 2:-2] = True
    return kernel[~inside]


def _centered(spot: Float64) -> Float64:
    """Take the background off and move the centroid of what is visible to the middle."""
    spot = spot - np.median(_border(spot))
    centroid = np.array(ndimage.center_of_mass(spot * _visible(spot)))
    off_center = centroid - len(spot) // 2
    if np.abs(off_center).max() < _OFF_CENTER:
        return spot
    return ndimage.shift(spot, -off_center, mode="nearest")


def _visible(kernel: Float64) -> NDArray[np.bool_]:
    """Return where a kernel stands out from the noise that its border shows."""
    smooth = ndimage.gaussian_filter(kernel, 0.7)
    least = max(_KEPT_SMOOTH * _border(smooth).std(), _KEPT_SHARE * smooth.max())
    parts, _ = ndimage.label(smooth > min(least, smooth.max() / 2), np.ones((3, 3)))
    brightest = parts == parts.flat[np.argmax(smooth)]
    return brightest & (kernel > min(_KEPT * _border(kernel).std(), kernel.max() / 2))


def _cleaned(kernel: Float64) -> Float64:
    """Leave out what is negative or lost in the noise, and normalise to sum 1."""
    kernel = np.maximum(kernel, 0) * _visible(kernel)
    return kernel / kernel.sum()


def _kernel_of_pair(blurred: Float32, sharp: Float32, name: str) -> Float64:
    """Find the kernel that turns the sharp picture into the blurred one: (K, K), sum 1."""
    blurred, sharp = _aligned(_middle(blurred), _middle(sharp))
    widest = min(sharp.shape) // 4
    for reach in (reach for reach in _REACHES if reach <= widest):
        kernel, explained = _least_squares_kernel(blurred, sharp, reach)
        if _border(kernel).mean() <= _DARK * kernel.max():
            if explained < _EXPLAINED:
                break
            return _cleaned(_centered(kernel))
    raise ValueError(
        f"{name} does not show what its sharp picture shows, "
        f"or is blurred over more than {min(widest, _REACHES[-1])} px from the centre"
    )


def _middle(picture: Float32) -> Float32:
    """Cut the middle out of a large picture."""
    top, left = (max(length - _MIDDLE, 0) // 2 for length in picture.shape)
    return picture[top : top + _MIDDLE, left : left + _MIDDLE]


def _aligned(blurred: Float32, sharp: Float32) -> tuple[Float32, Float32]:
    """Cut two pictures down to what both show, moved by whole px."""
    # What one shows beyond the border of the other must not count: both fade out.
    fading = np.multiply.outer(*(np.hanning(length) for length in sharp.shape))
    pair = ((picture - picture.mean()) * fading for picture in (blurred, sharp))
    likeness = correlate(*pair, mode="same", method="fft")
    best = np.unravel_index(np.argmax(likeness), likeness.shape)
    shift = np.array(best) - np.array(likeness.shape) // 2
    ahead = tuple(slice(max(amount, 0), min(amount, 0) or None) for amount in shift)
    behind = tuple(slice(max(-amount, 0), min(-amount, 0) or None) for amount in shift)
    return blurred[ahead], sharp[behind]


def _least_squares_kernel(blurred: Float32, sharp: Float32, reach: int) -> tuple[Float64, float]:
    """Minimise |sharp * h - blurred|^2 for h >= 0, up to a constant brightness.

    Returns
    -------
    kernel : (K, K) float64 ndarray
    explained : float
        The share of the blurred picture's variance that it explains, from 0 to 1.
    """
    target = blurred[reach:-reach, reach:-reach].astype(np.float64)
    target -= target.mean()
    source = sharp - sharp.mean(dtype=np.float64)
    normal = _correlations(source, reach)
    right = correlate(source, target, mode="valid")[::-1, ::-1].ravel()
    ridge = _RIDGE * np.trace(normal) / len(normal) + np.finfo(float).tiny
    factor = cholesky(normal + ridge * np.eye(len(normal)), lower=True)
    kernel, _ = nnls(factor.T, solve_triangular(factor, right, lower=True))
    power = np.sum(target**2)
    explained = (2 * kernel @ right - kernel @ normal @ kernel) / power if power > 0 else 0.0
    return kernel.reshape(2 * reach + 1, -1), explained


def _correlations(source: Float64, reach: int) -> Float64:
    """Return the products of the inner part of a picture moved in two ways: (K^2, K^2).

    Entry (u, v) is the sum over x of f[x - u] f[x - v] without the means; it is found from the
    product of the picture with itself moved by v - u, once for all pairs of that difference.
    """
    side = 2 * reach + 1
    height, width = source.shape
    rows, columns = (_moved_inner_part(length, reach) for length in source.shape)
    products = np.empty((side, side, side, side))
    for down, across in np.ndindex(side, 2 * side - 1):
        across -= side - 1
        if down == 0 and across < 0:
            continue
        left, right = max(across, 0), width + min(across, 0)
        moved = source[: height - down, left - across : right - across]
        sums = (
            rows[: side - down, down:]
            @ (source[down:, left:right] * moved)
            @ columns[max(-across, 0) : side - max(across, 0), left:right].T
        )
        i, j = (np.arange(length) for length in sums.shape)
        i, j = i[:, None], j + max(-across, 0)
        products[i, j, i + down, j + across] = sums
        products[i + down, j + across, i, j] = sums
    inner = (height - 2 * reach) * (width - 2 * reach)
    means = (rows @ source @ columns.T).ravel() / inner
    return products.reshape(side**2, -1) - inner * np.multiply.outer(means, means)


def _moved_inner_part(length: int, reach: int) -> Float64:
    """Mark the pixels that lie `reach` or more inside, moved by reach ... -reach: (K, length)."""
    first = 2 * reach - np.arange(2 * reach + 1)[:, None]
    place = np.arange(length)
    return ((place >= first) & (place < first + length - 2 * reach)).astype(np.float64)
