"""What one run does with all planes of a stack, one after the other: no Qt, any thread."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from napari.layers import Labels
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus import pipeline
from napari_defocus.core.progress import Progress, silent
from napari_defocus.io.ome_zarr_writer import OmeZarrWriter
from napari_defocus.psf import AUTO, is_left_open
from napari_defocus.settings import CONFIDENT, THRESHOLD_PLANES
from napari_defocus.widgets.jobs.analysis import Analysis, Wanted
from napari_defocus.widgets.jobs.estimation import JobCache, Picture
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, Plane
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    DEFOCUS,
    METADATA_KEY,
    PLANES,
    Results,
    confidence_description,
    noise_description,
)
from napari_defocus.widgets.layers.result_stores import (
    UNTIL_CLOSED,
    Place,
    disk_errors_refused,
    letters_of,
    whole_or_gone,
)
from napari_defocus.widgets.layers.seeds import seeds_of_plane

if TYPE_CHECKING:
    from napari_defocus.likelihood.psf_choice import PSFChoice

MOST_IN_MEMORY = 1_000_000_000
"""In bytes: results that fill more are kept on the disk."""

Position = tuple[int, ...]
"""Where a plane is along the axes that are not displayed."""


@dataclass(frozen=True, kw_only=True)
class StackAnalysis(Wanted):
    """What is wanted of all planes of a stack.

    `plane` is one of them, or a part of it, such as the one that is shown; the others are those
    at all other positions of the axes that are not displayed. Of a single picture, there are none.

    Attributes
    ----------
    seeds : napari.layers.Labels or None
        What the mask keeps to. Each plane has its own if the layer has the axes of the stack.
    place : Place
        Where results are kept that do not fit into memory, see `is_large`.
    """

    seeds: Labels | None = None
    place: Place = UNTIL_CLOSED

    def __post_init__(self) -> None:
        """Refuse, before any work is done, impossible settings, seeds, and too much of all."""
        self.of_plane(self.plane)
        if self.is_large:
            self.place.check_room(self._size)
            self._letters()

    @property
    def is_large(self) -> bool:
        """Whether the results do not fit into memory, and are kept in stores."""
        return self._size > MOST_IN_MEMORY

    @property
    def _size(self) -> int:
        """Return how many bytes the results fill."""
        sizes = (np.dtype(dtype).itemsize for dtype in self.dtypes.values())
        return sum(sizes) * int(np.prod(self.shape))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the results: the layer's, or that of the parts."""
        sizes = iter(self.plane.shape)
        lengths = zip(self.plane.data.shape, self.plane.index, strict=False)
        return tuple(length if isinstance(at, int) else next(sizes) for length, at in lengths)

    def positions(self) -> Iterator[Position]:
        """Return where the planes are along the axes that are not displayed, in order."""
        return product(*(range(self.plane.data.shape[axis]) for axis in self.plane.sliders))

    def run(self, cache: JobCache, progress: Progress = silent) -> Results:
        """Return the wanted results as layers that lie on the stack.

        A plane that cannot be analysed is NaN in the map and 0 in the mask and the confidence;
        the summary and the metadata say why. What is found of `plane` is cached, and of no
        other plane.

        Raises
        ------
        NotAnalysableError
            If no plane can be analysed.
        """
        choice = self._chosen_lens()
        if choice is not None:
            settled = replace(self, estimation=self.estimation.settled(choice.psf))
            return settled.run(cache, progress).with_lens(choice)
        threshold = self._found_threshold()
        if threshold is not None and self.mask is not None:
            settled = replace(self, mask=replace(self.mask, threshold=threshold))
            return settled.run(cache, progress).with_threshold(threshold)
        if not self.is_large:
            return self._analysed(
                {name: self._empty(name) for name in self.dtypes}, cache, progress
            )
        writers: dict[str, OmeZarrWriter] = {}
        with whole_or_gone(writers), disk_errors_refused():
            for name in self.dtypes:
                writers[name] = self._new_store(name)
            return self._analysed(writers, cache, progress)

    def _analysed(self, values: Mapping[str, Any], cache: JobCache, progress: Progress) -> Results:
        found = _Found(values)
        positions = list(self.positions())
        for number, position in enumerate(positions):
            plane = self.plane.at_position(position)
            # Candidates of one plane may be as large as the results of many.
            memory = cache if plane == self.plane else JobCache()
            reported = _of_one(progress, number, len(positions))
            reported("Reading the picture", 0.0)
            try:
                layers = self.of_plane(plane).run(memory, reported)
            except ValueError as reason:
                found.refused[position] = str(reason)
                found.leave_out(plane)
            else:
                found.take(layers, plane, position)
        if len(found.refused) == len(positions):
            raise NotAnalysableError(next(iter(found.refused.values())))
        return Results(self._layers(found), self._summary(found))

    def _chosen_lens(self) -> PSFChoice | None:
        """Return the lens of all planes, if they are to choose it; None if none can be read."""
        if not is_left_open(self.estimation.psf):
            return None
        from napari_defocus.tiled.psf_of_planes import MOST_PLANES

        planes = self._some_planes(MOST_PLANES)
        return pipeline.lens_of_planes(planes, self.estimation) if planes else None

    def _found_threshold(self) -> float | None:
        """Return the threshold of all planes' masks, if they are to say it."""
        if self.mask is None or self.mask.threshold != AUTO:
            return None
        planes = self._some_planes(THRESHOLD_PLANES)
        within = self.plane.inside
        return pipeline.threshold_of_planes(planes, self.estimation, within=within)

    def _some_planes(self, most: int) -> list[NDArray[Any]]:
        """Return the pixels of up to so many planes, evenly apart, that can be read."""
        from napari_defocus.tiled.psf_of_planes import evenly_spaced

        positions, planes = list(self.positions()), []
        for number in evenly_spaced(len(positions), most):
            with suppress(ValueError):
                planes.append(Picture.of(self.plane.at_position(positions[number])).image)
        return planes

    def of_plane(self, plane: Plane) -> Analysis:
        """Return what is wanted of one plane."""
        return Analysis(
            plane=plane,
            estimation=self.estimation,
            mask=self.mask,
            seeds=None if self.seeds is None else seeds_of_plane(self.seeds, plane),
            blur_map=self.blur_map,
            confidence=self.confidence,
        )

    def _empty(self, result: str) -> NDArray[Any]:
        return np.full(self.shape, _unknown(result), self.dtypes[result])

    def _letters(self) -> str:
        plane = self.plane
        return letters_of(plane.placement["axis_labels"], plane.sliders, len(plane.index))

    def _new_store(self, result: str) -> OmeZarrWriter:
        return self.place.new_store(
            result,
            self.plane,
            axes=dict(zip(self._letters(), range(len(self.shape)), strict=True)),
            shape=self.shape,
            dtype=self.dtypes[result],
            estimation=self.estimation,
            mask=self.mask,
        )

    def _layers(self, found: _Found) -> list[LayerDataTuple]:
        """Return what was found as layers like those of one plane, lying where the first one is."""
        first = self.plane.at_position(next(self.positions()))
        of_all = {
            "noise_variance": float(np.median(list(found.noise_variances.values()))),
            PLANES: self._about_planes(found),
        }
        layers = []
        for result, (keywords, kind) in found.looks.items():
            values = found.values[result]
            made = keywords["metadata"][METADATA_KEY] | of_all
            # Each plane has its own.
            made.pop("intensities", None)
            keywords = keywords | first.placement | {"metadata": {METADATA_KEY: made}}
            layer = LayerDataTuple((values, keywords, kind))
            if isinstance(values, OmeZarrWriter):
                layer = self.place.layer(layer, values.finish(), self._letters())
            layers.append(layer)
        return layers

    def _about_planes(self, found: _Found) -> dict[str, Any]:
        return {
            "axes": self.plane.sliders,
            "noise_variances": [found.noise_variances.get(at) for at in self.positions()],
            "intensities": [found.intensities.get(at) for at in self.positions()],
            "not analysed": {str(_named(at)): why for at, why in found.refused.items()},
        }

    def _summary(self, found: _Found) -> str:
        variances = list(found.noise_variances.values())
        count = len(variances)
        noise = noise_description(self.estimation.noise_variance, variances)
        lines = [f"{count} plane{'s' * (count != 1)}", noise]
        if CONFIDENCE in found.values:
            lines.append(confidence_description(float(np.mean(found.sure))))
        where = [self.place.lifetime_text()] * self.is_large
        return "\n".join([*lines, *found.refusals(), *where])


