"""Where a stack is in focus, against the truth; and what the sharpest pixels are worth.

    python benchmarks/stacks.py --data FOLDER_OF_SHARP_PICTURES [--fit] [--look FOLDER]
    python benchmarks/stacks.py --moving
    python benchmarks/stacks.py --peers [--look FOLDER]

A sharp picture, seen in planes whose focus moves by equal steps: the radius of plane z is
k |z - z0(x, y)| px, up to 16 px, with white noise in each channel. z0 is slanted, curved (hills
and valleys), or slanted with a step: a disc that is somewhere else. The step goes across the
picture's things, where no colour tells of it.

Prints a Markdown table, means over the pictures: the share of textured pixels whose position is
within half a plane of the true one; the median error, in planes; k as it was found; the PSNR of
the composite, of the best single plane, of a composite by the local variance of the Laplacian
(over squares of 3 to 25 px, the best side for each stack, which knows the truth), and of one by
the true nearest plane. Textured is where the sharp picture's luminance, without what a Gaussian
of 2 px leaves of it, has a local standard deviation (Gaussian of 5 px) above 0.01.

Then the confidence: of all pixels with about the same one, the share that is right to half a
plane; and the seconds for a plane of 1 MP. With --fit, finds the constants of the confidence on
the other half of the pictures first.

With --moving, stacks that drift, breathe and flicker instead (`moving_stacks`), and clipped
highlights: the PSNR of the composite, after one factor of brightness and without the outermost
16 px, beside that of the stack which does none of it, with the same noise; by how many px the
alignment is off at most, and by which part the gains; and how many pixels lie in islands, over 1.5
planes off the median of 41 x 41 px where the true position is not.

With --peers, the composites of other programs on such stacks (`stack_conditions`, `stack_peers`).
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from moving_stacks import taken
from pictures import picture_paths, sharp_pictures
from scipy.ndimage import gaussian_filter, laplace, median_filter, uniform_filter
from scipy.optimize import minimize
from skimage.util import img_as_float
from stack_conditions import report_peers

from napari_defocus import Disc, SharpestPlane, sharpest_plane, simulate_defocus
from napari_defocus.core.image import LUMA_WEIGHTS
from napari_defocus.stacks import focus_labels as labels

PLANES = {0.5: 25, 1.0: 21, 2.0: 15}
LARGEST = 16.0
SHAPES = ("slanted", "curved", "step")
SQUARES = (3, 5, 9, 15, 25)
BINS = (0, 0.2, 0.5, 0.8, 0.9, 0.95, 0.98, 1.001)


@dataclass(frozen=True)
class Stack:
    """A simulated stack: planes (Z, H, W, 3), sharp (H, W, 3), positions (H, W)."""

    name: str
    planes: np.ndarray
    sharp: np.ndarray
    truth: np.ndarray

    @property
    def nearest(self) -> np.ndarray:
        return np.rint(self.truth).astype(int)


def main() -> None:
    arguments = parsed_arguments()
    if arguments.moving:
        report_moving(arguments)
        return
    if arguments.peers:
        report_peers(arguments)
        return
    pictures = {
        name: np.asarray(picture / (255 if picture.dtype == np.uint8 else 1), np.float32)
        for name, picture in sharp_pictures(arguments.data).items()
    }
    if arguments.fit:
        print("weight of mass {:.3f}, bias {:.3f}\n".format(*fit(pictures)))
    chosen = {name: pictures[name] for name in list(pictures)[:: arguments.every]}
    print(f"{', '.join(chosen)}\n")
    print("| focus | px a plane | noise | within half a plane | median error | k found | PSNR "
          "| best plane | Laplacian | true planes |")  # fmt: skip
    print("|---" * 10 + "|")
    stated, right = [], []
    for shape in SHAPES:
        for k in arguments.px_per_plane:
            for variance in arguments.noise:
                rows = []
                for stack in stacks(chosen, shape, k, variance):
                    found = sharpest_plane(stack.planes)
                    rows.append(scores(stack, found))
                    stated.append(found.confidence.ravel()[::7])
                    right.append(is_right(stack, found).ravel()[::7])
                    if arguments.look:
                        look(arguments.look, f"{stack.name}-{shape}-{k:g}", stack, found)
                print(table_row(shape, k, variance, np.mean(rows, axis=0)), flush=True)
    report_confidence(np.concatenate(stated), np.concatenate(right))
    report_speed()


def parsed_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "sharp"
    parser.add_argument("--data", type=Path, default=shared, help="folder of sharp pictures")
    parser.add_argument("--noise", type=float, nargs="+", default=[1e-6, 1e-4])
    parser.add_argument("--px-per-plane", type=float, nargs="+", default=list(PLANES))
    parser.add_argument("--every", type=int, default=2, help="take every n-th picture")
    parser.add_argument("--moving", action="store_true", help="stacks that drift and flicker")
    parser.add_argument("--peers", action="store_true", help="composites of other programs")
    parser.add_argument("--only", nargs="+", help="some of the programs of --peers")
    parser.add_argument("--fit", action="store_true", help="find the constants first")
    parser.add_argument("--look", type=Path, help="folder for PNGs of positions and composites")
    return parser.parse_args()


def stacks(
    pictures: dict[str, np.ndarray], shape: str, k: float, variance: float
) -> Iterator[Stack]:
    count = PLANES.get(k, 21)
    for name, sharp in pictures.items():
        truth = positions(shape, count, sharp.shape[:2])
        rng = np.random.default_rng(0)
        planes = [
            simulate_defocus(
                sharp,
                np.minimum(k * np.abs(plane - truth), LARGEST),
                psf=Disc(LARGEST),
                noise_variance=variance,
                rng=rng,
            )
            for plane in range(count)
        ]
        yield Stack(name, np.stack(planes), sharp, truth)


def positions(shape: str, count: int, size: tuple[int, int]) -> np.ndarray:
    """Return z0 between the third plane and the last but two: (H, W)."""
    row, column = (at / length for at, length in zip(np.indices(size), size, strict=True))
    return position_at(shape, count, row, column)


def position_at(shape: str, count: int, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Return z0 at shares of the height and of the width."""
    if shape == "curved":
        part = (1 - np.cos(2 * np.pi * column) * np.cos(2 * np.pi * row)) / 2
    elif shape == "slanted":
        part = 0.35 * column + 0.65 * row
    else:
        disc = (column - 0.55) ** 2 + (row - 0.5) ** 2 < 0.3**2
        part = np.where(disc, 0.85 - 0.2 * column, 0.15 + 0.3 * row)
    return 2 + (count - 5) * part


