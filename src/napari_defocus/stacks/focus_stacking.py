"""Focus stacking: the plane in which each pixel is sharpest, and a picture of those pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.axes import said_axes
from napari_defocus.core.checks import (
    Linearize,
    check_flag,
    check_linearize,
    check_noise_variance,
    check_number,
    check_real,
    check_stride,
    check_weights,
)
from napari_defocus.core.image import checked_range
from napari_defocus.core.intensity import Intensities
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.likelihood.exact_spectra import within_window
from napari_defocus.psf.families import AutomaticPSF, Disc, PSFFamily
from napari_defocus.settings import MapSettings
from napari_defocus.stacks.alignment import StackAlignment
from napari_defocus.stacks.best_focus import best_focus
from napari_defocus.stacks.composites import put_together
from napari_defocus.stacks.contrast_peaks import Peak, check_peak
from napari_defocus.stacks.depth_from_focus import MOST_PX_A_PLANE
from napari_defocus.stacks.matched_planes import Align, Match, check_align, check_match, matched
from napari_defocus.stacks.plane_reader import PlaneReader
from napari_defocus.stacks.plane_weights import Shares
from napari_defocus.stacks.planes import StackPlanes

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

WINDOW = 17
"""px. It may be small, because comparing planes with each other needs no resolution in frequency.
By hand.
"""

_FEW_PEAKS = 0.005
"""Share of the picture: two peaks on less of it are not mentioned. Chosen by hand."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SharpestPlane:
    """Where a stack is in focus, from `sharpest_plane`.

    Attributes
    ----------
    position : (H, W) float32 ndarray
        The plane of best focus of each pixel, counted from 0; also between planes.
    plane : (H, W) int32 ndarray
        The nearest whole plane.
    composite : (H, W) or (H, W, C) ndarray
        All in focus, in the stack's dtype: planes blended by position and detail, or each pixel
        from `plane`.
    confidence : (H, W) float32 ndarray
        Probability that `position` is within half a plane of the true one, from 0 to 1. It is
        low where no plane shows any texture: there, positions come from around.
    share_of_plane : (Z,) float64 ndarray
        The share of the pixels that are sharpest in each plane; they add up to 1.
    px_per_plane : float
        By how many px the radius of the blur grows from plane to plane, given or found. What is
        found is 5 to 15 % too small at 1 px a plane. It is up to 35 % too small where the focus
        is steep and most planes are blurred by more than the family's largest scale. Positions
        hardly depend on it. NaN if there was no texture to find it by.
    noise_variance : float
        Of the luminance, intensities in [0, 1], given or found.
    intensities : Intensities
        Which intensities of all planes are 0 and 1, and the contrast of the sharpest pixels.
    alignment : StackAlignment or None
        How the planes lay on the middle one before they were moved. Positions, composite and all
        else lie as the middle plane does. None if no plane was moved.
    gain : (Z,) float64 ndarray
        By how much each plane was brighter than their median. Planes were divided by it.
    two_peaks : (H, W) bool ndarray
        Where two planes are sharp, with blurred ones between them. There, `peak` chose one.
    notes : tuple of str
        What was found about motion, brightness and peaks, and what was done: a sentence each.
    """

    position: Float32
    plane: NDArray[np.int32]
    composite: NDArray[Any]
    confidence: Float32
    share_of_plane: Float64
    px_per_plane: float
    noise_variance: float
    intensities: Intensities
    alignment: StackAlignment | None
    gain: Float64
    two_peaks: NDArray[np.bool_]
    notes: tuple[str, ...]

    @property
    def best(self) -> int:
        """The plane that is sharpest at the most pixels."""
        return int(self.share_of_plane.argmax())

    def height_um(self, z_step_um: float) -> Float32:
        """Return how high each pixel's best focus lies above the first plane: (H, W) in um.

        Parameters
        ----------
        z_step_um : float
            How far neighbouring planes are apart, in um; negative if they go down. A file says it
            as `open_source(path).pixel_size["z"]`. Through air into another medium, the focus
            moves by more than the stage.

        Raises
        ------
        TypeError, ValueError
            If `z_step_um` is not a finite number, or 0.
        """
        takes = "a finite number of um, not 0"
        check_number("z_step_um", z_step_um, lambda step: 0 < abs(step) < math.inf, takes)
        return self.position * np.float32(z_step_um)


