"""The pages of docs/measured/, written from a run's numbers."""

from collections.abc import Iterable

import numpy as np
from ablation import DEFAULT, EDGES, MASK, STEPS
from peers import SCORES
from record import OURS, PAPER, Number, Record, best_methods, table, verdict_on

MAIN_MEASURES = (
    "mean error",
    "in focus, area under ROC",
    "right where 0.9 is stated",
    "mean difference from what is right",
    "energy above the least",
    "PSNR",
    "time",
    "largest memory",
)
PARTS = ("accuracy", "wide", "photographs", "real", "energy", "restoration", "sizes")
METHODS = (OURS, PAPER, *SCORES)
_NOT_IN_TABLE = ("without a step", "with an option", "search for", "photograph ", "uniform, ")
_KEPT_UNIFORM = "uniform, noise"


def in_main_table(what: str, measure: str) -> bool:
    if measure.startswith("stated"):
        return False
    return what.startswith(_KEPT_UNIFORM) or not what.startswith(_NOT_IN_TABLE)


def main_table(record: Record) -> str:
    """Return the one table that run_all.py prints: what matters most of each group."""
    rows = [row for row in record.rows() if in_main_table(*row) and row[1] in MAIN_MEASURES]
    return table(record, rows, METHODS)


def whole_table(record: Record) -> str:
    return table(record, [row for row in record.rows() if in_main_table(*row)], METHODS)


def peers_page(record: Record, plots: Iterable[str]) -> str:
    """Return docs/measured/peers.md."""
    pictures = {
        "accuracy.png": "Mean error in px over noise, quality of JPEG and radius, a line a method",
        "confidence.png": "The share of right pixels over the stated confidence",
        "speed.png": "Seconds and megabytes over megapixels, a line a method",
    }
    images = [f"![{pictures[name]}]({name})" for name in plots if name in pictures]
    return "\n\n".join(
        ["# Against peers", introduction(record, PARTS), METHODS_TEXT, *images,
         "## In short", main_table(record), "## Where another is better",
         where_others_win(record), "## All numbers", MEASURES_TEXT,
         whole_table(record)]
    ) + "\n"  # fmt: skip


def introduction(record: Record, parts: Iterable[str]) -> str:
    """Say when, where and with what some parts were measured; those of one run in one paragraph."""
    runs: dict[str, list[str]] = {}
    for part in parts:
        if part in record.made:
            runs.setdefault(_circumstances(record.made[part]), []).append(
                f"{part} in {record.made[part]['minutes']} minutes at a load of "
                f"{record.made[part]['load at the start']} to "
                f"{record.made[part]['load at the end']}, commit {record.made[part]['commit']}"
            )
    paragraphs = [f"{run} Measured: {'; '.join(found)}." for run, found in runs.items()]
    return "\n\n".join(paragraphs) + "\n\nAll single values are in `numbers.json`."


def _circumstances(made: dict) -> str:
    versions = ", ".join(f"{name} {number}" for name, number in made["versions"].items())
    return (
        f"Made by `python benchmarks/run_all.py{' --quick' if made['quick'] else ''}` on "
        f"{made['date'].split()[0]}, on {made['processor']}, {made['cores']} cores. Python "
        f"{made['python']}, {versions}. Sharp pictures: "
        f"{', '.join(made['pictures'])} (from {made['pictures from']}), seed {made['seed']}."
    )


METHODS_TEXT = """\
- *napari-defocus*: the default; nothing is known to it, one setting for all.
- *paper*: `mode="paper"`, the plain method of Zhu, Cohen, Schiller and Milanfar, with both
  gradients and our estimate of the noise.
- *blur-detector* (PyPI, at its downsampling of 4), scikit-image's *blur_effect* in tiles of 40 px,
  and the local variance of the *Laplacian* give scores without a unit. They become px by the
  monotone map of least absolute error, fitted with the truth of the *other* pictures of the same
  family and condition: nobody who uses them knows that much. Of uniform blur they only have to
  tell the few radii apart that there are. Rank correlation and the area under the ROC curve need no
  such map. blur-detector's score is relative within one picture: several pictures of uniform blur
  are not what it is for.
- *one radius for all*: the median of the true radii of the other pictures, as a floor.
- Of labels, *paper* is alpha-expansion until nothing gets better, *exact* one cut over all labels.
- Of restoration, *Wiener* and *Richardson-Lucy* are scikit-image's with one radius; that and the
  other setting are the best for each picture, which knows the sharp one.

Ramps go from 0.9 to 5.1 px, bumps from 0.5 to 7 px; uniform blur is 0 to 8 px. Layers are
ellipses one before the other, and the motorcycle of scikit-image has a measured depth, in linear
light, 8 bits; both hide what is behind them. Sharp pictures are never perfectly sharp: their own
blur adds to the true radius, which counts at 1 px and below. Lenses that are no disc are
analysed as discs; the radius is that of the disc with the same second moment. The camera is
that of `benchmarks/camera.py`. *Wide* are mosaics of the sharp pictures with a blur of up to 48 px,
and sharp things before a ground that is so blurred (`benchmarks/wide.py`)."""

