"""How well maps and masks of real photographs agree with outlines drawn by hand.

    python benchmarks/in_focus.py --data FOLDER_OF_PHOTOGRAPHS

The outlines are in benchmarks/masks; a rim of 4 px along them and what is marked as unsure do not
count. Prints a Markdown table: the area under the ROC curve (blurred against in focus) of the blur
map and of peers' scores; and the intersection over union of the default mask, of the map up to
2 px, and of scores cut where it is best for each photograph, which knows the outline. A part of
run_all.py.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from measures import THRESHOLD, area_under_roc, overlap
from peers import SCORES, scores
from pictures import OUTLINES, photographs
from record import OURS, PAPER, Number, Record, circumstances, table
from scipy.ndimage import binary_dilation, binary_erosion
from skimage.draw import polygon2mask

from napari_defocus import estimate_candidates, label_blur_map, segment_in_focus

RIM = 4
CUTS = np.linspace(0.01, 0.99, 50)
AREA, UNION = "in focus, area under ROC", "in focus, intersection over union"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "photos"
    parser.add_argument("--data", type=Path, default=shared, help="folder of the photographs")
    record = Record(circumstances())
    measure_photographs(photographs(parser.parse_args().data), record)
    print(table(record, record.rows(), (OURS, PAPER, *SCORES)))


def measure_photographs(pictures: dict[str, np.ndarray], record: Record) -> None:
    """Add the area under the ROC curve and the intersection over union of each photograph."""
    rows = {name: figures(picture, outline_of(name)) for name, picture in pictures.items()}
    for what, chosen in ({name: [name] for name in rows} | {"photographs": list(rows)}).items():
        for measure, method in next(iter(rows.values())):
            values = tuple(rows[name][measure, method] for name in chosen)
            where = what if what == "photographs" else f"photograph {what}"
            record.add(Number(where, measure, method, values, better="higher"))


def outline_of(name: str) -> dict:
    return json.loads((OUTLINES / f"{name}.json").read_text())


def figures(picture: np.ndarray, outline: dict) -> dict[tuple[str, str], float]:
    """Return each measure of each method."""
    in_focus, counts = masks(outline)
    found: dict[tuple[str, str], float] = {}
    true = in_focus[counts]
    for method, mode in {OURS: "curve", PAPER: "paper"}.items():
        candidates = estimate_candidates(picture, mode=mode)
        blur_map = label_blur_map(candidates, picture)[counts]
        mask = segment_in_focus(candidates, picture)[counts] == 1
        found[AREA, method] = area_under_roc(blur_map, ~true)
        found[UNION, method] = overlap(mask, true)
        if method == OURS:
            found[UNION, "our map up to 2 px"] = overlap(blur_map <= THRESHOLD, true)
    for method, score in scores(picture).items():
        found[AREA, method] = area_under_roc(score[counts], ~true)
        found[UNION, method] = best_overlap(score[counts], true)
    return found


def best_overlap(score: np.ndarray, true: np.ndarray) -> float:
    return max(overlap(score <= cut, true) for cut in np.quantile(score, CUTS))


def masks(outline: dict) -> tuple[np.ndarray, np.ndarray]:
    """Return what is in focus, and which pixels count."""
    width, height = outline["size"]

    def inside(polygons: list) -> np.ndarray:
        parts = [polygon2mask((height, width), np.array(part)[:, ::-1]) for part in polygons]
        return np.any([np.zeros((height, width), bool), *parts], axis=0)

    in_focus = inside(outline["in_focus"])
    rim = binary_dilation(in_focus, iterations=RIM) & ~binary_erosion(in_focus, iterations=RIM)
    return in_focus, ~(inside(outline["unsure"]) & ~in_focus) & ~rim


if __name__ == "__main__":
    main()
