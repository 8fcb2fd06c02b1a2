"""The candidate scales of every analysed window: local maxima of the likelihood, (9)-(13)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import (
    Linearize,
    Mode,
    Spectra,
    check_linearize,
    check_mode,
    check_real,
    check_stride,
)
from napari_defocus.core.image import PreparedImage, prepare_image
from napari_defocus.core.intensity import Intensities, IntensityRange
from napari_defocus.core.progress import Progress, silent
from napari_defocus.likelihood.analysis_grid import AnalysisGrid
from napari_defocus.likelihood.blur_spectra import (
    check_windows,
    label_scales,
    spectrum_table,
)
from napari_defocus.likelihood.fixed_point import fixed_point_maxima
from napari_defocus.likelihood.gabor import gradients, local_power, padding, window_centers
from napari_defocus.likelihood.maxima import CANDIDATES, local_maxima
from napari_defocus.likelihood.noise import ShotNoise, mean_shot_noise, noise_variance_of
from napari_defocus.likelihood.profile_likelihood import (
    profile_log_likelihood,
    quasi_log_likelihood,
)
from napari_defocus.psf.families import PSFFamily
from napari_defocus.settings import MapSettings

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

Search = Literal["lattice", "fixed-point"]

_LEAST_OPAQUE = 0.05
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class BlurCandidates:
    """What the windows of one picture say about the blur, and what made it.

    R x C windows lie `stride` px apart; one stands for the pixels around its centre.

    Attributes
    ----------
    radii : (R, C, 3) float32 ndarray
        Scales of the best local maxima of the likelihood, best first, in px, in the
        continuous domain; NaN where there are fewer. With `Disc`, one that cannot be told
        from a point (radius up to 0.5 px) is given as 0.25 px.
    log_likelihoods : (R, C, 3) float32 ndarray
        log p of (9) at those scales, both gradients added; in the mode "curve" each divided by
        its dispersion. -inf where there are fewer.
    curve : (R, C, L) float32 ndarray
        log p(r) at `scales`.
    scales : (L,) float64 ndarray
        0, 0.1, ... px over the domain of the PSF family.
    row_centers, column_centers : (R,) and (C,) float64 ndarray
        Where the windows stand, in px; may be half-way between pixels.
    image_shape : (int, int)
        Height and width of the picture, in px.
    psf : PSFFamily
    noise_variance : float
        Of the luminance, intensities in [0, 1]; given or found; the mean over the picture if
        it grows with the intensity.
    window, stride : int
        N and the distance between windows, in px.
    mode : {"curve", "paper"}
        Which likelihood it is, see `estimate_candidates`.
    shot_noise : ShotNoise or None
        How the noise grows with the intensity, if it was said to.
    intensities : Intensities or None
        Which intensities of the picture are 0 and 1, and its contrast. What labels it takes
        them from here, unless it is given others. None of candidates made by hand.
    """

    radii: Float32
    log_likelihoods: Float32
    curve: Float32
    scales: Float64
    row_centers: Float64
    column_centers: Float64
    image_shape: tuple[int, int]
    psf: PSFFamily
    noise_variance: float
    window: int
    stride: int
    mode: Mode
    shot_noise: ShotNoise | None = None
    intensities: Intensities | None = None

    def places_of_window(self) -> NDArray[np.int64]:
        """Return how many places share the window of each: (R, C), above 1 along the border."""
        return AnalysisGrid.over(self.image_shape, self.window, self.stride).places()

    def displacement(self) -> Float64:
        """Return how far, in px, each window lies from its place: (R, C), not 0 near the border."""
        grid = AnalysisGrid.over(self.image_shape, self.window, self.stride)
        pad = (padding(length, self.window) for length in self.image_shape)
        return np.hypot.outer(
            *(
                centers[window] - extra - place
                for centers, window, extra, place in zip(
                    (grid.rows, grid.columns),
                    (grid.row_of_window, grid.column_of_window),
                    pad,
                    (self.row_centers, self.column_centers),
                    strict=True,
                )
            )
        )

    def log_likelihood_at(self, row: float, column: float) -> tuple[Float64, Float64]:
        """Return the likelihood curve at one pixel (the paper's Fig. 6).

        Parameters
        ----------
        row, column : float
            A place in the picture, in px.

        Returns
        -------
        scales : (L,) float64 ndarray
            In px.
        log_likelihood : (L,) float64 ndarray
            log p(r) of (9) of the window nearest to that place.

        Raises
        ------
        ValueError
            If the place is outside the picture.
        """
        return self.scales, self.curve[self.nearest_window(row, column)].astype(np.float64)

    def nearest_window(self, row: float, column: float) -> tuple[int, int]:
        """Return which window speaks for one pixel: its place in (R, C).

        Parameters
        ----------
        row, column : float
            A place in the picture, in px.

        Raises
        ------
        ValueError
            If the place is outside the picture.
        """
        check_place(row, column, self.image_shape)
        i = np.abs(self.row_centers - row).argmin()
        j = np.abs(self.column_centers - column).argmin()
        return int(i), int(j)

    def window_at(self, row: float, column: float) -> tuple[float, float, float, float]:
        """Return what part of the picture the curve of one pixel comes from.

        Windows that would reach over the border are moved inside. What counts in a window is
        weighted by a Gaussian with a standard deviation of a quarter of its side.

        Parameters
        ----------
        row, column : float
            A place in the picture, in px.

        Returns
        -------
        top, left, bottom, right : float
            Edges, in px; the centre of the first pixel is 0, its outer edge -0.5. A picture
            smaller than a window is all of it.

        Raises
        ------
        ValueError
            If the place is outside the picture.

        Examples
        --------
        >>> import numpy as np
        >>> from napari_defocus import estimate_candidates
        >>> picture = np.random.default_rng(0).uniform(size=(120, 120))
        >>> estimate_candidates(picture, stride=1).window_at(60, 0)
        (39.5, -0.5, 80.5, 40.5)
        """
        grid = AnalysisGrid.over(self.image_shape, self.window, self.stride)
        edges = []
        for at, centers, window, length in zip(
            self.nearest_window(row, column),
            (grid.rows, grid.columns),
            (grid.row_of_window, grid.column_of_window),
            self.image_shape,
            strict=True,
        ):
            center = centers[window[at]] - padding(length, self.window)
            reach = np.array([-self.window, self.window]) / 2
            edges.append(np.clip(center + reach, -0.5, length - 0.5))
        (top, bottom), (left, right) = edges
        return float(top), float(left), float(bottom), float(right)


def check_candidates(candidates: Any) -> None:
    """Refuse candidates of a stack or a dask array, and what are no candidates."""
    if isinstance(candidates, BlurCandidates):
        return
    if hasattr(candidates, "results"):
        raise TypeError(
            "candidates are those of a stack or a dask array; this takes those of one picture, "
            "as estimate_candidates gives them for an array of numpy"
        )
    raise TypeError(
        f"candidates is {type(candidates).__name__}; it takes what estimate_candidates returns"
    )


def check_place(row: float, column: float, shape: tuple[int, int]) -> None:
    """Check that a place, in px, is in a picture of a height and width."""
    height, width = shape
    check_real("row", row, "a place in the picture")
    check_real("column", column, "a place in the picture")
    if not (0 <= row <= height - 1 and 0 <= column <= width - 1):
        raise ValueError(
            f"(row, column) is ({row}, {column}); it takes a place in the picture of "
            f"{height} x {width} px"
        )


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
    """

    psf: PSFFamily
    window: int = MapSettings.window
    stride: int = MapSettings.stride
    mode: Mode = MapSettings.mode
    spectra: Spectra = "exact"
    search: Search | None = "lattice"
    linearize: Linearize | None = MapSettings.linearize
    intensity_range: IntensityRange | None = None

    def __post_init__(self) -> None:
        """Refuse impossible values before any work is done with them."""
        object.__setattr__(self, "psf", check_windows(self.psf, self.window))
        check_mode(self.mode)
        check_stride(self.stride, self.window)
        check_linearize(self.linearize)
        if not isinstance(self.spectra, str) or self.spectra not in get_args(Spectra):
            raise ValueError(f"spectra is {self.spectra!r}; it takes one of {get_args(Spectra)}")
        if self.search is not None:
            check_search(self.search)

    def prepared(self, image: ArrayLike, intensities: Intensities | None = None) -> PreparedImage:
        """Return a picture as spectra see it; of a tile, with the intensities of its plane."""
        return prepare_image(image, intensities or self.intensity_range, self.linearize)

    def candidates(
        self,
        picture: PreparedImage,
        noise_variance: float | ShotNoise | None,
        progress: Progress = silent,
    ) -> BlurCandidates:
        """Return the candidates of a prepared picture, whose noise is given or found."""
        progress("Measuring the noise", 0.0)
        if noise_variance is None:
            noise_variance = noise_variance_of(picture)
        if isinstance(noise_variance, ShotNoise):
            mean = mean_shot_noise(picture, noise_variance)
            return candidates_of(picture, self, mean, noise_variance, progress)
        return candidates_of(picture, self, float(noise_variance), None, progress)


def candidates_of(
    picture: PreparedImage,
    how: Estimation,
    noise_variance: float,
    shot_noise: ShotNoise | None = None,
    progress: Progress = silent,
) -> BlurCandidates:
    """Return the candidates of a prepared picture: Gabor powers, likelihood curves, their maxima.

    `noise_variance` is the mean over the whole picture if there is `shot_noise`.
    """
    psf, window, stride, mode = how.psf, how.window, how.stride, how.mode
    gradient = gradients(picture.evened, picture.opaque, window)
    grid = AnalysisGrid.over(picture.shape, window, stride)
    fractions = grid.rows[0] % 1, grid.columns[0] % 1
    table = spectrum_table(psf, window, *fractions, how.spectra, mixed=mode == "curve")
    opaque = _opaque_share(picture, grid, gradient.pad, window)
    noisier = None
    if shot_noise is not None:
        least = _TINY * picture.intensities.unit**2
        relative = shot_noise.variance_at(picture.luminance) / max(noise_variance, least)
        noisier = grid.mean_over_windows(relative, gradient.pad, window)
    scales = label_scales(psf)
    shape = (len(grid.row_of_window), len(grid.column_of_window))
    radii = np.empty((*shape, CANDIDATES), np.float32)
    log_likelihoods = np.empty((*shape, CANDIDATES), np.float32)
    curve = np.empty((*shape, len(scales)), np.float32)
    least_noise = max(noise_variance, picture.rounding_variance) / picture.intensities.unit**2
    for block in grid.blocks():
        progress("Estimating blur", 0.1 + 0.9 * block.start / len(grid.rows))
        power = local_power(gradient, grid.rows[block], grid.columns, window)
        if opaque is not None:
            power /= np.maximum(opaque[block], _LEAST_OPAQUE)[..., None, None]
        if noisier is not None:
            power /= np.maximum(noisier[block], _TINY)[..., None, None]
        points = power.reshape(-1, *table.noise.shape)
        if mode == "paper":
            block_curve = profile_log_likelihood(points, table, scales, least_noise)
            dispersion = np.ones(points.shape[:2], np.float32)
        else:
            block_curve, dispersion = quasi_log_likelihood(points, table, scales, least_noise)
        if how.search == "lattice":
            block_radii, block_heights = local_maxima(
                points, block_curve, table, scales, least_noise, dispersion
            )
        elif how.search == "fixed-point":
            block_radii, block_heights = fixed_point_maxima(points, table, least_noise, dispersion)
        else:
            block_radii = np.full((len(points), CANDIDATES), np.nan, np.float32)
            block_heights = np.full_like(block_radii, -np.inf)
        if opaque is not None:
            _silence_transparent(opaque[block].ravel(), block_radii, block_heights, block_curve)
        for result, values in (
            (radii, block_radii),
            (log_likelihoods, block_heights),
            (curve, block_curve),
        ):
            grid.spread(block, values, result)
    progress("Estimating blur", 1.0)
    return BlurCandidates(
        radii,
        log_likelihoods,
        curve,
        scales,
        window_centers(picture.shape[0], stride),
        window_centers(picture.shape[1], stride),
        picture.shape,
        psf,
        noise_variance,
        window,
        stride,
        mode,
        shot_noise,
        picture.intensities.above_noise(noise_variance),
    )


def check_search(search: str) -> None:
    """Check the name of a way to find maxima."""
    if not isinstance(search, str) or search not in get_args(Search):
        raise ValueError(f"search is {search!r}; it takes one of {get_args(Search)}")


def _opaque_share(
    picture: PreparedImage, grid: AnalysisGrid, pad: tuple[int, int], window: int
) -> Float32 | None:
    """Return the share of each window that is opaque, weighted as power is; None if all is."""
    if picture.opaque is None:
        return None
    return grid.mean_over_windows(picture.opaque, pad, window)


def _silence_transparent(
    opaque: Float32, radii: Float32, log_likelihoods: Float32, curve: Float32
) -> None:
    """Let windows speak in proportion to their opaque share, and the transparent ones not."""
    curve *= opaque[..., None]
    transparent = opaque < _LEAST_OPAQUE
    curve[transparent] = 0
    radii[transparent] = np.nan
    present = np.isfinite(radii)
    share = np.broadcast_to(opaque[..., None], radii.shape)
    log_likelihoods[present] *= share[present]
    log_likelihoods[~present] = -np.inf
