"""The candidate scales of every analysed window: local maxima of the likelihood, (9)-(13)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.checks import (
    Mode,
    check_real,
)
from napari_defocus.core.intensity import Intensities
from napari_defocus.likelihood.analysis_grid import AnalysisGrid
from napari_defocus.likelihood.border_windows import BorderWindows
from napari_defocus.likelihood.gabor import padding
from napari_defocus.likelihood.psf_choice import PSFChoice
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.likelihood.signs import doubt_of
from napari_defocus.psf.families import PSFFamily

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class BlurCandidates:
    r"""The likely radii at every window of one picture, and how they were estimated.

    The likelihood of a scale r is that of the local powers :math:`|g_i^{\nabla}|^2`, with the best
    variance s of the sharp picture's gradients, the blur spectrum (6) and the noise spectrum (7):

    .. math:: p(r) \propto \max_s \prod_i \frac{1}{v_i}
        \exp\left(-\frac{|g_i^{\nabla}|^2}{v_i}\right), \qquad
        v_i = s \, \sigma_i^2(r) + \sigma_{ni}^2 \tag{9}

    R x C windows lie `stride` px apart. Each decides about the pixels around its centre.

    Attributes
    ----------
    radii : (R, C, 3) float32 ndarray
        Scales of the best local maxima of the likelihood, best first, in px; NaN where there are
        fewer than three. With `Disc`, a radius up to 0.5 px is the same as a point, and is
        given as 0.25 px.
    log_likelihoods : (R, C, 3) float32 ndarray
        log p of (9) at those scales, summed over both gradients. In the mode "curve" each is
        divided by its dispersion. -inf where there are fewer than three.
    curve : (R, C, L) float32 ndarray
        log p(r) at `scales`.
    scales : (L,) float64 ndarray
        0, 0.1, ... px over the domain of the PSF family. Beyond 8 px (for windows of 41 px) the
        steps double with each octave.
    row_centers, column_centers : (R,) and (C,) float64 ndarray
        The centres of the windows, in px; they may lie half-way between pixels.
    image_shape : (int, int)
        Height and width of the picture, in px.
    psf : PSFFamily
        Its domain is what was searched: small pictures cannot tell large radii.
    noise_variance : float
        Of the luminance, for intensities in [0, 1], given or found. If it grows with the
        intensity, this is the mean over the picture; if it grows towards the corners, that of the
        centre.
    window, stride : int
        N and the distance between windows, in px.
    mode : {"curve", "paper"}
        Which likelihood it is, see `estimate_candidates`.
    shot_noise : ShotNoise or None
        How the noise grows with the intensity, if it does.
    intensities : Intensities or None
        Which intensities of the picture are 0 and 1, and its contrast. The functions that label
        take them from here, unless they get others. None if the candidates were made by hand.
    psf_choice : PSFChoice or None
        How `psf` was chosen, if the picture chose it.
    weight : (R, C) float32 ndarray or None
        How much each window counts, from 0 to 1: less for wide windows, which many places share.
        None if the picture has one level only.
    strength : (R, C) float32 ndarray or None
        Logarithm of 1 + each window's power at low frequencies relative to the noise's. This and
        `direction` are None if the candidates were made by hand.
    direction : (R, C, 2) float32 ndarray or None
        Real and imaginary part of the preferred direction d (`likelihood/signs.py`): near 0 if
        details lie in all directions alike, above about 1.5 where all lie in one.
    sharp : (H, W) bool ndarray or None
        Pixels that show sharp details themselves, see `sharp_details`. None in the mode "paper" and
        of candidates made by hand.
    noise_growth : float
        By how much the noise variance is larger in the corners, as a share of that in the centre;
        0 if it does not grow outwards. See `estimate_noise_variance`.
    over_border : (R, C) bool ndarray or None
        Whether the window of each place reaches over the border; else it was moved inside. See
        `border_windows`. None if all were.
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
    psf_choice: PSFChoice | None = None
    weight: Float32 | None = None
    strength: Float32 | None = None
    direction: Float32 | None = None
    sharp: NDArray[np.bool_] | None = None
    noise_growth: float = 0.0
    over_border: NDArray[np.bool_] | None = None

    @property
    def doubt(self) -> str | None:
        """Why the picture does not look like defocus, in a sentence; None if it may.

        Motion is noticed from about 6 px on, if nearly all of the picture has it. Noise alone is
        noticed as well. Sharpening, upscaling and smooth shading are not.
        """
        return doubt_of(self.strength, self.direction)

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
        """Return which window decides about one pixel: its place in (R, C).

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
        """Return the part of the picture that the curve of one pixel comes from.

        Windows that would reach over the border are moved inside, but for those of `over_border`.
        What counts in a window is weighted by a Gaussian with a standard deviation of a quarter of
        its side.

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
        edges = []
        for center, length in zip(
            self._center_of(self.nearest_window(row, column)), self.image_shape, strict=True
        ):
            reach = np.array([-self.window, self.window]) / 2
            edges.append(np.clip(center + reach, -0.5, length - 0.5))
        (top, bottom), (left, right) = edges
        return float(top), float(left), float(bottom), float(right)

    def _center_of(self, place: tuple[int, int]) -> tuple[float, float]:
        """Return the centre of the window that a place has its curve from, in px."""
        border = BorderWindows.over(self.image_shape, self.window, self.stride)
        if border is not None and self.over_border is not None and self.over_border[place]:
            return border.center_of(*place)
        grid = AnalysisGrid.over(self.image_shape, self.window, self.stride)
        row, column = (
            float(centers[window[at]] - padding(length, self.window))
            for at, centers, window, length in zip(
                place,
                (grid.rows, grid.columns),
                (grid.row_of_window, grid.column_of_window),
                self.image_shape,
                strict=True,
            )
        )
        return row, column


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
