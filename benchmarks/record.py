"""Numbers with what made them: kept as JSON, shown as a table, compared with those of before."""

import datetime
import json
import os
import platform
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Self

import numpy as np

OURS, PAPER = "napari-defocus", "paper"
ORACLES = (
    "exact",
    "true map",
    "our map",
    "our map, with confidence",
    "our map up to 2 px",
    "the picture itself",
)
"""Methods that no one competes with: they know the truth, or are variants of ours."""

PACKAGES = (
    "napari-defocus", "numpy", "scipy", "numba", "scikit-image", "PyMaxflow", "blur-detector",
)  # fmt: skip
_DIGITS = 5
_LEAST_CHANGE = 5e-3


@dataclass(frozen=True)
class Number:
    """One measured number, and all that it was made from.

    Attributes
    ----------
    what, measure, method : str
        Such as "ramp, noise 1e-06", "mean error", "napari-defocus".
    values : tuple of float
        Of each picture or each run; those that are not known are left out.
    unit : str
    better : {"lower", "higher", ""}
    kind : {"pictures", "runs"}
        Of pictures the mean counts, of runs the median.
    part : str
        Which part of run_all.py measured it; set when it is added.
    """

    what: str
    measure: str
    method: str
    values: tuple[float, ...]
    unit: str = ""
    better: str = ""
    kind: str = "pictures"
    part: str = ""

    @property
    def key(self) -> tuple[str, str, str]:
        return self.what, self.measure, self.method

    @property
    def value(self) -> float:
        known = [value for value in self.values if np.isfinite(value)]
        if not known:
            return np.nan
        return float(np.median(known) if self.kind == "runs" else np.mean(known))

    @property
    def spread(self) -> float:
        """Of runs half their range; of pictures the standard error of their mean."""
        known = np.array([value for value in self.values if np.isfinite(value)])
        if len(known) < 2:
            return 0.0
        if self.kind == "runs":
            return float(np.ptp(known) / 2)
        return float(known.std(ddof=1) / np.sqrt(len(known)))

    def shown(self) -> str:
        if not np.isfinite(self.value):
            return ""
        if self.unit == "%":
            return f"{100 * self.value:.0f} %"
        digits = 3 if abs(self.value) < 10 else 1
        return f"{self.value:.{digits}f}"


@dataclass
class Record:
    """All numbers, and what made those of each part.

    Attributes
    ----------
    made : dict
        By part: date, machine, versions, pictures, minutes and load.
    numbers : list of Number
    part : str
        What is being measured.
    """

    made: dict[str, dict[str, object]]
    numbers: list[Number] = field(default_factory=list)
    part: str = ""

    def add(self, *found: Number) -> None:
        self.numbers += [replace(number, part=self.part) for number in found]

    def keep_others_of(self, earlier: Self) -> None:
        """Take the parts of an earlier record that are not in this one."""
        missing = [part for part in earlier.made if part not in self.made]
        self.made |= {part: earlier.made[part] for part in missing}
        self.numbers += [number for number in earlier.numbers if number.part in missing]

    def row(self, what: str, measure: str) -> dict[str, Number]:
        return {n.method: n for n in self.numbers if (n.what, n.measure) == (what, measure)}

    def rows(self) -> list[tuple[str, str]]:
        return list(dict.fromkeys((n.what, n.measure) for n in self.numbers))

    def as_json(self) -> bytes:
        numbers = [
            asdict(n) | {"values": [_rounded(v) for v in n.values], "value": _rounded(n.value),
                         "spread": _rounded(n.spread)}
            for n in self.numbers
        ]  # fmt: skip
        lines = ",\n".join(json.dumps(number) for number in numbers)
        return (
            f'{{"made": {json.dumps(self.made, indent=1)},\n"numbers": [\n{lines}\n]}}\n'.encode()
        )

    @classmethod
    def read(cls, path: Path) -> Self:
        try:
            stored = json.loads(path.read_text())
            names = ("what", "measure", "method", "unit", "better", "kind", "part")
            numbers = [
                Number(
                    **{name: n[name] for name in names},
                    values=tuple(np.nan if v is None else v for v in n["values"]),
                )
                for n in stored["numbers"]
            ]
            return cls(stored["made"], numbers)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise SystemExit(f"{path} is not the numbers.json of a run: {error}") from None


