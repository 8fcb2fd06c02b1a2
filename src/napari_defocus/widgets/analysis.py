"""What one run does, from the plane to the result layers: no Qt, any thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.other_process import run_elsewhere
from napari_defocus.progress import Progress, silent, within
from napari_defocus.settings import (
    COMPARED_PSFS,
    MapSettings,
    MaskSettings,
    check_threshold,
    psf_of,
)
from napari_defocus.widgets.kept_candidates import KeptCandidates, fingerprint
from napari_defocus.widgets.layers import Plane
from napari_defocus.widgets.result_layers import blur_map_layer, confidence_layer, in_focus_layer
from napari_defocus.widgets.seeds import Seeds

if TYPE_CHECKING:
    from napari_defocus import BlurCandidates, PSFEvidence, ShotNoise

ESTIMATION_SHARE = 0.6
"""Of the time of a run; the rest is labelling."""

LARGE = 1_000_000
"""In px: larger pictures are labelled in another process, as cuts would stop the window."""


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """What is wanted of a plane.

    Attributes
    ----------
    plane : Plane
    estimation : MapSettings
        What the candidates are estimated with, and the map labelled.
    mask : MaskSettings or None
        What is segmented with; None for no mask.
    seeds : Seeds or None
        What the mask keeps to.
    blur_map : bool
        Whether a blur map is wanted.
    confidence : bool
        Whether the blur map's confidence is wanted too.
    """

    plane: Plane
    estimation: MapSettings
    mask: MaskSettings | None = None
    seeds: Seeds | None = None
    blur_map: bool = True
    confidence: bool = True

    def __post_init__(self) -> None:
        """Refuse impossible settings before any work is done with them."""
        family = self.estimation.family()
        if self.mask is not None:
            check_threshold(self.mask.threshold, family.max_scale)

    def run(self, kept: KeptCandidates, progress: Progress = silent) -> list[LayerDataTuple]:
        """Return the wanted result layers.

        Parameters
        ----------
        kept : KeptCandidates
            Candidates of earlier runs; those of this one are added.
        progress : callable, optional
            See `napari_defocus.progress`.
        """
        image = self.plane.read()
        span = self.plane.intensity_range(image)
        progress("Reading the picture", 0.0)
        candidates = self._candidates(image, span, kept, within(progress, 0.0, ESTIMATION_SHARE))
        steps = [self._map_layers] * self.blur_map + [self._mask_layers] * (self.mask is not None)
        share = (1.0 - ESTIMATION_SHARE) / len(steps)
        starts = [ESTIMATION_SHARE + share * n for n in range(len(steps))]
        return [
            layer
            for step, start in zip(steps, starts, strict=True)
            for layer in step(candidates, image, span, within(progress, start, start + share))
        ]

    def _candidates(
        self,
        image: NDArray[Any],
        span: tuple[float, float] | None,
        kept: KeptCandidates,
        progress: Progress,
    ) -> BlurCandidates:
        from napari_defocus import estimate_candidates, estimate_shot_noise

        estimation = self.estimation
        common: dict[str, Any] = {"linearize": estimation.linearize, "intensity_range": span}
        family = estimation.family()
        key = (
            *(fingerprint(image), estimation.noise_variance, estimation.shot_noise, family),
            *(estimation.window, estimation.stride, estimation.mode, *common.values()),
        )

        def estimate() -> BlurCandidates:
            noise: float | ShotNoise | None = estimation.noise_variance
            if estimation.shot_noise:
                progress("Measuring the noise", 0.0)
                noise = estimate_shot_noise(image, **common)
            return estimate_candidates(
                image,
                psf=family,
                noise_variance=noise,
                window=estimation.window,
                stride=estimation.stride,
                mode=estimation.mode,
                **common,
                progress=progress,
            )

        return kept.get(self.plane.layer, key, estimate)

    def _map_layers(
        self,
        candidates: BlurCandidates,
        image: NDArray[Any],
        span: tuple[float, float] | None,
        progress: Progress,
    ) -> list[LayerDataTuple]:
        from napari_defocus import confidence_map, label_blur_map

        blur_map = _cut(
            label_blur_map,
            candidates,
            image,
            smoothness=self.estimation.smoothness,
            color_sigma=self.estimation.color_sigma,
            intensity_range=span,
            progress=progress,
        )
        used = self.estimation, candidates.noise_variance
        layers = [blur_map_layer(self.plane, blur_map, *used, candidates.psf)]
        if self.confidence:
            progress("Measuring the confidence", 1.0)
            layers.append(confidence_layer(self.plane, confidence_map(candidates, blur_map), *used))
        return layers

    def _mask_layers(
        self,
        candidates: BlurCandidates,
        image: NDArray[Any],
        span: tuple[float, float] | None,
        progress: Progress,
    ) -> list[LayerDataTuple]:
        from napari_defocus import segment_in_focus

        assert self.mask is not None
        mask = _cut(
            segment_in_focus,
            candidates,
            image,
            threshold=self.mask.threshold,
            smoothness=self.mask.smoothness,
            color_sigma=self.mask.color_sigma,
            seeds=self.seeds.values if self.seeds else None,
            intensity_range=span,
            progress=progress,
        )
        used = self.mask, self.estimation, candidates.noise_variance
        name = self.seeds.name if self.seeds else None
        return [in_focus_layer(self.plane, mask, *used, name)]


def _cut(
    function: Callable[..., NDArray[Any]],
    candidates: BlurCandidates,
    image: NDArray[Any],
    **keywords: Any,
) -> NDArray[Any]:
    """Call a function that cuts graphs: in this thread if the picture is small."""
    if image.shape[0] * image.shape[1] > LARGE:
        return run_elsewhere(function, candidates, image, **keywords)
    return function(candidates, image, **keywords)


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Which lens fits a plane.

    Attributes
    ----------
    plane : Plane
    estimation : MapSettings
        Its lens is compared with `COMPARED_PSFS`.
    """

    plane: Plane
    estimation: MapSettings

    def run(self, progress: Progress = silent) -> list[tuple[str, PSFEvidence]]:
        """Return the lenses as text, and their evidence, the best first."""
        from napari_defocus import compare_psf

        settings = self.estimation
        texts = dict.fromkeys([*COMPARED_PSFS, settings.psf])
        text_of = {psf_of(text, settings.max_radius): text for text in texts}
        image = self.plane.read()
        comparison = compare_psf(
            image,
            list(text_of),
            noise_variance=settings.noise_variance,
            window=settings.window,
            linearize=settings.linearize,
            intensity_range=self.plane.intensity_range(image),
            progress=progress,
        )
        return [(text_of[row.psf], row) for row in comparison]
