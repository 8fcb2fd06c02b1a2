"""The noise variance of a picture: from its finest details, or by maximum evidence after JPEG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import correlate1d, uniform_filter
from scipy.optimize import nnls
from scipy.stats import ttest_ind

from napari_defocus.gabor import gradients, local_power, window_centers, within_picture
from napari_defocus.image import PreparedImage, prepare_image
from napari_defocus.likelihood import profile_log_likelihood
from napari_defocus.psf import Disc, PSFFamily
from napari_defocus.settings import Linearize, MapSettings
from napari_defocus.spectrum import check_windows, label_scales, spectrum_table

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_WINDOWS_A_SIDE = 24
_LADDER = 10.0 ** np.arange(-1.0, 2.01, 0.5)
_SCALE_STRIDE = 4
_FINE_STEP = 0.02
_LARGEST_LOSS_BELOW, _LARGEST_LOSS_ABOVE = 6.0, 12.0

_FINEST = np.array([1.0, -2.0, 1.0])
"""Its outer product with itself is Immerkaer's operator (CVIU 64(2), 1996); energy 36."""

_NEIGHBORHOOD = 25
_FLOOR_QUANTILE = 0.1
_FLOOR_OF_WHITE = 0.865
"""The 10 % quantile of the local variance of white noise of variance 1, over 25 x 25 px."""

_COMPRESSED_FACTOR = 15.0
"""How far the noise may exceed that of the finest details after JPEG: 1 to 18, quality 50 to 95."""

