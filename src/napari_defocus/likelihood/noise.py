"""The noise variance of a picture: from its finest details, and from the steps of JPEG."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import dctn
from scipy.ndimage import correlate1d, uniform_filter

from napari_defocus.core.checks import Linearize, check_real
from napari_defocus.core.image import PreparedImage, prepare_image
from napari_defocus.settings import MapSettings

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_FINEST = np.array([1.0, -2.0, 1.0])
"""Its outer product with itself is Immerkaer's operator (CVIU 64(2), 1996); energy 36."""

_FINE = np.array([1.0, 0.0, -2.0, 0.0, 1.0])
"""The same for details twice as large."""

_NEIGHBORHOOD = 25
_FLOOR_QUANTILE = 0.1
_FLOOR_OF_WHITE = 0.865
"""The 10 % quantile of the local variance of white noise of variance 1, over 25 x 25 px."""

_PROCESSING_VARIANCE = 2e-5
"""What a camera leaves at middle frequencies besides the finest details: a level of 8 bits or so.

With half the error of JPEG's steps, it served simulated cameras of qualities 40 to 98.
"""

_BLOCK = 8
_MOST_LINES = 1024
_LEAST_SCORE, _LEAST_SUM_OF_SCORES = 5.0, 7.0
_LEAST_STEP = 1e-4
"""Between neighbours, in pictures whose level of 8 bits is 1/255."""

_MOST_BLOCKS = 4096
_COEFFICIENTS = ((0, 1, 1, 0, 2, 1, 2, 2, 0, 3), (1, 0, 1, 2, 0, 2, 1, 2, 3, 0))
_JPEG_STEPS = range(2, 80)
_FEWEST_COEFFICIENTS = 30
_LEAST_COMB, _COMB_DEVIATIONS = 0.25, 2.5
_LEVELS = 255
_INTENSITY_BINS = 12
_FEWEST_PLACES = 100
_LEAST_SHARE = 1e-3
_SHOT_NOISE_STEP = 7


