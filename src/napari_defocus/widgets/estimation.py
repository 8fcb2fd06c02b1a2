"""Candidates and blur map of a plane, kept between runs: no Qt, any thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from napari_defocus.other_process import run_elsewhere
from napari_defocus.progress import Progress, within
from napari_defocus.settings import MapSettings
from napari_defocus.widgets.kept import KeptWork, fingerprint
from napari_defocus.widgets.layers import Plane

if TYPE_CHECKING:
    from napari_defocus import BlurCandidates, PSFFamily, ShotNoise

Float32 = NDArray[np.float32]

ESTIMATION_SHARE = 0.6
"""Of the time of a map or a mask; the rest is labelling."""

LARGE = 1_000_000
"""In px: larger pictures are labelled in another process, as cuts would stop the window."""

LARGEST_RADIUS = 20.0
"""In px: forms let look up to it, and pictures are restored up to it."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A plane that was read.

    Attributes
    ----------
    plane : Plane
    image : (H, W) or (H, W, 3) or (H, W, 4) ndarray
    span : (float, float) or None
        The intensities that stand for 0 and 1, see `Plane.intensity_range`.
    """

    plane: Plane
    image: NDArray[Any]
    span: tuple[float, float] | None

    @classmethod
    def of(cls, plane: Plane) -> Self:
        """Read a plane, see `Plane.read`."""
        image = plane.read()
        return cls(plane, image, plane.intensity_range(image))

    @cached_property
    def key(self) -> tuple[Any, ...]:
        """What tells it from other pictures."""
        return fingerprint(self.image), self.span


@dataclass(frozen=True, eq=False)
class EstimatedMap:
    """A blur map with its confidence.

    Attributes
    ----------
    values : (H, W) float32 ndarray
        Scale in px.
    safe : (H, W) float32 ndarray
        How much of it is safe to take away, in px.
    confidence : (H, W) float32 ndarray
        In [0, 1].
    noise_variance : float
        The variance that was used, found or given.
    psf : PSFFamily
    """

    values: Float32
    safe: Float32
    confidence: Float32
    noise_variance: float
    psf: PSFFamily


@dataclass(frozen=True, eq=False)
class Analysed:
    """What is known of a plane.

    Attributes
    ----------
    picture : Picture
    settings : MapSettings
        What it was estimated with.
    candidates : BlurCandidates
    blur_map : EstimatedMap or None
        None if none was made yet with these settings.
    """

    picture: Picture
    settings: MapSettings
    candidates: BlurCandidates
    blur_map: EstimatedMap | None = None


def estimated_candidates(
    picture: Picture, settings: MapSettings, kept: KeptWork, progress: Progress
) -> BlurCandidates:
    """Return the candidates of a picture: those of an earlier run, if nothing has changed."""
    from napari_defocus import estimate_candidates, estimate_shot_noise

    common: dict[str, Any] = {"linearize": settings.linearize, "intensity_range": picture.span}
    family = settings.family()

    def estimate() -> BlurCandidates:
        noise: float | ShotNoise | None = settings.noise_variance
        if settings.shot_noise:
            progress("Measuring the noise", 0.0)
            noise = estimate_shot_noise(picture.image, **common)
        return estimate_candidates(
            picture.image,
            psf=family,
            noise_variance=noise,
            window=settings.window,
            stride=settings.stride,
            mode=settings.mode,
            **common,
            progress=progress,
        )

    layer, key = picture.plane.layer, _candidates_key(picture, settings)
    candidates = kept.candidates.get(layer, key, estimate)
    if kept.analysed.known(layer, key) is None:
        kept.analysed.keep(layer(), key, Analysed(picture, settings, candidates))
    return candidates


def _candidates_key(picture: Picture, settings: MapSettings) -> tuple[Any, ...]:
    """Return all that candidates depend on."""
    return (
        *(*picture.key, settings.noise_variance, settings.shot_noise, settings.family()),
        *(settings.window, settings.stride, settings.mode, settings.linearize),
    )


def labelled_map(
    candidates: BlurCandidates, picture: Picture, settings: MapSettings, progress: Progress
) -> Float32:
    """Return the blur map of candidates."""
    from napari_defocus import label_blur_map

    return cut(
        label_blur_map,
        candidates,
        picture,
        smoothness=settings.smoothness,
        color_sigma=settings.color_sigma,
        progress=progress,
    )


def estimated_map(
    picture: Picture, settings: MapSettings, kept: KeptWork, progress: Progress
) -> EstimatedMap:
    """Return the blur map of a picture: that of an earlier run, if nothing has changed."""
    from napari_defocus import cautious_blur_map, confidence_map

    layer = picture.plane.layer

    def estimate() -> EstimatedMap:
        known = kept.candidates.known(layer, _candidates_key(picture, settings))
        share = 0.0 if known else ESTIMATION_SHARE
        estimating = within(progress, 0.0, share)
        candidates = estimated_candidates(picture, settings, kept, estimating)
        labelling = within(progress, share, 1.0)
        values = labelled_map(candidates, picture, settings, labelling)
        progress("Measuring the confidence", 1.0)
        confidence = confidence_map(candidates, values)
        safe = cautious_blur_map(candidates, values)
        return EstimatedMap(values, safe, confidence, candidates.noise_variance, candidates.psf)

    found = kept.maps.get(layer, _key(picture, settings), estimate)
    key = _candidates_key(picture, settings)
    candidates = kept.candidates.known(layer, key)
    if candidates is not None:
        kept.analysed.keep(layer(), key, Analysed(picture, settings, candidates, found))
    return found


def known_map(picture: Picture, settings: MapSettings, kept: KeptWork) -> EstimatedMap | None:
    """Return the blur map of a picture if an earlier run has estimated it."""
    return kept.maps.known(picture.plane.layer, _key(picture, settings))


def _key(picture: Picture, settings: MapSettings) -> tuple[Any, ...]:
    return *picture.key, settings, settings.family()


def cut(
    function: Callable[..., NDArray[Any]],
    candidates: BlurCandidates,
    picture: Picture,
    **keywords: Any,
) -> NDArray[Any]:
    """Call a function that cuts graphs: in this thread if the picture is small."""
    keywords["intensity_range"] = picture.span
    if np.prod(picture.image.shape[:2]) > LARGE:
        return run_elsewhere(function, candidates, picture.image, **keywords)
    return function(candidates, picture.image, **keywords)
