"""The noise variance sigma_n^2 of (7): from the finest details, and from the steps of JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import correlate1d, uniform_filter

from napari_defocus.core.checks import Linearize
from napari_defocus.core.image import PreparedImage, prepare_image
from napari_defocus.core.jpeg_steps import LEVELS, quantization_step
from napari_defocus.settings import MapSettings

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

FINEST = np.array([1.0, -2.0, 1.0])
"""Its outer product with itself is Immerkaer's operator (CVIU 64(2), 1996); energy 36."""

FINE = np.array([1.0, 0.0, -2.0, 0.0, 1.0])
"""The same for details twice as large."""

_NEIGHBORHOOD = 25
"""px: the side of the square over which a local variance is taken. Chosen by hand."""

_FLOOR_QUANTILE = 0.1
"""The quantile of the local variances that counts: the flattest places show noise alone. By hand.
"""

_FLOOR_OF_WHITE = 0.865
"""The 10 % quantile of the local variance of white noise of variance 1, over 25 x 25 px."""

PROCESSING_VARIANCE = 2e-5
"""Variance that a camera leaves at middle frequencies besides the finest details, for intensities
in [0, 1]: about a level of 8 bits. With half the error of JPEG's steps, it fitted simulated cameras
of qualities 40 to 98 (docs/decisions.md).
"""


def estimate_noise_variance(
    image: ArrayLike,
    *,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
) -> float:
    r"""Find the variance of the noise in a picture's luminance.

    White noise is seen in the finest details of the flattest places. Its measure is the 10 %
    quantile :math:`Q_{0.1}` of their local variance, over squares S of 25 x 25 px; for white noise
    of variance 1 this is 0.865. Fine details are those of Immerkaer's operator [1]_,

    .. math:: \hat{\sigma}_1^2 = \frac{Q_{0.1}(v_1)}{0.865}, \qquad
        v_1[\mathbf{x}] = \frac{1}{36 \, |S|} \sum_{\mathbf{u} \in S(\mathbf{x})}
        \left|(d^T d \otimes g)[\mathbf{u}]\right|^2, \qquad d = (1, -2, 1)

    JPEG removes the finest details first, and leaves errors in the others. If a picture shows its
    blocks of 8 px, the steps q of its rounding are found from the picture. Half their variance,
    q^2 / 12 in levels of 8 bits, is added, and a constant for what cameras do to pictures. With
    :math:`\hat{\sigma}_2^2` for details twice as large,
    :math:`d = (1, 0, -2, 0, 1)`, and the size :math:`\Delta` of a level,

    .. math:: \hat{\sigma}_n^2 = \hat{\sigma}_1^2
        + \max(0, \hat{\sigma}_2^2 - \hat{\sigma}_1^2)
        + \left(\frac{q^2}{24} + 2 \cdot 10^{-5} \cdot 255^2\right) \Delta^2

    Fine texture that is sharp everywhere counts as noise.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        See `estimate_candidates`.
    linearize : {"srgb"}, optional
        Decode the intensities first, see `estimate_candidates`.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; found by default, see `estimate_candidates`.

    Returns
    -------
    float
        Variance for intensities in [0, 1]; 0 for a constant picture. For k * image + b it is the
        same share of the squared contrast. Independent noise of variance v in each of R, G and B
        makes 0.45 v in the luminance.

    Raises
    ------
    TypeError, ValueError
        If `image` is not a picture.

    References
    ----------
    .. [1] J. Immerkaer, "Fast Noise Variance Estimation", Computer Vision and Image
       Understanding 64(2), 1996.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_noise_variance, simulate_defocus
    >>> noisy = simulate_defocus(camera()[:200, :200], np.full((200, 200), 2.0),
    ...                          noise_variance=1e-4, rng=0)
    >>> bool(0.8e-4 < estimate_noise_variance(noisy) < 1.25e-4)
    True
    """
    return noise_variance_of(prepare_image(image, intensity_range, linearize))


def noise_variance_of(picture: PreparedImage) -> float:
    """Find the noise variance of a prepared picture, see `estimate_noise_variance`."""
    return noise_variance_of_samples([NoiseSample.of(picture)])


@dataclass(frozen=True, eq=False)
class NoiseSample:
    """What a picture, or a piece of one, shows of its noise.

    Attributes
    ----------
    finest, fine : (N,) and (M,) ndarray
        Local variances of its finest details, and of those twice as large, the latter only if
        it was a JPEG.
    intensity : (N,) ndarray
        Its mean where each of `finest` was found.
    jpeg_step : float or None
        To which JPEG has rounded slow changes, in levels of 8 bits; None without it.
    luminance : float
        Its mean, darker than black counting as black.
    level : float
        How large a level of 8 bits is in the picture, intensities in [0, 1].
    """

    finest: Float64
    fine: Float64
    intensity: Float64
    jpeg_step: float | None
    luminance: float
    level: float

    @classmethod
    def of(cls, picture: PreparedImage, every: int = 1) -> NoiseSample:
        """Look at a prepared picture; of the variances, keep those of every so many pixels."""
        level = picture.intensities.level
        step = quantization_step(picture.luminance, level)
        finest, intensity = (values[::every] for values in local_variances(picture, FINEST))
        fine = np.empty(0) if step is None else local_variances(picture, FINE)[0][::every]
        bright = float(np.maximum(picture.luminance, 0).mean())
        return cls(finest, fine, intensity, step, bright, level)


def noise_variance_of_samples(samples: list[NoiseSample]) -> float:
    """Find the noise variance of a picture from pieces that are spread over it.

    It is a JPEG if half of the pieces look like it.
    """
    finest = noise_floor(np.concatenate([sample.finest for sample in samples]))
    steps = [sample.jpeg_step for sample in samples if sample.jpeg_step is not None]
    if 2 * len(steps) < len(samples):
        return finest
    fine = noise_floor(np.concatenate([sample.fine for sample in samples]))
    return finest + compression_variance(finest, fine, float(np.median(steps)), samples[0].level)


def noise_floor(details: NDArray[np.floating]) -> float:
    """Return the noise variance that local variances show where they are least."""
    return float(np.quantile(details, _FLOOR_QUANTILE)) / _FLOOR_OF_WHITE


def local_variances(picture: PreparedImage, taps: Float64) -> tuple[Float64, Float64]:
    """Return the local variance of fine details, and the intensity, around every pixel.

    `taps` find the details in each axis. For white noise the former is its variance. Places
    that are constant to the last bit (clipped, painted) or transparent are left out.
    """
    luminance, unit = picture.evened, picture.intensities.unit
    details = correlate1d(correlate1d(luminance, taps, axis=0), taps, axis=1)
    weight = np.ones_like(luminance) if picture.opaque is None else picture.opaque
    alive = uniform_filter((details != 0) * np.float32(1) * weight, _NEIGHBORHOOD)
    energy = uniform_filter(details**2 * weight, _NEIGHBORHOOD) / np.sum(taps**2) ** 2
    mean = uniform_filter(luminance, _NEIGHBORHOOD)
    kept = alive > 0.5
    if not kept.any():
        return np.zeros(1), np.zeros(1)
    return energy[kept] / alive[kept] * unit**2, mean[kept] * unit


def compression_variance(finest: float, fine: float, step: float, level: float) -> float:
    """Return how much of JPEG's noise is not in the finest details.

    `finest` and `fine` are the variances in the finest details, and in those twice as large.
    """
    of_levels = PROCESSING_VARIANCE + step**2 / 12 / LEVELS**2 / 2
    return max(0.0, fine - finest) + of_levels * (LEVELS * level) ** 2
