"""What is done to one tile of a picture: the tasks of which graphs are made."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.checks import Mode
from napari_defocus.core.image import PreparedImage
from napari_defocus.core.intensity import Intensities, IntensityRange, Limits, found_intensities
from napari_defocus.labeling.blur_map import coarse_problem, extrapolated, labeled_blur_map
from napari_defocus.labeling.coarse_to_fine import minimize_energy
from napari_defocus.labeling.confidence import confidence_and_caution, map_confidence
from napari_defocus.labeling.focus_threshold import blur_counts, threshold_of_counts
from napari_defocus.labeling.graph_cuts import solve_exactly
from napari_defocus.labeling.problem import CoarseLabels, LabelingProblem
from napari_defocus.labeling.segmentation import coarse_mask_problem, labeled_mask
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.estimation import Estimation, candidates_of
from napari_defocus.likelihood.local_noise import LocalNoise, noise_of_samples
from napari_defocus.likelihood.noise import NoiseSample
from napari_defocus.likelihood.noise_shading import NoiseShading
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.tiled.tiles import Tile

Float32 = NDArray[np.float32]
Problem = tuple[Float32, Float32]
Found = dict[str, NDArray[Any]]


class Preparing(Protocol):
    """What says how pixels are made ready."""

    @property
    def intensity_range(self) -> IntensityRange | None:
        """The range that is given."""

    def prepared(self, image: NDArray[Any], intensities: Intensities | None) -> PreparedImage:
        """Return a picture, or a piece of one whose intensities were found before."""


@dataclass(frozen=True)
class Noise:
    """The noise of a plane, and the intensities that it is measured in.

    Attributes
    ----------
    given : float, ShotNoise or None
        By the user.
    variance : float or None
        Its mean over the plane, if a tile alone does not know it.
    intensities : Intensities or None
        Of the plane, if a tile alone does not know them.
    growth : float
        By how much it grows from the centre of the plane, whose variance it is then, to its
        corners, see `NoiseShading`.
    """

    given: float | ShotNoise | None
    variance: float | None = None
    intensities: Intensities | None = None
    growth: float = 0.0

    @property
    def known(self) -> float | None:
        """Its variance, or mean variance; None if that is to be found from pixels."""
        if self.variance is not None or isinstance(self.given, ShotNoise):
            return self.variance
        return None if self.given is None else float(self.given)

    def of(self, picture: PreparedImage, tile: Tile) -> LocalNoise:
        """Return the noise of what a tile sees: how large, and how it grows."""
        if self.known is None:
            return LocalNoise.of(picture, self.given)
        shot_noise = self.given if isinstance(self.given, ShotNoise) else None
        shading = NoiseShading.over((tile.rows.length, tile.columns.length), self.growth)
        noise = LocalNoise(self.known, shot_noise, shading)
        return noise.seen_from(*(span.start for span in tile.seen))

    @classmethod
    def of_samples(
        cls,
        given: float | ShotNoise | None,
        intensities: Intensities,
        samples: list[NoiseSample],
    ) -> Noise:
        """Find the mean variance of a plane from pieces of it; none are needed if it is given."""
        noise, growth = noise_of_samples(samples) if given is None else (given, 0.0)
        if isinstance(noise, ShotNoise):
            variance = float(np.mean([noise.variance_at(one.intensity).mean() for one in samples]))
        else:
            variance = float(noise)
        return cls(noise, variance, intensities.above_noise(variance), growth)


def candidates_of_tile(
    seen: NDArray[Any], tile: Tile, noise: Noise, how: Estimation
) -> BlurCandidates:
    """Estimate the candidates of a tile, or of a plane, from all pixels that it sees."""
    picture = how.prepared(seen, noise.intensities)
    return candidates_of(picture, how, noise.of(picture, tile), within=tile.within)


def _problem_of_tile(
    seen: NDArray[Any], tile: Tile, noise: Noise, how: Estimation
) -> LabelingProblem:
    return LabelingProblem.of(candidates_of_tile(seen, tile, noise, how), seen[tile.within])


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """The results that are wanted of a picture; all cost hardly more than the first.

    Attributes
    ----------
    map : MapSettings or None
        How candidates are labelled, for a map.
    confidence : bool
        Whether to give the confidence of the map.
    risk : float or None
        For the map that `cautious_blur_map` gives.
    extrapolated : bool
        Whether to tell where the map has no evidence of its own.
    mask : MaskSettings or None
        A threshold that is found from the picture is found before, see `settled`.
    """

    map: MapSettings | None = None
    confidence: bool = False
    risk: float | None = None
    extrapolated: bool = False
    mask: MaskSettings | None = None

    @property
    def dtypes(self) -> dict[str, type]:
        """Names of the results, and what they hold."""
        asked = {
            "blur_map": (self.map is not None, np.float32),
            "confidence": (self.confidence, np.float32),
            "cautious": (self.risk is not None, np.float32),
            "extrapolated": (self.extrapolated, np.bool_),
            "mask": (self.mask is not None, np.uint8),
        }
        return {name: dtype for name, (is_asked, dtype) in asked.items() if is_asked}

    def settled(self, threshold: float | None) -> Wanted:
        """Return the same with the threshold of masks that was found, if it was to be found."""
        if self.mask is None or threshold is None:
            return self
        return replace(self, mask=replace(self.mask, threshold=threshold))

    def problems(
        self, problem: LabelingProblem, levels: int, seeds: NDArray[Any] | None
    ) -> dict[str, Problem]:
        """Return what the cells of a tile cost: for the map, and for the mask."""
        found: dict[str, Problem] = {}
        if self.map is not None:
            found["blur_map"] = coarse_problem(problem, levels, self.map)
        if self.mask is not None:
            found["mask"] = coarse_mask_problem(problem, levels, self.mask, seeds)
        return found

    def measure(
        self,
        problem: LabelingProblem,
        around: dict[str, CoarseLabels],
        seeds: NDArray[Any] | None,
        within: NDArray[Any] | None = None,
    ) -> Found:
        """Return all results that are wanted of a tile, everywhere that it sees."""
        found: Found = {}
        if self.map is not None:
            blur_map = labeled_blur_map(problem, self.map, around=around.get("blur_map"))
            found["blur_map"] = blur_map
            if self.risk is not None:
                sure, safe = confidence_and_caution(problem.candidates, blur_map, risk=self.risk)
                found.update(confidence=sure, cautious=safe)
            elif self.confidence:
                found["confidence"] = map_confidence(problem.candidates, blur_map)
            if self.extrapolated:
                found["extrapolated"] = extrapolated(problem)
        if self.mask is not None:
            where = None if within is None else within != 0
            found["mask"] = labeled_mask(
                problem, self.mask, seeds=seeds, within=where, around=around.get("mask")
            )
        return found


def join_intensities(
    dtype: np.dtype[Any],
    intensity_range: IntensityRange | None,
    limits: list[Limits],
    values: list[NDArray[Any]],
) -> Intensities:
    """Find the intensities of a plane from pieces: limits of all of it, and some of its values."""
    known = Limits.joined(limits) if limits else None
    return found_intensities(dtype, intensity_range, known, np.concatenate(values))


def look_at_noise(
    pixels: NDArray[Any],
    how: Preparing,
    intensities: Intensities,
    every: int,
    start: tuple[int, int],
    whole: tuple[int, int],
) -> NoiseSample:
    """Return what a piece of a plane shows of the noise, and where: see `NoiseSample.of`."""
    return NoiseSample.of(how.prepared(pixels, intensities), every, start, whole)


def noise_with_variance(pixels: NDArray[Any], how: Preparing, noise: Noise) -> Noise:
    """Return the noise of a plane that is one tile, with its variance and its intensities."""
    picture = how.prepared(pixels, noise.intensities)
    found = LocalNoise.of(picture, noise.given)
    intensities = picture.intensities.above_noise(found.variance)
    return Noise(found.shot_noise or noise.given, found.variance, intensities, found.growth)


def coarse_pass(
    pixels: NDArray[Any],
    seeds: NDArray[Any] | None,
    tile: Tile,
    levels: int,
    noise: Noise,
    how: Estimation,
    wanted: Wanted,
    threshold: float | None,
) -> dict[str, Problem]:
    """Return what the cells of the core of a tile cost: the coarse pass."""
    problem = _problem_of_tile(pixels, tile, noise, how)
    own, wanted = tile.core_cells(levels), wanted.settled(threshold)
    return {
        name: (data[own].copy(), weights[:, *own].copy())
        for name, (data, weights) in wanted.problems(problem, levels, seeds).items()
    }


def blur_pass(
    pixels: NDArray[Any], within: NDArray[Any] | None, tile: Tile, noise: Noise, how: Estimation
) -> NDArray[np.int64]:
    """Return how many places of the core of a tile are surely blurred by each scale."""
    problem = _problem_of_tile(pixels, tile, noise, how)
    where = None if within is None else within != 0
    return blur_counts(problem, where, tile.core_cells(0))


def threshold_of_tiles(
    counts: list[NDArray[np.int64]], scales: NDArray[np.floating], mode: Mode
) -> float:
    """Return up to which blur a picture, or a stack, counts as in focus."""
    return threshold_of_counts(np.sum(counts, axis=0), scales, mode)


def join_cells(costs: list[dict[str, Problem]], axis: int) -> dict[str, Problem]:
    """Put what cells beside each other cost together, along rows, 0, or columns, 1."""
    return {
        name: (
            np.concatenate([one[name][0] for one in costs], axis=axis),
            np.concatenate([one[name][1] for one in costs], axis=axis + 1),
        )
        for name in costs[0]
    }


def label_cells(rows: list[dict[str, Problem]]) -> dict[str, NDArray[np.int32]]:
    """Label the cells of a whole plane, for the map and for the mask."""
    return {
        name: (solve_exactly if name == "mask" else _minimized)(data, weights)
        for name, (data, weights) in join_cells(rows, 0).items()
    }


def _minimized(data: Float32, weights: Float32) -> NDArray[np.int32]:
    return minimize_energy(data, weights, finest=False)


def measure_tile(
    pixels: NDArray[Any],
    seeds: NDArray[Any] | None,
    within: NDArray[Any] | None,
    tile: Tile,
    levels: int,
    cells: dict[str, NDArray[np.int32]] | None,
    noise: Noise,
    how: Estimation,
    wanted: Wanted,
    threshold: float | None,
) -> Found:
    """Return the results of a tile: in its core, and in its margin where tiles are blended."""
    problem = _problem_of_tile(pixels, tile, noise, how)
    at = tile.cells(levels)
    around = {
        name: CoarseLabels(np.ascontiguousarray(labels[at]), tile.core_cells(0), tile.inner_sides)
        for name, labels in (cells or {}).items()
    }
    found = wanted.settled(threshold).measure(problem, around, seeds, within)
    return {
        name: found[name][tile.core(margin=dtype is np.float32)].copy()
        for name, dtype in wanted.dtypes.items()
    }


def confidence_pass(
    pixels: NDArray[Any],
    blur_map: NDArray[Any],
    tile: Tile,
    noise: Noise,
    how: Estimation,
    risk: float,
) -> Found:
    """Return the confidence of a given map in the core of a tile, and what is safe to undo."""
    sure, safe = confidence_and_caution(
        candidates_of_tile(pixels, tile, noise, how), blur_map, risk=risk
    )
    return {"confidence": sure[tile.core()].copy(), "cautious": safe[tile.core()].copy()}


def windows_of_tile(
    pixels: NDArray[Any], tile: Tile, noise: Noise, how: Estimation, name: str
) -> Float32:
    """Return an attribute of the candidates of the windows of a tile's core."""
    values: Float32 = getattr(candidates_of_tile(pixels, tile, noise, how), name)
    return values[tile.core_cells(0)].copy()