def scores(stack: Stack, found: SharpestPlane) -> list[float]:
    where = textured(stack.sharp)
    error = np.abs(found.position - stack.truth)[where]
    by_laplacian = (take(stack.planes, sharpest_by_laplacian(stack, side)) for side in SQUARES)
    return [
        float(np.mean(error <= labels.TOLERANCE)),
        float(np.median(error)),
        found.px_per_plane,
        psnr(found.composite, stack.sharp),
        max(psnr(plane, stack.sharp) for plane in stack.planes),
        max(psnr(composite, stack.sharp) for composite in by_laplacian),
        psnr(take(stack.planes, stack.nearest), stack.sharp),
    ]


def textured(sharp: np.ndarray) -> np.ndarray:
    fine = luminance(sharp) - gaussian_filter(luminance(sharp), 2)
    return gaussian_filter(fine**2, 5) > 0.01**2


def luminance(picture: np.ndarray) -> np.ndarray:
    return picture @ np.array(LUMA_WEIGHTS, np.float32) if picture.ndim == 3 else picture


def sharpest_by_laplacian(stack: Stack, side: int) -> np.ndarray:
    """Return the plane in which the Laplacian varies most over squares: (H, W)."""
    variances = []
    for plane in stack.planes:
        bent = laplace(luminance(plane))
        variances.append(uniform_filter(bent**2, side) - uniform_filter(bent, side) ** 2)
    return np.argmax(variances, axis=0)


