"""Candidates of a picture, a stack or a dask array."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from napari_defocus.api.dispatch import EstimationOptions, arranged_image, tiled_planes
from napari_defocus.core.axes import said_axes
from napari_defocus.core.checks import (
    Linearize,
    Mode,
    Spectra,
    check_block_size,
    check_noise_variance,
)
from napari_defocus.core.progress import Progress, silent
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.estimation import Estimation, Search, check_search
from napari_defocus.likelihood.psf_choice import choose_psf
from napari_defocus.likelihood.shot_noise import ShotNoise, noise_of
from napari_defocus.psf import AUTO
from napari_defocus.psf.families import AutomaticPSF, Disc, PSFFamily
from napari_defocus.settings import BLOCK_SIZE, MapSettings

if TYPE_CHECKING:
    from napari_defocus.tiled.candidates import LazyCandidates


@overload
def estimate_candidates(
    image: ArrayLike,
    *,
    spectra: Spectra = ...,
    search: Search = ...,
    axes: None = None,
    channel_axis: None = None,
    **options: Unpack[EstimationOptions],
) -> BlurCandidates: ...


@overload
def estimate_candidates(
    image: Any,
    *,
    spectra: Spectra = ...,
    search: Search = ...,
    axes: str | None = ...,
    channel_axis: int | None = ...,
    **options: Unpack[EstimationOptions],
) -> BlurCandidates | LazyCandidates: ...


def estimate_candidates(
    image: ArrayLike,
    *,
    psf: PSFFamily | Literal["auto"] = Disc(),
    noise_variance: float | ShotNoise | None = MapSettings.noise_variance,
    window: int = MapSettings.window,
    stride: int = MapSettings.stride,
    mode: Mode = MapSettings.mode,
    spectra: Spectra = "exact",
    search: Search = "lattice",
    linearize: Linearize | None = MapSettings.linearize,
    camera_softness: float = MapSettings.camera_softness,
    intensity_range: tuple[float, float] | None = None,
    axes: str | None = None,
    channel_axis: int | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
) -> BlurCandidates | LazyCandidates:
    """Estimate which blur scales are likely around every place of a picture.

    Sections II and III-A of [1]_: Gabor filters give the local power spectra of both gradients
    of the luminance (4); under white Gaussian gradients of unknown variance s behind a PSF of
    scale r, and white noise, each power is exponentially distributed (5); the profile
    likelihood (9) is evaluated on a lattice of scales, s by the fixed point (11), and its
    local maxima are refined in the continuous domain by Newton steps on look-up tables.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like, or dask.array.Array
        Any real dtype, in any range: k * image + b has the same candidates. What is not known
        carries no evidence: pixels that are NaN, masked (numpy.ma), or fully transparent, where
        a fourth channel is opacity. A stack of pictures if `axes` says so.
    psf : PSFFamily or callable or "auto", optional
        The family of PSFs; a disc by default. Its largest scale, 64 px by default, is looked for as
        far as the picture's size allows: a picture whose shorter side is below 656 px is searched
        up to 32 px, below 328 px up to 16, below 164 px up to 8 (windows of 41 px); what it was is
        in `BlurCandidates.psf`. A function from a scale in px, up to 8, to a kernel is a family
        too. "auto" lets the picture choose: a Gaussian or a ring of
        obstruction 0.3 or 0.5 if it clearly shows one, else a disc
        (`BlurCandidates.psf`, `BlurCandidates.psf_choice`); one for all planes of a stack. With
        another largest radius, `AutomaticPSF`.
    noise_variance : float or ShotNoise, optional
        Variance of the noise in the luminance, intensities in [0, 1] (see `intensity_range`),
        or how it grows with the intensity. By default it is found from the picture, see
        `estimate_noise_variance`.
    window : int, optional
        Side N of the analysis window in px, odd, at least 17.
    stride : int, optional
        Distance between analysed windows in px. The powers are band-limited by their window:
        4 loses nothing; 1 is the reference.
    mode : {"curve", "paper"}, optional
        "paper" is the likelihood (5) as it stands. "curve" expects that windows hold more than
        one scale, and divides each gradient's logarithm of it by the dispersion, which limits
        what windows say that the model does not fit.
    spectra : {"exact", "fitted"}, optional
        Blur spectra (6) tabulated from the family at every scale, or as the fit (12).
    search : {"lattice", "fixed-point"}, optional
        How the local maxima are found: among all scales of the curve, then by Newton steps; or
        as in the paper, by the fixed point (11) and (13) from whole px, much slower.
    camera_softness : float, optional
        Standard deviation, in px, of the blur that the camera has of its own: optics, diffraction,
        pixels, demosaicking. Scales are the defocus beyond it; 0 is as sharp as the camera can be.
        Not used in the mode "paper".
    linearize : {"srgb"}, optional
        Decode the intensities into linear light first. Blur is linear in radiance; pictures
        for displays are not.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1, and the picture's contrast. By default they are
        found and told (`BlurCandidates.intensities`): integers of 8 and 16 bits are scaled by
        their dtype's range, floats that hardly leave [0, 1] are taken as they are. Other floats
        and wider integers are scaled to [0, 1] from 0 to 255 or from 0 to 65535 if they are
        whole numbers that fit, else from the smallest to the largest value.
    axes : str, optional
        A letter for each axis of `image`: y, x, s for colours, any others for planes, such as
        "tzyx". Each plane is a picture of its own.
    channel_axis : int, optional
        Old: the axis of the colours; `axes` says it.
    block_size : int, optional
        Side, in px, of the parts in which planes of stacks and dask arrays are worked on;
        memory is bounded by it.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    BlurCandidates or LazyCandidates
        The latter of stacks and dask arrays: what the other functions take instead.

    Raises
    ------
    TypeError
        If `image` has no real dtype.
    ValueError
        If `image` has another shape, a side below 3 px or infinite values; if
        `noise_variance` is negative; if `mode`, `spectra`, `search` or `linearize` is unknown;
        if `window` is no odd number from 17 up, or `stride` is not within 1 to `window`.

    References
    ----------
    .. [1] X. Zhu, S. Cohen, S. Schiller, P. Milanfar, "Estimating Spatially Varying Defocus
       Blur from A Single Image", IEEE Transactions on Image Processing 22(12), 2013.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_candidates, simulate_defocus
    >>> blurred = simulate_defocus(camera()[:100, :100], np.full((100, 100), 3.0))
    >>> candidates = estimate_candidates(blurred)
    >>> float(np.median(candidates.radii[..., 0]).round())
    3.0
    """
    if not isinstance(noise_variance, ShotNoise):
        check_noise_variance(noise_variance)
    check_search(search)
    # What is no family is told by `Estimation`.
    lens: Any = AutomaticPSF() if isinstance(psf, str) and psf == AUTO else psf
    how = Estimation(
        lens, window, stride, mode, spectra, search, linearize, intensity_range, camera_softness
    )
    check_block_size(block_size)
    image, roles = arranged_image(image, said_axes(image, axes, channel_axis))
    if roles:
        from napari_defocus.tiled.candidates import LazyCandidates

        planes = tiled_planes(image, roles, intensity_range)
        if not isinstance(lens, AutomaticPSF):
            return LazyCandidates(planes, how, noise_variance, block_size)
        from napari_defocus.tiled.psf_of_planes import psf_of_planes

        progress("Choosing the lens", 0.0)
        each = [planes.plane(index) for index in np.ndindex(planes.counts)]
        choice = psf_of_planes(each, how, noise_variance)
        how = replace(how, psf=choice.psf)
        return LazyCandidates(planes, how, noise_variance, block_size, psf_choice=choice)
    picture = how.prepared(image)
    if not isinstance(lens, AutomaticPSF):
        return how.candidates(picture, noise_variance, progress)
    progress("Choosing the lens", 0.0)
    noise = noise_of(picture) if noise_variance is None else noise_variance
    choice = choose_psf(
        [picture],
        noise=noise,
        max_radius=lens.max_radius,
        window=window,
        camera_softness=camera_softness,
    )
    candidates = replace(how, psf=choice.psf).candidates(picture, noise, progress)
    return replace(candidates, psf_choice=choice)
