"""The noise of a picture wherever it is looked at: even, growing with the light or outwards."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.image import PreparedImage
from napari_defocus.likelihood.analysis_grid import AnalysisGrid
from napari_defocus.likelihood.noise import (
    NoiseSample,
    looks_like_jpeg,
    noise_variance_with_growth,
    places_of_samples,
)
from napari_defocus.likelihood.noise_shading import NoiseShading
from napari_defocus.likelihood.shot_noise import ShotNoise, plain_shot_noise

Float32 = NDArray[np.float32]

_TINY = 1e-12
"""The least noise variance that is divided by, for a contrast of 1: that of `SILENCE`."""

_ROUNDS = 3
"""Times that growth with the light and outwards are found, each without the other."""


@dataclass(frozen=True)
class LocalNoise:
    """The noise of a picture, or of a part of it.

    Attributes
    ----------
    variance : float
        Of the luminance, intensities in [0, 1]. With `shot_noise`, the mean over the whole picture;
        with `shading`, that of the centre.
    shot_noise : ShotNoise or None
        How it grows with the light.
    shading : NoiseShading or None
        How it grows with the distance from the centre: by a factor, if it has both.
    """

    variance: float
    shot_noise: ShotNoise | None = None
    shading: NoiseShading | None = None

    @classmethod
    def of(cls, picture: PreparedImage, given: float | ShotNoise | LocalNoise | None) -> LocalNoise:
        """Return the noise of a prepared picture, which is found if it is not given."""
        if isinstance(given, LocalNoise):
            return given
        growth = 0.0
        if given is None:
            given, growth = noise_of_samples([NoiseSample.of(picture)])
        shading = NoiseShading.over(picture.shape, growth)
        if isinstance(given, ShotNoise):
            mean = float(given.variance_at(picture.luminance).mean())
            return cls(mean, given, shading)
        return cls(float(given), None, shading)

    @property
    def growth(self) -> float:
        """By how much it is larger in the corners, as a share of the centre's."""
        return 0.0 if self.shading is None else self.shading.growth

    def reduced(self, share: float) -> LocalNoise:
        """Return noise whose variance is a share of this one's."""
        shot = self.shot_noise and self.shot_noise.reduced(share)
        return replace(self, variance=share * self.variance, shot_noise=shot)

    def seen_from(self, row: int, column: int) -> LocalNoise:
        """Return the noise of a part of the picture that starts at a row and column."""
        return replace(self, shading=self.shading and self.shading.seen_from(row, column))

    def halved(self) -> LocalNoise:
        """Return the same noise for pixels that are twice as wide; it is not `reduced`."""
        return replace(self, shading=self.shading and self.shading.halved())

    def of_pixels(self, picture: PreparedImage) -> float | NDArray[np.floating]:
        """Return the variance at each pixel of a picture, (H, W), or one for all."""
        variance: float | NDArray[np.floating] = max(self.variance, picture.rounding_variance)
        if self.shot_noise is not None:
            variance = self.shot_noise.variance_at(picture.luminance)
        if self.shading is not None:
            variance = variance * self.shading.relative_over(picture.shape)
        return variance

    def relative_to_windows(
        self, picture: PreparedImage, grid: AnalysisGrid, pad: tuple[int, int], window: int
    ) -> Float32 | None:
        """Return how many times noisier than `variance` windows are: (r, c); None if all alike.

        `pad` is how far the grid's places are from the picture's, in px.
        """
        noisier = None
        if self.shot_noise is not None:
            least = _TINY * picture.intensities.unit**2
            relative = self.shot_noise.variance_at(picture.luminance) / max(self.variance, least)
            noisier = grid.mean_over_windows(relative, pad, window)
        if self.shading is not None:
            # A window's mean: what is curved over its width is far below the noise of an estimate.
            rows, columns = (
                np.clip(centers - extra, 0, length - 1)
                for centers, extra, length in zip(
                    (grid.rows, grid.columns), pad, picture.shape, strict=True
                )
            )
            shaded = self.shading.relative(rows, columns)
            noisier = shaded if noisier is None else noisier * shaded
        return None if noisier is None else np.maximum(noisier, np.float32(_TINY))


def noise_of_samples(samples: list[NoiseSample]) -> tuple[float | ShotNoise, float]:
    """Find the noise of a picture from pieces of it, and by how much it grows to the corners.

    See `plain_shot_noise` for noise that grows with the light, and `NoisePlaces.growth_of` for the
    growth, which is 0 if none is plain. The noise is then that of the centre.
    """
    places = places_of_samples(samples)
    if looks_like_jpeg(samples):
        return noise_variance_with_growth(samples, places.growth), places.growth
    details = np.concatenate([sample.finest for sample in samples])
    intensity = np.concatenate([sample.intensity for sample in samples])
    shot = plain_shot_noise(details, intensity)
    if shot is None:
        return noise_variance_with_growth(samples, places.growth), places.growth
    growth = 0.0
    for _ in range(_ROUNDS):
        growth = places.growth_of(places.finest / shot.variance_at(places.intensity))
        if growth == 0:
            break
        flat = places.flattened(growth)
        shot = plain_shot_noise(flat.finest, flat.intensity) or shot
    return shot, growth
