"""How long the main job takes, beside PyPI's blur-detector on the same picture.

    python benchmarks/speed.py

Both run in turn in one process, warm; the medians and the median of the ratios count, because
machines are noisy. blur-detector gives a relative score without a unit.
"""

import argparse
import time
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from blur_detector import detectBlur
from pictures import middle

from napari_defocus import estimate_candidates, label_blur_map, segment_in_focus

SAMPLES = Path(__file__).parents[1] / "src" / "napari_defocus" / "samples"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pictures", type=Path, nargs="*", help="pictures of at least 500 px")
    parser.add_argument("--runs", type=int, default=5)
    arguments = parser.parse_args()
    print("| picture | estimate s | label s | segment s | map s | blur-detector s | map / it |")
    print("|---" * 7 + "|")
    for path in arguments.pictures or sorted(SAMPLES.glob("*.jpg")):
        picture = middle(imageio.imread(path)[..., :3], 500)
        times = np.array([timed(picture) for _ in range(arguments.runs + 1)])[1:]
        estimate, label, segment, peer = np.median(times, axis=0)
        ratio = np.median((times[:, 0] + times[:, 1]) / times[:, 3])
        print(
            f"| {path.stem} | {estimate:.2f} | {label:.2f} | {segment:.2f} "
            f"| {estimate + label:.2f} | {peer:.2f} | {ratio:.2f} |",
            flush=True,
        )


def timed(picture: np.ndarray) -> list[float]:
    """Return seconds for estimation, labelling, segmentation and the peer."""
    times = [time.perf_counter()]
    candidates = estimate_candidates(picture)
    times.append(time.perf_counter())
    label_blur_map(candidates, picture)
    times.append(time.perf_counter())
    segment_in_focus(candidates, picture)
    times.append(time.perf_counter())
    detectBlur(
        picture.mean(axis=2) / 255,
        downsampling_factor=4,
        num_scales=4,
        scale_start=2,
        num_iterations_RF_filter=3,
        show_progress=False,
    )
    times.append(time.perf_counter())
    return np.diff(times).tolist()


if __name__ == "__main__":
    main()
