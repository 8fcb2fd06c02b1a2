"""Real pictures with a known answer, and plain drawn ones: what the defaults say of them.

    python benchmarks/real.py --real ../shared/data/real

Prints tables in Markdown. Phones: photographs with radii that were measured from a sharp picture
of the scene, binned 3 x 3 (1 to 6.6 px) and at full size (5 to 20 px). Mitochondria: fluorescence
at known distances from focus. Nuclei: drawn as a camera with an offset and photon noise sees
them. Plain shapes: diamonds with nothing inside, through a perfect and a soft camera. Walls: a
house at high ISO.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter
from scipy.stats import spearmanr
from skimage.draw import polygon
from skimage.metrics import structural_similarity

from napari_defocus import (
    cautious_blur_map,
    confidence_map,
    estimate_candidates,
    focus_curve,
    label_blur_map,
    restore_all_in_focus,
    simulate_defocus,
)

Measured = tuple[np.ndarray, np.ndarray]
Measure = Callable[[np.ndarray], Measured]

RADII = (0.7, 1, 1.5, 2, 3, 4, 5, 6)
"""px, of plain shapes."""

TOLERANCE, RELATIVE_TOLERANCE = 0.5, 0.1
"""What counts as right: within 0.5 px, and beyond 5 px within a tenth."""


@dataclass(frozen=True)
class Points:
    """What was measured, how sure it was said to be, and what is true, at places of a scene."""

    scene: str
    found: np.ndarray
    confidence: np.ndarray
    truth: np.ndarray

    @property
    def error(self) -> float:
        """Mean absolute error, px."""
        return float(np.abs(self.found - self.truth).mean())

    @property
    def right(self) -> np.ndarray:
        """Whether each is right to half a pixel, or to a tenth."""
        tolerance = np.maximum(TOLERANCE, RELATIVE_TOLERANCE * self.truth)
        return np.abs(self.found - self.truth) <= tolerance

    @property
    def rank(self) -> float:
        """Rank correlation of what was found with what is true."""
        return float(spearmanr(self.found, self.truth)[0])

    def right_above(self, confidence: float) -> tuple[float, float]:
        """Return the share that is right where more confidence is stated, and how much that is."""
        sure = self.confidence > confidence
        return (float(self.right[sure].mean()) if sure.any() else np.nan), float(sure.mean())


def with_defaults(image: np.ndarray) -> Measured:
    """Measure with the defaults."""
    candidates = estimate_candidates(image)
    blur_map = label_blur_map(candidates, image)
    return blur_map, confidence_map(candidates, blur_map)


def binned(image: np.ndarray, by: int = 3) -> np.ndarray:
    """Return the mean of squares of so many px."""
    height, width = (length // by * by for length in image.shape)
    return image[:height, :width].reshape(height // by, by, width // by, by).mean((1, 3))


def phones(real: Path, measure: Measure, by: int = 3) -> Iterator[Points]:
    """Measure phone photographs, binned or at their full size."""
    for path in sorted(real.glob("*-photo.tif")):
        name = path.name.removesuffix("-photo.tif")
        photo = tifffile.imread(path) / 65535
        found = measure((binned(photo, by) if by > 1 else photo).astype(np.float32))
        known = np.load(real / f"{name}-radii.npz")
        mark = "3" if by == 3 else ""
        at = known[f"row{mark}"].astype(int), known[f"column{mark}"].astype(int)
        yield Points(name, found[0][at], found[1][at], known[f"radius{mark}"])


def restored(real: Path, by: int = 3) -> Iterator[tuple[str, list[float], list[float], float]]:
    """Yield PSNR, dB, and SSIM of phone photographs against sharp pictures; restored; the misfit.

    Binned, or, by 1, at their full size.
    """
    for path in sorted(real.glob("*-photo.tif")):
        name = path.name.removesuffix("-photo.tif")
        photo, sharp = (
            binned(tifffile.imread(real / f"{name}-{kind}.tif") / 65535, by).astype(np.float32)
            for kind in ("photo", "sharp")
        )
        candidates = estimate_candidates(photo)
        blur_map = label_blur_map(candidates, photo)
        safe, sure = cautious_blur_map(candidates, blur_map), confidence_map(candidates, blur_map)
        result, fit = restore_all_in_focus(
            photo, safe, confidence=sure, intensity_range=(0, 1), return_fit=True
        )
        yield name, _likeness(photo, sharp), _likeness(result, sharp), fit.misfit


def _likeness(picture: np.ndarray, sharp: np.ndarray) -> list[float]:
    inner = slice(8, -8)
    seen, true = (each.clip(0, 1)[inner, inner] for each in (picture, sharp))
    noise = float(-10 * np.log10(np.mean((seen - true) ** 2)))
    return [noise, float(structural_similarity(seen, true, data_range=1))]


def mitochondria(real: Path, measure: Measure) -> tuple[float, list[tuple[float, float, float]]]:
    """Return the rank correlation of radius and distance from focus, and z, radius, confidence."""
    rows = []
    for path in (real / "mitochondria").glob("*.tif"):
        image = tifffile.imread(path)
        found, sure = measure(image)
        objects = image >= np.quantile(image, 0.9)
        rows.append(
            (_distance(path), float(np.median(found[objects])), float(np.median(sure[objects])))
        )
    rows.sort()
    distance = [abs(z) for z, _, _ in rows]
    return float(spearmanr(distance, [radius for _, radius, _ in rows])[0]), rows


def sharpest_mitochondria(real: Path, measure: Measure) -> str:
    """Return which plane the focus curve names, by its distance from focus."""
    paths = sorted((real / "mitochondria").glob("*.tif"), key=_distance)
    maps, sure = (
        np.stack(each) for each in zip(*(measure(tifffile.imread(p)) for p in paths), strict=True)
    )
    curve = focus_curve(maps, confidence=sure)
    assert curve.best is not None
    return f"{_distance(paths[curve.best[0]]):+.1f} um, resting on {curve.rests_on}"


def _distance(path: Path) -> float:
    return float(path.stem[1:].removesuffix("um"))


def nuclei() -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield nuclei in focus, out of it, and far out of it, with where they are."""
    rng = np.random.default_rng(7)
    height, width, offset, gain, read = 240, 300, 100.0, 2.17, 3.0
    y, x = np.mgrid[:height, :width]
    light = np.zeros((height, width))
    for _ in range(26):
        row, column = rng.uniform(15, height - 15), rng.uniform(15, width - 15)
        a, b = rng.uniform(9, 14), rng.uniform(12, 19)
        t = rng.uniform(0, np.pi)
        u = (y - row) * np.cos(t) + (x - column) * np.sin(t)
        v = (x - column) * np.cos(t) - (y - row) * np.sin(t)
        inside = u**2 / a**2 + v**2 / b**2 < 1
        light = np.maximum(light, rng.uniform(60, 220) * inside)
    light *= 1 + 0.25 * gaussian_filter(rng.normal(0, 6, light.shape), 2.5)
    for name, sigma in (("sharp", 1.05), ("defocus-3", 3.0), ("defocus-9", 9.0)):
        electrons = rng.poisson(np.maximum(gaussian_filter(light, sigma), 0))
        counts = offset + gain * electrons + rng.normal(0, read, light.shape)
        yield name, np.clip(counts.round(), 0, 65535).astype(np.uint16), light > 0


