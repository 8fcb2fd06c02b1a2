"""From a prepared picture to its candidates: local spectra, likelihood curves, their maxima."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import (
    Linearize,
    Mode,
    Spectra,
    check_linearize,
    check_mode,
    check_softness,
    check_stride,
)
from napari_defocus.core.image import PreparedImage, prepare_image
from napari_defocus.core.intensity import Intensities, IntensityRange
from napari_defocus.core.memory import give_back
from napari_defocus.core.progress import Progress, silent
from napari_defocus.core.progress import within as within_share
from napari_defocus.likelihood.analysis_grid import AnalysisGrid
from napari_defocus.likelihood.averaged_pixels import halved_without, level_count, noise_share
from napari_defocus.likelihood.blur_spectra import SpectrumTable, label_scales, spectrum_table
from napari_defocus.likelihood.border_windows import BorderWindows
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.exact_spectra import check_side, domain_of_window, within_window
from napari_defocus.likelihood.gabor import Gradients, gradients, local_power, window_centers
from napari_defocus.likelihood.local_noise import LocalNoise
from napari_defocus.likelihood.maxima import CANDIDATES, joined_maxima, largest_point
from napari_defocus.likelihood.scale_space import (
    Level,
    joined,
    joined_scales,
    strongest,
)
from napari_defocus.likelihood.sharp_details import SharpDetails
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.likelihood.window_analysis import Said, Search, WindowAnalysis
from napari_defocus.psf.domain import growth_of_details, limited, seen_with_pixels, softness_beside
from napari_defocus.psf.families import PSFFamily, as_family
from napari_defocus.settings import MapSettings

Float32 = NDArray[np.float32]

_MAXIMA = 1 << 16
"""Windows whose maxima are found at once; for memory only."""


@dataclass(frozen=True)
class Estimation:
    """How candidates are estimated: what `estimate_candidates` takes, checked, but for the noise.

    Attributes
    ----------
    psf : PSFFamily
    window, stride : int
        Side N of the analysis window, and the distance between windows, in px.
    mode : {"curve", "paper"}
    spectra : {"exact", "fitted"}
    search : {"lattice", "fixed-point"} or None
        How maxima are found; None looks for none, the radii are NaN.
    linearize : {"srgb"} or None
    intensity_range : (float, float) or None
        The intensities that count as 0 and 1; None finds them.
    camera_softness : float
        Standard deviation, in px, of the blur that the camera has of its own; not in the mode
        "paper".
    levels : int or None
        Of averaged pixels, see `scale_space`; None takes as many as the picture has. The mode
        "paper" and the search "fixed-point" know one.
    """

    psf: PSFFamily
    window: int = MapSettings.window
    stride: int = MapSettings.stride
    mode: Mode = MapSettings.mode
    spectra: Spectra = "exact"
    search: Search | None = "lattice"
    linearize: Linearize | None = MapSettings.linearize
    intensity_range: IntensityRange | None = None
    camera_softness: float = MapSettings.camera_softness
    levels: int | None = None

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        object.__setattr__(self, "psf", as_family(self.psf))
        check_side(self.window)
        check_mode(self.mode)
        check_stride(self.stride, self.window)
        check_linearize(self.linearize)
        check_softness(self.camera_softness)
        if not isinstance(self.spectra, str) or self.spectra not in get_args(Spectra):
            raise ValueError(f"spectra is {self.spectra!r}; it takes one of {get_args(Spectra)}")
        if self.search is not None:
            check_search(self.search)

    def for_shape(self, shape: tuple[int, int]) -> Estimation:
        """Return the same for a picture of a height and width: its levels, and their domain."""
        if self.levels is not None:
            return self
        count = 1
        if self.mode != "paper" and self.search != "fixed-point":
            count = level_count(shape, self.window, self.psf.max_scale)
        if count == 1:
            return replace(self, psf=within_window(self.psf, self.window), levels=1)
        domain = domain_of_window(self.window) * 2 ** (count - 1)
        return replace(self, psf=limited(self.psf, domain), levels=count)

    def of_level(self, level: int) -> Estimation:
        """Return how one level is estimated: its own PSF, in its own px."""
        if self.levels == 1:
            return self
        psf = seen_with_pixels(self.psf, 2**level, domain_of_window(self.window))
        search = self.search if level == 0 else None
        return replace(self, psf=psf, levels=1, search=search)

    def prepared(self, image: ArrayLike, intensities: Intensities | None = None) -> PreparedImage:
        """Return a picture as spectra see it, grey; of a tile, with its plane's intensities."""
        picture = prepare_image(image, intensities or self.intensity_range, self.linearize)
        return replace(picture, color=picture.luminance[..., None])

    def candidates(
        self,
        picture: PreparedImage,
        noise: float | ShotNoise | LocalNoise | None,
        progress: Progress = silent,
    ) -> BlurCandidates:
        """Return the candidates of a prepared picture, whose noise is given or found."""
        progress("Measuring the noise", 0.0)
        return candidates_of(picture, self, LocalNoise.of(picture, noise), progress)


