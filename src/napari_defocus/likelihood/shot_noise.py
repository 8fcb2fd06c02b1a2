"""Noise whose variance grows with the intensity, as that of counted photons does."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import Linearize, check_real
from napari_defocus.core.image import PreparedImage, prepare_image
from napari_defocus.core.jpeg_steps import quantization_step
from napari_defocus.likelihood.noise import (
    FINE,
    FINEST,
    compression_variance,
    local_variances,
    noise_floor,
)
from napari_defocus.likelihood.noise_shading import free_line
from napari_defocus.settings import MapSettings

Float64 = NDArray[np.float64]
Float = NDArray[np.floating]

_INTENSITY_BINS, _FEWEST_PLACES = 16, 100
"""Ranges of intensity with equally many places, and the fewest places of a range. By hand."""

_FEWEST_BINS = 10
"""So many of these ranges have to lie on the line."""

_LARGEST_MISFIT = 0.1
"""Median distance of the ranges from the line, as a share of it: 0.02 to 0.08 on raw pictures of
cameras and microscopes, 0.1 to 0.7 where texture or JPEG makes the variances."""

_LEAST_GROWTH = 4.0
"""How many times as much noise the line has to have in the brightest range as in the darkest: raw
photographs have 8 to 30 times as much, simulations with a constant noise came to 2.1."""

_OUTLIERS, _ROUNDS = 2.5, 6
"""Ranges farther from the line than so many deviations are texture; rounds of leaving them out."""

_DARK_SHARE = 0.05
"""Share of the least variance of a range that is left where a line meets 0. Read noise and offset
cannot be told apart there.
"""

_LEAST_SHARE = 1e-3
"""The least variance of a range, as a share of the picture's noise variance. Chosen by hand."""

_EVERY = 7
"""Every 7th place is taken: neighbours share most of their surroundings. Chosen by hand."""


