"""What the confidence is worth: stated probability against the share of pixels that are right.

    python benchmarks/confidence.py --data SHARP_PICTURES --real ../shared/data/real [--fit]

Pictures of many kinds: all simulated families of `scenes.py`, real lenses, what breaks the
assumptions (`unlike.py`), and six photographs with measured radii. With --fit it finds the
constants of `labeling/confidence.py` and judges them by cross-validation: over scenes (nothing of
the source that a picture was made of is in the fit), and over kinds (no picture of its kind).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import real
import tifffile
import unlike
from pictures import SHIPPED, at_windows, middle, sharp_pictures, shipped_picture
from scenes import Picture, groups
from scipy.optimize import minimize

from napari_defocus import estimate_candidates, label_blur_map
from napari_defocus.labeling import confidence
from napari_defocus.likelihood.evidence import averaged_curve, informed_share

WINDOWS = 120
"""Of a picture, chosen at random."""

WEIGHTS = {
    "ramp": 4.0,
    "layers": 4.0,
    "bumps": 2.0,
    "motorcycle": 2.0,
    "phones, binned": 3.0,
    "phones, full size": 3.0,
    "ramp, camera": 2.0,
    "plain things": 1.5,
    "uniform": 1.5,
    "plain things, noisy": 0.7,
    "motion": 0.8,
    "gradients": 0.5,
    "noise": 0.3,
    "upscaled, sharp": 0.0,
    "sharpened, sharp": 0.1,
    "ramp, lens gaussian": 0.05,
    "ramp, lens annulus:0.5": 0.5,
}
"""How much each kind counts in the fit; others 1, real lenses 0.3. Kinds whose wrong radii nothing
in a window tells count little: they would make all others look too unsure. Upscaled sharp pictures
do not count at all: interpolation blurs, so that their radius is not 0."""

FOLDS = 7
_SHRINKAGE = 0.002
LEAST = 50

Rows = dict[str, np.ndarray]


def main() -> None:
    arguments = parsed_arguments()
    if arguments.cache and arguments.cache.exists():
        rows = dict(np.load(arguments.cache))
    else:
        rows = joined(list(measured(arguments.data, arguments.real)))
    if arguments.cache:
        np.savez(arguments.cache, **rows)
    report("as they are", rows, rows["stated"])
    if arguments.fit:
        weights = fitted(rows, np.ones(len(rows["right"]), bool))
        print("_WEIGHTS =", ", ".join(f"{w:.3f}" for w in weights), "\n")
        report("cross-validated over scenes", rows, cross_validated(rows, "scene"))
        report("cross-validated over kinds", rows, cross_validated(rows, "kind"))


def parsed_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=shared / "sharp", help="sharp pictures")
    parser.add_argument("--real", type=Path, default=shared / "real", help="real pictures")
    parser.add_argument("--fit", action="store_true", help="find the constants, too")
    parser.add_argument("--cache", type=Path, help="what was measured before, or is to be kept")
    return parser.parse_args()


def measured(data: Path, folder: Path) -> Iterator[Rows]:
    """Measure all pictures; each gives some windows."""
    for kind, picture in pictures(data, folder):
        yield windows_of(kind, picture)


def pictures(data: Path, folder: Path) -> Iterator[tuple[str, Picture]]:
    """Yield pictures, and what kind each is of."""
    sharp = sharp_pictures(data)
    sources = sharp | {name: middle(shipped_picture(name)) for name in SHIPPED}
    for group in groups(sources, quick=False, seed=1):
        condition = group.condition.split()[0].rstrip(",")
        kind = group.family if condition == "noise" else f"{group.family}, {condition}"
        if condition == "lens":
            kind = group.name
        yield from ((kind, picture) for picture in group.make())
    for name, picture in unlike.through_lenses(sources, folder / "lens_psfs"):
        yield f"lens {name}", picture
    others: dict[str, Callable[[], Iterator[Picture]]] = {
        "motion": lambda: unlike.moved(sources),
        "sharpened": lambda: unlike.sharpened(sources),
        "sharpened, sharp": lambda: unlike.sharpened_sharp(sources),
        "upscaled": lambda: unlike.upscaled(sources, sharp=False),
        "upscaled, sharp": lambda: unlike.upscaled(sources, sharp=True),
        "gradients": lambda: unlike.nothing_to_see(noise=False),
        "noise": lambda: unlike.nothing_to_see(noise=True),
        "plain things": lambda: unlike.plain_things(noisy=False),
        "plain things, noisy": lambda: unlike.plain_things(noisy=True),
        "phones, binned": lambda: phones(folder, 3),
        "phones, full size": lambda: phones(folder, 1),
    }
    for kind, make in others.items():
        yield from ((kind, picture) for picture in make())


def phones(folder: Path, by: int) -> Iterator[Picture]:
    """Yield photographs with the radii that were measured around some places."""
    mark = "3" if by == 3 else ""
    for path in sorted(folder.glob("*-photo.tif")):
        name = path.name.removesuffix("-photo.tif")
        photo = tifffile.imread(path) / 65535
        seen = (real.binned(photo, by) if by > 1 else photo).astype(np.float32)
        known = np.load(folder / f"{name}-radii.npz")
        truth = np.full(seen.shape, np.nan)
        places = known[f"row{mark}"].astype(int), known[f"column{mark}"].astype(int)
        for row, column, radius in zip(*places, known[f"radius{mark}"], strict=True):
            truth[row - 3 : row + 4, column - 3 : column + 4] = radius
        yield Picture(name, seen, truth)


def windows_of(kind: str, picture: Picture) -> Rows:
    """Measure a picture with the defaults, and return what is known of some of its windows."""
    candidates = estimate_candidates(picture.seen)
    blur_map = label_blur_map(candidates, picture.seen)
    radius, jump = confidence._at_windows(candidates, blur_map)
    curve = averaged_curve(candidates)
    truth = at_windows(picture.truth, candidates)
    known = np.argwhere(np.isfinite(truth))
    count = 4 * WINDOWS if kind.startswith("phones") else WINDOWS
    row, column = known[np.random.default_rng(0).permutation(len(known))[:count]].T
    features, prior, depth = confidence.features_of(candidates, curve, radius, jump)
    away = np.abs(radius - truth)
    right = (away <= confidence.tolerance(radius)) & (truth != unlike.NO_ANSWER)
    stated = confidence.window_confidence(candidates, curve, radius, jump)
    found = {
        "features": np.moveaxis(features, 0, -1)[row, column],
        "prior": prior[row, column],
        "informed": informed_share(depth)[row, column],
        "right": right[row, column],
        "stated": stated[row, column],
    }
    return found | {"kind": np.full(len(row), kind), "scene": np.full(len(row), picture.source)}


def joined(found: list[Rows]) -> Rows:
    return {name: np.concatenate([rows[name] for rows in found]) for name in found[0]}


def importance(kinds: np.ndarray) -> np.ndarray:
    """Return how much each window counts, so that kinds count as `WEIGHTS` says."""
    names, which, count = np.unique(kinds, return_inverse=True, return_counts=True)
    weights = [WEIGHTS.get(name, 0.3 if name.startswith("lens") else 1.0) for name in names]
    return np.array(weights)[which] / count[which]


def fitted(rows: Rows, used: np.ndarray) -> np.ndarray:
    """Find the weights that make what was seen most probable."""
    design, right = rows["features"][used], rows["right"][used].astype(float)
    prior, informed = rows["prior"][used], rows["informed"][used]
    counts = importance(rows["kind"][used])
    counts /= counts.sum()
    center, spread = design.mean(axis=0), design.std(axis=0)
    scaled = np.column_stack([(design - center) / spread, np.ones(len(design))])

    def surprise(weights: np.ndarray) -> tuple[float, np.ndarray]:
        own = 1 / (1 + np.exp(-np.clip(scaled @ weights, -30, 30)))
        sure = np.clip(informed * own + (1 - informed) * prior, 1e-4, 1 - 1e-4)
        slope = (sure - right) / (sure * (1 - sure)) * informed * own * (1 - own)
        value = -counts @ (right * np.log(sure) + (1 - right) * np.log(1 - sure))
        small = np.append(weights[:-1], 0)
        rise = scaled.T @ (counts * slope) + 2 * _SHRINKAGE * small
        return value + _SHRINKAGE * small @ small, rise

    found = minimize(surprise, np.zeros(scaled.shape[1]), jac=True, method="L-BFGS-B").x
    weights = found[:-1] / spread
    return np.append(weights, found[-1] - weights @ center)


def cross_validated(rows: Rows, over: str) -> np.ndarray:
    """Return what is stated of each window by a fit that knows nothing of its scene, or kind."""
    names = np.random.default_rng(0).permutation(np.unique(rows[over]))
    stated = np.empty(len(rows["right"]))
    for fold in np.array_split(names, FOLDS if over == "scene" else len(names)):
        out = np.isin(rows[over], fold)
        weights = fitted(rows, ~out)
        logit = rows["features"][out] @ weights[:-1] + weights[-1]
        own = 1 / (1 + np.exp(-logit))
        informed = rows["informed"][out]
        stated[out] = informed * own + (1 - informed) * rows["prior"][out]
    return stated


def difference(stated: np.ndarray, right: np.ndarray) -> float:
    """Return the mean difference of stated and right, over ten bins, weighted by windows."""
    place = np.minimum((10 * stated).astype(int), 9)
    return sum(
        abs(stated[place == k].sum() - right[place == k].sum()) for k in np.unique(place)
    ) / len(stated)


def report(title: str, rows: Rows, stated: np.ndarray) -> None:
    """Print a table of the kinds."""
    print(f"{title}\n\n| kind | stated | right | difference | above 0.8 | right there | worst |")
    print("|---" * 7 + "|")
    for kind in dict.fromkeys(rows["kind"]):
        inside = rows["kind"] == kind
        sure = inside & (stated > 0.8)
        worst = [
            rows["right"][sure & (rows["scene"] == scene)].mean()
            for scene in np.unique(rows["scene"][inside])
            if (sure & (rows["scene"] == scene)).sum() >= LEAST
        ]
        there = rows["right"][sure].mean() if sure.any() else np.nan
        print(
            f"| {kind} | {stated[inside].mean():.2f} | {rows['right'][inside].mean():.2f} | "
            f"{difference(stated[inside], rows['right'][inside]):.3f} | "
            f"{sure.sum() / inside.sum():.2f} | {there:.2f} | {min(worst, default=np.nan):.2f} |"
        )
    print()


if __name__ == "__main__":
    main()