def diamonds(side: int = 200, oversampling: int = 4) -> np.ndarray:
    """Return printed diamonds: sharp edges, nothing inside."""
    picture = np.full((side * oversampling,) * 2, 0.35)
    for row, column, size in ((60, 60, 42), (60, 140, 38), (140, 60, 38), (140, 140, 42)):
        for share, value in ((1.0, 0.6), (0.5, 0.25)):
            s = size * share
            rows = np.array([row - s, row, row + s, row]) * oversampling
            columns = np.array([column, column + 0.6 * s, column, column - 0.6 * s]) * oversampling
            picture[polygon(rows, columns, picture.shape)] = value
    return picture.reshape(side, oversampling, side, oversampling).mean((1, 3))


def plain_shapes(measure: Measure, noise: float = 1e-3) -> Iterator[Points]:
    """Measure plain shapes on their edges, through a perfect and through a soft camera."""
    sharp = diamonds()
    edges = np.hypot(*np.gradient(gaussian_filter(sharp, 1))) > 0.02
    for softness in (0.0, 0.7):
        for radius in RADII:
            camera = gaussian_filter(sharp, softness) if softness else sharp
            picture = np.asarray(simulate_defocus(camera, np.full(sharp.shape, float(radius))))
            picture = picture + np.random.default_rng(0).normal(0, noise, sharp.shape)
            found, sure = measure(picture)
            truth = np.full(int(edges.sum()), float(radius))
            yield Points(f"softness {softness}, {radius} px", found[edges], sure[edges], truth)


