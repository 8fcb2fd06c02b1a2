"""The forward model (1): a sharp picture seen through a blur that varies from place to place."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import check_number
from napari_defocus.core.image import prepare_light, with_unknown
from napari_defocus.forward.blur_operator import BlurOperator, checked_scales
from napari_defocus.psf.families import Disc, PSFFamily, as_family

Float32 = NDArray[np.float32]


def simulate_defocus(
    image: ArrayLike,
    blur_map: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    noise_variance: float = 0.0,
    rng: int | np.random.Generator | None = None,
    intensity_range: tuple[float, float] | None = None,
) -> Float32:
    r"""Blur a sharp picture by a map of scales and add noise, as in (1).

    Every pixel of the result is a mean of its neighbours, weighted by the PSF of its own scale,

    .. math:: g[\mathbf{x}] = \sum_{\mathbf{u}} h_{r(\mathbf{x})}[\mathbf{u}]
        f[\mathbf{x} - \mathbf{u}] + n[\mathbf{x}], \qquad
        n[\mathbf{x}] \sim \mathcal{N}(0, \sigma_n^2) \tag{1}

    The picture is mirrored at its border.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The sharp picture; a fourth channel (opacity) is left out.
    blur_map : (H, W) array_like
        Scale at every pixel, in px, within the family's domain; kernels change in steps of
        0.0125 px.
    psf : PSFFamily or callable, optional
    noise_variance : float, optional
        Variance of the white Gaussian noise in each channel, intensities in [0, 1].
    rng : int or numpy.random.Generator, optional
        Seed or source of the noise.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1. By default floats are taken as they are, and
        integers as `estimate_candidates` takes them.

    Returns
    -------
    (H, W) or (H, W, 3) float32 ndarray
        Nominally in [0, 1]; noise may go beyond, nothing is clipped. NaN where `image` is NaN
        or masked.

    Raises
    ------
    TypeError, ValueError
        If `image` is not a picture (see `estimate_candidates`), if `blur_map` has another shape
        or scales outside the domain, or if `noise_variance` is negative.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_defocus import simulate_defocus
    >>> point = np.zeros((5, 5)); point[2, 2] = 1.0
    >>> simulate_defocus(point, np.full((5, 5), 1.0))[1:4, 1:4].round(3)
    array([[0.025, 0.145, 0.025],
           [0.145, 0.318, 0.145],
           [0.025, 0.145, 0.025]], dtype=float32)
    """
    psf = as_family(psf)
    picture = prepare_light(image, intensity_range)
    scales = checked_scales(blur_map, picture.shape, psf)
    noise = noise_for(noise_variance, rng)
    blur = BlurOperator(scales, psf, picture.color.shape[2])
    blurred = blur.apply(blur.extend(picture.color))
    if noise_variance > 0:
        white = noise.standard_normal(blurred.shape, np.float32)
        blurred += np.float32(np.sqrt(noise_variance)) * white
    return with_unknown(blurred[..., 0] if blurred.shape[2] == 1 else blurred, image)


def noise_for(noise_variance: float, rng: int | np.random.Generator | None) -> np.random.Generator:
    """Check the noise of a simulation, and return its source."""
    takes = "a finite number from 0 up (to 1e15)"
    check_number("noise_variance", noise_variance, lambda v: 0 <= v <= 1e15, takes)
    try:
        return np.random.default_rng(rng)
    except (TypeError, ValueError):
        raise TypeError(
            f"rng is {rng!r}; it takes a whole number from 0 up, a Generator of NumPy, or None"
        ) from None
