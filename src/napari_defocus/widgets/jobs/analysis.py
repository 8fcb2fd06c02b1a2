"""What one run does, from the plane to the result layers: no Qt, any thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.core.checks import check_threshold_or_auto
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.psf import AUTO
from napari_defocus.psf.microscope import Microscope
from napari_defocus.psf.parsing import psf_of
from napari_defocus.settings import COMPARED_PSFS, MapSettings, MaskSettings
from napari_defocus.widgets.jobs.estimation import (
    ESTIMATION_SHARE,
    Analysed,
    JobCache,
    Picture,
    analysed_picture,
    estimated_map,
    same_candidates,
    segmented,
    settled_mask,
)
from napari_defocus.widgets.jobs.map_source import layers_of_map
from napari_defocus.widgets.layers.image_layers import Plane
from napari_defocus.widgets.layers.result_layers import (
    blur_map_layer,
    defocus_layer,
    in_focus_layer,
)
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    IN_FOCUS,
    METADATA_KEY,
    say_doubt,
    say_lens,
    say_noise_growth,
)
from napari_defocus.widgets.layers.seeds import Seeds

if TYPE_CHECKING:
    from napari_defocus import PSFEvidence
    from napari_defocus.psf.families import PSFFamily

Preview = Callable[[list[LayerDataTuple]], None]


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """Which results are wanted of a plane, or of several, and what makes them.

    Attributes
    ----------
    plane : Plane
    estimation : MapSettings
        What the candidates are estimated with, and the map labelled.
    mask : MaskSettings or None
        What is segmented with; None for no mask.
    blur_map : bool
        Whether a blur map is wanted.
    confidence : bool
        Whether the blur map's confidence is wanted too.
    """

    plane: Plane
    estimation: MapSettings
    mask: MaskSettings | None = None
    blur_map: bool = True
    confidence: bool = True

    def __post_init__(self) -> None:
        """Refuse impossible settings before any work is done with them."""
        family = self.estimation.family()
        if self.mask is not None:
            check_threshold_or_auto(self.mask.threshold, self._largest_looked_for(family))

    def _largest_looked_for(self, family: PSFFamily) -> float:
        """Return the largest scale, in px, that a picture of this size is searched up to."""
        from napari_defocus.likelihood.estimation import Estimation

        settings = self.estimation
        how = Estimation(family, settings.window, settings.stride, settings.mode)
        return how.for_shape(self.plane.shape).psf.max_scale

    @property
    def dtypes(self) -> dict[str, type]:
        """The dtypes of the wanted results, by what `result_metadata` calls these."""
        wanted: dict[str, type] = {BLUR_MAP: np.float32} if self.blur_map else {}
        if self.blur_map and self.confidence:
            wanted[CONFIDENCE] = np.float32
        return wanted | ({IN_FOCUS: np.uint8} if self.mask is not None else {})


@dataclass(frozen=True, kw_only=True)
class Analysis(Wanted):
    """What is wanted of one plane.

    Attributes
    ----------
    seeds : Seeds or None
        What the mask keeps to.
    """

    seeds: Seeds | None = None

    def run(
        self, cache: JobCache, progress: Progress = silent, preview: Preview | None = None
    ) -> list[LayerDataTuple]:
        """Return the wanted result layers.

        Parameters
        ----------
        cache, progress
            See `Job.run`.
        preview : callable, optional
            Called with `preview` of a large picture as soon as there is one.
        """
        progress("Reading the picture", 0.0)
        picture = Picture.of(self.plane)
        estimating = within(progress, 0.0, ESTIMATION_SHARE)
        analysed = analysed_picture(picture, self.estimation, cache, estimating)
        if preview is not None and analysed.is_large:
            there = within(progress, ESTIMATION_SHARE, ESTIMATION_SHARE)
            preview(self.preview(analysed, there))
        return self.labelled(analysed, cache, within(progress, ESTIMATION_SHARE, 1.0))

    def labelled(
        self, analysed: Analysed, cache: JobCache, progress: Progress = silent
    ) -> list[LayerDataTuple]:
        """Return the wanted result layers of a plane whose candidates are known."""
        steps = [self._map_layers] * self.blur_map + [self._mask_layers] * (self.mask is not None)
        return [
            layer
            for n, step in enumerate(steps)
            for layer in step(
                analysed, cache, within(progress, n / len(steps), (n + 1) / len(steps))
            )
        ]

    def fits(self, analysed: Analysed) -> bool:
        """Tell whether candidates are those of this plane and these settings."""
        same = same_candidates(analysed.settings, self.estimation)
        return self.plane == analysed.picture.plane and same

    def preview(
        self, analysed: Analysed, progress: Progress = silent, channel: str = ""
    ) -> list[LayerDataTuple]:
        """Return the wanted layers of a large picture at once, without their fine details.

        There is no confidence among them. For `channel` see `run_elsewhere`.
        """
        from napari_defocus.labeling.blur_map import preview_of_blur_map
        from napari_defocus.labeling.segmentation import labeled_mask

        layers = []
        common: dict[str, Any] = {"channel": channel, "progress": progress}
        if self.blur_map:
            settings = self.estimation.settled(analysed.candidates.psf)
            values = analysed.on_problem(preview_of_blur_map, settings=settings, **common)
            found = analysed.candidates
            made = settings, found.noise_variance, found.psf, found.intensities
            layers.append(blur_map_layer(self.plane, values, *made))
        if self.mask is not None:
            used = settled_mask(analysed, self.mask, channel)
            common |= {"settings": used, "seeds": self._seeds, "preview": True}
            mask = analysed.on_problem(labeled_mask, **common)
            layers.append(self._mask_layer(analysed, mask, used))
        for _, keywords, _ in layers:
            keywords["metadata"][METADATA_KEY]["preview"] = True
        return layers

    @property
    def _seeds(self) -> NDArray[np.integer] | None:
        return self.seeds.values if self.seeds else None

    def _map_layers(
        self, analysed: Analysed, cache: JobCache, progress: Progress
    ) -> list[LayerDataTuple]:
        found = estimated_map(analysed.picture, self.estimation, cache, progress)
        blur_map, confidence = layers_of_map(self.plane, self.estimation, found)
        layers = [blur_map]
        if isinstance(found.psf, Microscope):
            layers.append(defocus_layer(blur_map, found.psf))
        return [*layers, confidence] if self.confidence else layers

    def _mask_layers(
        self, analysed: Analysed, cache: JobCache, progress: Progress
    ) -> list[LayerDataTuple]:
        assert self.mask is not None
        used = settled_mask(analysed, self.mask)
        return [self._mask_layer(analysed, segmented(analysed, used, self._seeds, progress), used)]

    def _mask_layer(
        self, analysed: Analysed, mask: NDArray[np.uint8], settled: MaskSettings
    ) -> LayerDataTuple:
        found = self.mask != settled
        candidates, seeds = analysed.candidates, self.seeds.name if self.seeds else None
        settings = self.estimation.settled(candidates.psf)
        used = settled, settings, candidates.noise_variance, seeds, candidates.intensities
        counted = self.plane.counted(mask)
        layer = in_focus_layer(self.plane, counted, *used, threshold_found=found)
        layers = say_noise_growth([layer], candidates.noise_growth)
        return say_doubt(say_lens(layers, candidates.psf_choice), candidates.doubt)[0]


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
        texts.pop(AUTO, None)
        text_of = {psf_of(text, settings.max_radius): text for text in texts}
        picture = Picture.of(self.plane)
        comparison = picture.call(
            compare_psf,
            picture.image,
            list(text_of),
            noise_variance=settings.noise_variance,
            window=settings.window,
            camera_softness=settings.camera_softness,
            linearize=settings.linearize,
            progress=progress,
        )
        return [(text_of[row.psf], row) for row in comparison]