MEASURES_TEXT = """\
Means over the pictures (times, memory: medians over the runs); the best of a row is bold, but
for what knows the truth. *Where we are sure* is where our confidence is 0.5 or more, for every
method the same pixels. In focus is up to 2 px; pixels within 0.25 px of that do not count.
*Right where 0.9 is stated*: of the pixels with a confidence of 0.85 to 0.95, the share within
0.5 px. *At edges*: up to 10 px from a jump of 0.5 px. The intersection over union of *paper* is
that of its mask; that of scores, of their map up to 2 px, on photographs cut where it is best
for each. Memory is the largest of a process that does nothing else; *of it for the picture*:
beyond what it had after a small piece."""


def where_others_win(record: Record) -> str:
    """Return every row in which ours is not the best, as a list, largest first."""
    lines = []
    for what, measure in record.rows():
        found = record.row(what, measure)
        best = best_methods(found)
        if OURS in found and best and OURS not in best and in_main_table(what, measure):
            name = sorted(best)[0]
            ours, other = found[OURS], found[name]
            sure = surely_different(ours, other)
            lines.append(f"- {what}, {measure}: {name} {other.shown()}, ours {ours.shown()}"
                         + ("" if sure else " (within the spread of the pictures)"))  # fmt: skip
    return "\n".join(lines) or "Nowhere in this run."


def surely_different(one: Number, other: Number) -> bool:
    """Tell whether a difference is larger than chance among the same pictures or runs."""
    return verdict_on(one, other) != "the same"


def ablation_page(record: Record) -> str:
    """Return docs/measured/ablation.md."""
    return "\n\n".join(
        ["# What each step gains", introduction(record, ["ablation"]), ABLATION_TEXT,
         "![How many times the error is without each step](steps.png)",
         ablation_table(record),
         "## The mask and the time", mask_table(record), "## Options, off by default",
         two_column_table(record, "with an option: "), "## The paper's own search", SEARCH_TEXT,
         table(record, [r for r in record.rows() if r[0].startswith("search for")],
               ("lattice", "fixed-point"))]
    ) + "\n"  # fmt: skip


ABLATION_TEXT = """\
One step is left out at a time, everything else stays; `benchmarks/ablation.py` says how. Mean
absolute errors in px, noise variance 1e-5 in each channel, and how many percent more that is
than with everything: bold where it is worse beyond chance (twice the standard error over the
pictures, one by one), in italics where it is *better*."""

SEARCH_TEXT = """\
The best maximum of each window as the fast lattice finds it, and as the paper's fixed point (11)
and steepest descent (13) from whole px do: `search="fixed-point"`, both in `mode="paper"`."""

_ERRORS = ("mean error", EDGES, "elsewhere")


def ablation_table(record: Record) -> str:
    start = "without a step: "
    rows = [row for row in record.rows() if row[0].startswith(start) and row[1] in _ERRORS
            and not (row[1] == "mean error" and EDGES in
                     {m for w, m in record.rows() if w == row[0]})]  # fmt: skip
    names = [
        what.removeprefix(start).split(", noise")[0] + ("" if m == "mean error" else f", {m}")
        for what, m in rows
    ]
    names = [name.replace("mean error at edges", "at edges") for name in names]
    return steps_table(record, rows, names)


def mask_table(record: Record) -> str:
    start = "without a step: "
    masks = [row for row in record.rows() if row[0].startswith(start) and row[1] == MASK]
    names = ["mask, " + what.removeprefix(start).split(", noise")[0] for what, _ in masks]
    times = [row for row in record.rows() if row[0].startswith(start) and row[1] == "time"][:1]
    return ("Intersection over union of the in-focus mask; the time of candidates and labels is "
            "relative to the default, on ramps.\n\n"
            + steps_table(record, masks + times, [*names, *["time"] * len(times)]))  # fmt: skip


def steps_table(record: Record, rows: list[tuple[str, str]], names: list[str]) -> str:
    lines = ["| instead | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for step in STEPS:
        cells = [step_cell(record.row(*row), step.name) for row in rows]
        lines.append(f"| {step.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def step_cell(found: dict[str, Number], step: str) -> str:
    if step not in found or not np.isfinite(found[step].value):
        return ""
    number, default = found[step], found[DEFAULT]
    shown = number.shown()
    if step == DEFAULT or number.kind == "runs":
        return shown
    if number.better == "lower":
        shown += f" ({100 * (number.value / default.value - 1):+.0f} %)"
    verdict = verdict_on(default, number)
    return {"worse": f"**{shown}**", "better": f"*{shown}*"}.get(verdict, shown)


def two_column_table(record: Record, start: str) -> str:
    lines = ["| pictures | default | with | mean error |", "|---" * 4 + "|"]
    for what, measure in record.rows():
        if what.startswith(start):
            default, (name, number) = (
                record.row(what, measure)[DEFAULT],
                list(record.row(what, measure).items())[-1],
            )
            lines.append(f"| {what.removeprefix(start)} | {default.shown()} px | `{name}` "
                         f"| {number.shown()} px |")  # fmt: skip
    return "\n".join(lines)
