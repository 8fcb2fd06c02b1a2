"""Planes of a stack laid on each other and equally bright, each read and interpolated once.

Between planes that move, nothing can be compared; so motion and brightness are measured in one
pass over neighbouring planes, before anything else is. "auto" applies what is surely there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, gaussian_filter

from napari_defocus.core.image import LUMA_WEIGHTS
from napari_defocus.core.known_pixels import known_pixels
from napari_defocus.core.progress import Progress
from napari_defocus.stacks.alignment import SPLINE, StackAlignment, moved
from napari_defocus.stacks.exposure import (
    LARGEST_DRIFT,
    Exposure,
    Squares,
    exposure_of,
    squares_of,
)
from napari_defocus.stacks.planes import StackPlanes
from napari_defocus.stacks.registration import Details, Motion, alignment_of, motion_between
from napari_defocus.stacks.white import White

Float32 = NDArray[np.float32]
Align = Literal["auto"] | bool | StackAlignment
Match = Literal["auto"] | bool

MEASURING = "Comparing neighbouring planes"
"""The step in which motion and brightness are measured."""

_SURE = 4.0
"""A motion or a gain is there from so many standard errors on. Chosen by hand."""

_LEAST_MOTION, _LEAST_GAIN = 0.35, 0.005
"""px at a corner, and factor beyond 1: less is not corrected by "auto". Chosen by hand: stacks that
do not move measure up to 0.3 px at their ends.
"""

_MOST_UNCERTAINTY = 1.0
"""px: less certain alignments do not count, unless planes have moved much farther. By hand."""

_EVENLY = 1
"""Order of the splines that move a plane to compare means over squares."""

_SPLINE_REACH = 2
"""px around unknown pixels that splines spoil."""

_DARKEST, _SMOOTH = 0.001, 2.0
"""Quantile of a plane that counts as dark, once a Gaussian of so many px has averaged its noise.
Chosen by hand.
"""


@dataclass(frozen=True, eq=False)
class MatchedPlanes:
    """Planes of a stack, read as `StackPlanes` are, laid on one of them and equally bright.

    Attributes
    ----------
    planes : StackPlanes
    alignment : StackAlignment or None
        None if planes stay where they are.
    exposure : Exposure or None
        None if planes stay as bright as they are.
    evenly_lit : bool
        Whether planes are known to be equally bright, as found or made.
    white : float
        The value at which the camera clipped light, infinity if it clipped none.
    notes : tuple of str
        What was found and done, a sentence each.
    """

    planes: StackPlanes
    alignment: StackAlignment | None = None
    exposure: Exposure | None = None
    evenly_lit: bool = False
    white: float = np.inf
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Count the planes."""
        return len(self.planes)

    @property
    def shape(self) -> tuple[int, ...]:
        """See `StackPlanes.shape`."""
        return self.planes.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of the stack."""
        return self.planes.dtype

    def read(self, number: int) -> NDArray[Any]:
        """Read one plane: (H, W) or (H, W, C) of the stack's dtype, masked where it shows nothing.

        Raises
        ------
        ValueError
            If it has infinite values.
        """
        plane = self.planes.read(number)
        if not (self.moves(number) or self._changes(number)):
            return plane
        known = known_pixels(plane)
        values = np.ma.getdata(plane).astype(np.float64 if plane.dtype.itemsize > 2 else np.float32)
        if self._changes(number):
            colors = values[..., :3] if values.ndim == 3 else values
            colors[...] = self._lit(colors, number)
        if self.moves(number):
            values, known = self._moved(values, known, number)
        return _as_given(values, known, self.dtype)

    def look_at(self, number: int) -> NDArray[Any]:
        """Read a plane to compare it with others: clipped where the brightest one is, see `read`.

        Planes that were divided by different gains are clipped at different values. The darkest
        one would have the most contrast beside clipped light.
        """
        plane = self.read(number)
        if not np.isfinite(self._ceiling):
            return plane
        limited = plane.copy()
        colors = limited[..., :3] if limited.ndim == 3 else limited
        colors[...] = np.minimum(colors, self.dtype.type(self._ceiling))
        return limited

    @property
    def _ceiling(self) -> float:
        """Where the plane that was made darkest is clipped; infinity if none was made darker."""
        if self.exposure is None or not np.isfinite(self.white):
            return np.inf
        offset = self.exposure.offset
        lowest = np.asarray((self.white - offset) / self.exposure.gain.max() + offset)
        return float(cast_to(lowest, self.dtype))

    def moves(self, number: int) -> bool:
        """Whether a plane is read between its pixels."""
        return self.alignment is not None and self.alignment.motion[number] > 0

    def brightest(self, plane: NDArray[Any], number: int) -> Float32:
        """Return the brightest colour of each pixel of a plane that was looked at.

        As it was given, unless it is known where light is clipped: then all planes are clipped at
        the same value.
        """
        values = np.ma.getdata(plane)
        found = values if values.ndim == 2 else values[..., 0]
        for channel in range(1, min(values.shape[2], 3) if values.ndim == 3 else 1):
            found = np.maximum(found, values[..., channel])
        found = found.astype(np.float32)
        known = known_pixels(plane)
        if known is not None:
            found[~known] = found[known].min() if known.any() else 0
        if self.exposure is None or np.isfinite(self._ceiling):
            return found
        gain, offset = self.exposure.gain[number], self.exposure.offset
        given: Float32 = (found - np.float32(offset)) * np.float32(gain) + np.float32(offset)
        return given

    def clipped(self, number: int) -> NDArray[np.bool_]:
        """Return where the camera clipped a plane's light, in each colour, as it is laid."""
        plane = self.planes.read(number)
        at_white = np.ma.getdata(plane) >= self.white
        if self.moves(number):
            assert self.alignment is not None
            colors = at_white.reshape(*at_white.shape[:2], -1).astype(np.float32)
            laid = [
                self.alignment.aligned(colors[..., each], number, order=0)
                for each in range(colors.shape[2])
            ]
            at_white = (np.stack(laid, axis=-1) == 1).reshape(at_white.shape)
        return at_white

    def _changes(self, number: int) -> bool:
        return self.exposure is not None and self.exposure.gain[number] != 1

    def _lit(self, values: NDArray[Any], number: int) -> NDArray[Any]:
        assert self.exposure is not None
        offset = self.exposure.offset
        return (values - offset) / self.exposure.gain[number] + offset

    def _moved(
        self, values: NDArray[Any], known: NDArray[np.bool_] | None, number: int
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        assert self.alignment is not None
        lay = self.alignment.aligned
        if known is not None:
            fill = values[known].mean(axis=0) if known.any() else 0
            values = np.where(known[..., None] if values.ndim == 3 else known, values, fill)
        channels = values.reshape(*values.shape[:2], -1)
        laid = np.stack(
            [
                lay(channels[..., each], number, order=_ORDER_OF_OPACITY if each == 3 else SPLINE)
                for each in range(channels.shape[2])
            ],
            axis=-1,
        ).reshape(values.shape)
        shown = np.isfinite(laid if laid.ndim == 2 else laid[..., 0])
        if known is not None:
            safe = binary_erosion(known, iterations=_SPLINE_REACH, border_value=1)
            shown &= lay(safe.astype(np.float32), number, order=0) == 1
        # Splines swing beyond the values beside something bright: no pixel was so.
        low, high = values.min(axis=(0, 1)), values.max(axis=(0, 1))
        return np.clip(np.nan_to_num(laid, copy=False), low, high), shown


_ORDER_OF_OPACITY = 0
"""Order of the splines that move a fourth channel: 0, so that each pixel keeps one opacity."""


def _as_given(
    values: NDArray[Any], known: NDArray[np.bool_] | None, dtype: np.dtype[Any]
) -> NDArray[Any]:
    """Return values in the dtype of the stack, rounded, masked where they are not known."""
    given = cast_to(values, dtype)
    if known is None or known.all():
        return given
    unknown = ~known if given.ndim == 2 else np.broadcast_to(~known[..., None], given.shape)
    return np.ma.masked_array(given, unknown)


def cast_to(values: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return numbers in a dtype: rounded, and at most its largest, if it is one of integers."""
    if dtype.kind == "f":
        return values.astype(dtype)
    if dtype.kind == "b":
        return np.asarray(values > 0.5)
    limits = np.iinfo(dtype)
    # Doubles beside the largest integers of 64 bits round up beyond them.
    high = np.nextafter(float(limits.max) + 1, 0) if dtype.itemsize == 8 else float(limits.max)
    return np.rint(values).clip(float(limits.min), high).astype(dtype)


def check_align(align: Any) -> None:
    """Refuse what says nothing about the alignment."""
    if not isinstance(align, StackAlignment):
        _check_choice("align", align, ", or a StackAlignment")


def check_match(match_brightness: Any) -> None:
    """Refuse what says nothing about the brightness."""
    _check_choice("match_brightness", match_brightness)


def _check_choice(name: str, given: Any, more: str = "") -> None:
    if isinstance(given, str) and given == "auto":
        return
    if not isinstance(given, bool | np.bool_):
        raise TypeError(f"{name} is {given!r}; it takes 'auto', True or False{more}")


def matched(
    planes: StackPlanes, align: Align, match_brightness: Match, progress: Progress
) -> MatchedPlanes:
    """Measure how planes lie and how bright they are, and lay them on each other as is asked for.

    Parameters
    ----------
    planes : StackPlanes
    align : "auto", bool or StackAlignment
        "auto": if some plane surely moves. An alignment is used as it is.
    match_brightness : "auto" or bool
        "auto": if some plane is surely brighter or darker than the others.
    progress : callable
    """
    given = align if isinstance(align, StackAlignment) else None
    if given is not None:
        given.check_fits((planes.shape[0], planes.shape[1]), len(planes))
    if (given is not None or not align) and not match_brightness:
        return MatchedPlanes(planes, given, notes=_told_given(given))
    measured, exposure, white = _measured(planes, align, given, progress)
    alignment, notes = given, _told_given(given)
    if given is None and align:
        alignment, notes = _chosen_alignment(measured, align)
    if not match_brightness:
        return MatchedPlanes(planes, alignment, notes=notes)
    chosen, even, told = _chosen_exposure(exposure, match_brightness)
    return MatchedPlanes(planes, alignment, chosen, even, white, notes + told)


def _told_given(given: StackAlignment | None) -> tuple[str, ...]:
    return () if given is None else (f"Planes were aligned as given: {given}.",)


def _measured(
    planes: StackPlanes, align: Align, given: StackAlignment | None, progress: Progress
) -> tuple[StackAlignment | None, Exposure, float]:
    motions: list[Motion] = []
    pairs: list[Squares] = []
    darkest = np.inf
    white = White(planes.dtype)
    asked = given is None and bool(align)
    before: Float32 | None = None
    details: Details | None = None
    for number in range(len(planes)):
        progress(MEASURING, number / len(planes))
        given_plane = planes.read(number)
        white.see(given_plane)
        plane = _luminance(given_plane)
        darkest = min(darkest, _darkest(plane))
        if given is not None:
            plane = given.aligned(plane, number, _EVENLY)
        shown, details = details, Details.of(plane) if asked else None
        laid = plane
        if shown is not None and details is not None:
            motion = motion_between(shown, details)
            motions.append(motion)
            laid = moved(plane, motion.factor, motion.shift, _EVENLY)
        if before is not None:
            pairs.append(squares_of(before, laid, white.level))
        before = plane
    exposure = exposure_of(pairs, darkest if np.isfinite(darkest) else 0.0)
    if not motions:
        return None, exposure, white.level
    return alignment_of(motions, (planes.shape[0], planes.shape[1])), exposure, white.level


def _luminance(plane: NDArray[Any]) -> Float32:
    """Return the luminance of a plane in its own units, NaN where it is not known."""
    known = known_pixels(plane)
    values = np.ma.getdata(plane).astype(np.float32)
    if values.ndim == 3:
        if values.shape[2] >= 3:
            red, green, blue = (
                np.float32(weight) * values[..., k] for k, weight in enumerate(LUMA_WEIGHTS)
            )
            values = red + green + blue
        else:
            values = values[..., 0]
    return values if known is None else np.where(known, values, np.float32(np.nan))


def _darkest(plane: Float32) -> float:
    known = np.isfinite(plane)
    if not known.any():
        return float("inf")
    even = gaussian_filter(np.where(known, plane, plane[known].mean()), _SMOOTH)
    return float(np.quantile(even[known], _DARKEST))


def _chosen_alignment(
    measured: StackAlignment | None, align: Align
) -> tuple[StackAlignment | None, tuple[str, ...]]:
    """Return what is applied, and what is said of it."""
    if measured is None or not _is_certain(measured):
        told = "Planes show too little in common to tell whether they have moved"
        return None, (f"{told}; they were taken as aligned.",)
    if align != "auto":
        return measured, (f"Planes were aligned: {measured}.",)
    kept = _surely(measured)
    if kept.is_still:
        return None, (
            f"No plane moves by more than still planes seem to ({measured.largest_motion:.2f}"
            " px); none was aligned.",
        )
    return kept, (f"Planes were aligned: {kept}.",)


def _is_certain(measured: StackAlignment) -> bool:
    """Return whether planes lie where they are said to, or have surely moved much farther."""
    unsure = measured.uncertainty > _MOST_UNCERTAINTY
    return bool((measured.motion > _SURE * measured.uncertainty)[unsure].all())


def _surely(measured: StackAlignment) -> StackAlignment:
    """Return an alignment without magnifications, turns and shifts that may be chance."""
    still = StackAlignment.still(measured.shape, len(measured))
    kept = measured
    for part in ("magnification", "turn", "shift"):
        alone = replace(still, **{part: getattr(measured, part)})
        motion = alone.motion
        surely = (motion > _SURE * measured.uncertainty) & (motion > _LEAST_MOTION)
        if not surely.any():
            kept = replace(kept, **{part: getattr(still, part)})
    return kept


def _chosen_exposure(
    exposure: Exposure, match_brightness: Match
) -> tuple[Exposure | None, bool, tuple[str, ...]]:
    """Return what is applied, whether planes are equally bright then, and what is said of it."""
    gain, error = exposure.gain, exposure.error
    if not np.isfinite(error).all():
        told = "Planes show too little in common to compare how bright they are."
        return None, False, (told,)
    if gain.max() > LARGEST_DRIFT or gain.min() < 1 / LARGEST_DRIFT:
        told = f"Planes differ in brightness by factors from {gain.min():.2f} to {gain.max():.2f}"
        return None, False, (f"{told}: that is more than flicker, and was left as it is.",)
    off = np.abs(gain - 1)
    most = f"{100 * off.max():.1f} %"
    surely = (off > _SURE * error) & (off > _LEAST_GAIN)
    if match_brightness == "auto" and not surely.any():
        return None, True, (f"Planes are equally bright, to {most}.",)
    return exposure, True, (f"Planes were made equally bright; they differed by up to {most}.",)
