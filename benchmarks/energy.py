"""How near the least energy the labels are, on real photographs.

    python benchmarks/energy.py --data FOLDER_OF_PHOTOGRAPHS

Prints a Markdown table: the energy (14) of our labels on the grid of windows, in percent above
that of expansion moves over all labels until none lowers it (below it where negative), and the
seconds that both take. --exact adds how far it is above the least energy of all, from one cut over
all labels, which takes a minute or more on 500 x 500 px and much memory: with --side.

--full compares pixels instead: the labels that the map is made from, with those of expansion moves
over all pixels from these labels and from each pixel's own best; and what it takes to bring ours
there by the moves of the grid. It takes minutes and about 1.5 kB a pixel. The rest is a part of
run_all.py, too.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from pictures import middle
from record import OURS, PAPER, Number, Record

from napari_defocus import BlurCandidates, estimate_candidates
from napari_defocus.core.image import PreparedImage
from napari_defocus.labeling.blur_map import CURVE_WEIGHT, JUMP, REACH
from napari_defocus.labeling.blurred_edges import less_at_blurred_edges, squared_step_of
from napari_defocus.labeling.coarse_to_fine import minimize_energy
from napari_defocus.labeling.graph_cuts import (
    energy_of,
    expand_until_settled,
    improve,
    solve_exactly,
)
from napari_defocus.labeling.pairwise_term import Blocks, pixel_weights
from napari_defocus.labeling.pixel_refinement import label_pixels
from napari_defocus.labeling.problem import LabelingProblem
from napari_defocus.settings import MapSettings

SMOOTHNESS, COLOR_SIGMA = MapSettings.smoothness, MapSettings.color_sigma


def main() -> None:
    arguments = parsed_arguments()
    if arguments.full:
        print("| photograph | labels of blocks % | of pixels % | + moves % | s | reference s |")
        print("|---" * 6 + "|")
    else:
        print("| photograph | nodes | ours % | exact % | ours s | reference s | exact s |")
        print("|---" * 7 + "|")
    row = full_row if arguments.full else grid_row
    for path in sorted(arguments.data.glob("*.jpg")):
        if arguments.names and path.stem not in arguments.names:
            continue
        picture = imageio.imread(path)[..., :3]
        if picture.size > 3 * 2e6:
            continue
        if arguments.side:
            picture = middle(picture, arguments.side)
        print(f"| {path.stem} | " + row(Problem.of(picture), arguments.exact) + " |", flush=True)


def parsed_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "photos"
    parser.add_argument("names", nargs="*", help="names of photographs, without .jpg; all of them")
    parser.add_argument("--data", type=Path, default=shared, help="folder of photographs")
    parser.add_argument("--side", type=int, help="only the middle of each, so many px wide")
    parser.add_argument("--exact", action="store_true", help="find the least energy, too")
    parser.add_argument("--full", action="store_true", help="compare pixels, not windows")
    return parser.parse_args()


@dataclass(frozen=True)
class Problem:
    """Costs and weights of one picture."""

    candidates: BlurCandidates
    picture: PreparedImage
    blocks: Blocks
    cost: np.ndarray
    block_weight: np.ndarray
    pixel_weight: np.ndarray

    @classmethod
    def of(cls, picture: np.ndarray) -> "Problem":
        scene = LabelingProblem.of(estimate_candidates(picture), picture)
        cost, weights = CURVE_WEIGHT * scene.data_term, (scene.block_weight, scene.pixel_weight)
        return cls(scene.own, scene.picture, scene.blocks, cost, *weights)

    def of_windows(self) -> tuple[np.ndarray, np.ndarray]:
        """Return costs and weights of the grid of windows."""
        color = self.picture.color
        weights = self.blocks.edge_weights(color, COLOR_SIGMA, SMOOTHNESS)
        step = squared_step_of(color, self.blocks)
        beyond = less_at_blurred_edges(weights, step, COLOR_SIGMA)
        weights = np.concatenate([weights, beyond])
        return self.cost * self.block_weight[..., None], weights

    def of_pixels(self) -> tuple[np.ndarray, np.ndarray]:
        """Return costs and weights of all pixels; the costs are interpolated."""
        cost = self.cost
        for axis, position in enumerate(self.blocks.positions):
            low = np.minimum(position.astype(int), max(cost.shape[axis] - 2, 0))
            share = np.expand_dims(position - low, (1, 2) if axis == 0 else (0, 2))
            high = np.minimum(low + 1, cost.shape[axis] - 1)
            mean = (1 - share) * cost.take(low, axis) + share * cost.take(high, axis)
            cost = mean.astype(np.float32)
        everywhere = np.ones(self.picture.shape, bool)
        cost *= self.pixel_weight[..., None]
        return cost, pixel_weights(self.picture.color, everywhere, COLOR_SIGMA, SMOOTHNESS)


@dataclass(frozen=True)
class Solved:
    """Energies and seconds of three solvers on the grid of windows of one picture."""

    nodes: tuple[int, int]
    ours: tuple[float, float]
    reference: tuple[float, float]
    exact: tuple[float, float]

    @classmethod
    def of(cls, problem: Problem, exact: bool) -> "Solved":
        data, weights = problem.of_windows()
        minimize_energy(data[:40, :40], weights_within(weights, 40))  # compiled
        solvers = minimize_energy, expand_until_settled, solve_exactly
        found = [energy_and_time(solve, data, weights) for solve in solvers[: 2 + exact]]
        return cls(data.shape[:2], *found, *([] if exact else [(np.nan, np.nan)]))


def measure_energy(photographs: dict[str, np.ndarray], side: int, record: Record) -> None:
    """Add how far labels are above the least energy, and in what time."""
    solved = {
        name: Solved.of(Problem.of(middle(picture, side)), exact=True)
        for name, picture in photographs.items()
    }
    what = f"labels of {len(solved)} photographs, {side} px"
    for method, name in {OURS: "ours", PAPER: "reference", "exact": "exact"}.items():
        found = [(getattr(each, name), each.exact[0]) for each in solved.values()]
        gaps = tuple(above(energy, least) for (energy, _), least in found)
        seconds = tuple(seconds for (_, seconds), _ in found)
        record.add(Number(what, "energy above the least", method, gaps, "percent", "lower"))
        record.add(Number(what, "time of labels", method, seconds, "s", "lower", "runs"))


def grid_row(problem: Problem, exact: bool) -> str:
    found = Solved.of(problem, exact)
    return " | ".join(
        [
            f"{found.nodes[0]} x {found.nodes[1]}",
            f"{above(found.ours[0], found.reference[0]):+.3f}",
            f"{above(found.ours[0], found.exact[0]):.3f}" if exact else "",
            f"{found.ours[1]:.2f}",
            f"{found.reference[1]:.1f}",
            f"{found.exact[1]:.0f}" if exact else "",
        ]
    )


def full_row(problem: Problem, exact: bool) -> str:
    data, weights = problem.of_pixels()
    labels = minimize_energy(*problem.of_windows())
    pixels = label_pixels(
        labels,
        problem.cost,
        problem.blocks,
        problem.picture.color,
        smoothness=SMOOTHNESS,
        color_sigma=COLOR_SIGMA,
        jump=JUMP,
        reach=REACH,
        weight=problem.pixel_weight,
    )
    began = time.perf_counter()
    improved = improve(pixels, data, weights)
    seconds = time.perf_counter() - began
    began = time.perf_counter()
    settled = [expand_until_settled(data, weights, start=start) for start in (pixels, None)]
    reference_seconds = time.perf_counter() - began
    reference = min(energy_of(each, data, weights) for each in settled)
    gaps = (
        above(energy_of(each, data, weights), reference)
        for each in (problem.blocks.spread(labels), pixels, improved)
    )
    return " | ".join(
        [f"{gap:+.3f}" for gap in gaps] + [f"{seconds:.1f}", f"{reference_seconds:.0f}"]
    )


def weights_within(weights: np.ndarray, side: int) -> np.ndarray:
    """Return the weights of a corner of the grid, without those that lead out of it."""
    inner = weights[:, :side, :side].copy()
    inner[1:, -1] = 0
    inner[[0, 2], :, -1] = 0
    return inner


def energy_and_time(
    solve: Callable[..., np.ndarray], data: np.ndarray, weights: np.ndarray
) -> tuple[float, float]:
    began = time.perf_counter()
    labels = solve(data, weights)
    return energy_of(labels, data, weights), time.perf_counter() - began


def above(energy: float, reference: float) -> float:
    """Return how far an energy is above another, in percent."""
    return 100 * (energy / reference - 1)


if __name__ == "__main__":
    main()
