"""What one run does, from the plane to the result layers: no Qt, any thread."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from napari.types import LayerDataTuple

from napari_defocus.progress import Progress, silent, within
from napari_defocus.settings import (
    COMPARED_PSFS,
    MapSettings,
    MaskSettings,
    check_threshold,
    psf_of,
)
from napari_defocus.widgets.estimation import (
    ESTIMATION_SHARE,
    Picture,
    cut,
    estimated_candidates,
    estimated_map,
)
from napari_defocus.widgets.kept import KeptWork
from napari_defocus.widgets.layers import Plane
from napari_defocus.widgets.result_layers import blur_map_layer, confidence_layer, in_focus_layer
from napari_defocus.widgets.seeds import Seeds

if TYPE_CHECKING:
    from napari_defocus import BlurCandidates, PSFEvidence


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

    def run(self, kept: KeptWork, progress: Progress = silent) -> list[LayerDataTuple]:
        """Return the wanted result layers.

        Parameters
        ----------
        kept : KeptWork
            What earlier runs have found; what this one finds is added.
        progress : callable, optional
            See `napari_defocus.progress`.
        """
        picture = Picture.of(self.plane)
        progress("Reading the picture", 0.0)
        estimating = within(progress, 0.0, ESTIMATION_SHARE)
        candidates = estimated_candidates(picture, self.estimation, kept, estimating)
        steps = [self._map_layers] * self.blur_map + [self._mask_layers] * (self.mask is not None)
        share = (1.0 - ESTIMATION_SHARE) / len(steps)
        starts = [ESTIMATION_SHARE + share * n for n in range(len(steps))]
        return [
            layer
            for step, start in zip(steps, starts, strict=True)
            for layer in step(candidates, picture, kept, within(progress, start, start + share))
        ]

    def _map_layers(
        self, candidates: BlurCandidates, picture: Picture, kept: KeptWork, progress: Progress
    ) -> list[LayerDataTuple]:
        found = estimated_map(picture, self.estimation, kept, progress)
        used = self.estimation, candidates.noise_variance
        # Copies: what somebody paints on a layer is not kept.
        layers = [blur_map_layer(self.plane, found.values.copy(), *used, candidates.psf)]
        if self.confidence:
            confidence = self.plane.counted(found.confidence)
            layers.append(confidence_layer(self.plane, confidence, *used))
        return layers

    def _mask_layers(
        self, candidates: BlurCandidates, picture: Picture, kept: KeptWork, progress: Progress
    ) -> list[LayerDataTuple]:
        from napari_defocus import segment_in_focus

        assert self.mask is not None
        mask = cut(
            segment_in_focus,
            candidates,
            picture,
            threshold=self.mask.threshold,
            smoothness=self.mask.smoothness,
            color_sigma=self.mask.color_sigma,
            seeds=self.seeds.values if self.seeds else None,
            progress=progress,
        )
        used = self.mask, self.estimation, candidates.noise_variance
        name = self.seeds.name if self.seeds else None
        return [in_focus_layer(self.plane, self.plane.counted(mask), *used, name)]


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
        picture = Picture.of(self.plane)
        comparison = compare_psf(
            picture.image,
            list(text_of),
            noise_variance=settings.noise_variance,
            window=settings.window,
            linearize=settings.linearize,
            intensity_range=picture.span,
            progress=progress,
        )
        return [(text_of[row.psf], row) for row in comparison]