def may_be_large(plane: Plane, *, blur_map: bool, mask: bool) -> bool:
    """Tell whether results of all planes, a confidence among them, do not fit into memory."""
    count = np.prod([plane.data.shape[axis] for axis in plane.sliders])
    return bool(count * np.prod(plane.shape) * (8 * blur_map + mask) > MOST_IN_MEMORY)


@dataclass(frozen=True, eq=False)
class _Found:
    """What was found until now.

    Attributes
    ----------
    values : mapping of str to ndarray or OmeZarrWriter
        The results of the whole stack, in memory or on the disk.
    looks : dict
        What layers of them look like: the keywords and the type of those of one plane.
    noise_variances : dict
        Of the planes that were analysed.
    intensities : dict
        What the variances are measured in.
    refused : dict
        Why the others were not.
    sure : list of float
        The share of each analysed plane whose confidence is high.
    """

    values: Mapping[str, Any]
    looks: dict[str, tuple[dict[str, Any], str]] = field(default_factory=dict)
    noise_variances: dict[Position, float] = field(default_factory=dict)
    intensities: dict[Position, dict[str, Any] | None] = field(default_factory=dict)
    refused: dict[Position, str] = field(default_factory=dict)
    sure: list[float] = field(default_factory=list)

    def take(self, layers: list[LayerDataTuple], plane: Plane, position: Position) -> None:
        """Put the results of one plane into their place."""
        at = _whole(plane)
        only = tuple(0 if isinstance(n, int) else slice(None) for n in plane.index)
        for data, keywords, kind in layers:
            made = keywords["metadata"][METADATA_KEY]
            if made["result"] == DEFOCUS:
                continue  # the map's values, in another unit
            self.values[made["result"]][at] = data[only]
            self.looks[made["result"]] = keywords, kind
            self.noise_variances[position] = made["noise_variance"]
            self.intensities[position] = made["intensities"]
            if made["result"] == CONFIDENCE:
                self.sure.append(float((data >= CONFIDENT).mean()))

    def leave_out(self, plane: Plane) -> None:
        """Say of a plane that could not be analysed that nothing is known."""
        for result, values in self.values.items():
            if isinstance(values, OmeZarrWriter):
                values[_whole(plane)] = np.full(plane.shape, _unknown(result), values.dtype)

    def refusals(self) -> list[str]:
        """Return a line for every reason why planes were not analysed."""
        planes_of: dict[str, list[str]] = {}
        for position, reason in self.refused.items():
            planes_of.setdefault(reason, []).append(str(_named(position)))
        return [
            f"Not analysed: plane{'s' * (len(names) != 1)} {', '.join(names)} (from 0): {reason}"
            for reason, names in planes_of.items()
        ]


def _unknown(result: str) -> float:
    return np.nan if result == BLUR_MAP else 0


def _whole(plane: Plane) -> tuple[int | slice, ...]:
    """Return where the results of a plane are among those of all."""
    return tuple(n if isinstance(n, int) else slice(None) for n in plane.index)


def _named(position: Position) -> int | Position:
    return position[0] if len(position) == 1 else position


def _of_one(progress: Progress, number: int, count: int) -> Progress:
    """Return a callback for the work on one plane that names it, counted from 1."""

    def report(step: str, done: float) -> None:
        progress(f"Plane {number + 1} of {count}: {step}", (number + done) / count)

    return report