def candidates_of(
    picture: PreparedImage,
    how: Estimation,
    noise: LocalNoise,
    progress: Progress = silent,
    within: tuple[slice, slice] | None = None,
) -> BlurCandidates:
    """Return the candidates of a prepared picture: those of its levels, joined.

    `noise` is that of the picture, which may be a part of a larger one. Candidates are those of the
    part of the picture that `within` says; coarse levels see the rest, too.
    """
    how = how.for_shape(picture.shape)
    part = picture if within is None else _cut(picture, within)
    start = (0, 0) if within is None else (within[0].start, within[1].start)
    of_part = noise.seen_from(*start)
    if how.levels == 1:
        found = _of_one_level(part, how.of_level(0), of_part, progress, finest=True)
        if how.mode == "paper":
            return found
        return replace(found, sharp=_sharp_details(part, how, of_part).inside)
    levels, details = _levels_of(picture, (part, of_part), how, noise, progress)
    sharp = details.inside if within is None else details.inside[within]
    return replace(_joined_candidates(levels, how, start, details), sharp=sharp)


def _levels_of(
    picture: PreparedImage,
    part: tuple[PreparedImage, LocalNoise],
    how: Estimation,
    noise: LocalNoise,
    progress: Progress,
) -> tuple[list[Level], SharpDetails]:
    """Return the levels of a picture, the finest of a part of it, and its own sharp details."""
    count = how.levels or 1
    shares = np.cumsum([0, *(4.0**-level for level in range(count))])
    levels: list[Level] = []
    details: list[SharpDetails] = []
    hidden = np.zeros(picture.shape, bool)
    for level in range(count):
        report = within_share(progress, *shares[level : level + 2] / shares[-1])
        seen, own = part if level == 0 else (picture, noise)
        reduced = own.reduced(noise_share(level))
        found = _of_one_level(seen, how.of_level(level), reduced, report, finest=level == 0)
        levels.append(Level(seen, found, 2**level, hidden))
        if level + 1 < count:
            # Not less than at level 0: a camera's noise is not white.
            details.append(_sharp_details(picture, how, noise))
            picture, hidden = halved_without(picture, details[-1].around | hidden)
            noise = noise.halved()
    return levels, details[0]


def _sharp_details(picture: PreparedImage, how: Estimation, noise: LocalNoise) -> SharpDetails:
    """Return the sharp details of a level's picture: points have fine details at any blur."""
    if growth_of_details(how.psf):
        return SharpDetails.none(picture.shape)
    return SharpDetails.of(picture, noise.of_pixels(picture) / picture.intensities.unit**2)


def _joined_candidates(
    levels: list[Level], how: Estimation, start: tuple[int, int], sharp: SharpDetails
) -> BlurCandidates:
    """Return the candidates of all levels; the finest shows the picture from a place in px on."""
    finest = levels[0].candidates
    scales = joined_scales(how.psf.max_scale, how.window, len(levels))
    give_back(finest.image_shape)
    curve, weight = joined(levels, scales, start, sharp)
    strength = strongest(levels, start)
    joint = replace(
        finest, curve=curve, scales=scales, psf=how.psf, weight=weight, strength=strength
    )
    if how.search is None:
        return joint
    flat, exact = curve.reshape(-1, len(scales)), finest.radii.reshape(-1, CANDIDATES)
    point = largest_point(_table(finest.image_shape, how.of_level(0)), finest.scales)
    found = [
        joined_maxima(flat[first : first + _MAXIMA], scales, point, exact[first : first + _MAXIMA])
        for first in range(0, len(flat), _MAXIMA)
    ]
    radii, heights = (
        np.concatenate(some).reshape(finest.radii.shape) for some in zip(*found, strict=True)
    )
    return replace(joint, radii=radii, log_likelihoods=heights)


def _cut(picture: PreparedImage, part: tuple[slice, slice]) -> PreparedImage:
    """Return a part of a prepared picture, row by row in memory, as kernels expect it."""
    color, luminance = (
        np.ascontiguousarray(plane[part]) for plane in (picture.color, picture.luminance)
    )
    opaque = None if picture.opaque is None else np.ascontiguousarray(picture.opaque[part])
    return PreparedImage(color, luminance, opaque, picture.intensities)


