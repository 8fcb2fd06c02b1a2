"""What is odd about the fields of a batch: flags by limits, with a reason each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from napari_defocus.batch.blur_histogram import share_up_to
from napari_defocus.batch.table import FAILED, Row
from napari_defocus.batch.wells import wells_of
from napari_defocus.likelihood.signs import NOTHING_SEEN, ONE_DIRECTION
from napari_defocus.settings import FieldLimits

NOT_MEASURED = "failed"
NOT_DEFOCUS = "not defocus"
OUT_OF_FOCUS = "out of focus"
PARTLY = "partly out of focus"
SATURATED = "saturated"
EMPTY = "empty"

WORST_FIRST = (NOT_MEASURED, NOT_DEFOCUS, OUT_OF_FOCUS, PARTLY, SATURATED, EMPTY)
"""All flags, in the order in which a report has its fields."""


@dataclass(frozen=True)
class Flag:
    """One of `WORST_FIRST`, and why a field has it, in words."""

    name: str
    reason: str


def flags_of(row: Row, limits: FieldLimits) -> tuple[Flag, ...]:
    """Return the flags of a row of the table; none if the field can be trusted.

    Where nothing is known, or details lie in one direction, radii say little: such a field is not
    called out of focus.

    Parameters
    ----------
    row : dict
        With `blur_histogram`, as the JSON lines have it.
    limits : FieldLimits

    Examples
    --------
    >>> row = {"status": "done", "share_sure": 0.9, "median_known_radius_px": 4.25}
    >>> flags_of(row, FieldLimits())[0].reason
    'the median blur is 4.2 px, more than 1.5 px'
    """
    if row["status"] == FAILED:
        return (Flag(NOT_MEASURED, row.get("error") or "no reason is known"),)
    seen = [*_emptiness(row, limits), *_motion(row, limits)] or [*_blur(row, limits)]
    found = [*seen, *_saturation(row, limits)]
    return tuple(sorted(found, key=lambda flag: WORST_FIRST.index(flag.name)))


def _emptiness(row: Row, limits: FieldLimits) -> Iterator[Flag]:
    known = row.get("share_sure")
    if NOTHING_SEEN in (row.get("careful") or ""):
        yield Flag(EMPTY, "nothing stands out from the noise")
    elif known is None:
        yield Flag(EMPTY, "no pixel counts")
    elif known < limits.min_share_known:
        least = _percent(limits.min_share_known)
        yield Flag(EMPTY, f"the blur is known on {_percent(known)} of it, less than {least}")


def _motion(row: Row, limits: FieldLimits) -> Iterator[Flag]:
    preferred = row.get("one_direction")
    if preferred is not None and preferred > limits.max_one_direction:
        much = f"{preferred:.2f}, more than {limits.max_one_direction:g}"
        yield Flag(NOT_DEFOCUS, f"details lie in one direction, as after motion ({much})")
    elif ONE_DIRECTION in (row.get("careful") or ""):
        yield Flag(NOT_DEFOCUS, "nearly all details lie in one direction, as after motion")


def _blur(row: Row, limits: FieldLimits) -> Iterator[Flag]:
    radius, most = row.get("median_known_radius_px"), limits.in_focus_up_to
    sharp = share_within(row, limits)
    if radius is not None and radius > most:
        yield Flag(OUT_OF_FOCUS, f"the median blur is {radius:.1f} px, more than {most:g} px")
    elif sharp is not None and sharp < limits.min_share_in_focus:
        least = _percent(limits.min_share_in_focus)
        yield Flag(PARTLY, f"{_percent(sharp)} of what is known is in focus, less than {least}")


def _saturation(row: Row, limits: FieldLimits) -> Iterator[Flag]:
    share = row.get("share_saturated")
    if share is not None and share > limits.max_share_saturated:
        most = _percent(limits.max_share_saturated)
        told = f"{_percent(share)} of the pixels are saturated, more than {most}"
        yield Flag(SATURATED, told)


def share_within(row: Row, limits: FieldLimits) -> float | None:
    """Return the share of what is known of a field that is in focus by the limits."""
    histogram: Sequence[int] = row.get("blur_histogram") or ()
    return share_up_to(histogram, limits.in_focus_up_to) if histogram else None


def judged_rows(rows: Iterable[Row], limits: FieldLimits) -> list[Row]:
    """Return rows with the columns `JUDGED`: share in focus, flags, and well.

    Examples
    --------
    >>> rows = [{"source": "A01.tif", "status": "failed", "error": "it is damaged"}]
    >>> judged_rows(rows, FieldLimits())[0]["flags"]
    'failed'
    """
    given = list(rows)
    wells = wells_of(row["source"] for row in given)
    return [
        row
        | {
            "share_within_limit": share_within(row, limits),
            "flags": "; ".join(flag.name for flag in flags_of(row, limits)) or None,
            "well": wells.get(row["source"]),
        }
        for row in given
    ]


def flag_names(row: Row) -> list[str]:
    """Return the flags of a judged row."""
    flags: str = row.get("flags") or ""
    return flags.split("; ") if flags else []


def badness(row: Row) -> tuple[int, float]:
    """Return a key that sorts judged rows worst first: by their flags, then by their blur."""
    names = flag_names(row)
    rank = WORST_FIRST.index(names[0]) if names else len(WORST_FIRST)
    return rank, -(row.get("median_known_radius_px") or 0.0)


def _percent(share: float) -> str:
    return f"{float(f'{100 * share:.2g}'):g} %"
