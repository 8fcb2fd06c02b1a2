"""What one run does with planes that are too large for memory: no Qt, any thread."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from napari.layers import Labels
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.core.intensity import Intensities
from napari_defocus.core.progress import Progress, silent
from napari_defocus.core.worker_process import run_elsewhere
from napari_defocus.io.lazy_arrays import Carried
from napari_defocus.io.ome_zarr_writer import OmeZarrWriter
from napari_defocus.pipeline import measure_candidates
from napari_defocus.psf import is_left_open
from napari_defocus.settings import CONFIDENT
from napari_defocus.widgets.jobs.analysis import Wanted
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.tiled_job import TiledJob, as_dask, measure_into
from napari_defocus.widgets.layers.image_layers import LARGEST_IN_MEMORY, Plane
from napari_defocus.widgets.layers.result_layers import (
    blur_map_layer,
    confidence_layer,
    in_focus_layer,
)
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    IN_FOCUS,
    METADATA_KEY,
    PLANES,
    Results,
    noise_description,
)
from napari_defocus.widgets.layers.result_stores import (
    UNTIL_CLOSED,
    Place,
    letters_of,
    whole_or_gone,
)
from napari_defocus.widgets.layers.seeds import seeds_of_plane

_NAMES = {BLUR_MAP: "blur_map", CONFIDENCE: "confidence", IN_FOCUS: "mask"}
"""What `measure_into` calls the results."""

_WITH_PYRAMID = 4 / 3


@dataclass(frozen=True, kw_only=True)
class LargeAnalysis(Wanted):
    """What is wanted of a plane, or of all planes, too large for memory.

    It is measured part by part in another process. Results are kept in OME-Zarr stores, and
    their layers read what is looked at.

    Attributes
    ----------
    seeds : napari.layers.Labels or None
        What the mask keeps to, as in `StackAnalysis`.
    all_planes : bool
        Whether the planes at all other positions of the sliders are wanted, too.
    place : Place
        Where the stores are.

    Examples
    --------
    In a script, without a window:

    >>> import numpy as np
    >>> from napari.components import ViewerModel
    >>> from napari_defocus.settings import MapSettings
    >>> from napari_defocus.widgets.jobs.estimation import JobCache
    >>> from napari_defocus.widgets.layers.image_layers import shown_plane
    >>> from napari_defocus.widgets.display.add_results import add_results
    >>> viewer = ViewerModel()
    >>> slide = viewer.add_image(np.random.default_rng(0).random((80, 90)), name="slide")
    >>> wanted = LargeAnalysis(plane=shown_plane(slide, viewer.dims), estimation=MapSettings())
    >>> layers = add_results(viewer, wanted.run(JobCache()).layers)
    >>> [layer.name for layer in layers]
    ['slide blur (px)', 'slide confidence']
    """

    seeds: Labels | None = None
    all_planes: bool = False
    place: Place = UNTIL_CLOSED

    def __post_init__(self) -> None:
        """Refuse, before any work is done, what cannot be."""
        super().__post_init__()
        self._letters()
        sizes = [np.dtype(dtype).itemsize for dtype in self.dtypes.values()]
        self.place.check_room(int(_WITH_PYRAMID * np.prod(self._shape()) * sum(sizes)))

    def run(self, cache: JobCache, progress: Progress = silent) -> Results:
        """Return the wanted results as lazy layers that lie on the picture.

        Nothing is cached: the candidates of large pictures are larger than they are.

        Raises
        ------
        NotAnalysableError
            If the picture cannot be measured, or the stores cannot be written.
        """
        progress("Preparing", 0.0)
        work = self._work()
        if is_left_open(self.estimation.psf):
            image = as_dask(work.image.array, work.axes)
            choice = measure_candidates(image, self.estimation, axes=work.axes).psf_choice
            settled = replace(self, estimation=self.estimation.settled(choice.psf))
            return settled.run(cache, progress).with_lens(choice)
        writers: dict[str, OmeZarrWriter] = {}
        with whole_or_gone(writers):
            for result in self.dtypes:
                writers[_NAMES[result]] = self._new_store(result)
            found = run_elsewhere(measure_into, work, writers, progress=progress)
        stores = {result: writers[_NAMES[result]].path for result in self.dtypes}
        noise, intensities, threshold = found
        if threshold is None or self.mask is None:
            return self._results(stores, noise, intensities)
        settled = replace(self, mask=replace(self.mask, threshold=threshold))
        return settled._results(stores, noise, intensities).with_threshold(threshold)

    def _work(self) -> TiledJob:
        plane, letters = self.plane, self._letters()
        image = plane.data[self._index()]
        return TiledJob(
            image=Carried(image),
            axes=letters + "s" * (image.ndim - len(letters)),
            estimation=self.estimation,
            blur_map=self.blur_map,
            confidence=self.confidence,
            mask=self.mask,
            seeds=self._seeds(),
            inside=plane.inside,
        )

    def _index(self) -> tuple[int | slice, ...]:
        """Return what picks all that is wanted out of the layer's data."""
        if not self.all_planes:
            return self.plane.index
        return tuple(slice(None) if isinstance(at, int) else at for at in self.plane.index)

    def _letters(self) -> str:
        """Return a letter for each axis of what is wanted, but for colours."""
        labels, ndim = self.plane.placement["axis_labels"], len(self.plane.index)
        if not self.all_planes:
            return "yx"
        return letters_of(labels, self.plane.sliders, ndim)

    def _stored(self) -> str:
        """Return the letters in the order of the results: planes first."""
        return "".join(sorted(self._letters(), key=lambda a: "tczyx".index(a)))

    def _shape(self) -> tuple[int, ...]:
        """Return the shape of the results, planes first."""
        planes = [self.plane.data.shape[axis] for axis in self.plane.sliders] * self.all_planes
        return (*(int(n) for n in planes), *self.plane.shape)

    def _seeds(self) -> NDArray[np.integer] | None:
        if self.seeds is None or self.mask is None:
            return None
        count = len(self.plane.sliders) * self.all_planes
        planes = [
            seeds_of_plane(self.seeds, self._at(position)).values
            for position in np.ndindex(self._shape()[:count])
        ]
        return np.stack(planes).reshape(self._shape())

    def _at(self, position: tuple[int, ...]) -> Plane:
        return self.plane.at_position(position) if self.all_planes else self.plane

    def _new_store(self, result: str) -> OmeZarrWriter:
        own = dict(zip(self._letters(), self._own_axes(), strict=True))
        return self.place.new_store(
            result,
            self.plane,
            axes={letter: own[letter] for letter in self._stored()},
            shape=self._shape(),
            dtype=self.dtypes[result],
            estimation=self.estimation,
            mask=self.mask,
        )

    def _own_axes(self) -> list[int]:
        """Return which axes of the layer the results have."""
        sliced = [] if self.all_planes else self.plane.sliders
        return [axis for axis in range(len(self.plane.index)) if axis not in sliced]

    def _results(
        self,
        stores: dict[str, Path],
        noise: NDArray[np.float64],
        intensities: list[Intensities],
    ) -> Results:
        first, variance = self._at((0,) * noise.ndim), float(np.median(noise))
        layers = []
        for result, store in stores.items():
            layer = self._layer(result, first, variance, intensities[0])
            if self.all_planes:
                layer[1]["metadata"][METADATA_KEY][PLANES] = {
                    "axes": self.plane.sliders,
                    "noise_variances": noise.ravel().tolist(),
                    "intensities": [of_plane.facts() for of_plane in intensities],
                    "not analysed": {},
                }
            on = None if self.all_planes else first
            layers.append(self.place.layer(layer, store, self._letters(), on))
        return Results(layers, self._summary(noise, layers))

    def _layer(
        self, result: str, plane: Plane, variance: float, intensities: Intensities
    ) -> LayerDataTuple:
        """Return what the layer of a result looks like, without its values."""
        none: NDArray[Any] = np.zeros((1, 1), self.dtypes[result])
        if result == BLUR_MAP:
            return blur_map_layer(plane, none, self.estimation, variance, intensities=intensities)
        if result == CONFIDENCE:
            return confidence_layer(plane, none, self.estimation, variance, intensities)
        assert self.mask is not None
        seeds = None if self.seeds is None else self.seeds.name
        used = self.mask, self.estimation, variance, seeds, intensities
        return in_focus_layer(plane, none, *used)

    def _summary(self, noise: NDArray[np.float64], layers: list[LayerDataTuple]) -> str:
        lines = [f"{noise.size} planes"] * (noise.size > 1)
        lines.append(noise_description(self.estimation.noise_variance, noise.ravel()))
        if self.blur_map and self.confidence:
            data, keywords, _ = layers[1]
            smallest = data[-1] if keywords.get("multiscale") else data
            share = (np.asarray(smallest) >= CONFIDENT).mean()
            lines.append(f"Trusted on about {share:.0%} (confidence {CONFIDENT:g} or more)")
        return "\n".join([*lines, self.place.lifetime_text()])


def is_large(plane: Plane) -> bool:
    """Tell whether a plane is measured part by part, see `LARGEST_IN_MEMORY`."""
    return bool(np.prod(plane.shape) > LARGEST_IN_MEMORY)
