"""Numbers of real pictures with a known answer, for run_all.py; see real.py."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from real import (
    mitochondria,
    nuclei,
    phones,
    plain_shapes,
    restored,
    walls,
    with_defaults,
)
from record import OURS, Number, Record


def measure_real(folder: Path, record: Record) -> None:
    """Measure phones, fluorescence, plain shapes and walls of a folder as data/real."""
    for name, by in (("phones, binned", 3), ("phones, full size", 1)):
        points = list(phones(folder, with_defaults, by=by))
        add = _adder(record, name)
        add("mean error", tuple(each.error for each in points), unit="px", better="lower")
        add("rank correlation", tuple(each.rank for each in points), better="higher")
        add("stated confidence", tuple(float(each.confidence.mean()) for each in points))
        add("right", tuple(float(each.right.mean()) for each in points), unit="%", better="higher")
    for name, found in (("walls", walls), ("plain shapes", plain_shapes)):
        points = list(found(with_defaults))
        add = _adder(record, name)
        add("mean error", tuple(each.error for each in points), unit="px", better="lower")
    correlation, _ = mitochondria(folder, with_defaults)
    _adder(record, "mitochondria")("rank correlation", (correlation,), better="higher")
    radii = [float(np.median(with_defaults(image)[0][objects])) for _, image, objects in nuclei()]
    in_order = float(np.all(np.diff(radii) > 0))
    _adder(record, "nuclei")("right order", (in_order,), unit="%", better="higher")
    gains = tuple(after[0] - before[0] for _, before, after, _ in restored(folder))
    _adder(record, "phones, binned")("gain of restoring", gains, unit="dB", better="higher")


def _adder(record: Record, what: str) -> Callable[..., None]:
    def add(measure: str, values: tuple[float, ...], unit: str = "", better: str = "") -> None:
        record.add(Number(f"real: {what}", measure, OURS, values, unit, better))

    return add
