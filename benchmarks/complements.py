"""Whether two pictures of a scene, focused on the one and on the other of its depths, complement.

    python benchmarks/complements.py --data FOLDER_OF_SHARP_PICTURES

What is in focus in the one is blurred in the other, whatever is in the scene: a truth that needs no
outlines. A subject of each sharp picture, an irregular blob, lies before another picture; both are
seen by a lens that is focused on one of them and blurs the other by 3 to 12 px, behind noise or
JPEG. Prints a Markdown table: the share of the pixels on which exactly one of both masks says "in
focus", with the threshold found from each picture and with 2 px, and the intersection over union of
the masks with the truth. A part of run_all.py.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from measures import overlap
from pictures import whole_sharp_pictures
from record import Number, Record, circumstances, table
from scenes import eight_bits, jpeg
from scipy.ndimage import gaussian_filter
from skimage.util import img_as_float

from napari_defocus import estimate_candidates, segment_in_focus, simulate_layered_defocus

SIDES = 360, 480
SHARP = 0.5
RADII = 3.0, 6.0, 12.0
AREA = 0.35
QUALITY, VARIANCE = 85, 1e-5
METHODS = {"threshold found": "auto", "threshold of 2 px": 2.0}
COMPLEMENT, UNION = "complements, share of pixels", "complements, intersection over union"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of sharp pictures; scikit-image's own")
    sources, record = whole_sharp_pictures(parser.parse_args().data), Record(circumstances())
    measure_complements(sources, record)
    print(table(record, record.rows(), METHODS))


def measure_complements(
    sources: dict[str, np.ndarray], record: Record, *, quick: bool = False
) -> None:
    """Add how well the masks of both pictures complement each other, for each radius."""
    for radius in RADII[1:2] if quick else RADII:
        pairs = list(scenes(sources, radius))
        for method, threshold in METHODS.items():
            found = [figures(*pair, threshold) for pair in pairs]
            for measure, values in zip((COMPLEMENT, UNION), zip(*found, strict=True), strict=True):
                record.add(
                    Number(f"pairs, {radius:g} px", measure, method, values, better="higher")
                )


def scenes(
    sources: dict[str, np.ndarray], radius: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return scenes focused on the subject and on what lies behind, and where the subject is."""
    pictures = [of_one_size(source) for source in sources.values()]
    for number, subject in enumerate(pictures):
        rng = np.random.default_rng([number, round(radius)])
        inside = blob(rng)
        sharp = np.where(inside[..., None], subject, pictures[(number + 1) % len(pictures)])
        seen = []
        for on_subject in (True, False):
            radii = np.where(inside == on_subject, SHARP, radius)
            picture, _ = simulate_layered_defocus(
                sharp, np.where(inside, 0.0, 1.0), radii, noise_variance=VARIANCE, rng=rng
            )
            seen.append(jpeg(picture, QUALITY) if number % 2 else eight_bits(picture))
        yield *seen, inside


def of_one_size(picture: np.ndarray) -> np.ndarray:
    """Return the middle of a picture, mirrored at its borders where it is too small, in colour."""
    colors = img_as_float(picture)
    colors = np.repeat(colors[..., None], 3, axis=2) if colors.ndim == 2 else colors
    lacking = [max(0, side - length) for side, length in zip(SIDES, colors.shape, strict=False)]
    padded = np.pad(colors, [*((n // 2, n - n // 2) for n in lacking), (0, 0)], mode="symmetric")
    top, left = ((length - side) // 2 for length, side in zip(padded.shape, SIDES, strict=False))
    return padded[top : top + SIDES[0], left : left + SIDES[1]]


def blob(rng: np.random.Generator) -> np.ndarray:
    """Return an irregular region of a third of the picture."""
    rough = gaussian_filter(rng.standard_normal(SIDES), 30)
    row, column = (np.indices(SIDES) - np.array(SIDES)[:, None, None] / 2) / max(SIDES)
    height = rough / rough.std() / 2 - 5 * np.hypot(row, column)
    return height > np.quantile(height, 1 - AREA)


def figures(
    on_subject: np.ndarray, behind: np.ndarray, inside: np.ndarray, threshold: float | str
) -> tuple[float, float]:
    """Return the share of pixels that complement, and the mean intersection over union."""
    first, second = (
        segment_in_focus(estimate_candidates(picture), picture, threshold=threshold) == 1
        for picture in (on_subject, behind)
    )
    unions = overlap(first, inside), overlap(second, ~inside)
    return float((first != second).mean()), float(np.mean(unions))


if __name__ == "__main__":
    main()
