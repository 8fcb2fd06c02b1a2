"""Blur of any size: the same windows on coarser and coarser pictures, joined to one curve.

A window of 41 px tells radii up to 8 px. Twice as wide ones are measured with the same window on
the picture whose pixels are means of 2 x 2, and so on: level l has pixels of 2^l px. The PSF is
the family's own there, and white noise would have 1 / 4^l of its variance; a camera's has more
(`averaged_pixels.noise_share`). One curve of all levels lives
on one axis of scales: 0.1 px apart up to 8 px, then as far apart as each level's own are, up to 16
px, 32 px, and so on.

Levels do not say the same, and not all that they say is true:

- What is blurred beyond a level's range looks like anything between 3 px and the end of the range,
  so all of that, and everything beyond, is as likely as the likeliest of it.
- What is blurred little looks like 1 to 2 px of a coarse level, as things have less fine detail
  than a white spectrum has. So all scales up to 3 px of level 1 (2 px of others) are one class.
- Windows of coarse levels are wide, and the sharper side wins in them: where a level says "little"
  and the finer one "much", the finer one, which sees less of its surroundings, is right.
- Sharp details that a finer level shows pixel by pixel are left out of the pictures of coarser
  ones (`sharp_details`), so that what is in front has no part in what these see of the ground. In
  and beside such details they have no say; places that are only beside them offer what the ground
  would say, too (`ground_beside`).
- Where the finer levels say "little" all around, and the window of a coarse level does not deny it,
  something sharp is before a blurred ground: the level has no say. If its window says "much", what
  looks sharp is noise, as scenes have details of all sizes. Where only some windows of the finer
  levels say "little", it is chance. Both lose their say.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from napari_defocus.core.compiled import compiled
from napari_defocus.core.image import PreparedImage
from napari_defocus.core.threads import in_bands
from napari_defocus.likelihood.between_windows import between, neighbors, of_four
from napari_defocus.likelihood.blur_spectra import LABEL_STEP
from napari_defocus.likelihood.candidates import BlurCandidates
from napari_defocus.likelihood.evidence import evidence_share, limit_below_top, limited_below_top
from napari_defocus.likelihood.exact_spectra import domain_of_window
from napari_defocus.likelihood.ground_beside import GroundBeside
from napari_defocus.likelihood.own_side import on_own_side
from napari_defocus.likelihood.prior import log_prior
from napari_defocus.likelihood.sharp_details import SharpDetails

Float32 = NDArray[np.float32]
Float64 = NDArray[np.floating]

_ANYTHING = 3.0
"""px of a level, if its windows tell 8 px. Blur beyond the range of a level looks like more than
this.
"""

_LITTLE, _LITTLE_OF_FIRST = 2.0, 3.0
"""px of such a level: up to there, radii are one class. Of level 1 it is more, as level 0 tells
radii below 6 px better (bumps: 0.32 px with 2, 0.27 with 3; docs/decisions.md)."""

_SAY = np.float32(0.5)
"""Weight of a level, beside level 0: each level also sees what the one before it saw
(docs/decisions.md).
"""

_STEEPNESS = np.float32(6)
"""Units of log-likelihood from surely one class to surely the other. Chosen by hand."""

_ALL, _SOME = np.float32(0.9), np.float32(0.6)
"""If more than the first share of the windows around say "little", coarser levels do not count. If
fewer than the second, they count fully.
"""

_SURELY_MUCH = np.float32(1.5)
"""Of the share of the windows around that say "much", before it is cut off at 1: two thirds are
enough. Chosen on a sharp subject before a blur of 20 px (docs/decisions.md)."""

_AROUND = 1.77
"""Windows: standard deviation of the Gaussian over which windows count as around, that of a
window's own weights if they lie 4 px apart."""

_BESIDE, _FEW, _MANY = 3.0, np.float32(0.05), np.float32(0.2)
"""px of a level, over which the share of what is hidden is averaged; up to and from which share the
level has all of its say, and none."""

_PIECE = 32
"""Rows of a level's windows whose curves are joined at once; for memory only."""

