"""What labelling needs of a picture and its candidates: worked out once, labelled many times."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.image import PreparedImage, prepare_image
from napari_defocus.core.progress import Progress, silent
from napari_defocus.labeling.blurred_edges import squared_step_of
from napari_defocus.labeling.data_term import EXTRA_OF_SHARP, Costs, data_term
from napari_defocus.labeling.pairwise_term import Blocks
from napari_defocus.likelihood.candidates import BlurCandidates, check_candidates
from napari_defocus.likelihood.own_side import AT_ONCE, on_own_side

Float32 = NDArray[np.float32]
Result = TypeVar("Result")
Ingredients = tuple[BlurCandidates, ArrayLike, tuple[float, float] | None]

_REMEMBERED = 2
"""Problems that a worker process keeps: that of this picture and that of the one before."""


@dataclass(frozen=True, eq=False)
class LabelingProblem:
    """A picture and its candidates, ready to be labelled with any smoothness and threshold.

    Attributes
    ----------
    candidates : BlurCandidates
        As they were estimated.
    own : BlurCandidates
        Each place with what its own side of an edge says.
    picture : PreparedImage
    blocks : Blocks
        Of the windows.
    """

    candidates: BlurCandidates
    own: BlurCandidates
    picture: PreparedImage
    blocks: Blocks

    @classmethod
    def of(
        cls,
        candidates: BlurCandidates,
        image: ArrayLike | PreparedImage,
        intensity_range: tuple[float, float] | None = None,
    ) -> LabelingProblem:
        """Prepare the picture that candidates came from, with their intensities.

        One that was prepared before must not have been decoded into linear light: colours are
        compared as they are seen.

        Raises
        ------
        TypeError
            If `image` has no real dtype, or `candidates` are not those of one picture.
        ValueError
            If it is not a picture, or another one than that of `candidates`.
        """
        check_candidates(candidates)
        picture = _picture_of(candidates, image, intensity_range)
        own = on_own_side(candidates, picture)
        centers = candidates.row_centers, candidates.column_centers
        # From here on, only colours are asked for.
        picture = replace(picture, luminance=picture.color[..., 0])
        return cls(candidates, own, picture, Blocks.around(*centers, picture.shape))

    @cached_property
    def color(self) -> Float32:
        """The colours, divided by the unit of the intensities, see `sigma`."""
        unit = self.picture.intensities.unit
        return self.picture.color if unit == 1 else self.picture.color / np.float32(unit)

    def sigma(self, color_sigma: float) -> float:
        """Return sigma_lambda of (16), a share of the contrast, as `color` has it."""
        intensities = self.picture.intensities
        return color_sigma * intensities.contrast / intensities.unit

    @cached_property
    def data_term(self) -> Float32:
        """The cost of each scale at each window, see `data_term`: (R, C, L)."""
        return data_term(self.own)

    @cached_property
    def costs(self) -> Float32 | Costs:
        """The same; of a large picture, worked out where it is asked for."""
        is_large = self.own.mode == "curve" and self.blocks.area.size > AT_ONCE
        return Costs.of(self.own) if is_large else self.data_term

    @cached_property
    def pixel_weight(self) -> NDArray[np.uint8] | None:
        """How much the data term counts at each pixel, (H, W); None if once at all."""
        sharp = self.candidates.sharp
        if sharp is None:
            return None
        return np.where(sharp, 1 + EXTRA_OF_SHARP, 1).astype(np.uint8)

    @cached_property
    def block_weight(self) -> Float32:
        """How much it counts at all pixels of a block together: (R, C)."""
        sharp, area = self.candidates.sharp, self.blocks.area
        if sharp is None:
            return area
        return area + EXTRA_OF_SHARP * self.blocks.count(sharp).astype(np.float32)

    def block_cost(self, curve_weight: np.float32) -> Float32:
        """Return `data_term` of all pixels of each block, times `unit`: (R, C, L)."""
        return self.data_term * (self.unit(curve_weight) * self.block_weight)[..., None]

    def block_costs(self, curve_weight: np.float32) -> Float32 | Costs:
        """Return the same; of a large picture, worked out where it is asked for."""
        costs = self.costs
        if isinstance(costs, Costs):
            return costs.times(self.unit(curve_weight) * self.block_weight)
        return self.block_cost(curve_weight)

    def unit(self, curve_weight: np.float32) -> float:
        """Return the weight of `data_term` in the energy: that, but in the mode "paper" 1."""
        return 1.0 if self.candidates.mode == "paper" else float(curve_weight)

    @cached_property
    def squared_step(self) -> Float32:
        """How much the colour changes at edges that may be blurred, see `squared_step_of`."""
        return squared_step_of(self.color, self.blocks)

    @cached_property
    def pairs(self) -> Float32:
        """How many pairs of pixels there are between neighbouring blocks: (4, R, C)."""
        return self.blocks.edge_weights(np.zeros((*self.picture.shape, 1), np.float32), 1.0, 1.0)


def _picture_of(
    candidates: BlurCandidates,
    image: ArrayLike | PreparedImage,
    intensity_range: tuple[float, float] | None,
) -> PreparedImage:
    """Prepare the picture that candidates came from, or say that it is another one."""
    if isinstance(image, PreparedImage):
        # Of candidates, the contrast is known to be above the noise.
        picture = replace(image, intensities=candidates.intensities or image.intensities)
    else:
        picture = prepare_image(
            image, candidates.intensities if intensity_range is None else intensity_range
        )
    if picture.shape != candidates.image_shape:
        raise ValueError(
            f"image is {picture.shape[0]} x {picture.shape[1]} px; these candidates are of a "
            f"picture of {candidates.image_shape[0]} x {candidates.image_shape[1]} px"
        )
    return picture


@dataclass(frozen=True, eq=False)
class CoarseLabels:
    """Labels of a whole picture's coarser grid, where a part of it lies.

    Attributes
    ----------
    labels : (r, c) int32 ndarray
        r is R / 2, R / 4 or so, rounded up, for the R x C blocks of the part.
    own : (slice, slice)
        Which of the part's rows and columns of blocks matter.
    inner_sides : tuple of bool
        Whether the picture goes on beyond the part's top, left, bottom and right.
    """

    labels: NDArray[np.int32]
    own: tuple[slice, slice]
    inner_sides: tuple[bool, bool, bool, bool]

    def hold(self, data: Float32, price: float) -> None:
        """Add a price for each label that the rim of the part differs, to costs (R, C, L)."""
        rows, columns, count = data.shape
        factor = 1
        while -(-rows // factor) > self.labels.shape[0]:
            factor *= 2
        fine = self.labels.repeat(factor, 0).repeat(factor, 1)[:rows, :columns]
        top, left, bottom, right = self.inner_sides
        held = np.zeros((rows, columns), bool)
        held[0] |= top
        held[-1] |= bottom
        held[:, 0] |= left
        held[:, -1] |= right
        away = np.abs(np.arange(count) - fine[held][:, None])
        data[held] += (price * away).astype(np.float32)


class UnknownProblemError(LookupError):
    """No problem of that name is known here."""


_problems: OrderedDict[str, LabelingProblem] = OrderedDict()


def with_problem(
    function: Callable[..., Result],
    name: str,
    ingredients: Ingredients | None,
    *,
    progress: Progress = silent,
    **keywords: object,
) -> Result:
    """Call a function with a problem that this process remembers.

    For a process that is told the candidates of a picture once, and asked to label them often.

    Parameters
    ----------
    function : callable
        Called as ``function(problem, progress=progress, **keywords)``.
    name : str
        Of the problem; the last two are remembered.
    ingredients : (BlurCandidates, image, intensity_range) or None
        What `LabelingProblem.of` takes; None if the problem should be known.
    progress : callable, optional
    **keywords
        Of the function.

    Raises
    ------
    UnknownProblemError
        If it is not known and no ingredients are given.
    """
    problem = _problems.pop(name, None)
    if problem is None:
        if ingredients is None:
            raise UnknownProblemError(name)
        problem = LabelingProblem.of(*ingredients)
    _problems[name] = problem
    while len(_problems) > _REMEMBERED:
        _problems.popitem(last=False)
    return function(problem, progress=progress, **keywords)
