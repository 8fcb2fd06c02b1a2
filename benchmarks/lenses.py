"""How far blur maps are from the truth when the lens is no disc, or is not known.

    python benchmarks/lenses.py --data FOLDER_OF_SHARP_PICTURES

Pictures are blurred by a ramp of the blur radius from 1 to 7 px with the PSFs of several lenses,
and analysed with the right family, with discs, and with families that were calibrated from 9
settings of the lens, 0 to 8 px: from one point source each, with noise of 2 % of its peak, and
from blurred and sharp versions of the first picture.

Prints a Markdown table: the mean over the pictures of the absolute error (MAE, px), its ratio to
that of discs on discs and to that of the lens' own family, the MAE of the median picture, the
bias (px), and the share of pixels within 0.5 px. The scale of every family is the blur radius, so
that the error with the wrong one is that of what the lens takes from the picture, not of a unit.
"""

import argparse
from pathlib import Path

import numpy as np
from pictures import SIDE, sharp_pictures

from napari_defocus import Disc, estimate_blur_map, simulate_defocus
from napari_defocus.psf.calibration import calibrate_psf
from napari_defocus.psf.families import Annulus, Gaussian, Polygon, PSFFamily
from napari_defocus.psf.measured import MeasuredPSF

SETTINGS = range(9)
LAMP_NOISE = 0.02


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "sharp"
    parser.add_argument("--data", type=Path, default=shared, help="folder of sharp pictures")
    parser.add_argument("--noise", type=float, default=1e-6)
    arguments = parser.parse_args()
    pictures = list(sharp_pictures(arguments.data).values())
    row, column = np.indices((SIDE, SIDE)) / (SIDE - 1)
    truth = 1 + 6 * (0.8 * row + 0.2 * column)
    print("| lens | assumed | MAE | to discs | to own | median MAE | bias | within 0.5 px |")
    print("|---" * 8 + "|")
    discs = None
    for lens, families in cases(pictures[0], arguments.noise).items():
        blurred = [
            simulate_defocus(picture, truth, psf=lens, noise_variance=arguments.noise, rng=0)
            for picture in pictures
        ]
        own = None
        for name, family in families.items():
            errors = [estimate_blur_map(b, psf=family) - truth for b in blurred]
            error = np.mean(np.abs(errors))
            discs, own = discs or error, own or error
            print(
                f"| {type(lens).__name__} | {name} | {error:.3f} | {error / discs:.2f} "
                f"| {error / own:.2f} | {np.median(np.mean(np.abs(errors), axis=(1, 2))):.3f} "
                f"| {np.mean(errors):+.3f} | {np.mean(np.abs(errors) <= 0.5):.0%} |",
                flush=True,
            )


def cases(picture: np.ndarray, noise: float) -> dict[PSFFamily, dict[str, PSFFamily]]:
    """Return the families to assume for each lens, its own first."""
    polygon, annulus, gaussian = Polygon(6), Annulus(0.5), Gaussian()
    return {
        Disc(): {"Disc": Disc()},
        polygon: {
            "Polygon": polygon,
            "Disc": Disc(),
            "calibrated, points": calibrated_from_points(polygon),
            "calibrated, points, scales given": calibrated_from_points(polygon, SETTINGS),
            "calibrated, pairs": calibrated_from_pairs(polygon, picture, noise),
        },
        annulus: {
            "Annulus": annulus,
            "Disc": Disc(),
            "calibrated, points, scales given": calibrated_from_points(annulus, SETTINGS),
            "calibrated, pairs, scales given": calibrated_from_pairs(
                annulus, picture, noise, SETTINGS
            ),
        },
        gaussian: {"Gaussian": gaussian, "Disc": Disc()},
    }


def calibrated_from_points(lens: PSFFamily, scales: range | None = None) -> MeasuredPSF:
    rng = np.random.default_rng(0)
    dark = np.zeros((61, 61), np.float32)
    dark[30, 30] = 1
    spots = [simulate_defocus(dark, np.full(dark.shape, radius), psf=lens) for radius in SETTINGS]
    noise = LAMP_NOISE * rng.standard_normal((len(spots), *dark.shape))
    pictures = [0.8 * (spot / spot.max() + n) for spot, n in zip(spots, noise, strict=True)]
    return calibrate_psf(pictures, scales=scales, max_scale=lens.max_scale)


def calibrated_from_pairs(
    lens: PSFFamily, sharp: np.ndarray, noise: float, scales: range | None = None
) -> MeasuredPSF:
    pictures = [
        simulate_defocus(
            sharp, np.full(sharp.shape[:2], radius), psf=lens, noise_variance=noise, rng=radius
        )
        for radius in SETTINGS
    ]
    return calibrate_psf(pictures, sharp=sharp, scales=scales, max_scale=lens.max_scale)


if __name__ == "__main__":
    main()