def take(planes: np.ndarray, plane: np.ndarray) -> np.ndarray:
    rows, columns = np.indices(plane.shape)
    return planes[plane, rows, columns]


def psnr(picture: np.ndarray, sharp: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((picture - sharp) ** 2)))


def is_right(stack: Stack, found: SharpestPlane) -> np.ndarray:
    return np.abs(found.position - stack.truth) <= labels.TOLERANCE


def table_row(shape: str, k: float, variance: float, values: np.ndarray) -> str:
    share, error, speed, *decibels = values
    cells = " | ".join(f"{value:.1f}" for value in decibels)
    return (
        f"| {shape} | {k:g} | {variance:.0e} | {share:.1%} | {error:.3f} | {speed:.2f} | {cells} |"
    )


def report_confidence(stated: np.ndarray, right: np.ndarray) -> None:
    print("\n| confidence | pixels | stated | right |\n" + "|---" * 4 + "|")
    for low, high in pairwise(BINS):
        here = (stated >= low) & (stated < high)
        if here.any():
            print(f"| {low:g} to {min(high, 1):g} | {here.mean():.1%} | {stated[here].mean():.3f} "
                  f"| {right[here].mean():.3f} |")  # fmt: skip


CONDITIONS = {
    "still": {},
    "drift 1.5 px": {"drift": 1.5},
    "drift 3 px, breathing 2 %": {"drift": 3, "breathing": 0.02},
    "turning 0.3 degrees": {"turning": 0.3},
    "flicker 25 %": {"flicker": 0.25},
    "all of it": {"drift": 3, "breathing": 0.02, "turning": 0.1, "flicker": 0.25},
}
EDGE = 16


def report_moving(arguments: argparse.Namespace) -> None:
    """Print what stacks that move and flicker lose against those that do not."""
    print("| focus | noise | planes | PSNR | against still | off (px) | gains off | islands |")
    print("|---" * 8 + "|")
    names = [path.stem for path in picture_paths(arguments.data)][:: arguments.every]
    scenes = [img_as_float(imageio.imread(arguments.data / f"{name}.png"))[..., :3] @ LUMA_WEIGHTS
              for name in names]  # fmt: skip
    for shape in ("slanted", "step"):
        for variance in arguments.noise:
            for clipped in (False, True):
                still: list[float] = []
                for name, condition in CONDITIONS.items():
                    rows = [moving_scores(scene, shape, variance, clipped, condition)
                            for scene in scenes]  # fmt: skip
                    still = still or [row[0] for row in rows]
                    lost = [row[0] - before for row, before in zip(rows, still, strict=True)]
                    decibels, off, gains, islands = np.mean(rows, axis=0)
                    what = f"{name}, highlights" if clipped else name
                    print(f"| {shape} | {variance:.0e} | {what} | {decibels:.1f} "
                          f"| {np.mean(lost):+.1f} | {off:.2f} | {gains:.2%} | {islands:.2%} |",
                          flush=True)  # fmt: skip


def moving_scores(
    scene: np.ndarray, shape: str, variance: float, clipped: bool, condition: dict[str, float]
) -> list[float]:
    if clipped:
        scene = with_highlights(scene)

    def focus(row: np.ndarray, column: np.ndarray) -> np.ndarray:
        return position_at(shape, 9, row, column)

    stack = taken(scene, focus, noise_variance=variance, clipped=clipped, **condition)
    found = sharpest_plane(stack.planes)
    inner = np.s_[EDGE:-EDGE, EDGE:-EDGE]
    seen, sharp = found.composite[inner].astype(float), stack.sharp[inner]
    seen = seen * (seen * sharp).sum() / (seen**2).sum()
    if clipped:  # brighter than white is white
        seen = seen.clip(0, 1)
    laid = found.alignment
    off = 0.0 if laid is None else float(np.abs(laid.shift - stack.shift).max())
    gains = float(np.abs(found.gain / stack.gain - 1).max())
    odd = np.abs(found.position - median_filter(found.position, 41)) > 1.5
    true = np.abs(stack.truth - median_filter(stack.truth, 41)) > 0.5
    return [psnr(seen, sharp), off, gains, float(np.mean(odd & ~true))]


