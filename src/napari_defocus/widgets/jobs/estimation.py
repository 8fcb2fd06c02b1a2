"""Candidates and blur map of a plane, cached between runs: no Qt, any thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self, TypeVar
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from napari_defocus import pipeline
from napari_defocus.core.picture_remarks import picture_remarks
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.core.worker_process import run_elsewhere
from napari_defocus.psf import AUTO, left_open
from napari_defocus.settings import MapSettings, MaskSettings, RestorationSettings
from napari_defocus.widgets.jobs.cache import LayerCache, fingerprint
from napari_defocus.widgets.layers.image_layers import Plane

if TYPE_CHECKING:
    from napari_defocus import BlurCandidates, PSFFamily
    from napari_defocus.core.intensity import Intensities
    from napari_defocus.labeling.problem import Ingredients
    from napari_defocus.likelihood.psf_choice import PSFChoice
    from napari_defocus.restoration.all_in_focus import RestorationFit

Float32 = NDArray[np.float32]
T = TypeVar("T")

ESTIMATION_SHARE = 0.6
"""Of the time of a map or a mask; the rest is labelling."""

LARGE = 250_000
"""In px: larger pictures are worked on in another process, as cuts would stop the window."""

LARGEST_RADIUS = 128.0
"""In px: forms let look up to it, and pictures are restored up to it."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A plane that was read.

    Attributes
    ----------
    plane : Plane
    image : (H, W) or (H, W, 3) or (H, W, 4) ndarray
    """

    plane: Plane
    image: NDArray[Any]

    @classmethod
    def of(cls, plane: Plane) -> Self:
        """Read a plane, see `Plane.read`."""
        return cls(plane, plane.read())

    @property
    def is_large(self) -> bool:
        """Whether work on it would stop the window if it were done in a thread."""
        return bool(np.prod(self.image.shape[:2]) > LARGE)

    def call(self, function: Callable[..., T], *args: Any, **keywords: Any) -> T:
        """Call a function of ours: in another process if the picture is large."""
        if self.is_large:
            return run_elsewhere(function, *args, **keywords)
        return function(*args, **keywords)

    @cached_property
    def key(self) -> tuple[Any, ...]:
        """What tells it from other pictures."""
        return (fingerprint(self.image),)

    @cached_property
    def remarks(self) -> list[str]:
        """What it says of itself that makes a map say little."""
        return picture_remarks(self.image, MapSettings.window)

    @cached_property
    def intensities(self) -> Intensities:
        """Which intensities are 0 and 1, as they are found."""
        from napari_defocus.core.image import prepare_image

        return prepare_image(self.image).intensities


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
    intensities : Intensities or None
        What the variance is measured in.
    psf_choice : PSFChoice or None
        How the family was chosen, if the picture was to choose it.
    doubt : str or None
        Why the picture does not look like defocus; None if it may.
    noise_growth : float
        By how much the noise is larger in the corners than in the centre.
    """

    values: Float32
    safe: Float32
    confidence: Float32
    noise_variance: float
    psf: PSFFamily
    intensities: Intensities | None = None
    psf_choice: PSFChoice | None = None
    doubt: str | None = None
    noise_growth: float = 0.0


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
    name : str
        Tells the candidates from all others.
    """

    picture: Picture
    settings: MapSettings
    candidates: BlurCandidates
    blur_map: EstimatedMap | None = None
    name: str = field(default_factory=lambda: uuid4().hex)

    @property
    def is_large(self) -> bool:
        """Whether it is labelled in another process, and a preview is worth it."""
        return self.picture.is_large

    def on_problem(
        self,
        function: Callable[..., Any],
        *,
        channel: str = "",
        progress: Progress = silent,
        **keywords: Any,
    ) -> Any:
        """Call a function of a `LabelingProblem` in another process, which remembers this one.

        Parameters
        ----------
        function : callable
            Of a module of ours.
        channel : str, optional
            See `run_elsewhere`.
        progress : callable, optional
        **keywords
            Of the function.
        """
        from napari_defocus.labeling.problem import UnknownProblemError, with_problem

        def call(ingredients: Ingredients | None) -> Any:
            return run_elsewhere(
                with_problem,
                *(function, self.name, ingredients),
                channel=channel,
                progress=progress,
                **keywords,
            )

        try:
            return call(None)
        except UnknownProblemError:
            return call((self.candidates, self.picture.image, None))


class JobCache:
    """What all widgets have found, and use again: none does what another has done.

    Attributes
    ----------
    maps : LayerCache of EstimatedMap
    restored : LayerCache of float32 ndarray
        All-in-focus pictures.
    analysed : LayerCache of Analysed
        The candidates, and all else that is known of the plane that was analysed last.
    """

    def __init__(self) -> None:
        self.maps: LayerCache[EstimatedMap] = LayerCache()
        self.restored: LayerCache[tuple[NDArray[np.float32], RestorationFit]] = LayerCache()
        self.analysed: LayerCache[Analysed] = LayerCache()


def analysed_picture(
    picture: Picture, settings: MapSettings, cache: JobCache, progress: Progress
) -> Analysed:
    """Return the candidates of a picture: those of an earlier run, if nothing has changed."""
    layer, key = picture.plane.layer, _candidates_key(picture, settings)
    found = cache.analysed.known(layer, key)
    if found is None:
        found = Analysed(picture, settings, _candidates(picture, settings, progress))
        _ = picture.remarks  # here, not where they are said: that would stop the window
        cache.analysed.put(layer(), key, found)
    return found


def _candidates(picture: Picture, settings: MapSettings, progress: Progress) -> BlurCandidates:
    return picture.call(pipeline.measure_candidates, picture.image, settings, progress=progress)


def weights_of(settings: MapSettings) -> dict[str, Any]:
    """Return what labels candidates, as keywords of `label_blur_map`."""
    return {"smoothness": settings.smoothness, "color_sigma": settings.color_sigma}


def same_candidates(first: MapSettings, second: MapSettings) -> bool:
    """Tell whether settings differ at most in what labels candidates."""
    alike = replace(first, **weights_of(second))
    return alike == second and first.family() == second.family()


def _candidates_key(picture: Picture, settings: MapSettings) -> tuple[Any, ...]:
    """Return all that candidates depend on."""
    return (
        *(*picture.key, settings.noise_variance, settings.shot_noise, settings.family()),
        *(
            settings.window,
            settings.stride,
            settings.mode,
            settings.linearize,
            settings.camera_softness,
        ),
    )


def estimated_map(
    picture: Picture, settings: MapSettings, cache: JobCache, progress: Progress
) -> EstimatedMap:
    """Return the blur map of a picture: that of an earlier run, if nothing has changed."""
    layer, candidates_key = picture.plane.layer, _candidates_key(picture, settings)

    def estimate() -> EstimatedMap:
        share = 0.0 if cache.analysed.known(layer, candidates_key) else ESTIMATION_SHARE
        analysed = analysed_picture(picture, settings, cache, within(progress, 0.0, share))
        return _labelled_map(analysed, settings, within(progress, share, 1.0))

    found = cache.maps.get(layer, _key(picture, settings), estimate)
    analysed = cache.analysed.known(layer, candidates_key)
    if analysed is not None:
        analysed = replace(analysed, settings=settings, blur_map=found)
        cache.analysed.put(layer(), candidates_key, analysed)
    return found


def _labelled_map(analysed: Analysed, settings: MapSettings, progress: Progress) -> EstimatedMap:
    candidates, picture = analysed.candidates, analysed.picture
    if analysed.is_large:
        from napari_defocus.labeling.blur_map import labeled_blur_map
        from napari_defocus.labeling.confidence import confidence_of_problem

        labeling, judging = within(progress, 0.0, 0.8), within(progress, 0.8, 1.0)
        values = analysed.on_problem(labeled_blur_map, settings=settings, progress=labeling)
        sure, safe = analysed.on_problem(confidence_of_problem, blur_map=values, progress=judging)
    else:
        found = pipeline.label_map(candidates, picture.image, settings, progress=progress)
        values, sure = found.blur_map, found.confidence
        safe = found.cautious(RestorationSettings.risk)
    used = candidates.noise_variance, candidates.psf, candidates.intensities, candidates.psf_choice
    return EstimatedMap(values, safe, sure, *used, candidates.doubt, candidates.noise_growth)


def known_map(picture: Picture, settings: MapSettings, cache: JobCache) -> EstimatedMap | None:
    """Return the blur map of a picture if an earlier run has estimated it."""
    found = cache.maps.known(picture.plane.layer, _key(picture, settings))
    if found is not None:
        return found
    # Its layer says the lens that the picture has chosen.
    asked = replace(settings, psf=left_open(settings.psf))
    chosen = cache.maps.known(picture.plane.layer, _key(picture, asked))
    return chosen if chosen is not None and asked.settled(chosen.psf) == settings else None


def _key(picture: Picture, settings: MapSettings) -> tuple[Any, ...]:
    return *picture.key, settings, settings.family()


def segmented(
    analysed: Analysed,
    settings: MaskSettings,
    seeds: NDArray[np.integer] | None,
    progress: Progress,
) -> NDArray[np.uint8]:
    """Return the in-focus mask of a plane, see `napari_defocus.segment_in_focus`."""
    given: dict[str, Any] = {"seeds": seeds, "progress": progress}
    if analysed.is_large:
        from napari_defocus.labeling.segmentation import labeled_mask

        return analysed.on_problem(labeled_mask, settings=settings, **given)
    candidates, image = analysed.candidates, analysed.picture.image
    return pipeline.segment(candidates, image, settings, **given)


def settled_mask(analysed: Analysed, settings: MaskSettings, channel: str = "") -> MaskSettings:
    """Return the settings with the threshold that the plane says, if it was to say it."""
    inside = analysed.picture.plane.inside
    if settings.threshold != AUTO or not analysed.is_large:
        image = analysed.picture.image
        return pipeline.settled_mask(analysed.candidates, image, settings, within=inside)
    from napari_defocus.labeling.focus_threshold import focus_threshold_of

    found = analysed.on_problem(focus_threshold_of, within=inside, channel=channel)
    return replace(settings, threshold=found)
