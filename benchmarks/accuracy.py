"""How far the blur map is from the truth, on pictures blurred by known maps.

    python benchmarks/accuracy.py --data FOLDER_OF_SHARP_PICTURES

Prints a Markdown table: for each family of maps and noise variance (of each channel), the mean
over the pictures of the squared error (MSE, px^2), the absolute error (MAE, px) and the share of
pixels within 0.5 px, for the map, for the global maximum of the likelihood alone, and for the
best of the three candidates (which knows the truth); the latter two over the windows that have
any. The picture's own blur adds to that of the map, which counts at 1 px and below.
"""

import argparse
from pathlib import Path

import numpy as np
from pictures import at_windows, bumps, ramp, sharp_pictures, uniform

from napari_defocus import estimate_candidates, label_blur_map, simulate_defocus

FAMILIES = {
    "ramp": ramp(),
    "bumps": bumps(),
    **{f"disc {radius} px": uniform(radius) for radius in (1, 2, 3, 5, 7)},
}


def main() -> None:
    arguments = parsed_arguments()
    pictures = sharp_pictures(arguments.data)
    print(f"mode {arguments.mode}, stride {arguments.stride}; {', '.join(pictures)}\n")
    print("| blur | noise | map MSE | MAE | within 0.5 | maximum MSE | MAE | within 0.5 "
          "| best of 3 MSE | MAE | within 0.5 |")  # fmt: skip
    print("|---" * 11 + "|")
    for family, truth in FAMILIES.items():
        for variance in arguments.noise:
            rows = [scores(picture, truth, variance, arguments) for picture in pictures.values()]
            if arguments.each:
                for name, row in zip(pictures, rows, strict=True):
                    print(table_row(f"{family}, {name}", variance, row))
            print(table_row(family, variance, np.mean(rows, axis=0)), flush=True)


def parsed_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "sharp"
    parser.add_argument("--data", type=Path, default=shared, help="folder of sharp pictures")
    parser.add_argument("--mode", default="curve", choices=("curve", "paper"))
    parser.add_argument("--stride", type=int, default=4)
    parser.add_argument("--noise", type=float, nargs="+", default=[1e-6, 1e-4])
    parser.add_argument("--each", action="store_true", help="a row for each picture too")
    return parser.parse_args()


def scores(
    picture: np.ndarray, truth: np.ndarray, variance: float, arguments: argparse.Namespace
) -> np.ndarray:
    """Return (MSE, MAE, share within 0.5 px) of map, maximum and best of three: (3, 3)."""
    blurred = simulate_defocus(picture, truth, noise_variance=variance, rng=0)
    candidates = estimate_candidates(blurred, mode=arguments.mode, stride=arguments.stride)
    blur_map = label_blur_map(candidates, blurred)
    true_radii = at_windows(truth, candidates)[..., None]
    distances = np.abs(candidates.radii - true_radii)
    distances = distances[np.isfinite(distances[..., 0])]
    errors = (np.abs(blur_map - truth), distances[:, 0], np.nanmin(distances, axis=1))
    return np.array([[np.mean(e**2), np.mean(e), np.mean(e <= 0.5)] for e in errors])


def table_row(family: str, variance: float, values: np.ndarray) -> str:
    cells = [f"{mse:.3f} | {mae:.3f} | {share:.0%}" for mse, mae, share in values]
    return f"| {family} | {variance:.0e} | {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
