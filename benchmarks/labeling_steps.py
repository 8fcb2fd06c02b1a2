"""What the steps of labels, masks and confidences take.

    python benchmarks/labeling_steps.py [MEGAPIXELS ...]

Prints a Markdown table: processor seconds and seconds of each step, for mosaics of photographs of
so many megapixels (0.25, 1 and 4), and the largest resident memory of the process. What is compiled
at first use is compiled before, on a small piece.
"""

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from functools import wraps
from types import ModuleType

import numpy as np
from sizes import SMALL, megabytes, picture_of

from napari_defocus import confidence_map, estimate_candidates, label_blur_map, segment_in_focus
from napari_defocus.labeling import blur_map, confidence, problem, segmentation

STEPS = {
    "map": [
        (problem, "on_own_side", "own side of edges"),
        (blur_map, "_problem_of_blocks", "costs and weights"),
        (blur_map, "minimize_energy", "labels of blocks"),
        (blur_map, "label_pixels", "labels of pixels"),
        (blur_map, "refine_labels", "refinement"),
        (blur_map, "interpolate_labels", "interpolation"),
    ],
    "mask": [
        (problem, "on_own_side", "own side of edges"),
        (segmentation, "settled", "threshold"),
        (segmentation, "_problem_of_blocks", "costs and weights"),
        (segmentation, "solve_exactly", "cut of blocks"),
        (segmentation, "cut_pixels", "cuts of pixels"),
    ],
    "confidence": [
        (confidence, "averaged_curve", "averaged curves"),
        (confidence, "window_confidence", "held against the map"),
    ],
}
"""Of each result: where a step is called, its name there, and what it is."""


class Stopwatch:
    """Processor seconds and seconds of functions, by name."""

    def __init__(self) -> None:
        self.spent: dict[str, np.ndarray] = defaultdict(lambda: np.zeros(2))

    def timed(self, name: str, function: Callable) -> Callable:
        @wraps(function)
        def wrapped(*arguments, **keywords):
            began = now()
            try:
                return function(*arguments, **keywords)
            finally:
                self.spent[name] += now() - began

        return wrapped

    def watch(self, module: ModuleType, function: str, name: str) -> None:
        setattr(module, function, self.timed(name, getattr(module, function)))


def now() -> np.ndarray:
    return np.array([time.process_time(), time.perf_counter()])


def results(picture: np.ndarray) -> dict[str, Callable]:
    candidates = estimate_candidates(picture)
    found = label_blur_map(candidates, picture)
    return {
        "map": lambda: label_blur_map(candidates, picture),
        "mask": lambda: segment_in_focus(candidates, picture),
        "confidence": lambda: confidence_map(candidates, found),
    }


def main(sizes: list[float]) -> None:
    for make in results(picture_of(0.25)[:SMALL, :SMALL]).values():
        make()
    print("| megapixels | result | step | processor s | s |\n|---|---|---|---|---|")
    for size in sizes:
        for result, make in results(picture_of(size)).items():
            watch = Stopwatch()
            kept = {(module, name): getattr(module, name) for module, name, _ in STEPS[result]}
            for step in STEPS[result]:
                watch.watch(*step)
            watch.timed("all", make)()
            for (module, name), function in kept.items():
                setattr(module, name, function)
            for step, (processor, seconds) in watch.spent.items():
                print(f"| {size:g} | {result} | {step} | {processor:.2f} | {seconds:.2f} |")
        print(f"| {size:g} | | largest memory, MB | {megabytes():.0f} | |", flush=True)


if __name__ == "__main__":
    main([float(size) for size in sys.argv[1:]] or [0.25, 1, 4])