@dataclass(frozen=True)
class ShotNoise:
    r"""Noise whose variance grows with the intensity I, as that of counted photons does.

    .. math:: \sigma_n^2(I) = \sigma_{\text{read}}^2 + \gamma \max(I - o, 0)

    Parameters
    ----------
    read_variance : float
        :math:`\sigma_{\text{read}}^2`: where there is no light, intensities in [0, 1].
    gain : float
        :math:`\gamma`: growth of the variance from black to white.
    offset : float, optional
        :math:`o`: the intensity that the camera gives without light.

    Raises
    ------
    TypeError, ValueError
        If one is not a number or not finite, or `read_variance` and `gain` are negative or both 0.

    Examples
    --------
    >>> float(ShotNoise(1e-6, 1e-4).variance_at(np.array(0.5)))
    5.1e-05
    """

    read_variance: float
    gain: float
    offset: float = 0.0

    def __post_init__(self) -> None:
        for name in ("read_variance", "gain"):
            value = getattr(self, name)
            check_real(name, value, "a finite number from 0 up")
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} is {value}; it takes a finite number from 0 up")
        if self.read_variance == self.gain == 0:
            raise ValueError("read_variance and gain are both 0; at least one must be larger")
        check_real("offset", self.offset, "a finite number")
        if not math.isfinite(self.offset):
            raise ValueError(f"offset is {self.offset}; it takes a finite number")

    def reduced(self, share: float) -> ShotNoise:
        """Return noise whose variance is a share of this one's."""
        return replace(self, read_variance=share * self.read_variance, gain=share * self.gain)

    def variance_at(self, intensity: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return the variance at intensities in [0, 1]; darker than `offset` counts as that."""
        return self.read_variance + self.gain * np.maximum(intensity - self.offset, 0)


def estimate_shot_noise(
    image: ArrayLike,
    *,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
) -> ShotNoise:
    r"""Find how the variance of the noise in a picture's luminance grows with the intensity.

    The flattest places of each range of intensities, with the mean I, give a variance
    :math:`v_I`, see `estimate_noise_variance`, to which a line with non-negative coefficients is
    fitted:

    .. math:: \underset{\sigma_{\text{read}}^2, \, \gamma \, \ge \, 0}{\text{arg min}} \sum_I \left(
        \frac{\sigma_{\text{read}}^2 + \gamma I}{v_I} - 1\right)^2

    A line whose constant may be negative is fitted, too. If it fits to 10 %, and the noise grows at
    least four times, it is taken instead: it meets 0 at the offset of the camera. If the picture
    shows JPEG's blocks, the line is scaled so that its mean is `estimate_noise_variance`.

    Parameters
    ----------
    image, linearize, intensity_range
        See `estimate_noise_variance`.

    Returns
    -------
    ShotNoise
        `estimate_candidates` takes it as `noise_variance`.

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


def plain_shot_noise(details: Float, intensity: Float) -> ShotNoise | None:
    """Find how the noise of a picture grows with the light; None if it plainly does not.

    It grows if, over ranges of intensity, the variance of the flattest places plainly lies on a
    rising line: that of raw pictures of cameras does, whose noise is that of counted photons. The
    line may meet 0 at an intensity above 0: the offset of the camera.

    Parameters
    ----------
    details, intensity : (N,) ndarray
        Local variances and intensities of places that are spread over the picture.
    """
    line = _Line.of(details, intensity)
    return None if line is None or not line.is_plain else line.noise


@dataclass(frozen=True)
class _Line:
    """The variance of the flattest places over the intensity, and how well a line fits it."""

    constant: float
    slope: float
    least: float
    growth: float
    misfit: float
    ranges: int

    @classmethod
    def of(cls, details: Float, intensity: Float) -> _Line | None:
        """Fit a line to ranges of intensity; relative errors count, outliers do not."""
        bins = _ranges_of(intensity)
        if len(bins) < _FEWEST_BINS:
            return None
        floor = np.array([noise_floor(details[places]) for places in bins])
        mean = np.array([intensity[places].mean() for places in bins])
        if floor.min() <= 0:
            return None
        kept = np.ones(len(bins), bool)
        for _ in range(_ROUNDS):
            constant, slope = free_line((mean / floor)[kept], (1 / floor)[kept])
            misfit = np.abs((constant + slope * mean) / floor - 1)
            kept = misfit < _OUTLIERS * (1.4826 * np.median(misfit[kept]) + _LEAST_SHARE)
            if kept.sum() < 2:
                return None
        ends = constant + slope * np.array([mean[kept].min(), mean[kept].max()])
        growth = ends[1] / max(ends[0], _DARK_SHARE * floor.min())
        typical = float(np.median(misfit))
        least = float(floor.min())
        return cls(constant, slope, least, float(growth), typical, int(kept.sum()))

    @property
    def is_plain(self) -> bool:
        """Whether the noise is one that grows with the light, beyond doubt."""
        fits = self.misfit < _LARGEST_MISFIT and self.ranges >= _FEWEST_BINS
        return fits and self.slope > 0 and self.growth > _LEAST_GROWTH

    @property
    def noise(self) -> ShotNoise:
        """The noise that the line says."""
        if self.constant >= 0:
            return ShotNoise(self.constant, self.slope)
        return ShotNoise(_DARK_SHARE * self.least, self.slope, -self.constant / self.slope)


def _ranges_of(intensity: Float) -> list[NDArray[np.intp]]:
    """Return the places of each range of intensity, equally many in each; none of too few."""
    order = np.array_split(np.argsort(intensity, kind="stable"), _INTENSITY_BINS)
    return [places for places in order if len(places) >= _FEWEST_PLACES]


def shot_noise_of(picture: PreparedImage) -> ShotNoise:
    """Find the growth of the noise of a prepared picture, see `estimate_shot_noise`."""
    everywhere = local_variances(picture, FINEST)
    finest = noise_floor(everywhere[0])
    level = picture.intensities.level
    step, compression = quantization_step(picture.luminance, level), 0.0
    if step is not None:
        fine = noise_floor(local_variances(picture, FINE)[0])
        compression = compression_variance(finest, fine, step, level)
    variance = finest + compression
    if variance == 0:
        raise ValueError("image has no noise; its growth with the intensity cannot be found")
    details, intensity = (values[::_EVERY] for values in everywhere)
    plain = None if compression else plain_shot_noise(details, intensity)
    if plain is not None:
        return plain
    bins = _ranges_of(intensity)
    if len(bins) < 2:
        return ShotNoise(variance, 0.0)
    floor = np.array([noise_floor(details[places]) for places in bins])
    floor = np.maximum(floor, _LEAST_SHARE * variance)
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
    a, b = free_line(slope, constant)
    if a >= 0 and b >= 0:
        return a, b
    # The least is where one of them is 0: the one that explains more stays.
    c, s = float(np.sum(constant)), float(np.sum(slope))
    cc, ss = float(np.sum(constant**2)), float(np.sum(slope**2))
    alone = c / cc, max(s, 0.0) / ss if ss > 0 else 0.0
    return (alone[0], 0.0) if c * alone[0] >= s * alone[1] else (0.0, alone[1])
