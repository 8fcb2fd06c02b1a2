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
from napari_defocus.likelihood.estimation import Estimation, check_search
from napari_defocus.likelihood.local_noise import LocalNoise
from napari_defocus.likelihood.psf_choice import choose_psf, is_to_choose
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.likelihood.window_analysis import Search
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

    This is Sections II and III-A of [1]_. Gabor filters give the local power spectra of both
    gradients of the luminance (4). The gradients of the sharp picture are taken to be white and
    Gaussian, with an unknown variance s, and the noise to be white. Then each power is
    exponentially distributed (5). The profile likelihood (9) is evaluated on a lattice of scales,
    with s from the fixed point (11). Newton steps refine its local maxima between the scales.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like, or dask.array.Array
        Any real dtype, in any range: k * image + b has the same candidates. A fourth channel is
        opacity. Pixels that are NaN, masked (numpy.ma) or fully transparent are not known, and
        count for nothing. With `axes`, it is a stack of pictures.
    psf : PSFFamily or callable or "auto", optional
        The family of PSFs; a disc by default. Its largest scale is 64 px by default. Small
        pictures are searched up to less: 32 px if their shorter side is below 656 px, 16 px below
        328 px, 8 px below 164 px (for windows of 41 px). `BlurCandidates.psf` has the largest scale
        that was searched. A function from a scale in px, up to 8, to a kernel is a family as
        well. "auto" lets the picture choose: a Gaussian or a ring of obstruction 0.3 or 0.5 if it
        clearly shows one, and otherwise a disc. `BlurCandidates.psf_choice` says which. The planes
        of a stack share one family. `AutomaticPSF` chooses with another largest radius.
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
        "paper" is the likelihood (5). "curve" expects that windows hold more than one scale. It
        also divides the logarithm of each gradient's likelihood by its dispersion, so that
        windows that do not fit the model count for less.
    spectra : {"exact", "fitted"}, optional
        Whether the blur spectra (6) are tabulated from the family at every scale, or fitted (12).
    search : {"lattice", "fixed-point"}, optional
        How the local maxima are found. "lattice" looks at all scales of the curve, and then takes
        Newton steps. "fixed-point" is the paper's way, much slower: (11) and (13) from whole px.
    camera_softness : float, optional
        Standard deviation, in px, of the camera's own blur: optics, diffraction, pixels,
        demosaicking. Scales are the defocus beyond it, so 0 is as sharp as the camera can be. It
        is not used in the mode "paper".
    linearize : {"srgb"}, optional
        Decode the intensities into linear light first. Blur is linear in radiance; pictures
        for displays are not.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1, and as the picture's contrast. By default they are
        found; `BlurCandidates.intensities` has them. For integers of 8 and 16 bits, they are the
        range of the dtype. Floats that hardly leave [0, 1] are not scaled. Other floats and wider
        integers are scaled from 0 to 255, or from 0 to 65535, if they are whole numbers that fit,
        and otherwise from the smallest to the largest value.
    axes : str, optional
        A letter for each axis of `image`: y, x, s for colours, any others for planes, such as
        "tzyx". Each plane is a picture of its own.
    channel_axis : int, optional
        The axis of the colours. Deprecated: use `axes`.
    block_size : int, optional
        Side, in px, of the parts in which planes of stacks and dask arrays are worked on. It
        bounds the memory.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    BlurCandidates or LazyCandidates
        LazyCandidates for stacks and dask arrays. The other functions take both.

    Raises
    ------
    TypeError
        If `image` has no real dtype.
    ValueError
        If `image` has another shape, a side below 3 px or infinite values. If
        `noise_variance` is negative, or `mode`, `spectra`, `search` or `linearize` is unknown.
        If `window` is not an odd number from 17 up, or `stride` is not within 1 to `window`.

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
    # What is not a family is told by `Estimation`.
    lens: Any = AutomaticPSF() if isinstance(psf, str) and psf == AUTO else psf
    how = Estimation(
        lens, window, stride, mode, spectra, search, linearize, intensity_range, camera_softness
    )
    check_block_size(block_size)
    image, roles = arranged_image(image, said_axes(image, axes, channel_axis))
    if roles:
        from napari_defocus.tiled.candidates import LazyCandidates

        planes = tiled_planes(image, roles, intensity_range)
        if not is_to_choose(how.psf):
            return LazyCandidates(planes, how, noise_variance, block_size)
        from napari_defocus.tiled.psf_of_planes import psf_of_planes

        progress("Choosing the lens", 0.0)
        each = [planes.plane(index) for index in np.ndindex(planes.counts)]
        choice = psf_of_planes(each, how, noise_variance)
        how = replace(how, psf=choice.psf)
        return LazyCandidates(planes, how, noise_variance, block_size, psf_choice=choice)
    picture = how.prepared(image)
    if not is_to_choose(how.psf):
        return how.candidates(picture, noise_variance, progress)
    progress("Choosing the lens", 0.0)
    noise = LocalNoise.of(picture, noise_variance)
    choice = choose_psf(
        [picture],
        how.psf,
        noise=noise,
        window=window,
        camera_softness=camera_softness,
    )
    candidates = replace(how, psf=choice.psf).candidates(picture, noise, progress)
    return replace(candidates, psf_choice=choice)
