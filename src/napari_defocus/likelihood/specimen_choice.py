"""Whether a microscope's picture shows points or things with edges, by its fine details."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from napari_defocus.core.image import PreparedImage
from napari_defocus.likelihood.averaged_pixels import halved_without, level_count
from napari_defocus.likelihood.exact_spectra import domain_of_window
from napari_defocus.likelihood.local_noise import LocalNoise
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.likelihood.window_evidence import LARGEST_LOSS, Windows, family_fit, spacing
from napari_defocus.psf import SPECIMENS
from napari_defocus.psf.domain import seen_with_pixels
from napari_defocus.psf.microscope import Microscope

_TEXTURED = 20.0
"""Units of log-likelihood that the likeliest radius of a window that counts is above the least
likely one."""


def specimen_margin(
    pictures: Sequence[PreparedImage],
    lens: Microscope,
    noise: float | ShotNoise | LocalNoise | None,
    window: int,
    camera_softness: float,
) -> tuple[float, int]:
    """Return by how much points explain pictures better than texture, and how many windows say it.

    In units of log-likelihood, the mean of the windows of a level, and then of the levels. Those of
    averaged pixels are asked, as far as a picture has any: at the finest one, a little blur and
    edges are nearly what more blur and points are (docs/decisions.md). No softer scenes are tried,
    as edges are softer points.
    """
    gains: dict[int, list[float]] = {}
    for picture in pictures:
        for level, windows in _levels(picture, lens, noise, window, len(pictures)):
            gains.setdefault(level, []).extend(_gains(windows, lens, 2**level, camera_softness))
    told = [each for each in gains.values() if each]
    if not told:
        return 0.0, 0
    return float(np.mean([np.mean(each) for each in told])), sum(map(len, told))


def _levels(
    picture: PreparedImage,
    lens: Microscope,
    noise: float | ShotNoise | LocalNoise | None,
    window: int,
    pictures: int,
) -> Iterator[tuple[int, Windows]]:
    """Yield the windows of each level that is asked; of the finest one if there is no other."""
    count = level_count(picture.shape, window, lens.max_scale)
    found = LocalNoise.of(picture, noise)
    for level in range(count):
        if level or count == 1:
            yield level, Windows.of(picture, found, window, spacing(picture, window, pictures))
        picture, _ = halved_without(picture, np.zeros(picture.shape, bool))
        found = found.halved().reduced(0.25)


def _gains(
    windows: Windows, lens: Microscope, side: int, camera_softness: float
) -> Sequence[float]:
    """Return by how much points explain each textured window better than texture."""
    domain = domain_of_window(windows.window)
    seen = [
        seen_with_pixels(replace(lens, specimen=each), side, domain)  # type: ignore[arg-type]
        for each in SPECIMENS
    ]
    texture, points = (family_fit([windows], each, camera_softness, softer=()) for each in seen)
    textured = np.maximum(texture.depth, points.depth) > _TEXTURED
    gain = points.evidence - texture.evidence
    return np.clip(gain[textured], -LARGEST_LOSS, LARGEST_LOSS).tolist()
