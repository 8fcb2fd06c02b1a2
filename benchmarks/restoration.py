"""How much of the blur can be taken away, and how long that takes.

    python benchmarks/restoration.py --data FOLDER
    python benchmarks/restoration.py --speed

The middle 300 x 300 px of sharp pictures, blurred by the ramp from 0.9 to 5.1 px, with white
noise. PSNR and SSIM against the sharp picture, 20 px at the border left out:

- blind: our own map, as careful as `cautious_blur_map` is by default, with its confidence;
- map as it is: our own map, with its confidence; and alone;
- true: the true map.

run_all.py asks for the same, beside scikit-image's Wiener filter and Richardson-Lucy with one
radius: the radius and the setting that are best for each picture, which knows the sharp one.

With --speed, a colour picture of 500 x 500 px of our samples and the same ramp, beside PyPI's
blur-detector in the same run: seconds for one application of the blur and of its adjoint, for
the restoration, and its PSNR beside that of four times as many rounds; and the largest memory.
"""

import argparse
import itertools
import time
import tracemalloc
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from pictures import SAMPLES, middle, ramp, sharp_pictures
from record import OURS, Number, Record
from skimage.metrics import structural_similarity
from skimage.restoration import richardson_lucy, wiener

from napari_defocus import (
    Disc,
    cautious_blur_map,
    confidence_map,
    estimate_candidates,
    label_blur_map,
    restore_all_in_focus,
    simulate_defocus,
)
from napari_defocus.forward.blur_operator import BlurOperator
from napari_defocus.restoration import deconvolution

INNER = np.s_[20:-20, 20:-20]
NOISE = (1e-6, 1e-5)
METHODS = ("the picture itself", OURS, "our map, with confidence", "our map", "true map")
RADII = (2.0, 2.5, 3.0, 3.5, 4.0)
PEERS = {
    "Wiener": (wiener, (1e-4, 1e-3, 1e-2, 1e-1)),
    "Richardson-Lucy": (richardson_lucy, (10, 30)),
}
_PAD = 24


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("sharp"), help="a folder of pictures")
    parser.add_argument("--noise", type=float, nargs="*", default=NOISE)
    parser.add_argument("--speed", action="store_true", help="measure the time instead")
    parser.add_argument("--runs", type=int, default=5)
    arguments = parser.parse_args()
    if arguments.speed:
        return measure_speed(arguments.runs)
    print("| noise | picture | input | blind | map as it is | map alone | true map |")
    print("|---" * 7 + "|")
    for variance in arguments.noise:
        rows = []
        for name, sharp in sharp_pictures(arguments.data).items():
            scores = restored(as_floats(sharp), variance)
            rows.append(scores)
            print(f"| {variance:g} | {name} | " + cells(scores) + " |", flush=True)
        print(f"| {variance:g} | **mean** | " + cells(np.mean(rows, axis=0)) + " |")
        gains = np.array(rows)[:, 1:, 0] - np.array(rows)[:, :1, 0]
        print(f"| {variance:g} | gain, mean (least) | | " + gain_cells(gains) + " |", flush=True)
    return None


def measure_restoration(sharp: dict[str, np.ndarray], record: Record, *, quick: bool) -> None:
    """Add PSNR and SSIM of every picture and noise, ours and those of one radius for all."""
    for variance in NOISE[:1] if quick else NOISE:
        found: dict[str, list[tuple[float, float]]] = {}
        for picture in sharp.values():
            each = dict(zip(METHODS, restored(picture, variance), strict=True))
            each |= best_of_one_radius(picture, variance, quick=quick)
            for method, scores in each.items():
                found.setdefault(method, []).append(scores)
        what = f"restored, ramp, noise {variance:.0e}"
        for place, (measure, unit) in enumerate({"PSNR": "dB", "SSIM": ""}.items()):
            for method, scores in found.items():
                values = tuple(score[place] for score in scores)
                record.add(Number(what, measure, method, values, unit, "higher"))


def best_of_one_radius(
    sharp: np.ndarray, variance: float, *, quick: bool
) -> dict[str, tuple[float, float]]:
    """Return the best that deconvolution with one radius can do, and its SSIM."""
    seen = simulate_defocus(sharp, ramp(), noise_variance=variance, rng=0)
    radii = RADII[::2] if quick else RADII
    found = {}
    for name, (method, settings) in PEERS.items():
        radius, setting = max(
            itertools.product(radii, settings),
            key=lambda tried: psnr(deconvolved(one(seen), tried[0], method, tried[1]), one(sharp)),
        )
        picture = deconvolved(seen, radius, method, setting)
        found[name] = psnr(picture, sharp), ssim(picture, sharp)
    return found


def one(picture: np.ndarray) -> np.ndarray:
    """Return the green of a picture in colour: what is best for it is for the others, too."""
    return picture[..., 1] if picture.ndim == 3 else picture