_MARGIN = 96
"""px of a level that a place sees at most: half a window, half a window that windows move, what
evidence is averaged over, the spaces between windows, and what makes pixels be left out."""


def reach_of(levels: int, window: int) -> int:
    """Return how far, in px, a place sees with so many levels, but for what level 0 sees."""
    return 0 if levels == 1 else int(np.ceil(_MARGIN * window / 41)) * 2 ** (levels - 1)


def joined_scales(largest: float, window: int, levels: int) -> Float64:
    """Return the axis of scales, in px, of curves of so many levels: (L,)."""
    domain = domain_of_window(window)
    parts = [LABEL_STEP * np.arange(int(min(domain, largest) / LABEL_STEP + 1e-6) + 1)]
    for level in range(1, levels):
        step, start = LABEL_STEP * 2**level, domain * 2 ** (level - 1)
        count = int((min(domain * 2**level, largest) - start) / step + 1e-6)
        parts.append(start + step * np.arange(1, count + 1))
    return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class Level:
    """What one level says.

    Attributes
    ----------
    picture : PreparedImage
        Of pixels that are means of `side` x `side` px.
    candidates : BlurCandidates
        In px of the level.
    side : int
    hidden : (h, w) bool ndarray
        What was left out of the picture, as finer levels show it sharp.
    """

    picture: PreparedImage
    candidates: BlurCandidates
    side: int
    hidden: NDArray[np.bool_]

    def places(self, row_centers: Float64, column_centers: Float64) -> tuple[Float64, Float64]:
        """Return where places, in px of level 0, lie between the windows, counted in windows."""
        found = self.candidates
        rows, columns = (
            np.clip(((at + 0.5) / self.side - 0.5 - own[0]) / found.stride, 0, max(len(own) - 1, 0))
            for at, own in (
                (row_centers, found.row_centers),
                (column_centers, found.column_centers),
            )
        )
        return rows, columns


def joined(
    levels: list[Level], scales: Float64, start: tuple[int, int], details: SharpDetails
) -> tuple[Float32, Float32]:
    """Join the curves of all levels.

    Parameters
    ----------
    levels : list of Level
        From the finest on; the finest may show a part of what the others show. Its curves are
        limited in place.
    scales : (L,) float64 ndarray
        Of the joined curve, see `joined_scales`.
    start : (int, int)
        First row and column, in px, that the finest one shows.
    details : SharpDetails
        Of the whole picture at the finest level.

    Returns
    -------
    curve : (R, C, L) float32 ndarray
        In log-likelihood, 0 at its top.
    weight : (R, C) float32 ndarray
        How much a place counts: what wide windows say, many places share.
    """
    finest = levels[0].candidates
    at = finest.row_centers + start[0], finest.column_centers + start[1]
    before = limit_below_top(finest.curve)
    unit = domain_of_window(finest.window) / 8
    anything = unit * _ANYTHING
    total = _on_axis(before, 1, scales, finest.scales, anything)
    octaves = np.zeros(total.shape[:2], np.float32)
    closed, sharply = np.zeros_like(octaves), np.zeros_like(octaves)
    fine = levels[0]
    ground = GroundBeside.of(details, at, finest.stride, len(scales))
    own_best = ground.best(before, finest.scales)
    for number, level in enumerate(levels[1:], 1):
        little = unit * (_LITTLE_OF_FIRST if number == 1 else _LITTLE)
        own = on_own_side(level.candidates, level.picture)
        plain = limited_below_top(np.asarray(own.curve))
        around = np.stack(
            _said_around(before, fine.candidates.scales, anything, 2 * little), axis=2
        )
        if fine.side > 1:
            around = between(around, *fine.places(*at))
        here = between(_said_here(level, own, plain, little), *level.places(*at))
        closed = np.maximum(closed, np.clip((around[..., 0] - _SOME) / (_ALL - _SOME), 0, 1))
        sharply = np.maximum(sharply, _beside_hidden(level, at))
        free = 1 - np.maximum(closed * here[..., 2], sharply)
        much = here[..., 0] * free * (1 - here[..., 1])
        spilled = here[..., 1] * np.minimum(_SURELY_MUCH * around[..., 1], 1)
        gain = _SAY * here[..., 0] * free * (1 - spilled)
        keep = 1 - much * _share_below(total, scales, anything * level.side / 2)
        rows, columns = level.places(*at)
        for some in _pieces(len(total), level.side):
            seen = _rows_between(rows[some], len(plain))
            own_axis = level.candidates.scales
            curve = _on_axis(plain[seen], level.side, scales, own_axis, anything, little)
            part = curve, seen.start, len(plain)
            given = rows[some], columns, keep[some], gain[some], total[some]
            in_bands(_add_level, len(total[some]), *part, *given)
            ground.add(*part, some, rows, columns, _SAY * here[..., 0])
        octaves += much * _octaves(number, last=number == len(levels) - 1)
        before, fine = plain, level
    del before, plain, curve
    total -= total.max(axis=2, keepdims=True)
    ground.offered(total, own_best, scales, anything)
    return total, ((1 + octaves) ** -2).astype(np.float32)


