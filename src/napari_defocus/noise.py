"""The noise variance of a picture, by maximum evidence."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import correlate1d

from napari_defocus.gabor import gradients, local_power, window_centers, within_picture
from napari_defocus.image import PreparedImage, prepare_image
from napari_defocus.likelihood import profile_log_likelihood
from napari_defocus.psf import Disc, PSFFamily
from napari_defocus.settings import MapSettings
from napari_defocus.spectrum import check_windows, label_scales, spectrum_table

Float32 = NDArray[np.float32]

_WINDOWS_A_SIDE = 32
_LADDER = 10.0 ** -np.arange(0.0, 7.01, 0.5)

_FINEST = np.array([1.0, -2.0, 1.0])
"""Its outer product with itself is Immerkaer's operator (CVIU 64(2), 1996); energy 36."""

_FINEST_FACTOR = 15.0
"""How far the evidence may exceed the variance of the finest details. On photographs and on
JPEG of quality 50 to 95 the two differ by factors of 1 to 18; on pictures that are sharp
everywhere, where the evidence takes texture for noise, by up to 170."""


def estimate_noise_variance(
    image: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    window: int = MapSettings.window,
    intensity_range: tuple[float, float] | None = None,
) -> float:
    """Find the variance of the noise in a picture's luminance.

    It is the variance that explains the local spectra best: the one that maximises the mean
    over windows of max_{r, s} log p(r, s), with p of (5). Unlike an estimate from the finest
    details alone, it stays right on pictures that were compressed or denoised, where the
    noise that matters at the frequencies in use is larger than at the highest. That other
    estimate serves as a bound, 15 times as large: on a picture that is sharp everywhere, the
    evidence cannot tell texture from noise.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        See `estimate_candidates`.
    psf : PSFFamily, optional
        The family of blurs that the picture may have.
    window : int, optional
        Side N of the analysis window, px.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1.

    Returns
    -------
    float
        Variance for intensities in [0, 1]; 0 for a constant picture. Independent noise of
        variance v in each of R, G and B is 0.45 v in luminance.

    Raises
    ------
    TypeError, ValueError
        If `image` is no picture, `psf` no PSF family, or `window` no odd number from 17 up that
        is at least twice the family's largest scale.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_noise_variance, simulate_defocus
    >>> noisy = simulate_defocus(camera()[:200, :200], np.full((200, 200), 2.0),
    ...                          noise_variance=1e-4, rng=0)
    >>> bool(0.5e-4 < estimate_noise_variance(noisy) < 2e-4)
    True
    """
    check_windows(psf, window)
    return evidence_noise_variance(prepare_image(image, intensity_range), psf, window)


def evidence_noise_variance(picture: PreparedImage, psf: PSFFamily, window: int) -> float:
    """Find the variance of maximum evidence on a sparse lattice of windows."""
    gradient = gradients(picture.luminance, picture.opaque, window)
    height, width = (
        length + 2 * pad for length, pad in zip(picture.shape, gradient.pad, strict=True)
    )
    rows, columns = _sparse_centers(height, window), _sparse_centers(width, window)
    table = spectrum_table(psf, window, rows[0] % 1, columns[0] % 1, "exact")
    power = local_power(gradient, rows, columns, window).reshape(-1, *table.noise.shape)
    ceiling = float(np.mean(power / table.noise))
    if ceiling == 0.0:
        return 0.0
    power = power[power.any(axis=(1, 2))]
    scales = label_scales(psf)[::2]
    ladder = ceiling * _LADDER
    evidence = np.array(
        [
            profile_log_likelihood(power, table, scales, variance).max(axis=1).mean()
            for variance in ladder
        ]
    )
    bound = _FINEST_FACTOR * finest_variance(picture.luminance)
    return min(float(np.exp(_peak(np.log(ladder), evidence))), bound or np.inf)


def finest_variance(luminance: Float32) -> float:
    """Estimate the noise variance from the finest details alone.

    The median absolute deviation of second differences along both axes, as for white noise;
    too large on fine texture, too small where compression or denoising took those details.
    """
    details = correlate1d(correlate1d(luminance, _FINEST, axis=0), _FINEST, axis=1)
    sigma = np.median(np.abs(details)) / (0.6745 * np.sum(_FINEST**2))
    return float(sigma**2)


def _sparse_centers(length: int, window: int) -> NDArray[np.float64]:
    stride = max(4, -(-length // _WINDOWS_A_SIDE))
    return np.unique(within_picture(window_centers(length, stride), length, window))


def _peak(position: NDArray[np.float64], value: NDArray[np.float64]) -> float:
    """Return where the parabola through the largest value and its neighbours has its top."""
    best = int(np.clip(np.argmax(value), 1, len(value) - 2))
    left, middle, right = value[best - 1 : best + 2]
    curvature = left - 2 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature < 0 else 0.0
    return float(position[best] + np.clip(shift, -1, 1) * (position[best + 1] - position[best]))
