"""How each plane of a stack lies on the one before.

Both planes show one scene, blurred differently. Blur by a symmetric PSF moves nothing. So the
cross-correlation of one place in both planes has its peak where the place has moved to. It is
computed in blocks, to a fraction of a pixel (`block_shifts`). One similarity (shift, magnification,
turn) is fitted to the blocks, with weights that leave out those that differ. The second plane is
laid on the first, and the blocks measure what is left, until it is little. How much the blocks
differ says how sure the motion is. Where few blocks show anything, as with cells on a dark
ground, they cannot tell a turn; then only a shift is fitted.

Neighbouring planes are compared, because their blur is similar. pystackreg compares whole planes.
It gives no error to tell a motion from none, and takes brightness for motion. Log-polar transforms
are not needed: between neighbours, magnifications of a few percent move the blocks by less than
their width.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from napari_defocus.stacks.alignment import StackAlignment, moved
from napari_defocus.stacks.block_shifts import block_shifts, block_spectra

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

_FINE, _COARSE = 1.0, 8.0
"""px: standard deviations of the Gaussians between which details are compared. Chosen by hand."""

_LEAST_BLOCK, _MOST_BLOCK, _BLOCKS_A_SIDE = 32, 128, 8
"""The least and the largest side of a block in px, and the most blocks along a side. By hand."""

_COARSE_SIDE = 512
"""px: planes with longer sides are first compared at this size. Chosen by hand."""

_ROUNDS, _SETTLED = 3, 0.05
"""How often blocks are asked at most, and px at a corner: what moves a plane less is the last. By
hand.
"""

_HARDLY = 0.5
"""px at a corner: a rough motion below it is left to the first round. Chosen by hand."""

_SPLINE = 3
"""Order of the splines that move details for the comparison. Chosen by hand."""

_KNOWN = 0.95
"""The share of a block that must be known. Chosen by hand."""

_FEWEST_BLOCKS = 4
"""From so many blocks on, a magnification and a turn are fitted, too. Chosen by hand."""

_UNSURE = 0.25
"""px at a corner: a similarity of a larger error is given up for a shift. Chosen by hand: four
neighbours of such an error are off by half a pixel.
"""

_OUTLIER = 1.5
"""A block counts less if it is off by more than so many standard deviations. Chosen by hand."""

_LEAST_SCATTER = 0.01
"""px: the least scatter of the blocks. Chosen by hand."""

_ROBUST_ROUNDS = 20

_NORMAL = 1.4826
"""Standard deviations of a normal distribution in its median absolute deviation."""

_LEAST_FREEDOM = 0.25
"""The least number of blocks beyond those that a similarity needs: fewer say little. By hand."""


_TINY = 1e-12


@dataclass(frozen=True)
class Motion:
    """How a plane lies on another: what one shows at x, it shows at factor x + shift.

    Places are complex numbers from the plane's middle, rows the real part.
    """

    factor: complex = 1.0
    shift: complex = 0.0
    error_of_factor: float = 0.0
    error_of_shift: float = math.inf

    def before(self, later: Motion) -> Motion:
        """Return this one, then another that was known; the errors are those of this one."""
        return Motion(
            later.factor * self.factor,
            later.factor * self.shift + later.shift,
            self.error_of_factor,
            self.error_of_shift,
        )

    def after(self, first: Motion) -> Motion:
        """Return the motion that is this one after another; errors add up."""
        return Motion(
            self.factor * first.factor,
            self.factor * first.shift + self.shift,
            math.hypot(self.error_of_factor, first.error_of_factor),
            math.hypot(self.error_of_shift, first.error_of_shift),
        )

    def at_corner(self, corner: float) -> float:
        """Return by how many px a place is moved at most that is so far from the middle."""
        return abs(self.shift) + corner * abs(self.factor - 1)

    def error_at_corner(self, corner: float) -> float:
        """Return the standard error of a place that is so far from the middle, in px."""
        return math.hypot(self.error_of_shift, corner * self.error_of_factor)

    def inverse(self) -> Motion:
        """Return the way back."""
        return Motion(
            1 / self.factor, -self.shift / self.factor, self.error_of_factor, self.error_of_shift
        )


@dataclass(frozen=True, eq=False)
class Details:
    """What of a plane is compared with another one.

    Attributes
    ----------
    fine : (H, W) float32 ndarray
        Details of middle size; NaN is unknown.
    rough : Details or None
        Those of a plane that is `step` times smaller. None if the plane is small.
    step : int
    """

    fine: Float32
    rough: Details | None = None
    step: int = 1

    @classmethod
    def of(cls, plane: Float32) -> Details:
        """Look at a luminance, (H, W); NaN is unknown."""
        largest = max(plane.shape)
        if largest <= _COARSE_SIDE:
            return cls(_details(plane))
        step = -(-largest // _COARSE_SIDE)
        return cls(_details(plane), cls(_details(_shrunk(plane, step))), step)

    @property
    def corner(self) -> float:
        """How far a corner is from the middle, in px."""
        return math.hypot(*self.fine.shape) / 2


def motion_between(first: Details, second: Details) -> Motion:
    """Measure how a plane lies on another one.

    Returns
    -------
    Motion
        Its `error_of_shift` is infinite if there was nothing to compare.
    """
    start = Motion()
    if first.rough is not None and second.rough is not None:
        rough = motion_between(first.rough, second.rough)
        scaled = Motion(rough.factor, rough.shift * first.step)
        start = scaled if scaled.at_corner(first.corner) > _HARDLY else start
    similarity = _refined(first, second, start)
    if similarity.error_at_corner(first.corner) < _UNSURE:
        return similarity
    shift = _refined(first, second, Motion(shift=start.shift), only_shift=True)
    return min(similarity, shift, key=lambda motion: motion.error_at_corner(first.corner))


def alignment_of(motions: list[Motion], shape: tuple[int, int]) -> StackAlignment | None:
    """Join the motions from plane to plane, each of the next one on the one before.

    None if there was nothing to compare between some of them.
    """
    if not all(math.isfinite(motion.error_of_shift) for motion in motions):
        return None
    count = len(motions) + 1
    reference = count // 2
    found = [Motion(error_of_shift=0.0)] * count
    for number in range(reference + 1, count):
        found[number] = motions[number - 1].after(found[number - 1])
    for number in range(reference - 1, -1, -1):
        found[number] = motions[number].inverse().after(found[number + 1])
    factors = np.array([motion.factor for motion in found])
    shifts = np.array([motion.shift for motion in found])
    corner = math.hypot(*shape) / 2
    errors = [motion.error_at_corner(corner) for motion in found]
    return StackAlignment(
        shape=shape,
        reference=reference,
        shift=np.stack([shifts.real, shifts.imag], axis=1),
        magnification=np.abs(factors),
        turn=np.rad2deg(np.angle(factors)),
        uncertainty=np.array(errors),
    )


def _shrunk(plane: Float32, step: int) -> Float32:
    """Return the means of squares of so many pixels a side."""
    height, width = (length - length % step for length in plane.shape)
    squares = plane[:height, :width].reshape(height // step, step, width // step, step)
    return np.asarray(squares.mean(axis=(1, 3)))


def _refined(first: Details, second: Details, motion: Motion, only_shift: bool = False) -> Motion:
    """Ask the blocks, several times, for what a motion leaves."""
    shape = first.fine.shape
    side = min(*shape, max(_LEAST_BLOCK, min(_MOST_BLOCK, min(shape) // 3)))
    blocks = _Blocks.of(first.fine, side)
    for _ in range(_ROUNDS):
        laid = moved(second.fine, motion.factor, motion.shift, _SPLINE)
        places, left, weights = blocks.asked(laid)
        if not len(places):
            return Motion()
        change = _fitted(places, left, weights, only_shift)
        motion = change.before(motion)
        if change.at_corner(first.corner) < _SETTLED:
            break
    return motion


def _details(plane: Float32) -> Float32:
    """Return the details of a plane that are compared; NaN where it is not known."""
    known = np.isfinite(plane)
    if known.all():
        return gaussian_filter(plane, _FINE) - gaussian_filter(plane, _COARSE)
    filled = np.where(known, plane, plane[known].mean() if known.any() else 0).astype(np.float32)
    details = gaussian_filter(filled, _FINE) - gaussian_filter(filled, _COARSE)
    return np.where(known, details, np.float32(np.nan))


@dataclass(frozen=True, eq=False)
class _Blocks:
    """The blocks of a plane that others are compared with.

    Attributes
    ----------
    corners : (N, 2) int ndarray
        Half of neighbouring blocks overlap unless there would be too many.
    places : (N,) complex128 ndarray
        Of their middles, from the middle of the plane.
    values : (N, S, S) float32 ndarray
        Details, less towards the edges.
    known : (N,) bool ndarray
    spectra : (N, S, S // 2 + 1) complex64 ndarray
    """

    corners: NDArray[np.int64]
    places: Complex
    values: Float32
    known: Mask
    spectra: NDArray[np.complex64]

    @classmethod
    def of(cls, details: Float32, side: int) -> _Blocks:
        """Cut blocks of a side."""
        lattice = [
            np.linspace(0, length - side, min(_BLOCKS_A_SIDE, 2 * (length // side) - 1)).astype(int)
            for length in details.shape
        ]
        corners = np.stack(np.meshgrid(*lattice, indexing="ij"), axis=-1).reshape(-1, 2)
        away = corners - (np.array(details.shape) - side) / 2
        values, known = _cut(details, corners, side)
        return cls(corners, away[:, 0] + 1j * away[:, 1], values, known, block_spectra(values))

    def asked(self, laid: Float32) -> tuple[Complex, Complex, Float64]:
        """Return where blocks are, how far details have moved there, and how alike they are."""
        side = self.values.shape[1]
        values, known = _cut(laid, self.corners, side)
        energy = _sums(self.values**2) * _sums(values**2)
        product = _sums(self.values * values)
        likeness = np.divide(product, np.sqrt(energy), where=energy > 0, out=np.zeros(len(energy)))
        kept = (likeness > 0) & known & self.known
        shifts = block_shifts(self.spectra[kept], block_spectra(values[kept]), side)
        return self.places[kept], shifts[:, 0] + 1j * shifts[:, 1], likeness[kept] ** 2


def _cut(details: Float32, corners: NDArray[np.int64], side: int) -> tuple[Float32, Mask]:
    """Cut blocks out of details, less towards their edges; return which are known, too."""
    slope = np.hanning(side + 2)[1:-1].astype(np.float32)
    blocks = np.stack(
        [details[row : row + side, column : column + side] for row, column in corners]
    )
    seen = np.isfinite(blocks)
    blocks[~seen] = 0
    return blocks * slope[:, None] * slope, seen.mean(axis=(1, 2)) >= _KNOWN


def _sums(blocks: Float32) -> Float64:
    return np.asarray(blocks.sum(axis=(1, 2), dtype=np.float64))


def _fitted(places: Complex, shifts: Complex, likeness: Float64, only_shift: bool) -> Motion:
    """Fit a similarity or a shift to what blocks say, those less that say something else."""
    weights, factor, spread = likeness, 0j, _TINY
    for _ in range(_ROBUST_ROUNDS):
        total = weights.sum()
        middle, shift = (weights * places).sum() / total, (weights * shifts).sum() / total
        away = places - middle
        spread = max(float((weights * np.abs(away) ** 2).sum() / total), _TINY)
        if len(places) >= _FEWEST_BLOCKS and not only_shift:
            factor = (weights * away.conj() * (shifts - shift)).sum() / total / spread
        off = np.abs(shifts - shift - factor * away)
        usual = max(float(np.median(off)) * _NORMAL, _LEAST_SCATTER)
        weights = likeness / (1 + (off / (_OUTLIER * usual)) ** 2)
    # Blocks that overlap by half say the same twice, along rows and along columns.
    independent = float(total**2 / (weights**2).sum()) / 4
    scatter = max(float((weights * off**2).sum() / total) / 2, _LEAST_SCATTER**2)
    used = 1 if only_shift else 2
    error = math.sqrt(scatter / max(independent - used, _LEAST_FREEDOM))
    error_of_factor = 0.0 if only_shift else error / math.sqrt(spread)
    return Motion(complex(1 + factor), complex(shift - factor * middle), error_of_factor, error)
