"""A coherent position of best focus: labels of blocks, of pixels beside jumps, and between.

A label is a position in the stack, a quarter of a plane from the next one. Labels are chosen as
those of a blur map are: as the most likely state of a Markov random field, a minimum of (14).
`depth_from_focus` is its data term. The pairwise term (15) counts label steps, and the weights (16)
come from a picture that is sharp everywhere.

Beside clear jumps, windows see both sides, and the sharper texture wins. There, each pixel has a
data term of its own: how much its focus measure, the energy of fine detail, is below its peak at
a position. Only the peak counts, because light from across an edge adds detail to other planes. Up
to 12 px from a jump, the peak was right at 86 to 98 % of the pixels, and the fit of the whole curve
at 70 to 86 % (noise 1e-6).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter, minimum_filter

from napari_defocus.core.image import PreparedImage
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.core.threads import in_one_thread
from napari_defocus.labeling.blur_map import CURVE_WEIGHT
from napari_defocus.labeling.coarse_to_fine import minimize_energy
from napari_defocus.labeling.continuous_refinement import refine_curves
from napari_defocus.labeling.graph_cuts import Labels, Mask, Places
from napari_defocus.labeling.pairwise_term import Blocks
from napari_defocus.labeling.pixel_refinement import ChangeAt, interpolate_labels, label_pixels
from napari_defocus.likelihood.blur_spectra import LABEL_STEP
from napari_defocus.likelihood.evidence import informed_share

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]
ReadPlane = Callable[[int], PreparedImage]

TOLERANCE = 0.5
"""What counts as right, in planes."""

REACH = 6
"""How far, in px, a jump may be moved off the blocks at once. Chosen by hand."""

_DEPTH = np.float32(15)
"""The most that a position costs, in units of log-likelihood, as in labeling/data_term.py."""

_NEIGHBORHOOD = 4.0
"""px: standard deviation of the Gaussian that averages evidence. Chosen by hand."""

_CLEAR_EXCESS, _STEEPNESS = 1.4, 4.0
"""Rise of the sharpest plane's power, in units of the noise's, with which evidence begins to count,
and the power with which it does. Noise alone has 0.4 to 0.9; chosen by hand.
"""

_FINE, _SURROUNDINGS = 1.0, 0.7
"""px: standard deviations of the Gaussians that take away what is not fine, and average the rest.
Chosen by hand.
"""

_LEAST_ENERGY = np.float32(1e-9)
"""The least focus measure whose logarithm is taken, for a contrast of 1. Chosen by hand."""

_MEASURE_DEPTH, _MEASURE_WEIGHT = np.float32(2), np.float32(180)
"""Units of its logarithm that the focus measure may lack at most, and what one costs, in the units
of the data term. Chosen by hand; how often the peak was right is said above.
"""

_PIXEL_SMOOTHNESS = 0.2
"""The smoothness between pixels, as a share of that between blocks. Chosen by hand."""

_CLEAR_JUMP = 4.0
"""The least jump, in planes, within reach: windows are better beside smaller jumps and on slopes.
By hand.
"""

_TEMPER = 0.7
"""Power of the likelihood, before positions are compared for the confidence. Chosen by hand."""

_WEIGHT_OF_MASS, _BIAS = 1.12, 4.07
"""The logistic curve from log odds to the confidence, fitted by benchmarks/stacks.py --fit."""

_LEAST_ODDS = 5e-4
"""Added to both shares, so that their log odds are finite. Chosen by hand."""

_ROUNDING, _TINY = 1e-4, 1e-12
"""Differences of positions that are rounding, and the least weight that is divided by."""


@dataclass(frozen=True, eq=False)
class LabeledFocus:
    """The labels that were chosen for a stack.

    Attributes
    ----------
    labels : (R, C) int32 ndarray
        Of blocks.
    pixels : (H, W) int32 ndarray
        Of pixels.
    likeness : (4, R, C) float32 ndarray
        How alike neighbouring blocks are in colour: the weights (16) by those of one colour.
    """

    labels: Labels
    pixels: Labels
    likeness: Float32


@dataclass(frozen=True, eq=False)
class FocusCostVolume:
    """What each position of best focus costs at each window of a stack.

    Attributes
    ----------
    cost : (R, C, L) float32 ndarray
        Of each position, in units of log-likelihood.
    excess : (R, C) ndarray
        By how much the power of the sharpest plane is above the median's, in units of noise.
    labels_a_plane : int
        Labels from plane to plane.
    blocks : Blocks
        Of the windows.
    stride : int
        Between the windows, in px.
    unit : float
        Of the intensities, see `Intensities.unit`.
    """

    cost: Float32
    excess: Float64
    labels_a_plane: int
    blocks: Blocks
    stride: int
    unit: float = 1.0

    @property
    def _limited(self) -> Float32:
        return np.minimum(self.cost - self.cost.min(axis=2, keepdims=True), _DEPTH)

    @cached_property
    def _averaged(self) -> Float32:
        sigma = _NEIGHBORHOOD / self.stride
        return gaussian_filter(self._limited, (sigma, sigma, 0))

    @cached_property
    def informed(self) -> Float32:
        """How far there is evidence around each window, from 0 to 1: (R, C).

        Among many planes noise alone has a sharpest one: some power has to rise above it.
        """
        rise = gaussian_filter(self.excess, _NEIGHBORHOOD / self.stride)
        seen = 1 - np.exp(-((rise / _CLEAR_EXCESS) ** _STEEPNESS))
        return informed_share(np.ptp(self._averaged, axis=2)) * seen.astype(np.float32)

    def labeled(
        self,
        read: ReadPlane,
        color: Float32,
        *,
        smoothness: float,
        color_sigma: float,
        progress: Progress = silent,
    ) -> LabeledFocus:
        """Choose the label of every pixel.

        Parameters
        ----------
        read : callable
            Returns a plane, given its number; not called where nothing jumps.
        color : (H, W, C) float32 ndarray
            A picture that is sharp everywhere, for the weights (16), divided by `unit`.
        smoothness, color_sigma : float
            lambda_0, per label step, and sigma_lambda of (16).
        progress : callable, optional

        Returns
        -------
        LabeledFocus
        """
        blocks = self.blocks
        data = CURVE_WEIGHT * self._limited * self.informed[..., None]
        weights = blocks.edge_weights(color, color_sigma, smoothness)
        labels = minimize_energy(
            data * blocks.area[..., None], weights, within(progress, 0, 0.55, "Choosing planes")
        )
        reach = 2 * (-(-REACH // self.stride)) + 1
        spread = maximum_filter(labels, reach) - minimum_filter(labels, reach)
        near = blocks.spread(spread >= _CLEAR_JUMP * self.labels_a_plane)
        pixels = label_pixels(
            labels,
            data,
            blocks,
            color,
            smoothness=_PIXEL_SMOOTHNESS * smoothness,
            color_sigma=color_sigma,
            jump=self._jump,
            reach=REACH,
            change_at=self._change_of_measure(read, near, within(progress, 0.55, 0.9)),
            progress=within(progress, 0.9, 1.0),
        )
        pairs = blocks.edge_weights(np.zeros_like(color[..., :1]), color_sigma, 1.0)
        return LabeledFocus(labels, pixels, weights / np.maximum(smoothness * pairs, _TINY))

    def position(self, labeled: LabeledFocus, progress: Progress = silent) -> Float32:
        """Find the position of best focus of every pixel, between labels: (H, W).

        In planes from the first.
        """
        with in_one_thread():  # two tiles at once would be most of the memory of a stack
            fine = refine_curves(
                -self.cost, labeled.labels, labeled.likeness, self._jump, stride=self.stride,
                progress=progress,
            )  # fmt: skip
        scale = interpolate_labels(fine, labeled.labels, labeled.pixels, self.blocks, self._jump)
        last = (self.cost.shape[2] - 1) / self.labels_a_plane
        return np.clip(scale / np.float32(LABEL_STEP * self.labels_a_plane), 0, np.float32(last))

    @property
    def _jump(self) -> int:
        return max(2, self.labels_a_plane)

    def _change_of_measure(
        self, read: ReadPlane, near: Mask, progress: Progress
    ) -> ChangeAt | None:
        """Return what a change of label costs by the pixels' own focus measure; NaN elsewhere."""
        if not near.any():
            return None
        planes = (self.cost.shape[2] - 1) // self.labels_a_plane + 1
        measure = np.empty((int(near.sum()), planes), np.float32)
        for number in range(planes):
            progress("Looking along the edges", number / planes)
            energy = focus_measure(read(number), _SURROUNDINGS)[near]
            measure[:, number] = np.log(energy + _LEAST_ENERGY * np.float32(self.unit) ** 2)
        lack = np.minimum(measure.max(axis=1, keepdims=True) - measure, _MEASURE_DEPTH)
        lack *= _MEASURE_WEIGHT
        row_of = np.maximum(np.cumsum(near.ravel()) - 1, 0)

        def cost(labels: Labels, place: Places) -> Float64:
            plane, between = np.divmod(labels.ravel()[place], self.labels_a_plane)
            row, share = row_of[place], between / self.labels_a_plane
            after = np.minimum(plane + 1, planes - 1)
            return np.asarray((1 - share) * lack[row, plane] + share * lack[row, after])

        def change(now: Labels, new: Labels, place: Places) -> Float64:
            change = cost(new, place) - cost(now, place)
            return np.where(near.ravel()[place], change, np.nan)

        return change

    def confidence(self, position: Float32) -> Float32:
        """Return the probability that each position is within half a plane of the true one.

        It comes from the share of the likelihood within half a plane of the position, as
        `confidence_map` does for radii. The likelihood is limited in depth and averaged over the
        neighbouring windows. Without evidence, it is the share of all positions that are so near.
        """
        rows, columns = (
            np.rint(centers).astype(int)
            for centers in (self.blocks.row_centers, self.blocks.column_centers)
        )
        odds, prior = self.odds(position[np.ix_(rows, columns)])
        likely = 1 / (1 + np.exp(-_WEIGHT_OF_MASS * odds - _BIAS))
        sure = self.informed * likely + (1 - self.informed) * prior
        places = np.meshgrid(*self.blocks.positions, indexing="ij")
        return np.clip(map_coordinates(sure.astype(np.float32), places, order=1), 0, 1)

    def odds(self, position: Float32) -> tuple[Float64, Float64]:
        """Return the log odds of positions at the windows, and the share of all that are right.

        Of the likelihood within half a plane of each against that of all others: (R, C) each.
        """
        likelihood = np.exp(-_TEMPER * (self._averaged - self._averaged.min(axis=2, keepdims=True)))
        labels = np.arange(self.cost.shape[2]) / self.labels_a_plane
        agrees = np.abs(labels - position[..., None]) <= TOLERANCE + _ROUNDING
        share = np.sum(likelihood, axis=2, where=agrees) / likelihood.sum(axis=2)
        return np.log((share + _LEAST_ODDS) / (1 - share + _LEAST_ODDS)), agrees.mean(axis=2)


def focus_measure(picture: PreparedImage, surroundings: float) -> Float32:
    """Return the focus measure of each pixel, the energy of details below 1 px there: (H, W)."""
    fine = picture.luminance - gaussian_filter(picture.luminance, _FINE)
    return gaussian_filter(fine**2, surroundings)
