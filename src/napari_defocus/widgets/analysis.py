"""What one run does, from the plane to the result layers: no Qt, any thread."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.progress import Progress, silent, within
from napari_defocus.settings import MapSettings, MaskSettings, check_threshold
from napari_defocus.widgets.kept_candidates import KeptCandidates, fingerprint
from napari_defocus.widgets.layers import Plane, blur_map_layer, in_focus_layer

if TYPE_CHECKING:
    from napari_defocus import BlurCandidates

ESTIMATION_SHARE = 0.6
"""Of the time of a run; the rest is labelling."""


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
    blur_map : bool
        Whether a blur map is wanted.
    """

    plane: Plane
    estimation: MapSettings
    mask: MaskSettings | None = None
    blur_map: bool = True

    def __post_init__(self) -> None:
        """Refuse impossible settings before any work is done with them."""
        if self.mask is not None:
            check_threshold(self.mask.threshold, self.estimation.max_radius)

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
        steps = [self._map_layer] * self.blur_map + [self._mask_layer] * (self.mask is not None)
        share = (1.0 - ESTIMATION_SHARE) / len(steps)
        starts = [ESTIMATION_SHARE + share * n for n in range(len(steps))]
        return [
            step(candidates, image, span, within(progress, start, start + share))
            for step, start in zip(steps, starts, strict=True)
        ]

    def _candidates(
        self,
        image: NDArray[Any],
        span: tuple[float, float] | None,
        kept: KeptCandidates,
        progress: Progress,
    ) -> BlurCandidates:
        from napari_defocus import Disc, estimate_candidates

        arguments: dict[str, Any] = {
            "psf": Disc(self.estimation.max_radius),
            "noise_variance": self.estimation.noise_variance,
            "window": self.estimation.window,
            "stride": self.estimation.stride,
            "mode": self.estimation.mode,
            "intensity_range": span,
        }

        def estimate() -> BlurCandidates:
            return estimate_candidates(image, **arguments, progress=progress)

        return kept.get(self.plane.layer, (fingerprint(image), *arguments.values()), estimate)

    def _map_layer(
        self,
        candidates: BlurCandidates,
        image: NDArray[Any],
        span: tuple[float, float] | None,
        progress: Progress,
    ) -> LayerDataTuple:
        from napari_defocus import label_blur_map

        blur_map = label_blur_map(
            candidates,
            image,
            smoothness=self.estimation.smoothness,
            color_sigma=self.estimation.color_sigma,
            intensity_range=span,
            progress=progress,
        )
        return blur_map_layer(self.plane, blur_map, self.estimation, candidates.noise_variance)

    def _mask_layer(
        self,
        candidates: BlurCandidates,
        image: NDArray[Any],
        span: tuple[float, float] | None,
        progress: Progress,
    ) -> LayerDataTuple:
        from napari_defocus import segment_in_focus

        assert self.mask is not None
        mask = segment_in_focus(
            candidates,
            image,
            threshold=self.mask.threshold,
            smoothness=self.mask.smoothness,
            color_sigma=self.mask.color_sigma,
            intensity_range=span,
            progress=progress,
        )
        return in_focus_layer(
            self.plane, mask, self.mask, self.estimation, candidates.noise_variance
        )
