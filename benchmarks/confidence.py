"""What the confidence is worth: stated probability against the share of pixels that are right.

    python benchmarks/confidence.py --data FOLDER_OF_SHARP_PICTURES [--fit]

Half of the pictures (with those that scikit-image ships) are for the fit, the other half, with
other scenes, for the table: random ramps and layered scenes of disc blur with white noise, as
they are; and as JPEG, or with layers beyond the 8 px that are looked for. With --fit it finds
the constants of confidence.py.
"""

import argparse
import io
from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from pictures import SIDE, at_windows, sharp_pictures
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.optimize import minimize

from napari_defocus import Disc, estimate_candidates, label_blur_map, simulate_defocus
from napari_defocus.labeling import confidence
from napari_defocus.likelihood.evidence import averaged_curve

DOMAIN, BEYOND = 8.0, 12.0


@dataclass(frozen=True)
class Scene:
    """What is known of the windows of one simulated picture; each array is (R, C)."""

    kind: str
    share: np.ndarray
    prior: np.ndarray
    informed: np.ndarray
    jump: np.ndarray
    right: np.ndarray
    stated: np.ndarray


def main() -> None:
    arguments = parsed_arguments()
    pictures = list(
        (sharp_pictures(Path("scikit-image")) | sharp_pictures(arguments.data)).values()
    )
    if arguments.fit:
        fitted = fit([scene for seed in range(6) for scene in scenes(pictures[::2], seed)])
        print(f"weight of mass {fitted[0]:.3f}, of jump {fitted[1]:.3f}, bias {fitted[2]:.3f}\n")
    held_out = [scene for seed in range(10, 16) for scene in scenes(pictures[1::2], seed)]
    for kinds in ({"ramp", "layers"}, {"ramp"}, {"layers"}, {"hard"}):
        report(" and ".join(sorted(kinds)), [scene for scene in held_out if scene.kind in kinds])


def parsed_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "sharp"
    parser.add_argument("--data", type=Path, default=shared, help="folder of sharp pictures")
    parser.add_argument("--fit", action="store_true", help="find the constants first")
    return parser.parse_args()


def scenes(pictures: list[np.ndarray], seed: int) -> list[Scene]:
    found = []
    for number, picture in enumerate(pictures):
        rng = np.random.default_rng([seed, number])
        kind = ("ramp", "layers", "hard")[(seed + number) % 3]
        truth = random_ramp(rng) if kind == "ramp" else layers(rng, beyond=kind == "hard")
        variance = 10 ** rng.uniform(-6, -4)
        blurred = simulate_defocus(
            picture, truth, psf=Disc(BEYOND), noise_variance=variance, rng=rng
        )
        found.append(scene(kind, jpeg(blurred) if kind == "hard" else blurred, truth))
    return found


def scene(kind: str, picture: np.ndarray, truth: np.ndarray) -> Scene:
    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture)
    jump = maximum_filter(blur_map, 31) - minimum_filter(blur_map, 31)
    radius, jump = at_windows(blur_map, candidates), at_windows(jump, candidates)
    curve = averaged_curve(candidates)
    share, prior, depth = confidence.likelihood_share(candidates, curve, radius)
    right = np.abs(radius - at_windows(truth, candidates)) <= confidence.TOLERANCE
    stated = confidence.window_confidence(candidates, curve, radius, jump)
    return Scene(kind, share, prior, confidence.informed_share(depth), jump, right, stated)


def random_ramp(rng: np.random.Generator) -> np.ndarray:
    row, column = np.indices((SIDE, SIDE))
    angle = rng.uniform(0, 2 * np.pi)
    height = np.cos(angle) * row + np.sin(angle) * column
    low, high = rng.uniform(0.5, 7.5, 2)
    return low + (high - low) * (height - height.min()) / np.ptp(height)


def layers(rng: np.random.Generator, *, beyond: bool) -> np.ndarray:
    """One to three ellipses before a background, each of its own blur."""
    row, column = np.indices((SIDE, SIDE))
    largest = BEYOND if beyond else 7.5
    truth = np.full((SIDE, SIDE), rng.uniform(0.5, largest))
    for _ in range(rng.integers(1, 4)):
        y, x = rng.uniform(0, SIDE, 2)
        long, short = rng.uniform(40, 110, 2)
        angle = rng.uniform(0, np.pi)
        along = (column - x) * np.cos(angle) + (row - y) * np.sin(angle)
        across = (row - y) * np.cos(angle) - (column - x) * np.sin(angle)
        truth[(along / long) ** 2 + (across / short) ** 2 < 1] = rng.uniform(0.5, largest)
    return truth


def jpeg(picture: np.ndarray) -> np.ndarray:
    whole = np.clip(np.rint(255 * picture), 0, 255).astype(np.uint8)
    return imageio.imread(
        io.BytesIO(imageio.imwrite("<bytes>", whole, extension=".jpg", quality=90))
    )


def fit(found: list[Scene]) -> np.ndarray:
    """Find the weights that make what was seen most probable."""
    share, prior, informed, jump, right = (
        np.concatenate([getattr(scene, name).ravel() for scene in found])
        for name in ("share", "prior", "informed", "jump", "right")
    )
    odds = np.log((share + confidence._LEAST_ODDS) / (1 - share + confidence._LEAST_ODDS))
    design = np.stack([odds, np.log(jump + confidence._LEAST_JUMP), np.ones_like(odds)], axis=1)

    def surprise(weights: np.ndarray) -> float:
        sure = informed / (1 + np.exp(-design @ weights)) + (1 - informed) * prior
        return -np.mean(np.log(np.where(right, sure, 1 - sure) + 1e-6))

    return minimize(surprise, [0.4, -0.4, 1.0]).x


def report(name: str, found: list[Scene]) -> None:
    stated = np.concatenate([scene.stated.ravel() for scene in found])
    right = np.concatenate([scene.right.ravel() for scene in found])
    place = np.minimum((10 * stated).astype(int), 9)
    differences = []
    print(f"{name}: {right.mean():.0%} of {len(right)} windows are right\n")
    print("| stated | windows | mean stated | right |\n|---|---|---|---|")
    for k in range(10):
        inside = place == k
        if inside.sum() >= 50:
            means = stated[inside].mean(), right[inside].mean()
            differences.append((abs(means[0] - means[1]), inside.sum()))
            print(f"| {k / 10:.1f} to {(k + 1) / 10:.1f} | {inside.sum()} | "
                  f"{means[0]:.2f} | {means[1]:.2f} |")  # fmt: skip
    each, count = np.array(differences).T
    print(f"\nmean difference of the bins {each.mean():.3f}, of the windows "
          f"{np.average(each, weights=count):.3f}\n")  # fmt: skip


if __name__ == "__main__":
    main()
