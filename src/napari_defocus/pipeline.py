"""The blur of a picture as commands find it, measured or read from a file, and tell it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import napari_defocus
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.psf import AUTO
from napari_defocus.settings import BLOCK_SIZE, THRESHOLD_PLANES, UNKNOWN, MapSettings, MaskSettings

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from napari_defocus.core.intensity import Intensities, IntensityRange, Limits
    from napari_defocus.likelihood.candidates import BlurCandidates
    from napari_defocus.likelihood.psf_choice import PSFChoice
    from napari_defocus.likelihood.shot_noise import ShotNoise
    from napari_defocus.psf.families import PSFFamily
    from napari_defocus.restoration.all_in_focus import Restoration, RestorationFit

CANDIDATES_SHARE = 0.7
"""Roughly how much of the time goes into the candidates; for the progress bar only."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement:
    """A blur map, and what is known about it.

    Attributes
    ----------
    blur_map : (H, W) float32 ndarray
        Scale in px; NaN where it is not known, which only maps that are read have.
    confidence : (H, W) float32 ndarray or None
        None if the map was read and nothing else.
    psf : PSFFamily
    noise_variance : float or None
        None if it was neither given nor measured.
    shot_noise : ShotNoise or None
    map_file, confidence_file : Path or None
        What was read instead of measuring.
    candidates : BlurCandidates or None
        What the map was made of, if it was measured.
    intensities : Intensities or None
        What the noise variance is measured in, if it is known.
    """

    blur_map: NDArray[Any]
    confidence: NDArray[Any] | None
    psf: PSFFamily
    noise_variance: float | None
    shot_noise: ShotNoise | None = None
    map_file: Path | None = None
    confidence_file: Path | None = None
    candidates: BlurCandidates | None = None
    intensities: Intensities | None = None

    @property
    def noise_growth(self) -> float:
        """By how much the noise is larger in the corners than in the centre, if it was found."""
        return 0.0 if self.candidates is None else self.candidates.noise_growth

    @property
    def psf_choice(self) -> PSFChoice | None:
        """How the family was chosen, if the picture was to choose it."""
        return None if self.candidates is None else self.candidates.psf_choice

    @property
    def doubt(self) -> str | None:
        """Why the picture does not look like defocus; None if it may, or was not measured."""
        return None if self.candidates is None else self.candidates.doubt

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the picture, in px."""
        return self.blur_map.shape[0], self.blur_map.shape[1]

    def cautious(self, risk: float) -> NDArray[Any]:
        """Return how much of the map is safe to take away; all of it if it was read."""
        if self.candidates is None:
            return self.blur_map
        return napari_defocus.cautious_blur_map(self.candidates, self.blur_map, risk=risk)

    def trusted(self, min_confidence: float) -> NDArray[Any]:
        """Return the map with NaN where the confidence is lower."""
        import numpy as np

        if self.confidence is None:
            return self.blur_map
        return np.where(self.confidence < min_confidence, np.float32(np.nan), self.blur_map)


def find_blur(
    image: NDArray[Any],
    settings: MapSettings,
    intensity_range: IntensityRange | None,
    map_file: Path | None,
    confidence_file: Path | None,
    progress: Progress,
) -> Measurement:
    """Return the map that is given as a file, or else measure it."""
    if map_file is not None:
        return read_map(map_file, confidence_file, settings, image.shape[:2])
    if confidence_file is not None:
        raise ValueError(
            f"map_confidence is {confidence_file}; it needs the map that it belongs to, too"
        )
    return measure_map(image, settings, intensity_range, progress)


def measure_map(
    image: NDArray[Any],
    settings: MapSettings,
    intensity_range: IntensityRange | None = None,
    progress: Progress = silent,
) -> Measurement:
    """Estimate the candidates, and the map and its confidence from them."""
    first, second = shares(progress)
    candidates = measure_candidates(image, settings, intensity_range, first)
    return label_map(candidates, image, settings, intensity_range, second)


def shares(progress: Progress) -> tuple[Progress, Progress]:
    """Return the callbacks for the candidates and for what is made of them."""
    return within(progress, 0.0, CANDIDATES_SHARE), within(progress, CANDIDATES_SHARE, 1.0)


def measure_candidates(
    image: Any,
    settings: MapSettings,
    intensity_range: IntensityRange | None = None,
    progress: Progress = silent,
    *,
    axes: str | None = None,
    block_size: int = BLOCK_SIZE,
) -> Any:
    """Estimate the candidates of a picture, a stack or a dask array; find shot noise if asked to.

    Of a stack or a dask array, shot noise is that of its first plane.
    """
    from napari_defocus.compilation import compile_kernels

    psf = settings.family()
    compile_kernels(progress)
    noise: float | ShotNoise | None = settings.noise_variance
    if settings.shot_noise:
        progress("Measuring the noise", 0.0)
        noise = napari_defocus.estimate_shot_noise(
            _seen_of(image, axes), linearize=settings.linearize, intensity_range=intensity_range
        )
    return napari_defocus.estimate_candidates(
        image,
        psf=psf,
        noise_variance=noise,
        window=settings.window,
        stride=settings.stride,
        mode=settings.mode,
        linearize=settings.linearize,
        camera_softness=settings.camera_softness,
        intensity_range=intensity_range,
        axes=axes,
        block_size=block_size,
        progress=progress,
    )


def lens_of_planes(
    planes: Sequence[Any], settings: MapSettings, intensity_range: IntensityRange | None = None
) -> PSFChoice:
    """Choose one PSF family for planes that are measured one by one; pixels are read at once."""
    from napari_defocus.likelihood.estimation import Estimation
    from napari_defocus.tiled.psf_of_planes import psf_of_planes

    how = Estimation(
        settings.family(),
        settings.window,
        linearize=settings.linearize,
        intensity_range=intensity_range,
        camera_softness=settings.camera_softness,
    )
    return psf_of_planes(planes, how, settings.noise_variance)


def _seen_of(image: Any, axes: str | None) -> Any:
    """Return pixels that tell of the noise: of a stack or a dask array those of the first plane."""
    from napari_defocus.core.axes import first_plane, is_lazy

    if axes is None and not is_lazy(image):
        return image
    from napari_defocus.tiled.plane_noise import sampled

    return sampled(first_plane(image, axes))


def label_map(
    candidates: BlurCandidates,
    image: NDArray[Any],
    settings: MapSettings,
    intensity_range: IntensityRange | None = None,
    progress: Progress = silent,
) -> Measurement:
    """Make the coherent map of candidates, and its confidence."""
    blur_map = napari_defocus.label_blur_map(
        candidates,
        image,
        smoothness=settings.smoothness,
        color_sigma=settings.color_sigma,
        intensity_range=intensity_range,
        progress=within(progress, 0.0, 0.9),
    )
    progress("Measuring the confidence", 0.9)
    return Measurement(
        blur_map=blur_map,
        confidence=napari_defocus.confidence_map(candidates, blur_map),
        psf=candidates.psf,
        noise_variance=candidates.noise_variance,
        shot_noise=candidates.shot_noise,
        candidates=candidates,
        intensities=candidates.intensities,
    )


def settled_mask(
    candidates: Any,
    image: Any,
    settings: MaskSettings,
    intensity_range: IntensityRange | None = None,
    *,
    within: NDArray[Any] | None = None,
    progress: Progress = silent,
) -> MaskSettings:
    """Return the settings with the threshold that the picture says, if it was to say it."""
    if settings.threshold != AUTO:
        return settings
    found = napari_defocus.focus_threshold(
        candidates, image, within=within, intensity_range=intensity_range, progress=progress
    )
    return replace(settings, threshold=found)


def threshold_of_stack(
    planes: Sequence[Any],
    settings: MapSettings,
    intensity_range: IntensityRange | None = None,
    within: Sequence[Any] | None = None,
) -> float:
    """Return one threshold for planes of dask that are measured one by one; some are read now.

    If masks are given, one a plane, only what they mark counts.
    """
    import dask
    import dask.array as da

    from napari_defocus.tiled.psf_of_planes import evenly_spaced

    some = [*evenly_spaced(len(planes), THRESHOLD_PLANES)]
    stack = da.stack([planes[at] for at in some])
    marked = None if within is None else da.stack([within[at] for at in some])
    axes = "zyxs" if stack.ndim > 3 else "zyx"
    with dask.config.set(scheduler="synchronous"):
        candidates = measure_candidates(stack, settings, intensity_range, axes=axes)
        return napari_defocus.focus_threshold(candidates, stack, within=marked)


def threshold_of_planes(
    planes: Sequence[NDArray[Any]],
    settings: MapSettings,
    within: NDArray[Any] | None = None,
) -> float:
    """Return one threshold for all of these planes, which are in memory."""
    import numpy as np

    from napari_defocus.labeling.focus_threshold import blur_counts, threshold_of_counts
    from napari_defocus.labeling.problem import LabelingProblem

    found = [measure_candidates(plane, settings) for plane in planes]
    problems = map(LabelingProblem.of, found, planes)
    counts = [blur_counts(problem, within) for problem in problems]
    first = found[0]
    return threshold_of_counts(np.sum(counts, axis=0), first.scales, first.mode)


def segment(
    candidates: BlurCandidates,
    image: NDArray[Any],
    settings: MaskSettings,
    intensity_range: IntensityRange | None = None,
    *,
    seeds: NDArray[Any] | None = None,
    within: NDArray[Any] | None = None,
    progress: Progress = silent,
) -> NDArray[np.uint8]:
    """Return what is in focus."""
    return napari_defocus.segment_in_focus(
        candidates,
        image,
        **asdict(settings),
        seeds=seeds,
        within=within,
        intensity_range=intensity_range,
        progress=progress,
    )


def judged_mask(
    candidates: BlurCandidates,
    image: NDArray[Any],
    settings: MaskSettings,
    intensity_range: IntensityRange | None = None,
    *,
    mask: NDArray[Any],
    seeds: NDArray[Any] | None = None,
    within: NDArray[Any] | None = None,
) -> NDArray[Any]:
    """Return the mask with what is not known left in it, for shares of what is known."""
    if settings.unknown == "leave":
        return mask
    known = napari_defocus.known_places(candidates, image, intensity_range=intensity_range)
    if seeds is not None:
        known |= seeds != 0
    if within is not None:
        known &= within != 0
    judged = mask.copy()
    judged[~known] = UNKNOWN
    return judged


def restore(
    image: NDArray[Any],
    blur_map: NDArray[Any],
    confidence: NDArray[Any] | None,
    how: Restoration,
    *,
    limits: Limits | None = None,
    progress: Progress = silent,
) -> tuple[NDArray[np.float32], RestorationFit]:
    """Return the picture all in focus, and how well it fits its map.

    `limits` are intensities that planes of a stack share.
    """
    if limits is not None:
        prepared = how.prepared(image, limits)
        return how.restored_with_fit(image, prepared, blur_map, confidence, progress)
    return napari_defocus.restore_all_in_focus(
        image, blur_map, **vars(how), confidence=confidence, progress=progress, return_fit=True
    )


def intensities_of(
    picture: NDArray[Any], intensity_range: tuple[float, float] | None
) -> Intensities:
    """Return the intensities of a picture whose blur was not measured."""
    from napari_defocus.core.image import prepare_image

    return prepare_image(picture, intensity_range).intensities


def read_map(
    path: Path, confidence_path: Path | None, settings: MapSettings, shape: tuple[int, ...]
) -> Measurement:
    """Read a map that `map` wrote, for a picture of a height and width."""
    import numpy as np

    from napari_defocus.io.encoders import check_unit, description_in_tiff

    if settings.psf == AUTO:
        raise ValueError(
            "psf is 'auto', but map is given; it takes the lens that the map was measured with"
        )
    scales = _read_values(path, shape, "a blur map: values in px, as map writes them (.tif)")
    if path.suffix.lower() in (".tif", ".tiff"):
        check_unit(description_in_tiff(path), path)
    known = scales[~np.isnan(scales)]
    if not known.size:
        raise ValueError(f"{path} has only NaN; it takes a map with known pixels")
    if known.min() < 0 or np.isinf(known).any():
        raise ValueError(
            f"{path} has values from {known.min():g} to {known.max():g}; "
            "it takes finite ones from 0 px up, NaN unknown"
        )
    confidence = None
    if confidence_path is not None:
        confidence = _read_values(
            confidence_path, shape, "a confidence: values as map --confidence writes them (.tif)"
        )
        if not ((confidence >= 0) & (confidence <= 1)).all():
            raise ValueError(f"{confidence_path} has values that are not from 0 to 1")
    psf = _family_up_to(float(known.max()), settings)
    if known.max() > psf.max_scale:
        raise ValueError(
            f"{path} has values up to {known.max():g} px; {settings.psf} goes up to "
            f"{psf.max_scale:g} px"
        )
    return Measurement(
        blur_map=scales,
        confidence=confidence,
        psf=psf,
        noise_variance=settings.noise_variance,
        map_file=path,
        confidence_file=confidence_path,
    )


def _read_values(path: Path, shape: tuple[int, ...], what: str) -> NDArray[Any]:
    import numpy as np

    from napari_defocus.io.pictures import read_picture

    values = read_picture(path)
    if values.ndim != 2 or values.dtype.kind != "f":
        raise ValueError(f"{path} holds no {what.removeprefix('a ')}")
    if values.shape != shape:
        height, width = values.shape
        raise ValueError(
            f"{path} has {width} x {height} px; it takes as many as the picture has, "
            f"{shape[1]} x {shape[0]} px"
        )
    return values.astype(np.float32)


def _family_up_to(largest: float, settings: MapSettings) -> PSFFamily:
    """Return the family of the settings, with a domain that goes up to a scale if it can."""
    from napari_defocus.psf.parsing import psf_of

    return psf_of(settings.psf, max(settings.max_radius, largest))


def used(found: BlurCandidates | Measurement, settings: MapSettings) -> dict[str, Any]:
    """Return what files say about how the blur was found."""
    measured = asdict(settings.settled(found.psf)) | {"noise_variance": found.noise_variance}
    if not isinstance(found, Measurement) or found.map_file is None:
        return measured
    kept = {name: measured[name] for name in ("psf", "linearize", "noise_variance")}
    return kept | file_facts(found)


def file_facts(found: Measurement) -> dict[str, Any]:
    """Return what was read instead of measuring; None if it was not."""
    files = {"map": found.map_file, "map_confidence": found.confidence_file}
    return {name: path and str(path) for name, path in files.items()}
