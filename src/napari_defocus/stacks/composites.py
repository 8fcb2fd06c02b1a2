"""Pictures put together from the planes of a stack, at positions that are known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import check_flag, check_real
from napari_defocus.core.image import given_reals
from napari_defocus.core.known_pixels import known_pixels
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.likelihood.noise import noise_variance_of
from napari_defocus.psf.families import Disc, PSFFamily
from napari_defocus.stacks.alignment import StackAlignment
from napari_defocus.stacks.fusion import blended
from napari_defocus.stacks.matched_planes import Align, Match, MatchedPlanes, check_match, matched
from napari_defocus.stacks.plane_reader import PlaneReader
from napari_defocus.stacks.plane_weights import Shares
from napari_defocus.stacks.planes import StackPlanes
from napari_defocus.stacks.shown_detail import ShownDetail

Float32 = NDArray[np.float32]


def put_together(
    read: PlaneReader, position: Float32, shares: Shares | None, progress: Progress
) -> NDArray[Any]:
    """Return the composite at positions: blended by shares, or of the nearest planes' pixels."""
    if shares is None:
        composite = pixels_of_planes(read.planes, position, progress)
    else:
        composite = blended(read.planes.read, position, shares, progress)
    if read.planes.exposure is not None and np.isfinite(read.planes.white):
        _keep_white(composite, position, read.planes, blend=shares is not None)
    return composite


def _keep_white(
    composite: NDArray[Any], position: Float32, planes: MatchedPlanes, *, blend: bool
) -> None:
    """Let what is clipped in the planes around its position be white, and nothing be whiter.

    To be as bright as the others, a plane is divided by its gain, and what was clipped in it is no
    longer white. How bright it was, nobody knows.
    """
    position = position if blend else np.rint(position)
    first, last = (each.astype(np.int32) for each in (np.floor(position), np.ceil(position)))
    clipped = np.ones(composite.shape, bool)
    for number in range(len(planes)):
        around = (first == number) | (last == number)
        if around.any():
            clipped[around] &= planes.clipped(number)[around]
    colors = np.s_[..., :3] if composite.ndim == 3 else np.s_[...]
    white = composite.dtype.type(planes.white)
    composite[colors][clipped[colors]] = white
    np.minimum(composite[colors], white, out=composite[colors])


def pixels_of_planes(planes: MatchedPlanes, position: Float32, progress: Progress) -> NDArray[Any]:
    """Take each pixel from the nearest plane that shows it: (H, W) or (H, W, C)."""
    plane = np.rint(position).astype(np.int32)
    composite = np.empty(planes.shape, planes.dtype)
    numbers = range(len(planes)) if planes.alignment is not None else np.unique(plane)
    nearest = np.full(plane.shape, len(planes) + 1, np.int32)
    for done, number in enumerate(numbers):
        progress("Putting the sharpest pixels together", done / len(numbers))
        away = np.abs(plane - np.int32(number))
        here = away < nearest
        values = planes.read(int(number))
        known = known_pixels(values) if planes.alignment is not None else None
        if known is not None:
            here &= known
        composite[here] = np.ma.getdata(values)[here]
        nearest[here] = away[here]
    progress("Putting the sharpest pixels together", 1.0)
    return composite


def composite_at(
    position: ArrayLike,
    stack: Any,
    *,
    axes: str | None = None,
    channel: int | None = None,
    time: int | None = None,
    alignment: StackAlignment | None = None,
    match_brightness: Match = "auto",
    px_per_plane: float = 1.0,
    psf: PSFFamily = Disc(),
    blend: bool = True,
    progress: Progress = silent,
) -> NDArray[Any]:
    """Put the planes of a stack together at positions that were found in another one.

    The stack may be another channel of the same scene, whose own texture would tell less. Planes
    are read one at a time, two to five times each.

    Parameters
    ----------
    position : (H, W) array_like
        In planes from the first, such as `SharpestPlane.position`.
    stack : (Z, H, W) or (Z, H, W, 3) or (Z, H, W, 4) array_like
        As in `sharpest_plane`, of any dtype; numpy, dask, zarr.
    axes, channel, time : optional
        Which planes to take, as in `sharpest_plane`.
    alignment : StackAlignment, optional
        The alignment of the stack in which the positions were found, `SharpestPlane.alignment`: a
        stage that drifts does so for all channels. None if its planes lie on each other.
    match_brightness : "auto" or bool, optional
        As in `sharpest_plane`.
    px_per_plane : float, optional
        By how many px the radius grows from plane to plane, `SharpestPlane.px_per_plane`.
    psf : PSFFamily, optional
    blend : bool, optional
        As in `sharpest_plane`.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    (H, W) or (H, W, C) ndarray
        In the dtype of the stack.

    Raises
    ------
    TypeError
        If an argument is of another type.
    ValueError
        If `position` has another height and width than the planes, or values that are not finite
        or beyond the planes, or another argument is beyond its range.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_defocus import composite_at
    >>> other = np.stack([np.full((20, 30), 100 * plane, np.uint16) for plane in range(4)])
    >>> position = np.broadcast_to(np.linspace(0, 3, 30), (20, 30))
    >>> composite_at(position, other, match_brightness=False, blend=False)[0, ::9]
    array([  0, 100, 200, 300], dtype=uint16)
    """
    planes = StackPlanes.of(stack, axes, channel=channel, time=time)
    where = _checked_position(position, planes)
    if alignment is not None and not isinstance(alignment, StackAlignment):
        raise TypeError(f"alignment is {alignment!r}; it takes a StackAlignment, or None")
    check_match(match_brightness)
    check_flag("blend", blend)
    check_real("px_per_plane", px_per_plane, "a finite number above 0")
    if not (math.isfinite(px_per_plane) and px_per_plane > 0):
        raise ValueError(f"px_per_plane is {px_per_plane}; it takes a finite number above 0")
    lay: Align = False if alignment is None else alignment
    laid = matched(planes, lay, match_brightness, within(progress, 0.0, 0.3))
    read, shares = PlaneReader.of(laid, None, None), None
    if blend:
        shares = _shares_of(read, float(px_per_plane), psf, within(progress, 0.3, 0.6))
    return put_together(read, where, shares, within(progress, 0.6, 1.0))


def _checked_position(position: ArrayLike, planes: StackPlanes) -> Float32:
    where = given_reals("position", position).astype(np.float32)
    if where.shape != planes.shape[:2]:
        raise ValueError(
            f"position has shape {where.shape}; stack has planes of {planes.shape[:2]}"
        )
    last = len(planes) - 1
    if not ((where >= 0) & (where <= last)).all():
        raise ValueError(
            f"position goes from {where.min()} to {where.max()}; it takes planes from 0 to {last}"
        )
    return where


def _shares_of(
    read: PlaneReader, px_per_plane: float, psf: PSFFamily, progress: Progress
) -> Shares:
    """Look at all planes for their details and their noise."""
    planes = read.planes
    shown, noise = ShownDetail(planes.shape, len(planes)), []
    for number in range(len(planes)):
        progress("Reading the planes", number / len(planes))
        plane = planes.look_at(number)
        picture = read.prepared(plane)
        shown.see(number, picture.luminance, planes.brightest(plane, number))
        if not planes.moves(number):
            noise.append(noise_variance_of(picture))
    variance = float(np.median(noise))
    return Shares(len(planes), px_per_plane, psf, variance, shown)