def deconvolved(seen: np.ndarray, radius: float, method, setting: float) -> np.ndarray:
    """Deconvolve each channel by one disc, mirrored at the border."""
    kernel, planes = Disc().kernel(radius), np.atleast_3d(seen)
    padded = np.pad(planes, ((_PAD, _PAD), (_PAD, _PAD), (0, 0)), mode="symmetric").clip(0, 1)
    channels = [method(channel, kernel, setting) for channel in np.moveaxis(padded, 2, 0)]
    inner = np.stack(channels, axis=2)[_PAD:-_PAD, _PAD:-_PAD]
    return inner.reshape(seen.shape).astype(np.float32)


def as_floats(picture: np.ndarray) -> np.ndarray:
    scale = 255 if picture.dtype == np.uint8 else 1
    return (picture / scale).astype(np.float32)


def restored(sharp: np.ndarray, variance: float) -> list[tuple[float, float]]:
    """Return PSNR and SSIM of the input and of what becomes of it."""
    truth = ramp()
    seen = simulate_defocus(sharp, truth, noise_variance=variance, rng=0)
    candidates = estimate_candidates(seen)
    blur_map = label_blur_map(candidates, seen)
    sure = confidence_map(candidates, blur_map)
    safe = cautious_blur_map(candidates, blur_map)
    results = (
        seen,
        restore_all_in_focus(seen, safe, confidence=sure),
        restore_all_in_focus(seen, blur_map, confidence=sure),
        restore_all_in_focus(seen, blur_map),
        restore_all_in_focus(seen, truth),
    )
    return [(psnr(picture, sharp), ssim(picture, sharp)) for picture in results]


def psnr(picture: np.ndarray, truth: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((picture.clip(0, 1) - truth)[INNER] ** 2)))


def ssim(picture: np.ndarray, truth: np.ndarray) -> float:
    axis = 2 if truth.ndim == 3 else None
    return structural_similarity(
        picture.clip(0, 1)[INNER], truth[INNER], data_range=1, channel_axis=axis
    )


def cells(scores: np.ndarray | list[tuple[float, float]]) -> str:
    return " | ".join(f"{decibels:.2f} dB, {similarity:.3f}" for decibels, similarity in scores)


def gain_cells(gains: np.ndarray) -> str:
    return " | ".join(f"{column.mean():.2f} ({column.min():.2f}) dB" for column in gains.T)


def measure_speed(runs: int) -> None:
    from blur_detector import detectBlur

    print("| picture | peer s | A + A' s | / peer | restore s | / peer | PSNR | of 4 x rounds |")
    print("|---" * 8 + "|")
    for path in sorted(SAMPLES.glob("*.jpg")):
        sharp = as_floats(middle(imageio.imread(path)[..., :3], 500))
        radii = ramp(500) * 0.6 + 0.37
        seen = simulate_defocus(sharp, radii, noise_variance=1e-6, rng=0)
        blur = BlurOperator(radii.astype(np.float32), Disc(), 3)
        inside = blur.extend(seen)
        times = []
        for _ in range(runs + 1):
            marks = [time.perf_counter()]
            detectBlur(
                seen.mean(axis=2).astype(float).clip(0, 1),
                downsampling_factor=4,
                num_scales=4,
                scale_start=2,
                num_iterations_RF_filter=3,
                show_progress=False,
            )
            marks.append(time.perf_counter())
            blur.adjoint(blur.apply(inside))
            marks.append(time.perf_counter())
            result = restore_all_in_focus(seen, radii)
            marks.append(time.perf_counter())
            times.append(np.diff(marks))
        seconds = np.array(times[1:])
        ratios = np.median(seconds[:, 1:] / seconds[:, :1], axis=0)
        peer, there_and_back, restoring = np.median(seconds, axis=0)
        limits = deconvolution._TOLERANCE, deconvolution._MOST_ROUNDS
        deconvolution._TOLERANCE, deconvolution._MOST_ROUNDS = 0.0, 4 * deconvolution._USUAL_ROUNDS
        converged = restore_all_in_focus(seen, radii)
        deconvolution._TOLERANCE, deconvolution._MOST_ROUNDS = limits
        print(
            f"| {path.stem} | {peer:.2f} | {there_and_back:.3f} | {ratios[0]:.3f} "
            f"| {restoring:.2f} | {ratios[1]:.1f} | {psnr(result, sharp):.2f} "
            f"| {psnr(converged, sharp):.2f} |",
            flush=True,
        )
    tracemalloc.start()
    restore_all_in_focus(seen, radii)
    print(f"largest memory: {tracemalloc.get_traced_memory()[1] / seen.nbytes:.1f} pictures")


if __name__ == "__main__":
    main()