def _rounded(value: float) -> float | None:
    return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None


def circumstances(**settings: object) -> dict[str, object]:
    """Return when, where and with what numbers are measured."""
    return {
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in PACKAGES},
        "commit": _commit(),
        "load at the start": load(),
        **settings,
    }


def load() -> float | None:
    """Return how many processes wanted to compute in the last minute."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "")


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


@cache
def _commit() -> str:
    """Ask git once: the pages that are written change the working tree."""
    try:
        here = Path(__file__).parent
        command = ["git", "describe", "--always", "--dirty"]
        return subprocess.check_output(command, cwd=here, text=True, stderr=-3).strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def table(record: Record, rows: Iterable[tuple[str, str]], methods: Sequence[str]) -> str:
    """Return a Markdown table; the best of each row is bold, what has no column comes last."""
    lines = ["| what | measure | " + " | ".join(methods) + " | others |"]
    lines.append("|---" * (len(methods) + 3) + "|")
    for what, measure in rows:
        found = record.row(what, measure)
        best = best_methods(found)
        cells = [_cell(found.get(method), method in best) for method in methods]
        others = ", ".join(
            f"{method} {_cell(number, method in best)}"
            for method, number in found.items()
            if method not in methods
        )
        unit = next(iter(found.values())).unit
        name = measure + (f", {unit}" if unit not in ("", "%") else "")
        lines.append(f"| {what} | {name} | " + " | ".join(cells) + f" | {others} |")
    return "\n".join(lines)


def _cell(number: Number | None, best: bool) -> str:
    if number is None:
        return ""
    return f"**{number.shown()}**" if best and number.shown() else number.shown()


def best_methods(found: dict[str, Number]) -> set[str]:
    """Return whose number is best as it is shown, among at least two that can be compared."""
    known = {
        name: number
        for name, number in found.items()
        if np.isfinite(number.value) and name not in ORACLES
    }
    better = next(iter(known.values())).better if known else ""
    if len(known) < 2 or not better:
        return set()
    choose = max if better == "higher" else min
    best = choose(known.values(), key=lambda number: number.value).shown()
    return {name for name, number in known.items() if number.shown() == best}


def compared(before: Record, after: Record) -> str:
    """Say what of our own became better or worse beyond the spread, as Markdown."""
    old = {number.key: number for number in before.numbers}
    lines, counts = [], dict.fromkeys(("better", "worse", "the same", "new"), 0)
    for number in after.numbers:
        if not number.better:
            continue
        verdict = verdict_on(old.get(number.key), number)
        counts[verdict] += 1
        if verdict in ("better", "worse"):
            was = old[number.key]
            lines.append(f"| {number.what} | {number.measure} | {number.method} "
                         f"| {was.shown()} | {number.shown()} | **{verdict}** |")  # fmt: skip
    summary = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
    head = ["| what | measure | method | before | now | |", "|---" * 6 + "|"] if lines else []
    return "\n".join([*_warnings(before, after), f"{summary}.", "", *head, *lines])


def verdict_on(before: Number | None, after: Number) -> str:
    """Say "better", "worse", "the same" or "new".

    Pictures are compared one by one, because the same ones differ from run to run by what was
    changed only; runs by their medians. Half a percent is the least that counts.
    """
    if before is None or not (np.isfinite(before.value) and np.isfinite(after.value)):
        return "new"
    change = after.value - before.value
    spread = before.spread + after.spread
    if after.kind == "pictures" and len(before.values) == len(after.values) > 1:
        each = np.array(after.values) - np.array(before.values)
        each = each[np.isfinite(each)]
        if len(each) > 1:
            change = float(each.mean())
            spread = 2 * float(each.std(ddof=1)) / np.sqrt(len(each))
    if abs(change) <= max(spread, _LEAST_CHANGE * abs(before.value)):
        return "the same"
    return "better" if (change < 0) == (after.better == "lower") else "worse"


def _warnings(before: Record, after: Record) -> list[str]:
    names = ("processor", "cores", "quick", "seed", "pictures", "photographs")
    differ = {
        f"{part}: {name}"
        for part in before.made.keys() & after.made.keys()
        for name in names
        if before.made[part].get(name) != after.made[part].get(name)
    }
    return [f"The two runs differ in {', '.join(sorted(differ))}.", ""] if differ else []
