"""The benchmarks' numbers as pictures: accuracy, confidence, time and memory."""

import io
from collections.abc import Iterable

import numpy as np
import PIL.Image
from ablation import DEFAULT, STEPS
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from peers import SCORES
from record import OURS, PAPER, Record

COLORS = {
    OURS: "#0f6fb5",
    PAPER: "#d97706",
    "blur-detector": "#2f8f4e",
    "blur_effect": "#8a5fbf",
    "Laplacian": "#777777",
}
METHODS = (OURS, PAPER, *SCORES)
ERROR = "mean error"
LEFT_OUT = "without a step: "
RATIOS = (0.5, 0.7, 1, 1.5, 2, 3, 5, 10, 20)


def drawn(record: Record) -> dict[str, bytes]:
    """Return PNG files by name, of what there are numbers of."""
    makers = {
        "accuracy.png": accuracy_figure,
        "confidence.png": confidence_figure,
        "speed.png": speed_figure,
        "steps.png": steps_figure,
    }
    figures = {name: make(record) for name, make in makers.items()}
    return {name: as_png(figure) for name, figure in figures.items() if figure is not None}


def as_png(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=100)
    small = io.BytesIO()
    PIL.Image.open(file).convert("RGB").quantize(64).save(small, format="png", optimize=True)
    return small.getvalue()


def accuracy_figure(record: Record) -> Figure | None:
    """Draw the mean error over noise, JPEG quality, radius and lens."""
    panels = [
        (f"{family}, over the noise variance", f"{family}, noise ")
        for family in ("ramp", "bumps", "layers", "motorcycle")
    ]
    panels += [
        ("ramp, over the quality of JPEG", "ramp, JPEG "),
        ("ramp by other lenses, seen as discs", "ramp, lens "),
        ("one radius everywhere, px", "uniform, "),
    ]
    if not names_after(record, "ramp, noise "):
        return None
    figure = Figure(figsize=(12, 6), layout="constrained")
    grid = figure.subplots(2, 4)
    for axes, (title, start) in zip(grid.flat, panels, strict=False):
        draw_errors(axes, record, names_after(record, start), start)
        axes.set_title(title, fontsize=9)
        axes.set_ylim(0)
        axes.tick_params(labelsize=8)
    for axes in grid[:, 0]:
        axes.set_ylabel("mean error, px", fontsize=9)
    grid[1, 1].tick_params("x", rotation=30)
    grid[1, 3].set_axis_off()
    grid[1, 3].legend(*grid[0, 0].get_legend_handles_labels(), loc="center", frameon=False)
    return figure


def names_after(record: Record, start: str) -> list[str]:
    """Return what follows the start of each row's name, but for the noise of uniform blur."""
    names = (what.removeprefix(start) for what, measure in record.rows()
             if what.startswith(start) and measure == ERROR)  # fmt: skip
    return [name for name in names if not name.startswith("noise")]


def draw_errors(axes: Axes, record: Record, names: Iterable[str], start: str) -> None:
    names = list(names)
    for method in METHODS:
        rows = [record.row(start + name, ERROR).get(method) for name in names]
        known = [(at, row) for at, row in enumerate(rows) if row is not None]
        if known:
            axes.errorbar(
                [at for at, _ in known],
                [row.value for _, row in known],
                [row.spread for _, row in known],
                color=COLORS[method],
                marker="o",
                markersize=4,
                linewidth=2 if method == OURS else 1.2,
                elinewidth=0.8,
                label=method,
            )
    axes.set_xticks(range(len(names)), [name.removesuffix(" px") for name in names])


def confidence_figure(record: Record) -> Figure | None:
    """Draw the share of right pixels over the stated probability."""
    whats = dict.fromkeys(what for what, _ in record.rows() if what.startswith("confidence, "))
    if not whats:
        return None
    figure = Figure(figsize=(4.6, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="#bbbbbb", linewidth=1)
    for what in whats:
        rows = [(measure, record.row(what, measure)[OURS]) for w, measure in record.rows()
                if w == what and measure.startswith("stated")]  # fmt: skip
        stated = [float(measure.removeprefix("stated ")) for measure, _ in rows]
        right = [number.value for _, number in rows]
        axes.plot(stated, right, marker="o", markersize=4, label=what.removeprefix("confidence, "))
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel="confidence", ylabel="share within 0.5 px")
    axes.legend(title="pictures with", fontsize=8, frameon=False, loc="lower right")
    return figure


def speed_figure(record: Record) -> Figure | None:
    """Draw seconds and memory over the size of the picture."""
    sizes = [what for what, measure in record.rows() if measure == "time" and what.endswith(" MP")]
    if not sizes:
        return None
    figure = Figure(figsize=(8.4, 3.8), layout="constrained")
    seconds, memory = figure.subplots(1, 2)
    for axes, measure, label in (
        (seconds, "time", "seconds"),
        (memory, "largest memory", "largest memory, MB"),
    ):
        for method in METHODS:
            rows = [(float(what.split()[0]), record.row(what, measure).get(method))
                    for what in sizes]  # fmt: skip
            known = np.array([(size, row.value) for size, row in rows if row is not None])
            if known.size:
                axes.loglog(*known.T, color=COLORS[method], marker="o", markersize=4,
                            linewidth=2 if method == OURS else 1.2, label=method)  # fmt: skip
        axes.set_xticks([float(what.split()[0]) for what in sizes])
        axes.set_xticklabels([what.split()[0] for what in sizes])
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
        axes.set(xlabel="megapixels", ylabel=label)
    figure.legend(*seconds.get_legend_handles_labels(), loc="outside lower center",
                  ncols=len(METHODS), fontsize=8, frameon=False)  # fmt: skip
    return figure


def steps_figure(record: Record) -> Figure | None:
    """Draw how many times the error is without each step, a dot for each kind of picture."""
    whats = [what for what, measure in record.rows()
             if what.startswith(LEFT_OUT) and measure == ERROR]  # fmt: skip
    if not whats:
        return None
    figure = Figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplots()
    names = [step.name for step in STEPS[1:]]
    for what in whats:
        row = record.row(what, ERROR)
        ratios = [row[name].value / row[DEFAULT].value for name in names]
        axes.plot(ratios, range(len(names)), "o", markersize=5, alpha=0.8,
                  label=what.removeprefix(LEFT_OUT))  # fmt: skip
    axes.axvline(1, color="#bbbbbb", linewidth=1, zorder=0)
    axes.set_xscale("log")
    axes.set_xticks(RATIOS, [f"{ratio:g}" for ratio in RATIOS])
    axes.minorticks_off()
    axes.set_yticks(range(len(names)), names)
    axes.grid(axis="y", color="#eeeeee")
    axes.set_axisbelow(True)
    axes.invert_yaxis()
    axes.set_xlabel("mean error, times that of everything together")
    axes.legend(fontsize=8, frameon=False)
    return figure
