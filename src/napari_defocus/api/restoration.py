"""All-in-focus pictures of a picture, a stack or a dask array."""

from __future__ import annotations

from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.api.dispatch import arranged_image, tiled_planes
from napari_defocus.core.axes import said_axes
from napari_defocus.core.checks import Linearize, check_block_size
from napari_defocus.core.progress import Progress, silent
from napari_defocus.psf.families import Disc, PSFFamily
from napari_defocus.restoration.all_in_focus import (
    Restoration,
    RestorationFit,
    TiledRestorationFit,
)
from napari_defocus.settings import BLOCK_SIZE, MapSettings, RestorationSettings

Float32 = NDArray[np.float32]


@overload
def restore_all_in_focus(
    image: ArrayLike,
    blur_map: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    noise_variance: float | None = RestorationSettings.noise_variance,
    confidence: ArrayLike | None = None,
    tv_weight: float | None = RestorationSettings.tv_weight,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    axes: str | None = None,
    channel_axis: int | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    return_fit: Literal[False] = ...,
) -> Float32: ...


@overload
def restore_all_in_focus(
    image: ArrayLike,
    blur_map: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    noise_variance: float | None = RestorationSettings.noise_variance,
    confidence: ArrayLike | None = None,
    tv_weight: float | None = RestorationSettings.tv_weight,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    axes: None = None,
    channel_axis: int | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    return_fit: Literal[True],
) -> tuple[Float32, RestorationFit]: ...


@overload
def restore_all_in_focus(
    image: ArrayLike,
    blur_map: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    noise_variance: float | None = RestorationSettings.noise_variance,
    confidence: ArrayLike | None = None,
    tv_weight: float | None = RestorationSettings.tv_weight,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    axes: str,
    channel_axis: int | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    return_fit: Literal[True],
) -> tuple[Float32, TiledRestorationFit]: ...


def restore_all_in_focus(
    image: ArrayLike,
    blur_map: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    noise_variance: float | None = RestorationSettings.noise_variance,
    confidence: ArrayLike | None = None,
    tv_weight: float | None = RestorationSettings.tv_weight,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    axes: str | None = None,
    channel_axis: int | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    return_fit: bool = False,
) -> Float32 | tuple[Float32, RestorationFit | TiledRestorationFit]:
    """Take the blur of a map away: minimise (19).

    ``sum_x w_x |(h_x * f)[x] - g[x]|^2 + lambda sum_x |grad f[x]|``, the total variation over both
    directions and all channels together. With an exact map, f is as good as the data allow. If the
    map is estimated, give ``cautious_blur_map(candidates, blur_map)`` instead, and the
    `confidence`: too large a radius makes rings.

    Photographs rarely fit their map as simulations do. If the first rounds leave more than noise
    explains, the misfit m counts as more noise: it enters w, and 30 m is added to lambda. Then two
    pictures are averaged, whose scales are lowered by 0.25 and by 1.25 of the standard deviation
    that follows from the confidence. The fine texture that they do not explain is added again. m
    is at most 0.0075 of the picture's variance, see `RestorationFit`. If a picture is restored in
    tiles, each tile finds its own m.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like, or dask.array.Array
        Any real dtype, see `estimate_candidates`. With `axes`, it is a stack; then `blur_map` and
        `confidence` are (..., H, W), as `estimate_blur_map` returns them. Pixels that are not
        known do not count: the opacity stays the same, and NaN or masked pixels become NaN.
    blur_map : (H, W) array_like
        Scale at every pixel, in px, within the family's domain.
    psf : PSFFamily or callable, optional
    noise_variance : float, optional
        Variance of the noise in the luminance, intensities in [0, 1], as `estimate_candidates`
        takes it. Noise of variance v in each colour channel makes 0.45 v in the luminance. It is
        found from the picture if left out.
    confidence : (H, W) array_like, optional
        How sure the map is, from 0 to 1, see `confidence_map`. A pixel counts less if a wrong
        radius would change it much: w = v / (v + (dg/dr)^2 d^2) with
        d = 2 (1 - confidence)^3 px. Where the result does not explain the picture, the radius is
        reduced. Without a confidence, the map is taken as exact.
    tv_weight : float, optional
        lambda; larger is smoother. If left out, it is 30 v + 3e-5 for a picture of full contrast,
        where v is the noise variance of a channel, and more if the picture does not fit its map.
        A given value is not changed.
    linearize : {"srgb"}, optional
        Decode the picture into linear light before, and encode it afterwards.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; found by default, see `estimate_candidates`. The
        planes of a stack share what is found.
    axes, channel_axis, block_size
        See `estimate_candidates`.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.
    return_fit : bool, optional
        Whether to return how well the picture fits its map, and where it was left as it was, too.

    Returns
    -------
    restored : float32 ndarray
        It has the shape of `image`. Values are in [0, 1], which stands for `intensity_range`, and
        NaN where `image` is NaN or masked. A stack has the axes of its planes first and its
        colours last. It is a dask array if `image` is one.
    fit : RestorationFit or TiledRestorationFit
        Only with `return_fit`. The second is of a stack or a dask array: it says what was left as
        it was, and no more, as each tile has a noise, a lambda and a misfit of its own.

    Raises
    ------
    TypeError
        If `image` has no real dtype, or `blur_map` or `confidence` holds no real numbers.
    ValueError
        If `image` is not a picture (see `estimate_candidates`). If `blur_map` or `confidence` has
        another shape, scales outside the domain, or a confidence outside [0, 1]. If
        `noise_variance`, `tv_weight` or `linearize` is impossible.

    References
    ----------
    .. [1] X. Zhu, S. Cohen, S. Schiller, P. Milanfar, "Estimating Spatially Varying Defocus
       Blur from A Single Image", IEEE Transactions on Image Processing 22(12), 2013, (19).
    .. [2] L. I. Rudin, S. Osher, E. Fatemi, "Nonlinear total variation based noise removal
       algorithms", Physica D 60, 1992.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import restore_all_in_focus, simulate_defocus
    >>> sharp, radius = camera()[100:180, 200:280] / 255, np.full((80, 80), 2.0)
    >>> blurred = simulate_defocus(sharp, radius, noise_variance=1e-6, rng=0)
    >>> restored = restore_all_in_focus(blurred, radius)
    >>> float(np.abs(blurred - sharp).mean() / np.abs(restored - sharp).mean()) > 2
    True

    With a radius that is far too large, most of the picture would get rings, and is left:

    >>> restored, fit = restore_all_in_focus(blurred, 3 * radius, tv_weight=3e-5, return_fit=True)
    >>> fit.left_as_it_was.shape, fit.unrestored > 0.3
    ((80, 80), True)
    """
    how = Restoration(psf, noise_variance, tv_weight, linearize, intensity_range)
    check_block_size(block_size)
    image, roles = arranged_image(image, said_axes(image, axes, channel_axis))
    if roles:
        from napari_defocus.tiled.restoration import restore_planes

        planes = tiled_planes(image, roles, intensity_range)
        made = restore_planes(planes, blur_map, confidence, how, block_size, progress)
        return made if return_fit else made[0]
    prepared = how.prepared(image)
    restored, fit = how.restored_with_fit(image, prepared, blur_map, confidence, progress)
    return (restored, fit) if return_fit else restored