_BLOCK = 8
_MOST_LINES = 1024
_LEAST_SCORE, _LEAST_SUM_OF_SCORES = 5.0, 7.0
_LEAST_STEP = 1e-4
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
    ValueError
        If one is negative or not finite, or both are 0.

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
            if not (np.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}; it takes a finite number from 0 up")
        if self.read_variance == self.gain == 0:
            raise ValueError("read_variance and gain are both 0; one of them takes more")

    def variance_at(self, intensity: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return the variance at intensities in [0, 1]; darker than black counts as black."""
        return self.read_variance + self.gain * np.maximum(intensity, 0)


def estimate_noise_variance(
    image: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    window: int = MapSettings.window,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
) -> float:
    """Find the variance of the noise in a picture's luminance.

    White noise is seen in the finest details of the flattest places: the 10 % quantile of their
    local variance. JPEG takes the finest details first. On pictures that show its blocks of
    8 px, each window has a variance that explains its spectrum best, the one of maximum
    evidence max_{r, s} log p(r, s), with p of (5), and the noise is the variance that most
    windows can agree on: what a window loses at another one counts up to a limit, so that
    texture, which passes for noise in some windows, has no say. It is at most 15 times that of
    the finest details. Fine texture that is sharp everywhere passes for noise.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        See `estimate_candidates`.
    psf : PSFFamily, optional
        The family of blurs that the picture may have.
    window : int, optional
        Side N of the analysis window, px.
    linearize : {"srgb"}, optional
        Decode the intensities first, see `estimate_candidates`.
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
    >>> bool(0.8e-4 < estimate_noise_variance(noisy) < 1.25e-4)
    True
    """
    psf = check_windows(psf, window)
    return noise_variance_of(prepare_image(image, intensity_range, linearize), [psf], window)


def estimate_shot_noise(
    image: ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    window: int = MapSettings.window,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
) -> ShotNoise:
    """Find how the variance of the noise in a picture's luminance grows with the intensity.

    The flattest places of each range of intensities give a variance, to which a line with
    non-negative coefficients is fitted. On pictures that show JPEG's blocks it is scaled so
    that its mean over the picture is `estimate_noise_variance`.

    Parameters
    ----------
    image, psf, window, linearize, intensity_range
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
    psf = check_windows(psf, window)
    return shot_noise_of(prepare_image(image, intensity_range, linearize), psf, window)


def noise_variance_of(picture: PreparedImage, families: Sequence[PSFFamily], window: int) -> float:
    """Find the noise variance of a prepared picture, the smallest with any of the families."""
    details, _ = _local_details(picture)
    return _variance(picture, details, families, window, _is_compressed(picture.luminance))


def _variance(
    picture: PreparedImage,
    details: Float64,
    families: Sequence[PSFFamily],
    window: int,
    compressed: bool,
) -> float:
    floor = float(np.quantile(details, _FLOOR_QUANTILE)) / _FLOOR_OF_WHITE
    if floor == 0 or not compressed:
        return floor
    ladder = floor * _LADDER
    agreed = (_agreed_variance(picture, psf, window, ladder) for psf in families)
    return min(*agreed, _COMPRESSED_FACTOR * floor)


def _agreed_variance(picture: PreparedImage, psf: PSFFamily, window: int, ladder: Float64) -> float:
    """Return the variance at which the limited losses of evidence of all windows are least."""
    gradient = gradients(picture.luminance, picture.opaque, window)
    height, width = (
        length + 2 * pad for length, pad in zip(picture.shape, gradient.pad, strict=True)
    )
    rows, columns = _sparse_centers(height, window), _sparse_centers(width, window)
    table = spectrum_table(psf, window, rows[0] % 1, columns[0] % 1, "exact")
    power = local_power(gradient, rows, columns, window).reshape(-1, *table.noise.shape)
    power = power[power.any(axis=(1, 2))]
    if not len(power):
        return float(ladder[-1])
    scales = label_scales(psf)[::_SCALE_STRIDE]
    evidence = [
        profile_log_likelihood(power, table, scales, variance).max(axis=1) for variance in ladder
    ]
    return _least_loss(np.log(ladder), np.stack(evidence, axis=1))


def _sparse_centers(length: int, window: int) -> NDArray[np.float64]:
    stride = max(4, -(-length // _WINDOWS_A_SIDE))
    return np.unique(within_picture(window_centers(length, stride), length, window))


def _least_loss(log_variance: Float64, evidence: Float32) -> float:
    """Return the variance at which the limited losses of all windows, (P, V), are least.

    A window prefers too much noise where texture passes for it, and too little only where it is
    clipped or transparent: a loss from too much noise has the larger limit.
    """
    fine = np.arange(log_variance[0], log_variance[-1], _FINE_STEP)
    height = CubicSpline(log_variance, evidence, axis=1)(fine)
    loss = height.max(axis=1, keepdims=True) - height
    too_little = np.arange(len(fine)) < height.argmax(axis=1)[:, None]
    limit = np.where(too_little, _LARGEST_LOSS_BELOW, _LARGEST_LOSS_ABOVE)
    return float(np.exp(fine[np.minimum(loss, limit).sum(axis=0).argmin()]))


def _local_details(picture: PreparedImage) -> tuple[Float64, Float64]:
    """Return the local variance of the finest details, and the intensity, around every pixel.

    For white noise the former is its variance. Places that are constant to the last bit
    (clipped, painted) or transparent are left out.
    """
    luminance = picture.luminance
    details = correlate1d(correlate1d(luminance, _FINEST, axis=0), _FINEST, axis=1)
    weight = np.ones_like(luminance) if picture.opaque is None else picture.opaque
    alive = uniform_filter((details != 0) * np.float32(1) * weight, _NEIGHBORHOOD)
    energy = uniform_filter(details**2 * weight, _NEIGHBORHOOD) / np.sum(_FINEST**2) ** 2
    mean = uniform_filter(luminance, _NEIGHBORHOOD)
    kept = alive > 0.5
    if not kept.any():
        return np.zeros(1), np.zeros(1)
    return energy[kept] / alive[kept], mean[kept]


def _is_compressed(luminance: Float32) -> bool:
    """Tell whether neighbours differ more between blocks of 8 px than within, as JPEG leaves it.

    The blocks may begin anywhere.
    """
    row_step, column_step = (-(-length // _MOST_LINES) for length in luminance.shape)
    # The median sees blocks in the flat part of a picture, the mean in its texture.
    for typical in (np.median, np.mean):
        scores = [
            _blockiness(typical(np.abs(np.diff(some, axis=0)), axis=1))
            for some in (luminance[:, ::column_step], luminance[::row_step].T)
        ]
        if max(scores) > _LEAST_SCORE or sum(scores) > _LEAST_SUM_OF_SCORES:
            return True
    return False


def _blockiness(steps: NDArray[np.floating]) -> float:
    """Return the largest t-score of one phase of 8 px against the seven others."""
    if len(steps) < 4 * _BLOCK:
        return 0.0
    log_steps = np.log(steps + _LEAST_STEP)
    bend = log_steps[1:-1] - 0.5 * (log_steps[:-2] + log_steps[2:])
    phase = np.arange(len(bend)) % _BLOCK
    return max(
        ttest_ind(bend[phase == k], bend[phase != k], equal_var=False).statistic
        for k in range(_BLOCK)
    )


def shot_noise_of(picture: PreparedImage, psf: PSFFamily, window: int) -> ShotNoise:
    """Find the growth of the noise of a prepared picture, see `estimate_shot_noise`."""
    everywhere, compressed = _local_details(picture), _is_compressed(picture.luminance)
    variance = _variance(picture, everywhere[0], [psf], window, compressed)
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
    design = np.stack([np.ones_like(mean), mean], axis=1) / floor[:, None]
    (read, gain), _ = nnls(design, np.ones_like(mean))
    if compressed:
        scale = variance / (read + gain * np.maximum(picture.luminance, 0).mean())
        read, gain = scale * read, scale * gain
    return ShotNoise(float(read), float(gain))