def _of_one_level(
    picture: PreparedImage,
    how: Estimation,
    noise: LocalNoise,
    progress: Progress,
    *,
    finest: bool,
) -> BlurCandidates:
    """Return the candidates of one level: Gabor powers, likelihood curves, their maxima."""
    window, stride = how.window, how.stride
    gradient = gradients(picture.evened, picture.opaque, window, picture.weight)
    grid = AnalysisGrid.over(picture.shape, window, stride)
    opaque = _opaque_share(picture, grid, gradient.pad, window)
    noisier = noise.relative_to_windows(picture, grid, gradient.pad, window)
    least_noise = max(noise.variance, picture.rounding_variance) / picture.intensities.unit**2
    scales = label_scales(how.psf)
    table = _table(picture.shape, how)
    seen = _share_seen(picture.shape, window)
    analysis = WindowAnalysis(table, scales, least_noise, window, how.mode, how.search, seen)
    found = Said.nothing((len(grid.row_of_window), len(grid.column_of_window)), len(scales))
    for block in grid.blocks():
        progress("Estimating blur", 0.1 + 0.9 * block.start / len(grid.rows))
        power = local_power(gradient, grid.rows[block], grid.columns, window)
        shares = (None if all_of is None else all_of[block] for all_of in (opaque, noisier))
        said = analysis.said(power, *shares)
        for result, values in zip(found.arrays(), said.arrays(), strict=True):
            grid.spread(block, values, result)
    over_border = None
    if finest and how.mode != "paper":
        over_border = _over_border(picture, noise, gradient, analysis, stride, found)
    progress("Estimating blur", 1.0)
    return BlurCandidates(
        found.radii,
        found.log_likelihoods,
        found.curve,
        scales,
        window_centers(picture.shape[0], stride),
        window_centers(picture.shape[1], stride),
        picture.shape,
        how.psf,
        noise.variance,
        window,
        stride,
        how.mode,
        noise.shot_noise,
        picture.intensities.above_noise(noise.variance),
        strength=found.signs[..., 0].copy(),
        direction=found.signs[..., 1:].copy(),
        noise_growth=noise.growth,
        over_border=over_border,
    )


def _over_border(
    picture: PreparedImage,
    noise: LocalNoise,
    gradient: Gradients,
    analysis: WindowAnalysis,
    stride: int,
    found: Said,
) -> NDArray[np.bool_] | None:
    """Let places near the border have what windows over it say, and return which: (R, C)."""
    border = BorderWindows.over(picture.shape, analysis.window, stride)
    if border is None:
        return None
    grid = border.grid()
    opaque = _opaque_share(picture, grid, gradient.pad, analysis.window)
    noisier = noise.relative_to_windows(picture, grid, gradient.pad, analysis.window)

    def says(power: Float32, places: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Said:
        of_places = np.ix_(*places)
        shares = (None if all_of is None else all_of[of_places] for all_of in (opaque, noisier))
        return analysis.said(power, *shares, with_signs=False)

    return border.take_over(found, analysis.scales, gradient, says)


def _table(shape: tuple[int, int], how: Estimation) -> SpectrumTable:
    """Return the spectra for the windows of a picture of a height and width."""
    grid = AnalysisGrid.over(shape, how.window, how.stride)
    fractions = grid.rows[0] % 1, grid.columns[0] % 1
    mixed = how.mode != "paper"
    softness = softness_beside(how.psf, how.camera_softness) if mixed else 0.0
    return spectrum_table(how.psf, how.window, *fractions, how.spectra, mixed, softness)


def check_search(search: str) -> None:
    """Check the name of a way to find maxima."""
    if not isinstance(search, str) or search not in get_args(Search):
        raise ValueError(f"search is {search!r}; it takes one of {get_args(Search)}")


def _opaque_share(
    picture: PreparedImage, grid: AnalysisGrid, pad: tuple[int, int], window: int
) -> Float32 | None:
    """Return the share of each window that is opaque, weighted as power is; None if all is."""
    if picture.weight is None:
        return (
            None if picture.opaque is None else grid.mean_over_windows(picture.opaque, pad, window)
        )
    share = picture.weight**2
    if picture.opaque is not None:
        share *= picture.opaque
    return grid.mean_over_windows(share, pad, window)


def _share_seen(shape: tuple[int, int], window: int) -> float:
    """Return the share of a window that a picture fills; the rest mirrors it, and tells no more."""
    return math.prod(min(1.0, length / window) for length in shape)