def walls(measure: Measure) -> Iterator[Points]:
    """Measure a house with plain walls, blurred by 3 px, at high and at low ISO."""
    rng = np.random.default_rng(5)
    drawing = Image.new("L", (400, 300), 170)
    draw = ImageDraw.Draw(drawing)
    draw.rectangle((0, 0, 400, 90), fill=205)
    draw.polygon([(30, 90), (200, 20), (370, 90)], fill=95)
    draw.rectangle((50, 90, 350, 300), fill=150)
    for x in range(75, 330, 70):
        for y in (115, 205):
            draw.rectangle((x, y, x + 38, y + 60), fill=60)
            draw.line((x + 19, y, x + 19, y + 60), fill=220, width=2)
            draw.line((x, y + 30, x + 38, y + 30), fill=220, width=2)
    light = np.asarray(drawing, float) / 255
    light += 0.012 * gaussian_filter(rng.normal(0, 2, light.shape), 0.8)
    blurred = np.asarray(simulate_defocus(np.clip(light, 0, 1), np.full(light.shape, 3.0)))
    for name, sigma in (("high ISO", 0.06), ("low ISO", 0.004)):
        noisy = (blurred + rng.normal(0, sigma, light.shape)) * 255
        found, sure = measure(np.clip(noisy, 0, 255).round().astype(np.uint8))
        truth = np.full(found.size, 3.0)
        yield Points(f"walls, {name}", found.ravel(), sure.ravel(), truth)


def report(real: Path, measure: Measure) -> None:
    """Print all tables."""
    print("| scene | error, px | stated | right | right above 0.8 (share) |\n|---|---|---|---|---|")
    photographs = list(phones(real, measure))
    for points in [*photographs, *walls(measure), *plain_shapes(measure)]:
        right, share = points.right_above(0.8)
        print(
            f"| {points.scene} | {points.error:.2f} | {points.confidence.mean():.2f} | "
            f"{points.right.mean():.2f} | {right:.2f} ({share:.2f}) |",
            flush=True,
        )
    print(f"\nphones, binned: mean error {np.mean([p.error for p in photographs]):.3f} px")
    print("| scene at full size | error, px | rank | stated | right |\n|---|---|---|---|---|")
    large = list(phones(real, measure, by=1))
    for points in large:
        print(
            f"| {points.scene} | {points.error:.2f} | {points.rank:+.2f} | "
            f"{points.confidence.mean():.2f} | {points.right.mean():.2f} |",
            flush=True,
        )
    print(
        f"\nphones, full size: mean error {np.mean([p.error for p in large]):.3f} px, "
        f"rank correlation {np.mean([p.rank for p in large]):.2f}"
    )
    correlation, rows = mitochondria(real, measure)
    print(f"mitochondria: rank correlation {correlation:+.2f}")
    print("; ".join(f"{z:+.1f} um {radius:.2f} px ({sure:.2f})" for z, radius, sure in rows))
    print(f"mitochondria, sharpest plane: {sharpest_mitochondria(real, measure)}")
    for name, image, objects in nuclei():
        found, sure = measure(image)
        print(f"nuclei {name}: {np.median(found[objects]):.2f} px, {sure[objects].mean():.2f}")


def main() -> None:
    """Measure with the defaults, and print."""
    shared = Path(__file__).parents[2] / "shared" / "data" / "real"
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--real", type=Path, default=shared)
    parser.add_argument("--restore", action="store_true", help="restore the photographs, too")
    arguments = parser.parse_args()
    report(arguments.real, with_defaults)
    for by in (3, 1) if arguments.restore else ():
        print(f"\n| restored, binned {by} x {by} | input, dB | gain, dB | gain, SSIM | misfit |")
        print("|---|---|---|---|---|")
        gains = []
        for name, before, after, misfit in restored(arguments.real, by):
            gains.append(np.subtract(after, before))
            decibels, similarity = gains[-1]
            print(
                f"| {name} | {before[0]:.2f} | {decibels:+.2f} | {similarity:+.3f} "
                f"| {misfit:.1e} |",
                flush=True,
            )
        (mean, similarity), (least, _) = np.mean(gains, axis=0), np.min(gains, axis=0)
        print(f"| mean (least) | | {mean:+.2f} ({least:+.2f}) | {similarity:+.3f} | |")


if __name__ == "__main__":
    main()