def _pieces(length: int, side: int) -> Iterator[slice]:
    """Cut rows of windows into pieces, for which a level has about as many rows each."""
    for start in range(0, length, _PIECE * side):
        yield slice(start, min(start + _PIECE * side, length))


def _rows_between(rows: Float64, height: int) -> slice:
    """Return the rows of windows that places at some rows lie between."""
    last = max(height - 2, 0)
    return slice(min(int(rows[0]), last), min(min(int(rows[-1]), last) + 2, height))


def _said_here(level: Level, own: BlurCandidates, plain: Float32, little: float) -> Float32:
    """Return how far a level has evidence, and how surely it says "little": (r, c, 3).

    On each place's own side, whose curves are `plain`, and last by windows that are not moved.
    """
    axis, unmoved = level.candidates.scales, limited_below_top(level.candidates.curve)
    says = (_share_below(curve, axis, little, prior=False) for curve in (plain, unmoved))
    return np.stack([evidence_share(own), *says], axis=2)


def _beside_hidden(level: Level, at: tuple[Float64, Float64]) -> Float32:
    """Return how surely places, in px of level 0, are in or beside what a level hides: (R, C)."""
    density = gaussian_filter(level.hidden.astype(np.float32), _BESIDE, truncate=3.0)
    rows, columns = (
        np.clip((places + 0.5) / level.side - 0.5, 0, length - 1)
        for places, length in zip(at, level.hidden.shape, strict=True)
    )
    found = between(density[..., None], rows, columns)[..., 0]
    return np.clip((found - _FEW) / (_MANY - _FEW), 0, 1)


def _octaves(level: int, *, last: bool) -> np.float32:
    """Return how many octaves beyond 8 px more the radius is, in the mean, if a level says "much".

    Level 1 says so from 6 px on, which is none; level 2 from 8 px on, up to 16 px if there is a
    next one; each next one adds an octave, and the last one, which tells two, half of another.
    """
    if level == 1:
        return np.float32(0)
    return np.float32((0.5 if level == 2 else 1.0) + (0.5 if last else 0.0))


def strongest(levels: list[Level], start: tuple[int, int]) -> Float32:
    """Return `BlurCandidates.strength` of the level that sees most at each place: (R, C).

    `start` is the first row and column, in px, that the finest level shows.
    """
    finest = levels[0].candidates
    at = finest.row_centers + start[0], finest.column_centers + start[1]
    found = _strength(levels[0])
    for level in levels[1:]:
        coarse = between(_strength(level)[..., None], *level.places(*at))
        found = np.maximum(found, coarse[..., 0])
    return found


def _strength(level: Level) -> Float32:
    strength = level.candidates.strength
    assert strength is not None, "levels are estimated, not made by hand"
    return strength


