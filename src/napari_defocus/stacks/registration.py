"""How each plane of a stack lies on the one before.

Both planes show one scene, blurred differently. Blur by a symmetric PSF moves nothing. So the
cross-correlation of one place in both planes has its peak where the place has moved to. It is
computed in blocks, to a fraction of a pixel (`skimage.registration.phase_cross_correlation`). One
similarity (shift, magnification, turn) is fitted to the blocks, with weights that leave out those
that differ. The second plane is laid on the first, and the blocks measure what is left. How much
the blocks differ says how sure the motion is.

Neighbouring planes are compared, because their blur is similar. pystackreg compares whole planes.
It gives no error to tell a motion from none, and takes brightness for motion. Log-polar transforms
are not needed: between neighbours, magnifications of a few percent move the blocks by less than
their width.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from skimage.registration import phase_cross_correlation

from napari_defocus.stacks.alignment import StackAlignment, moved

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

_FIRST, _FRACTIONS = (1,), (20, 20)
"""Blocks are compared to this fraction of a pixel, in each round, before and after the rough motion
is known. The mean of many blocks is finer. Chosen by hand.
"""

_SPLINE = 3
"""Order of the splines that move a plane for the comparison. Finer splines keep details that are
not compared. Chosen by hand.
"""

_KNOWN = 0.95
"""The share of a block that must be known. Chosen by hand."""

_FEWEST_BLOCKS = 4
"""From so many blocks on, a magnification and a turn are fitted, too. Chosen by hand."""

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

    def inverse(self) -> Motion:
        """Return the way back."""
        return Motion(
            1 / self.factor, -self.shift / self.factor, self.error_of_factor, self.error_of_shift
        )


def motion_between(first: Float32, second: Float32) -> Motion:
    """Measure how a plane lies on another one.

    Parameters
    ----------
    first, second : (H, W) float32 ndarray
        Luminances; NaN is unknown.

    Returns
    -------
    Motion
        Its `error_of_shift` is infinite if there was nothing to compare.
    """
    motion = Motion()
    largest = max(first.shape)
    if largest > _COARSE_SIDE:
        step = -(-largest // _COARSE_SIDE)
        small = _refined(_shrunk(first, step), _shrunk(second, step), motion, _FIRST + _FRACTIONS)
        motion = Motion(small.factor, small.shift * step)
        return _refined(first, second, motion, _FRACTIONS)
    return _refined(first, second, motion, _FIRST + _FRACTIONS)


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
    errors = [
        math.hypot(motion.error_of_shift, corner * motion.error_of_factor) for motion in found
    ]
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


def _refined(first: Float32, second: Float32, motion: Motion, fractions: tuple[int, ...]) -> Motion:
    """Ask the blocks, several times, for what a motion leaves."""
    side = min(*first.shape, max(_LEAST_BLOCK, min(_MOST_BLOCK, min(first.shape) // 3)))
    slope = np.hanning(side + 2)[1:-1].astype(np.float32)
    window = slope[:, None] * slope
    pattern, known = _details(first)
    for fraction in fractions:
        other, seen = _details(moved(second, motion.factor, motion.shift, _SPLINE))
        places, left, weights = _asked(pattern, other, known & seen, window, fraction)
        if not len(places):
            return Motion()
        motion = _fitted(places, left, weights).before(motion)
    return motion


def _details(plane: Float32) -> tuple[Float32, Mask]:
    """Return the details of a plane that are compared, and where it is known."""
    known = np.isfinite(plane)
    filled = np.where(known, plane, plane[known].mean() if known.any() else 0).astype(np.float32)
    return gaussian_filter(filled, _FINE) - gaussian_filter(filled, _COARSE), known


def _asked(
    first: Float32, second: Float32, known: Mask, window: Float32, fraction: int
) -> tuple[Complex, Complex, Float64]:
    """Return where blocks are, how far the second plane has moved there, and how alike they are."""
    side = len(window)
    middle = complex(*((np.array(first.shape) - side) / 2))
    places, shifts, weights = [], [], []
    for row, column in _corners(first.shape, side):
        block = np.s_[row : row + side, column : column + side]
        here, there = first[block] * window, second[block] * window
        energy = math.sqrt(float((here**2).sum()) * float((there**2).sum()))
        likeness = float((here * there).sum()) / energy if energy > 0 else 0.0
        if likeness <= 0 or known[block].mean() < _KNOWN:
            continue
        shift, *_ = phase_cross_correlation(
            there, here, upsample_factor=fraction, normalization=None
        )
        places.append(complex(row, column) - middle)
        shifts.append(complex(*shift))
        weights.append(likeness**2)
    return np.array(places), np.array(shifts), np.array(weights)


def _corners(shape: tuple[int, ...], side: int) -> Iterator[tuple[int, int]]:
    """Return the first corners of blocks, half of which overlap unless there would be too many."""
    rows, columns = (
        np.linspace(0, length - side, min(_BLOCKS_A_SIDE, 2 * (length // side) - 1)).astype(int)
        for length in shape
    )
    return ((int(row), int(column)) for row in rows for column in columns)


def _fitted(places: Complex, shifts: Complex, likeness: Float64) -> Motion:
    """Fit a similarity to what blocks say, those less that say something else."""
    weights, factor, spread = likeness, 0j, _TINY
    for _ in range(_ROBUST_ROUNDS):
        total = weights.sum()
        middle, shift = (weights * places).sum() / total, (weights * shifts).sum() / total
        away = places - middle
        spread = max(float((weights * np.abs(away) ** 2).sum() / total), _TINY)
        if len(places) >= _FEWEST_BLOCKS:
            factor = (weights * away.conj() * (shifts - shift)).sum() / total / spread
        off = np.abs(shifts - shift - factor * away)
        usual = max(float(np.median(off)) * _NORMAL, _LEAST_SCATTER)
        weights = likeness / (1 + (off / (_OUTLIER * usual)) ** 2)
    # Blocks that overlap by half say the same twice, along rows and along columns.
    independent = float(total**2 / (weights**2).sum()) / 4
    scatter = max(float((weights * off**2).sum() / total) / 2, _LEAST_SCATTER**2)
    error = math.sqrt(scatter / max(independent - 2, _LEAST_FREEDOM))
    return Motion(
        complex(1 + factor), complex(shift - factor * middle), error / math.sqrt(spread), error
    )
