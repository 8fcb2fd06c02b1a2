"""Which of the pictures in a TIFF is meant: the slide, without its label and its previews."""

from __future__ import annotations

from math import prod
from typing import Any

_BASELINE = "baseline"
"""What tifffile calls the picture that a slide is about."""

_BESIDE = ("label", "macro", "map", "overview", "preview", "thumbnail")
"""The first words in the names of pictures that slides have beside the main one."""

_LARGEST_EXTRA = 0.25
"""A picture with fewer pixels than this share of the largest one's counts as its preview."""

_MOST_LISTED = 6


def picture_number(tiff: Any) -> int:
    """Return which series of a file is the picture, or the stack, that it is about.

    It is the one that tifffile knows as a slide, or the largest if all others are much smaller or
    are, by their names, labels and previews. If none is clearly the one, ValueError lists them.
    """
    numbers = _candidates(tiff.series)
    pixels = [prod(tiff.series[number].shape) for number in numbers]
    largest = max(pixels)
    if sum(count >= _LARGEST_EXTRA * largest for count in pixels) > 1:
        listed = [_described(tiff.series[number]) for number in numbers[:_MOST_LISTED]]
        listed += ["..."] * (len(numbers) > _MOST_LISTED)
        raise ValueError(
            f"it holds {len(numbers)} pictures ({', '.join(listed)}); one picture, or one stack, "
            "is read"
        )
    return numbers[pixels.index(largest)]


def told_choice(tiff: Any) -> str:
    """Return in words what of a file is the picture, and what was left out; "" if it is all."""
    taken = picture_number(tiff)
    levels = len(tiff.series[taken].levels)
    told = [f"the largest of {levels} levels"] if levels > 1 else []
    others = [_described(each) for number, each in enumerate(tiff.series) if number != taken]
    told += [f"left out: {', '.join(others)}"] if others else []
    return "; ".join(told)


def _candidates(series: list[Any]) -> list[int]:
    if series[0].kind == "lsm":
        # The other one has a small picture of each plane.
        return [0]
    names = [str(each.name).lower() for each in series]
    slides = [number for number, name in enumerate(names) if name == _BASELINE]
    if slides:
        return slides
    shown = [number for number, name in enumerate(names) if not name.startswith(_BESIDE)]
    return shown or list(range(len(series)))


def _described(series: Any) -> str:
    name = str(series.name).strip().lower()
    if not {"Y", "X"} <= set(series.axes):
        return f"{' x '.join(map(str, series.shape))} (axes {series.axes})"
    height, width = (series.shape[series.axes.index(axis)] for axis in "YX")
    size = f"{width} x {height} px"
    planes = prod(series.shape) // (height * width)
    planes //= series.shape[series.axes.index("S")] if "S" in series.axes else 1
    size += f", {planes} planes" if planes > 1 else ""
    known = name.startswith((_BASELINE, *_BESIDE))
    return f"{name} of {size}" if known else size