def sharpest_plane(
    stack: Any,
    *,
    axes: str | None = None,
    channel_axis: int | None = None,
    channel: int | None = None,
    time: int | None = None,
    px_per_plane: float | None = None,
    align: Align = "auto",
    match_brightness: Match = "auto",
    blend: bool = True,
    peak: Peak = "strongest",
    psf: PSFFamily = Disc(),
    noise_variance: float | None = MapSettings.noise_variance,
    window: int = WINDOW,
    stride: int = MapSettings.stride,
    smoothness: float = MapSettings.smoothness,
    color_sigma: float = MapSettings.color_sigma,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> SharpestPlane:
    r"""Find where each pixel of a stack is in focus, and put the sharpest pixels together.

    This is depth from focus, and focus stacking. The planes show one scene, at equal steps of the
    focus: a place in focus at :math:`z_0` is blurred by a radius of :math:`k |z - z_0|` px in
    plane z. The power :math:`P_{zf}` that is seen at the frequency f in plane z is that of the
    scene, :math:`S_f`, times the blur spectrum (6), and that of the noise (7). The cost of a
    position is the deviance of (5),

    .. math:: \sum_{z, f} \left(q_{zf} - 1 - \log q_{zf}\right), \qquad q_{zf} =
        \frac{P_{zf}}{S_f \, \sigma_f^2(k |z - z_0|) + \sigma_{nf}^2}

    with the best :math:`S_f`, which is the same in all planes. It gives k, and :math:`z_0` to a
    small part of a plane, see `napari_defocus.stacks.depth_from_focus`. The positions are made
    coherent as a blur map is, see `label_blur_map`, and jump at the picture's edges. Where there is
    no texture, they come from around.

    Planes are read one at a time, three to six times each, and never all at once.

    Parameters
    ----------
    stack : (Z, H, W) or (Z, H, W, 3) or (Z, H, W, 4) array_like
        Two planes or more, in order. NumPy, dask, zarr, and anything else with a shape, a dtype
        and planes by index, will do. Any real dtype, see `estimate_candidates`; all planes share
        one range of intensities. A fourth channel is opacity. Pixels that are NaN or masked are
        not known. Axes of length 1 do not count.
    axes : str, optional
        A letter for each axis, such as "zyx", "yxzs" or "tczyx": y, x, s for colours, c for
        channels, t for times, and another letter for the planes. Channels are never taken for
        planes. Times are, if there is no other axis of planes.
    channel_axis : int, optional
        The axis of the colours. Deprecated: use `axes`.
    channel, time : int, optional
        Which one along c and t to take, from 0; needed if there are several.
    px_per_plane : float, optional
        k, by how many px the radius grows from plane to plane. By default it is found.
    align : "auto", bool or StackAlignment, optional
        Whether planes that shift, turn or are magnified (by a lens that breathes) are laid on the
        middle one first. "auto" does so if motion is surely there: more than four standard
        errors and 0.35 px. True does so always, False never. Or it is an alignment that was found
        before, for this stack or another channel. Motion is measured from plane to plane, up to
        about 10 px and a few percent a plane. Planes are interpolated once, by splines of order 5.
    match_brightness : "auto" or bool, optional
        Whether planes that a lamp made brighter or darker (by a factor of 2 at most) are made as
        bright as their median. "auto" does so if they surely differ by more than 0.5 %.
    blend : bool, optional
        Whether the composite is blended of the planes about the position, which averages noise
        and has no seams. Otherwise each pixel is that of the nearest plane.
    peak : {"strongest", "first", "last"}, optional
        Which plane to take where two are sharp, with blurred ones between them, as in something
        transparent. "first" is the one with the lowest number.
    psf : PSFFamily, optional
        The family of PSFs. Planes blurred by more than its largest scale count as blurred by
        exactly that.
    noise_variance : float, optional
        Variance of the noise in the luminance, intensities in [0, 1], the same in all planes.
        By default it is the median of the planes' own.
    window : int, optional
        Side of the analysis window in px, odd, at least 17 and twice the largest scale.
    stride : int, optional
        Distance between analysed windows in px.
    smoothness : float, optional
        lambda_0 of (16), for a difference of one label. A label is a quarter of a plane. If the
        blur grows by less than 0.5 px a plane, it is 0.125 px of blur, up to a whole plane.
    color_sigma : float, optional
        sigma_lambda of (16), as a share of the contrast.
    linearize : {"srgb"}, optional
        Decode the intensities into linear light first.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; found by default, see `estimate_candidates`.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    SharpestPlane

    Raises
    ------
    TypeError
        If `stack` holds no real numbers; if `channel` or `time` is not a whole number; if `align`,
        `match_brightness` or `blend` is of another type.
    ValueError
        If `align` is an alignment of another number or size of planes, or `peak` is unknown. If
        `stack` has other axes, several channels or times of which none is chosen, less than two
        planes, a side below 3 px, or infinite values. If `axes` and `channel_axis` do not fit it,
        or both are given. If `px_per_plane` is not above 0; and as in `estimate_candidates` and
        `label_blur_map`.

    Notes
    -----
    The radius has to grow evenly, in px of the PSF family's scale. The brightness may differ from
    plane to plane by a factor of up to 2. Blur by up to 0.5 px looks like none. Planes closer to
    each other than that are told apart by planes farther away.

    Examples
    --------
    A picture that is tilted against the focal plane, in focus from plane 1 on the left to
    plane 5 on the right:

    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import sharpest_plane, simulate_defocus
    >>> focus = np.broadcast_to(np.linspace(1, 5, 120), (120, 120))
    >>> stack = [simulate_defocus(camera()[:120, 60:180], abs(z - focus)) for z in range(7)]
    >>> found = sharpest_plane(stack)
    >>> bool(np.median(np.abs(found.position - focus)) < 0.3)
    True
    """
    psf = within_window(psf, window)
    if isinstance(psf, AutomaticPSF):
        raise ValueError("psf is 'auto'; it takes a PSF family such as Disc(): no picture chooses")
    axes = said_axes(stack, axes, channel_axis, "stack")
    whole = StackPlanes.of(stack, axes, channel=channel, time=time)
    _check_settings(px_per_plane, noise_variance, stride, window)
    check_align(align)
    check_match(match_brightness)
    check_flag("blend", blend)
    check_peak(peak)
    check_weights(smoothness, color_sigma)
    check_linearize(linearize)
    checked_range(intensity_range)
    planes = matched(whole, align, match_brightness, within(progress, 0.0, 0.2))
    read = PlaneReader.of(planes, intensity_range, linearize)
    focus = best_focus(
        read,
        psf=psf,
        window=window,
        stride=stride,
        noise_variance=noise_variance,
        px_per_plane=px_per_plane,
        peak=peak,
        smoothness=smoothness,
        color_sigma=color_sigma,
        progress=within(progress, 0.2, 0.9),
    )
    plane = np.rint(focus.position).astype(np.int32)
    shares = None
    if blend:
        shares = Shares(len(planes), focus.usable_rate, psf, focus.noise_variance, focus.shown)
    return SharpestPlane(
        position=focus.position,
        plane=plane,
        composite=put_together(read, focus.position, shares, within(progress, 0.9, 1.0)),
        confidence=focus.confidence,
        share_of_plane=np.bincount(plane.ravel(), minlength=len(planes)) / plane.size,
        px_per_plane=focus.px_per_plane,
        noise_variance=focus.noise_variance,
        intensities=focus.intensities,
        alignment=planes.alignment,
        gain=np.ones(len(planes)) if planes.exposure is None else planes.exposure.gain,
        two_peaks=focus.two_peaks,
        notes=(
            *planes.notes,
            *_told_rate(focus.px_per_plane if px_per_plane is None else 0.0),
            *_told_peaks(focus.share_of_two_peaks, peak),
        ),
    )


def _told_rate(found: float) -> Iterator[str]:
    if found >= MOST_PX_A_PLANE:
        yield (
            f"Only single planes show detail, as if the blur grew by {MOST_PX_A_PLANE:.0f} px a "
            "plane or more. If your steps are finer, planes differ in more than focus, such as in "
            "light or scene, and positions can be wrong. If you know the growth, give it."
        )


def _told_peaks(share: float, peak: Peak) -> tuple[str, ...]:
    if share < _FEW_PEAKS:
        return ()
    return (f"Two planes are sharp on {share:.0%} of the picture; the {peak} was taken there.",)


def _check_settings(
    px_per_plane: float | None, noise_variance: float | None, stride: int, window: int
) -> None:
    if px_per_plane is not None:
        check_real("px_per_plane", px_per_plane, "a finite number above 0, or None")
    if px_per_plane is not None and not (math.isfinite(px_per_plane) and px_per_plane > 0):
        raise ValueError(
            f"px_per_plane is {px_per_plane}; it takes a finite number above 0, or None"
        )
    check_noise_variance(noise_variance)
    check_stride(stride, window)
