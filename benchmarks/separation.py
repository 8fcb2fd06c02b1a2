"""How well blurred and sharp pixels are told apart, beside two other measures of blur.

    python benchmarks/separation.py --data FOLDER_OF_SHARP_PICTURES

Pictures are taken by the camera of camera.py, with each map upright and upside down, so that the
sky is as often sharp as it is blurred. Pixels of true radii above 2 px are blurred. Prints a
Markdown table: the area under the ROC curve, the mean over the pictures, for the blur map, for
the local variance of the Laplacian (Gaussian window, standard deviation 15 px: none of 4 to 20 px
did better over all) and for PyPI's blur-detector, as in speed.py. The order of the pixels is all
that counts, and 0.5 is chance.
"""

import argparse
import warnings
from pathlib import Path

import numpy as np
from blur_detector import detectBlur
from camera import LUMA, MAPS, large_pictures, photographed, with_flats
from scipy.ndimage import gaussian_filter, laplace
from scipy.stats import rankdata

from napari_defocus import estimate_blur_map

THRESHOLD = 2.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "sharp"
    parser.add_argument("--data", type=Path, default=shared, help="folder of sharp pictures")
    pictures = large_pictures(parser.parse_args().data)
    print(f"{', '.join(pictures)}\n")
    print("| blur | pictures | blur map | Laplacian | blur-detector |\n" + "|---" * 5 + "|")
    for blur, truth in MAPS.items():
        for content, paint in {"as they are": np.asarray, "wall and sky": with_flats}.items():
            areas = []
            for number, picture in enumerate(pictures.values()):
                for radii in (truth, truth[::-1]):
                    seen = photographed(paint(picture), radii, number)
                    areas.append([area_under_roc(s, radii > THRESHOLD) for s in scores(seen)])
            cells = (f"{area:.3f}" for area in np.mean(areas, axis=0))
            print(f"| {blur} | {content} | {' | '.join(cells)} |", flush=True)


def scores(picture: np.ndarray) -> list[np.ndarray]:
    """Return three measures that are large where a picture, uint8, is blurred."""
    luma = picture @ LUMA / 255
    return [estimate_blur_map(picture), -laplacian_variance(luma), -detected_sharpness(luma)]


def laplacian_variance(luma: np.ndarray) -> np.ndarray:
    response = laplace(luma)
    return gaussian_filter(response**2, 15) - gaussian_filter(response, 15) ** 2


def detected_sharpness(luma: np.ndarray) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return detectBlur(
            luma,
            downsampling_factor=4,
            num_scales=4,
            scale_start=2,
            num_iterations_RF_filter=3,
            show_progress=False,
        )


def area_under_roc(score: np.ndarray, positive: np.ndarray) -> float:
    """Return the share of pairs, one positive and one not, that are in order; ties are half."""
    ranks, count = rankdata(score)[positive.ravel()], positive.sum()
    return (ranks.sum() - count * (count + 1) / 2) / (count * (~positive).sum())


if __name__ == "__main__":
    main()
