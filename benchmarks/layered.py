"""How far maps and masks are from the truth in a scene with depth, at its edges and elsewhere.

    python benchmarks/layered.py

The motorcycle of scikit-image, a picture whose disparity is known at most pixels, scaled down
by 2, seen by a lens that is focused on the nearest or on the farthest thing and makes discs of
at most 6 px; 8 bits, noise of variance 1e-5. Disparities of the camera beside it make the depth.

Prints a Markdown table: the mean absolute error of the map in px up to 10 px from where the
radius jumps by more than 0.5 px, and elsewhere; and the intersection over union of the mask with
the pixels of true radii up to 2 px. What has no known disparity does not count.
"""

import argparse

import numpy as np
import skimage.data
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from napari_defocus import estimate_candidates, label_blur_map, segment_in_focus
from napari_defocus.forward.occlusion import simulate_layered_defocus

LARGEST = 6.0
THRESHOLD = 2.0
JUMP, REACH = 0.5, 10


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--noise", type=float, default=1e-5)
    arguments = parser.parse_args()
    picture, disparity = motorcycle()
    known = np.isfinite(disparity)
    print(
        "| in focus | mode | MAE at edges | MAE elsewhere | IoU of the mask |\n" + "|---" * 5 + "|"
    )
    for focus in ("nearest", "farthest"):
        seen, truth = photographed(picture, disparity, focus, arguments.noise)
        near_edge = distance_transform_edt(jump(truth) <= JUMP) <= REACH
        for mode in ("curve", "paper"):
            candidates = estimate_candidates(seen, mode=mode)
            error = np.abs(label_blur_map(candidates, seen) - truth)
            mask = segment_in_focus(candidates, seen, threshold=THRESHOLD) == 1
            sharp = truth <= THRESHOLD
            overlap = (mask & sharp)[known].sum() / (mask | sharp)[known].sum()
            print(
                f"| {focus} | {mode} | {error[known & near_edge].mean():.3f} "
                f"| {error[known & ~near_edge].mean():.3f} | {overlap:.2f} |",
                flush=True,
            )


def motorcycle() -> tuple[np.ndarray, np.ndarray]:
    """Return the picture, (250, 370, 3) in [0, 1], and its disparity in px; NaN is unknown."""
    try:
        picture, _, disparity = skimage.data.stereo_motorcycle()
    except (ImportError, OSError) as error:
        raise SystemExit(
            f"this scikit-image comes without its motorcycle, and could not fetch it: {error}; "
            "install pooch and run again with a connection"
        ) from None
    height, width = (length // 2 for length in disparity.shape)
    halves = picture[: 2 * height, : 2 * width].reshape(height, 2, width, 2, 3)
    disparity = np.where(np.isfinite(disparity), disparity, np.nan)
    # A mean over both sides of an edge would be the depth of neither.
    return halves.mean(axis=(1, 3)) / 255, disparity[: 2 * height : 2, : 2 * width : 2]


def photographed(
    picture: np.ndarray, disparity: np.ndarray, focus: str, variance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the picture, uint8, and the true radii in px."""
    low, high = np.nanmin(disparity), np.nanmax(disparity)
    plane = high if focus == "nearest" else low

    def radius(depth: np.ndarray) -> np.ndarray:
        return LARGEST * np.abs(-depth - plane) / (high - low)

    seen, truth = simulate_layered_defocus(
        picture, -disparity, radius, noise_variance=variance, rng=0
    )
    return np.rint(255 * seen.clip(0, 1)).astype(np.uint8), truth


def jump(truth: np.ndarray) -> np.ndarray:
    """Return the largest difference between a pixel's radius and its neighbours'."""
    return maximum_filter(truth, 3) - minimum_filter(truth, 3)


if __name__ == "__main__":
    main()