def with_highlights(scene: np.ndarray) -> np.ndarray:
    """Return a scene with 12 spots that are 5 to 20 times white: clipped, in and out of focus."""
    rng = np.random.default_rng(0)
    lit = np.array(scene, np.float32)
    for strength in rng.uniform(5, 20, 12):
        row, column = (rng.integers(100, length - 100) for length in scene.shape[:2])
        lit[row : row + 6, column : column + 6] = strength
    return lit


def report_speed() -> None:
    """Time a stack of 1 MP, of noise blurred along a ramp of focus."""
    side, count = 1000, 15
    rng = np.random.default_rng(0)
    sharp = gaussian_filter(rng.standard_normal((side, side)), 0.5).astype(np.float32)
    focus = np.linspace(2, count - 3, side)
    blurred = [0.5 + gaussian_filter(sharp, radius / 2) for radius in range(count)]
    planes = np.empty((count, side, side), np.float32)
    for plane in range(count):
        nearest = np.rint(np.abs(plane - focus)).astype(int)
        for radius in np.unique(nearest):
            planes[plane][:, nearest == radius] = blurred[radius][:, nearest == radius]
    start = time.perf_counter()
    sharpest_plane(planes)
    print(f"\n{(time.perf_counter() - start) / count:.2f} s a plane of 1 MP, {count} planes")


def fit(pictures: dict[str, np.ndarray]) -> np.ndarray:
    """Find the weights that make what was seen in the other pictures most probable."""
    others = {name: pictures[name] for name in list(pictures)[1::2]}
    found = [
        at_windows(stack)
        for shape in SHAPES
        for k, variance in ((0.5, 1e-4), (1.0, 1e-6), (1.0, 1e-3), (2.0, 1e-4))
        for stack in stacks(others, shape, k, variance)
    ]
    odds, prior, informed, right = (np.concatenate(values) for values in zip(*found, strict=True))

    def surprise(weights: np.ndarray) -> float:
        logit = weights[0] * odds + weights[1]
        sure = np.clip(informed / (1 + np.exp(-logit)) + (1 - informed) * prior, 1e-6, 1 - 1e-6)
        return -float(np.mean(np.where(right, np.log(sure), np.log(1 - sure))))

    return minimize(surprise, (1.0, 1.0), method="Nelder-Mead").x


def at_windows(stack: Stack) -> list[np.ndarray]:
    """Return what the confidence of a stack is made from, and whether its position is right."""
    seen = {}
    original = labels.FocusCostVolume.confidence

    def watched(grid: labels.FocusCostVolume, position: np.ndarray) -> np.ndarray:
        seen.update(grid=grid, position=position)
        return original(grid, position)

    labels.FocusCostVolume.confidence = watched
    try:
        sharpest_plane(stack.planes)
    finally:
        labels.FocusCostVolume.confidence = original
    grid, position = seen["grid"], seen["position"]
    centers = grid.blocks.row_centers, grid.blocks.column_centers
    windows = np.ix_(*(np.rint(center).astype(int) for center in centers))
    odds, prior = grid.odds(position[windows])
    right = np.abs(position - stack.truth)[windows] <= labels.TOLERANCE
    return [values.ravel() for values in (odds, prior, grid.informed, right)]


def look(folder: Path, name: str, stack: Stack, found: SharpestPlane) -> None:
    """Draw found and true positions, the confidence, and the composite beside the picture."""
    folder.mkdir(parents=True, exist_ok=True)
    last = len(stack.planes) - 1
    grey = [found.position / last, stack.truth / last, found.confidence]
    tiles = [np.repeat(tile[..., None], 3, axis=2) for tile in grey]
    error = np.abs(found.composite - stack.sharp) * 10
    drawn = np.hstack([*tiles, found.composite, error]).clip(0, 1)
    imageio.imwrite(folder / f"{name}.png", np.rint(255 * drawn).astype(np.uint8))


if __name__ == "__main__":
    main()
