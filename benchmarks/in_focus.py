"""How well maps and masks of real photographs agree with outlines drawn by hand.

    python benchmarks/in_focus.py --data FOLDER_OF_PHOTOGRAPHS

The outlines are in benchmarks/masks; a rim of 4 px along them and what is marked as unsure do not
count. Prints a Markdown table: the area under the ROC curve (blurred against in focus) of the blur
map, of the local variance of the Laplacian and of PyPI's blur-detector, as in separation.py; and
the intersection over union of the default mask, and of the map up to 2 px.
"""

import argparse
import json
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from camera import LUMA
from scipy.ndimage import binary_dilation, binary_erosion
from separation import THRESHOLD, area_under_roc, detected_sharpness, laplacian_variance
from skimage.draw import polygon2mask

from napari_defocus import estimate_candidates, label_blur_map, segment_in_focus

OUTLINES = Path(__file__).parent / "masks"
RIM = 4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "photos"
    parser.add_argument("--data", type=Path, default=shared, help="folder of the photographs")
    folder = parser.parse_args().data
    print(
        "| photograph | map, AUC | Laplacian, AUC | blur-detector, AUC | mask, IoU "
        "| map up to 2 px, IoU |\n" + "|---" * 6 + "|"
    )
    rows = []
    for path in sorted(OUTLINES.glob("*.json")):
        outline = json.loads(path.read_text())
        if not (folder / outline["picture"]).exists():
            raise SystemExit(f"{folder} has no {outline['picture']}; --data takes its folder")
        rows.append(figures(imageio.imread(folder / outline["picture"])[..., :3], outline))
        print(row(path.stem, rows[-1]), flush=True)
    print(row("mean", np.mean(rows, axis=0)))


def row(name: str, numbers: np.ndarray | list[float]) -> str:
    return f"| {name} | " + " | ".join(f"{number:.3f}" for number in numbers) + " |"


def figures(picture: np.ndarray, outline: dict) -> list[float]:
    in_focus, counts = masks(outline)
    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture)
    luma = picture @ LUMA / 255
    scores = (blur_map, -laplacian_variance(luma), -detected_sharpness(luma))
    areas = [area_under_roc(score[counts], ~in_focus[counts]) for score in scores]
    found = (segment_in_focus(candidates, picture) == 1, blur_map <= THRESHOLD)
    return areas + [overlap(each[counts], in_focus[counts]) for each in found]


def masks(outline: dict) -> tuple[np.ndarray, np.ndarray]:
    """Return what is in focus, and which pixels count."""
    width, height = outline["size"]

    def inside(polygons: list) -> np.ndarray:
        parts = [polygon2mask((height, width), np.array(part)[:, ::-1]) for part in polygons]
        return np.any([np.zeros((height, width), bool), *parts], axis=0)

    in_focus = inside(outline["in_focus"])
    rim = binary_dilation(in_focus, iterations=RIM) & ~binary_erosion(in_focus, iterations=RIM)
    return in_focus, ~(inside(outline["unsure"]) & ~in_focus) & ~rim


def overlap(found: np.ndarray, true: np.ndarray) -> float:
    return (found & true).sum() / max(1, (found | true).sum())


if __name__ == "__main__":
    main()
