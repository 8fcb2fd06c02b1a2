"""The noise variance sigma_n^2 of (7): from the finest details, and from the steps of JPEG."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import correlate1d, uniform_filter

from napari_defocus.core.checks import Linearize
from napari_defocus.core.image import PreparedImage, prepare_image
from napari_defocus.core.jpeg_steps import LEVELS, quantization_step
from napari_defocus.likelihood.noise_shading import PLACES_APART, NoisePlaces
from napari_defocus.settings import MapSettings

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Float = NDArray[np.floating]

FINEST = np.array([1.0, -2.0, 1.0])
"""Its outer product with itself is Immerkaer's operator (CVIU 64(2), 1996); energy 36."""

FINE = np.array([1.0, 0.0, -2.0, 0.0, 1.0])
"""The same for details twice as large."""

_NEIGHBORHOOD = 25
"""px: the side of the square over which a local variance is taken. Chosen by hand."""

_LEAST_ALIVE = 0.5
"""Share of a square that has to show any details, however small. Chosen by hand."""

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

    Cameras brighten what their lens makes dark in the corners, and the noise with it. If the
    flattest places plainly show that, over 8 rings in each quarter of the picture, the result is
    that of the centre, and `BlurCandidates.noise_growth` is g, with the distance :math:`\rho` from
    the centre, 1 in the corners:

    .. math:: \sigma_n^2(\rho) = \hat{\sigma}_n^2 \, (1 + g \rho^2)

    It is asked of pictures from about 340 px a side on, of JPEGs from 4 megapixels on.

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
        Variance for intensities in [0, 1], in the centre if it grows outwards; 0 for a constant
        picture. For k * image + b it is the same share of the squared contrast. Independent
        noise of variance v in each of R, G and B makes 0.45 v in the luminance.

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
    places : NoisePlaces
        Some of the variances, whose places in the whole picture are known.
    """

    finest: Float
    fine: Float
    intensity: Float
    jpeg_step: float | None
    luminance: float
    level: float
    places: NoisePlaces

    @classmethod
    def of(
        cls,
        picture: PreparedImage,
        every: int = 1,
        start: tuple[int, int] = (0, 0),
        whole: tuple[int, int] | None = None,
    ) -> NoiseSample:
        """Look at a prepared picture; of the variances, keep those of every so many pixels.

        It may be a piece of a larger one: `start` is the row and column where it starts, and
        `whole` are the height and width of the larger one.
        """
        level = picture.intensities.level
        step = quantization_step(picture.luminance, level)
        seen = _LocalVariances.of(picture, FINEST)
        (finest, intensity), some = seen.known, seen.at_places
        fine: Float = np.empty(0)
        coarser = None
        if step is not None:
            seen = _LocalVariances.of(picture, FINE)
            fine, coarser = seen.known[0][::every], seen.at_places
        bright = float(np.maximum(picture.luminance, 0).mean())
        places = _places(some, coarser, start, whole or picture.shape)
        return cls(finest[::every], fine, intensity[::every], step, bright, level, places)


def noise_variance_of_samples(samples: list[NoiseSample]) -> float:
    """Find the noise variance of a picture from pieces that are spread over it.

    If it grows towards the corners, it is that of the centre.
    """
    return noise_variance_with_growth(samples, places_of_samples(samples).growth)


def places_of_samples(samples: list[NoiseSample]) -> NoisePlaces:
    """Return the places of all pieces of a picture; of a JPEG, of pieces that look like one."""
    if not looks_like_jpeg(samples):
        places = NoisePlaces.joined([sample.places for sample in samples])
        return replace(places, fine=np.empty(0))
    return NoisePlaces.joined([one.places for one in samples if one.jpeg_step is not None])


def looks_like_jpeg(samples: list[NoiseSample]) -> bool:
    """Return whether a picture is a JPEG: if half of its pieces look like it."""
    return 2 * sum(sample.jpeg_step is not None for sample in samples) >= len(samples)


def noise_variance_with_growth(samples: list[NoiseSample], growth: float) -> float:
    """Find the noise variance of a picture, in its centre if it grows towards the corners."""
    if growth:
        shown: list[NoisePlaces] | list[NoiseSample]
        shown = [sample.places.flattened(growth) for sample in samples]
    else:
        shown = samples
    finest = noise_floor(np.concatenate([one.finest for one in shown]))
    if not looks_like_jpeg(samples):
        return finest
    steps = [sample.jpeg_step for sample in samples if sample.jpeg_step is not None]
    fine = noise_floor(np.concatenate([one.fine for one in shown]))
    return finest + compression_variance(finest, fine, float(np.median(steps)), samples[0].level)


def noise_floor(details: NDArray[np.floating]) -> float:
    """Return the noise variance that local variances show where they are least."""
    return float(np.quantile(details, _FLOOR_QUANTILE)) / _FLOOR_OF_WHITE


def local_variances(picture: PreparedImage, taps: Float64) -> tuple[Float, Float]:
    """Return the local variance of fine details, and the intensity, around every pixel.

    `taps` find the details in each axis. For white noise the former is its variance. Places
    that are constant to the last bit (clipped, painted) or transparent are left out.
    """
    return _LocalVariances.of(picture, taps).known


@dataclass(frozen=True, eq=False)
class _LocalVariances:
    """Energy of fine details, the share of pixels that have any, and intensity, around each pixel.

    All are (H, W), in units of `picture.evened`; `unit` is that in intensities.
    """

    energy: Float
    alive: Float
    mean: Float
    unit: float

    @classmethod
    def of(cls, picture: PreparedImage, taps: Float64) -> _LocalVariances:
        """Measure them in a prepared picture."""
        luminance = picture.evened
        details = correlate1d(correlate1d(luminance, taps, axis=0), taps, axis=1)
        weight = np.ones_like(luminance) if picture.opaque is None else picture.opaque
        alive = uniform_filter((details != 0) * np.float32(1) * weight, _NEIGHBORHOOD)
        energy = uniform_filter(details**2 * weight, _NEIGHBORHOOD) / np.sum(taps**2) ** 2
        mean = uniform_filter(luminance, _NEIGHBORHOOD)
        return cls(energy, alive, mean, picture.intensities.unit)

    @property
    def known(self) -> tuple[Float, Float]:
        """Variances and intensities of all places that tell of noise, one after the other."""
        kept = self.alive > _LEAST_ALIVE
        if not kept.any():
            return np.zeros(1), np.zeros(1)
        return self.energy[kept] / self.alive[kept] * self.unit**2, self.mean[kept] * self.unit

    @property
    def at_places(self) -> _LocalVariances:
        """The same at every sixth pixel of each axis."""
        some = np.s_[PLACES_APART // 2 :: PLACES_APART, PLACES_APART // 2 :: PLACES_APART]
        energy, alive, mean = (one[some].copy() for one in (self.energy, self.alive, self.mean))
        return _LocalVariances(energy, alive, mean, self.unit)


def _places(
    finest: _LocalVariances,
    fine: _LocalVariances | None,
    start: tuple[int, int],
    whole: tuple[int, int],
) -> NoisePlaces:
    """Return what is seen at every sixth pixel of each axis, and where in the whole picture."""
    both = [finest] if fine is None else [finest, fine]
    kept = np.logical_and.reduce([one.alive > _LEAST_ALIVE for one in both])
    rows, columns = (
        first + PLACES_APART // 2 + PLACES_APART * np.arange(count) - (length - 1) / 2
        for count, first, length in zip(kept.shape, start, whole, strict=True)
    )
    variances = [one.energy[kept] / one.alive[kept] * one.unit**2 for one in both]
    outward = np.add.outer(rows**2, columns**2) * (4 / sum((side - 1) ** 2 for side in whole))
    quadrant = np.add.outer(2 * (rows > 0), 1 * (columns > 0))
    return NoisePlaces(
        variances[0],
        np.empty(0) if fine is None else variances[1],
        finest.mean[kept] * finest.unit,
        outward[kept],
        quadrant[kept],
        whole[0] * whole[1],
    )


def compression_variance(finest: float, fine: float, step: float, level: float) -> float:
    """Return how much of JPEG's noise is not in the finest details.

    `finest` and `fine` are the variances in the finest details, and in those twice as large.
    """
    of_levels = PROCESSING_VARIANCE + step**2 / 12 / LEVELS**2 / 2
    return max(0.0, fine - finest) + of_levels * (LEVELS * level) ** 2