def _on_axis(
    curve: Float32,
    side: int,
    scales: Float64,
    own: Float64,
    anything: float,
    little: float | None = None,
) -> Float32:
    """Return curves of a level at the scales of all: one class below, one beyond its range."""
    first = int(np.searchsorted(own, anything - 1e-6))
    last = 0 if little is None else int(np.searchsorted(own, little + 1e-6))
    at = scales / side
    inside = int(np.searchsorted(at, own[-1] + 1e-6))
    position = np.minimum(at[:inside] / LABEL_STEP, len(own) - 1)
    low = np.minimum(position.astype(np.int64), len(own) - 2)
    share = (position - low).astype(np.float32)
    found = np.empty((*curve.shape[:2], len(scales)), np.float32)
    in_bands(_put_on_axis, len(curve), curve, low, share, first, last, found)
    return found


@compiled
def _put_on_axis(
    start: int,
    stop: int,
    curve: Float32,
    low: NDArray[np.int64],
    share: Float32,
    first: int,
    last: int,
    found: Float32,
) -> None:
    """Interpolate curves; those before `last`, and those beyond the range, are one class each.

    Of level 1 the two have 3 px in common: where it says "little", it denies no wide blur, as a
    subject spills over into its windows (without it, 4.8 instead of 3.4 px off beside one).
    """
    own = np.empty(curve.shape[2], np.float32)
    for i in range(start, stop):
        for j in range(curve.shape[1]):
            little, beyond = np.float32(-np.inf), np.float32(-np.inf)
            for k in range(last):
                little = max(little, curve[i, j, k])
            for k in range(len(own)):
                own[k] = little if k < last else curve[i, j, k]
                if k >= first:
                    beyond = max(beyond, own[k])
            for k in range(len(low)):
                found[i, j, k] = own[low[k]] + share[k] * (own[low[k] + 1] - own[low[k]])
            for k in range(len(low), found.shape[2]):
                found[i, j, k] = beyond


def _share_below(curve: Float32, scales: Float64, limit: float, *, prior: bool = True) -> Float32:
    """Return how surely a scale is at most `limit`: (R, C) from 0 to 1."""
    before = log_prior(scales) if prior else np.zeros(len(scales), np.float32)
    below = int(np.searchsorted(scales, limit + 1e-6))
    if below >= len(scales):
        return np.ones(curve.shape[:2], np.float32)
    rise = np.empty(curve.shape[:2], np.float32)
    in_bands(_rise_below, len(curve), curve, before, below, rise)
    return np.clip(np.float32(0.5) + rise / _STEEPNESS, 0, 1)


@compiled
def _rise_below(
    start: int, stop: int, curve: Float32, prior: Float32, below: int, rise: Float32
) -> None:
    """Return how much higher curves are, at their best, before a scale than from it on."""
    for i in range(start, stop):
        for j in range(curve.shape[1]):
            low, high = np.float32(-np.inf), np.float32(-np.inf)
            for k in range(below):
                low = max(low, curve[i, j, k] + prior[k])
            for k in range(below, curve.shape[2]):
                high = max(high, curve[i, j, k] + prior[k])
            rise[i, j] = low - high


def _said_around(
    curve: Float32, scales: Float64, little: float, much: float
) -> tuple[Float32, Float32]:
    """Return which share of the windows around says "little", and which says "much": (R, C)."""
    said = _share_below(curve, scales, little), 1 - _share_below(curve, scales, much)
    first, second = (gaussian_filter(share, _AROUND, truncate=2.0) for share in said)
    return first, second


@compiled
def _add_level(
    start: int,
    stop: int,
    curve: Float32,
    first: int,
    height: int,
    rows: Float64,
    columns: Float64,
    keep: Float32,
    gain: Float32,
    total: Float32,
) -> None:
    """Multiply curves by a share of their own, and add a share of a coarser level's, between.

    `curve` holds rows of that level from the first one given on, of `height` in all.
    """
    _, width, count = curve.shape
    for i in range(start, stop):
        top, bottom, down = neighbors(rows[i], height)
        for j in range(len(columns)):
            left, right, along = neighbors(columns[j], width)
            kept, gained = keep[i, j], gain[i, j]
            if gained == 0 and kept == 1:
                continue
            for k in range(count):
                said = of_four(curve, top - first, bottom - first, left, right, down, along, k)
                total[i, j, k] = kept * total[i, j, k] + gained * said
