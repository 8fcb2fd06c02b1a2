"""How long pictures of 0.25 to 12 megapixels take, and how much memory.

A part of run_all.py, which starts this file again for every measurement:

    python benchmarks/sizes.py METHOD MEGAPIXELS RUNS

prints the seconds of each run and the largest resident memory of that process as JSON. What is
compiled at first use is compiled before, on a small piece. Methods take turns, round by round, so
that what else the machine does falls on all of them; medians count.
"""

import json
import resource
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from pictures import SAMPLES
from record import OURS, PAPER, Number, Record

MEGAPIXELS = (0.25, 1, 4, 12)
QUICK_MEGAPIXELS = (0.25, 1)
LARGEST = {"blur_effect": 1, PAPER: 1}
"""Megapixels above which a method would take minutes; others go up to the end."""

STAGES = ("candidates", "labels", "confidence", "mask", "all in focus")
RESTORED_UP_TO = 0.25
SMALL = 120
_KILOBYTES_A_MEGABYTE = 2**20 / 1000 if sys.platform == "darwin" else 1000


def measure_sizes(record: Record, *, quick: bool) -> None:
    """Add seconds and memory of every method at every size, and of our stages."""
    for size in QUICK_MEGAPIXELS if quick else MEGAPIXELS:
        found = {name: Timed() for name in METHODS if size <= LARGEST.get(name, size)}
        rounds, runs = plan(size, quick)
        for _ in range(rounds):
            for name, timed in found.items():
                timed.add(measured_elsewhere(name, size, runs))
        for name, timed in found.items():
            record.add(*timed.numbers(name, size))
        print(f"{size} MP: {record.row(f'{size} MP', 'time')[OURS].shown()} s", flush=True)


def plan(size: float, quick: bool) -> tuple[int, int]:
    """Return how many rounds of how many runs."""
    if quick:
        return 1, 2 if size < 1 else 1
    return {0.25: (3, 2), 1: (2, 2), 4: (2, 1)}.get(size, (1, 1))


class Timed:
    """What the processes of one method and size have said."""

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self.peaks: list[float] = []
        self.bases: list[float] = []
        self.stages: dict[str, list[float]] = defaultdict(list)

    def add(self, answer: dict) -> None:
        for stages in answer["runs"]:
            self.seconds.append(sum(stages[name] for name in answer["counted"]))
            for name, seconds in stages.items():
                self.stages[name].append(seconds)
        self.peaks.append(answer["peak"])
        self.bases.append(answer["base"])

    def numbers(self, name: str, size: float) -> list[Number]:
        what = f"{size} MP"
        timed = [Number(what, "time", name, tuple(self.seconds), "s", "lower", "runs")]
        if name == OURS:
            timed += [
                Number(what, f"time of {stage}", name, tuple(seconds), "s", "lower", "runs")
                for stage, seconds in self.stages.items()
            ]
        own = tuple(peak - base for peak, base in zip(self.peaks, self.bases, strict=True))
        return [
            *timed,
            Number(what, "largest memory", name, tuple(self.peaks), "MB", "lower", "runs"),
            Number(what, "of it for the picture", name, own, "MB", "lower", "runs"),
        ]


def measured_elsewhere(name: str, size: float, runs: int) -> dict:
    command = [sys.executable, __file__, name, str(size), str(runs)]
    return json.loads(subprocess.check_output(command, text=True).splitlines()[-1])


def picture_of(megapixels: float) -> np.ndarray:
    """Return a mosaic of the package's photographs, each mirrored at its seams: uint8, 4 : 3."""
    height = round(np.sqrt(megapixels * 1e6 * 3 / 4))
    width = round(height * 4 / 3)
    tiles = [imageio.imread(path)[:480, :720, :3] for path in sorted(SAMPLES.glob("*.jpg"))]
    pair = np.concatenate([tiles[0], tiles[-1]], axis=1)
    missing = [(0, max(0, want - have)) for want, have in zip((height, width), pair.shape[:2])]  # noqa: B905
    return np.pad(pair, [*missing, (0, 0)], mode="symmetric")[:height, :width]


@dataclass
class Stopwatch:
    """Seconds since the last mark, by name."""

    seconds: dict[str, float]
    since: float

    @classmethod
    def started(cls) -> "Stopwatch":
        return cls({}, time.perf_counter())

    def mark(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = now - self.since
        self.since = now


def ours(picture: np.ndarray) -> dict[str, float]:
    from napari_defocus import (
        cautious_blur_map,
        confidence_map,
        estimate_candidates,
        label_blur_map,
        restore_all_in_focus,
        segment_in_focus,
    )

    watch = Stopwatch.started()
    candidates = estimate_candidates(picture)
    watch.mark("candidates")
    blur_map = label_blur_map(candidates, picture)
    watch.mark("labels")
    sure = confidence_map(candidates, blur_map)
    watch.mark("confidence")
    segment_in_focus(candidates, picture)
    watch.mark("mask")
    if picture.shape[0] * picture.shape[1] <= 1.01e6 * RESTORED_UP_TO:
        safe = cautious_blur_map(candidates, blur_map)
        restore_all_in_focus(picture, safe, confidence=sure)
        watch.mark("all in focus")
    return watch.seconds


def paper(picture: np.ndarray) -> dict[str, float]:
    from napari_defocus import estimate_candidates, label_blur_map

    watch = Stopwatch.started()
    candidates = estimate_candidates(picture, mode="paper")
    watch.mark("candidates")
    label_blur_map(candidates, picture)
    watch.mark("labels")
    return watch.seconds


def peer(name: str) -> Callable[[np.ndarray], dict[str, float]]:
    def timed(picture: np.ndarray) -> dict[str, float]:
        from peers import SCORES, luminance

        watch = Stopwatch.started()
        SCORES[name](luminance(picture))
        watch.mark("score")
        return watch.seconds

    return timed


METHODS: dict[str, Callable[[np.ndarray], dict[str, float]]] = {
    OURS: ours,
    PAPER: paper,
    **{name: peer(name) for name in ("blur-detector", "blur_effect", "Laplacian")},
}
COUNTED = {OURS: ("candidates", "labels"), PAPER: ("candidates", "labels")}


def megabytes() -> float:
    """Return the largest resident memory of this process so far.

    Linux's getrusage begins with what the parent had when it started this one.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(line.split()[1]) / _KILOBYTES_A_MEGABYTE
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _KILOBYTES_A_MEGABYTE


def main(name: str, megapixels: float, runs: int) -> None:
    picture = picture_of(megapixels)
    METHODS[name](picture[:SMALL, :SMALL])
    base = megabytes()
    found = [METHODS[name](picture) for _ in range(runs)]
    counted = COUNTED.get(name, ("score",))
    print(json.dumps({"runs": found, "counted": counted, "base": base, "peak": megabytes()}))


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), int(sys.argv[3]))