@dataclass(frozen=True)
class ShotNoise:
    """Noise whose variance grows with the intensity, as that of counted photons does.

    Parameters
    ----------
    read_variance : float
        Variance where the picture is black, intensities in [0, 1].
    gain : float
        Growth of the variance from black to white: it is `read_variance` + `gain` * intensity.

    Raises
    ------
    TypeError, ValueError
        If one is no number, negative or not finite, or both are 0.

    Examples
    --------
    >>> float(ShotNoise(1e-6, 1e-4).variance_at(np.array(0.5)))
    5.1e-05
    """

    read_variance: float
    gain: float

    def __post_init__(self) -> None:
        for name in ("read_variance", "gain"):
            value = getattr(self, name)
            check_real(name, value, "a finite number from 0 up")
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}; it takes a finite number from 0 up")
        if self.read_variance == self.gain == 0:
            raise ValueError("read_variance and gain are both 0; one of them takes more")

    def variance_at(self, intensity: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return the variance at intensities in [0, 1]; darker than black counts as black."""
        return self.read_variance + self.gain * np.maximum(intensity, 0)


def estimate_noise_variance(
    image: ArrayLike,
    *,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
) -> float:
    """Find the variance of the noise in a picture's luminance.

    White noise is seen in the finest details of the flattest places: the 10 % quantile of their
    local variance. JPEG takes the finest details first and leaves errors in the others. On
    pictures that show its blocks of 8 px, the steps q to which it has rounded the cosine
    transform of the blocks are read off the picture, and half their variance, q^2 / 12 in
    levels of 8 bits, is added, with what else cameras do to pictures. Fine texture that is
    sharp everywhere passes for noise.

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
        Variance for intensities in [0, 1]; 0 for a constant picture. Of k * image + b, it is
        the same share of the squared contrast. Independent noise of variance v in each of R, G
        and B is 0.45 v in luminance.

    Raises
    ------
    TypeError, ValueError
        If `image` is no picture.

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


def estimate_shot_noise(
    image: ArrayLike,
    *,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
) -> ShotNoise:
    """Find how the variance of the noise in a picture's luminance grows with the intensity.

    The flattest places of each range of intensities give a variance, to which a line with
    non-negative coefficients is fitted. On pictures that show JPEG's blocks it is scaled so
    that its mean over the picture is `estimate_noise_variance`.

    Parameters
    ----------
    image, linearize, intensity_range
        See `estimate_noise_variance`.

    Returns
    -------
    ShotNoise
        To be given to `estimate_candidates` as `noise_variance`.

    Raises
    ------
    TypeError, ValueError
        As `estimate_noise_variance`, and if the picture has no noise at all.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import estimate_shot_noise, simulate_defocus
    >>> noisy = simulate_defocus(camera()[:200, :200], np.full((200, 200), 2.0),
    ...                          noise_variance=1e-4, rng=0)
    >>> noise = estimate_shot_noise(noisy)
    >>> bool(0.7e-4 < noise.variance_at(np.array(0.5)) < 1.4e-4)
    True
    """
    return shot_noise_of(prepare_image(image, intensity_range, linearize))


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
    jpeg_step : float or None
        To which JPEG has rounded slow changes, in levels of 8 bits; None without it.
    luminance : float
        Its mean, darker than black counting as black.
    level : float
        How large a level of 8 bits is in the picture, intensities in [0, 1].
    """

    finest: Float64
    fine: Float64
    jpeg_step: float | None
    luminance: float
    level: float

    @classmethod
    def of(cls, picture: PreparedImage, every: int = 1) -> NoiseSample:
        """Look at a prepared picture; of the variances, keep those of every so many pixels."""
        level = picture.intensities.level
        step = _jpeg_step(picture.luminance, level)
        finest = _local_details(picture, _FINEST)[0][::every]
        fine = np.empty(0) if step is None else _local_details(picture, _FINE)[0][::every]
        bright = float(np.maximum(picture.luminance, 0).mean())
        return cls(finest, fine, step, bright, level)


def noise_variance_of_samples(samples: list[NoiseSample]) -> float:
    """Find the noise variance of a picture from pieces that are spread over it.

    It is a JPEG if half of the pieces look like it.
    """
    finest = _floor(np.concatenate([sample.finest for sample in samples]))
    steps = [sample.jpeg_step for sample in samples if sample.jpeg_step is not None]
    if 2 * len(steps) < len(samples):
        return finest
    fine = _floor(np.concatenate([sample.fine for sample in samples]))
    return finest + _compression_variance(finest, fine, float(np.median(steps)), samples[0].level)


def mean_shot_noise(picture: PreparedImage, noise: ShotNoise) -> float:
    """Return the mean variance over a picture of noise that grows with the intensity."""
    return float(noise.variance_at(picture.luminance).mean())


def _floor(details: NDArray[np.floating]) -> float:
    return float(np.quantile(details, _FLOOR_QUANTILE)) / _FLOOR_OF_WHITE


def _local_details(picture: PreparedImage, taps: Float64) -> tuple[Float64, Float64]:
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


def _compression_variance(finest: float, fine: float, step: float, level: float) -> float:
    """Return how much of JPEG's noise is not in the finest details.

    `finest` and `fine` are the variances in the finest details, and in those twice as large.
    """
    of_levels = _PROCESSING_VARIANCE + step**2 / 12 / _LEVELS**2 / 2
    return max(0.0, fine - finest) + of_levels * (_LEVELS * level) ** 2


def _jpeg_step(luminance: Float32, level: float) -> float | None:
    """Return `_quantization_step` of what was a JPEG, None of what was not."""
    luminance = luminance / np.float32(_LEVELS * level)
    origin = _origin_of_blocks(luminance)
    step = _quantization_step(luminance, origin or (0, 0))
    return None if origin is None and step <= 1 else step


def _origin_of_blocks(luminance: Float32) -> tuple[int, int] | None:
    """Find where JPEG's blocks of 8 px begin, in rows and columns; None if there are none.

    Neighbours differ more between blocks than within.
    """
    row_step, column_step = (-(-length // _MOST_LINES) for length in luminance.shape)
    # The median sees blocks in the flat part of a picture, the mean in its texture.
    for typical in (np.median, np.mean):
        (row, row_score), (column, column_score) = (
            _blockiness(typical(np.abs(np.diff(some, axis=0)), axis=1))
            for some in (luminance[:, ::column_step], luminance[::row_step].T)
        )
        if (
            max(row_score, column_score) > _LEAST_SCORE
            or row_score + column_score > _LEAST_SUM_OF_SCORES
        ):
            return row, column
    return None


def _blockiness(steps: NDArray[np.floating]) -> tuple[int, float]:
    """Return the phase of 8 px where the picture steps most, and its t-score against the others.

    Step i leads from line i to line i + 1.
    """
    if len(steps) < 4 * _BLOCK:
        return 0, 0.0
    log_steps = np.log(steps + _LEAST_STEP)
    bend = log_steps[1:-1] - 0.5 * (log_steps[:-2] + log_steps[2:])
    line = (np.arange(len(bend)) + 2) % _BLOCK
    scores = [_welch(bend[line == k], bend[line != k]) for k in range(_BLOCK)]
    return int(np.argmax(scores)), float(max(scores))


def _welch(some: Float64, others: Float64) -> float:
    """Return the t-score of a difference of means, variances unequal (Welch, Biometrika 34, 1947).

    As `scipy.stats.ttest_ind`, which takes thirty times as long to get there; NaN for constants.
    """
    squared_error = sum(values.var(ddof=1) / len(values) for values in (some, others))
    with np.errstate(divide="ignore", invalid="ignore"):
        return float((some.mean() - others.mean()) / np.sqrt(squared_error))


def _quantization_step(luminance: Float32, origin: tuple[int, int]) -> float:
    """Return the step to which JPEG has rounded slow changes within blocks, in levels of 8 bits.

    The cosine coefficients (Wallace, CACM 34(4), 1991) lie near multiples of their step. The
    largest step that they keep to counts, the median of ten coefficients; 1 if there is none.
    """
    row, column = origin
    rows, columns = (luminance.shape[0] - row) // _BLOCK, (luminance.shape[1] - column) // _BLOCK
    inside = luminance[row : row + rows * _BLOCK, column : column + columns * _BLOCK]
    grid = inside.reshape(rows, _BLOCK, columns, _BLOCK).swapaxes(1, 2)
    blocks = grid.reshape(-1, _BLOCK, _BLOCK)
    some = blocks[:: max(1, len(blocks) // _MOST_BLOCKS)]
    coefficients = _LEVELS * dctn(some, axes=(1, 2), norm="ortho")[:, *_COEFFICIENTS]
    return float(np.median([_comb(values) for values in coefficients.T]))


def _comb(values: Float32) -> int:
    """Return the largest step whose multiples values lie near, 1 if there is none."""
    largest = 1
    for step in _JPEG_STEPS:
        rounded = values[np.abs(values) > step / 2]  # to another multiple than 0
        if len(rounded) < _FEWEST_COEFFICIENTS:
            break
        nearness = np.cos(2 * np.pi / step * rounded).mean()
        if nearness > _LEAST_COMB + _COMB_DEVIATIONS / np.sqrt(len(rounded)):
            largest = step
    return largest


def shot_noise_of(picture: PreparedImage) -> ShotNoise:
    """Find the growth of the noise of a prepared picture, see `estimate_shot_noise`."""
    everywhere = _local_details(picture, _FINEST)
    finest = _floor(everywhere[0])
    level = picture.intensities.level
    step, compression = _jpeg_step(picture.luminance, level), 0.0
    if step is not None:
        fine = _floor(_local_details(picture, _FINE)[0])
        compression = _compression_variance(finest, fine, step, level)
    variance = finest + compression
    if variance == 0:
        raise ValueError("image has no noise; its growth with the intensity cannot be found")
    details, intensity = (values[::_SHOT_NOISE_STEP] for values in everywhere)
    order = np.array_split(np.argsort(intensity), _INTENSITY_BINS)
    bins = [places for places in order if len(places) >= _FEWEST_PLACES]
    if len(bins) < 2:
        return ShotNoise(variance, 0.0)
    floor = np.array([np.quantile(details[places], _FLOOR_QUANTILE) for places in bins])
    floor = np.maximum(floor / _FLOOR_OF_WHITE, _LEAST_SHARE * variance)
    mean = np.array([np.maximum(intensity[places], 0).mean() for places in bins])
    # Relative errors count: a textured bin is too high by a factor.
    read, gain = _line(mean / floor, 1 / floor)
    if compression:
        scale = variance / (read + gain * np.maximum(picture.luminance, 0).mean())
        read, gain = scale * read, scale * gain
    return ShotNoise(float(read), float(gain))


def _line(slope: Float64, constant: Float64) -> tuple[float, float]:
    """Return a and b, none negative, of the least sum of (a constant + b slope - 1)^2.

    The places are few, and the sums in their order: `scipy.optimize.nnls` calls BLAS.
    """
    cc, cs, ss = (float(np.sum(one)) for one in (constant**2, constant * slope, slope**2))
    c, s = float(np.sum(constant)), float(np.sum(slope))
    determinant = cc * ss - cs * cs
    if determinant > 0:
        a, b = (c * ss - s * cs) / determinant, (s * cc - c * cs) / determinant
        if a >= 0 and b >= 0:
            return a, b
    # The least is where one of them is 0: the one that explains more stays.
    alone = c / cc, max(s, 0.0) / ss if ss > 0 else 0.0
    return (alone[0], 0.0) if c * alone[0] >= s * alone[1] else (0.0, alone[1])
