"""Blur of up to 48 px, and sharp things before a ground that is so blurred: a part of run_all.py.

    python benchmarks/wide.py [--data FOLDER] [--quick]

Pictures of 3 megapixels are mosaics of sharp pictures, seen by a lens that makes discs, with noise
of variance 1e-5; with --quick, of 0.7 megapixels and fewer. Planes have one radius from 0.5 to
48 px; small ones are measured once more by somebody who knows that no radius is above 8 px. Layers
are sharp things before a blurred ground: a subject of a quarter of the picture, one of 3 %, and
bars and branches that are 5 to 30 px wide.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from measures import THRESHOLD
from pictures import whole_sharp_pictures
from record import OURS, Number, Record, table
from scipy.ndimage import distance_transform_edt
from scipy.signal import oaconvolve

from napari_defocus import Disc, estimate_candidates, label_blur_map, simulate_layered_defocus

NOISE = 1e-5
SHAPE, QUICK_SHAPE = (1536, 2048), (720, 960)
RADII = (0.5, 1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48)
QUICK_RADII = (2, 5, 12, 24, 40)
RANGES = ((8, 16), (16, 32), (32, 48))
NARROW = 8.0
SHARP = 0.5
GROUNDS, QUICK_GROUNDS = (5.0, 10.0, 20.0, 40.0), (5.0, 20.0)
THIN_GROUNDS, QUICK_THIN_GROUNDS = (4.0, 10.0, 20.0), (4.0, 20.0)
WIDTHS = (5, 10, 20, 30)
BESIDE, NEAR = 10, 40


@dataclass(frozen=True, eq=False)
class Mosaic:
    """Sharp pictures side by side, as many as are needed.

    Attributes
    ----------
    sources : list of (h, w, 3) ndarray
        In [0, 1].
    shape : (int, int)
    """

    sources: list[np.ndarray]
    shape: tuple[int, int]

    def laid(self, seed: int) -> np.ndarray:
        """Return the pictures in another order, some of them mirrored: (H, W, 3)."""
        rng = np.random.default_rng(seed)
        side = min(min(source.shape[:2]) for source in self.sources)
        height, width = (-(-length // side) for length in self.shape)
        order = rng.permutation(height * width) % len(self.sources)
        tiles = [_part(self.sources[number], side, rng) for number in order]
        rows = [np.hstack(tiles[at * width : (at + 1) * width]) for at in range(height)]
        return np.vstack(rows)[: self.shape[0], : self.shape[1]]


def _part(source: np.ndarray, side: int, rng: np.random.Generator) -> np.ndarray:
    top, left = (int(rng.integers(0, length - side + 1)) for length in source.shape[:2])
    part = source[top : top + side, left : left + side]
    return part[:, ::-1] if rng.integers(0, 2) else part


def measure_wide(sources: dict[str, np.ndarray], record: Record, *, quick: bool, seed: int) -> None:
    """Add the errors of planes and of layers."""
    colored = [np.atleast_3d(source) * np.ones(3) for source in sources.values()]
    mosaic = Mosaic(colored, QUICK_SHAPE if quick else SHAPE)
    _measure_planes(mosaic, record, QUICK_RADII if quick else RADII, seed)
    grounds = QUICK_GROUNDS if quick else GROUNDS
    for name, paint in {"a subject": subject, "3 % of the picture": small_subject}.items():
        for ground in grounds:
            _measure_outline(name, mosaic, paint(mosaic.shape), ground, record, seed)
    for ground in QUICK_THIN_GROUNDS if quick else THIN_GROUNDS:
        _measure_thin(mosaic, ground, record, seed)


def _measure_planes(mosaic: Mosaic, record: Record, radii: tuple[float, ...], seed: int) -> None:
    found = {radius: _error_of_plane(mosaic, radius, seed) for radius in radii}
    for low, high in RANGES:
        inside = tuple(found[r] / r for r in radii if low < r <= high or r == low == RANGES[0][0])
        record.add(
            Number(f"wide: planes, {low} to {high} px", "mean relative error", OURS, inside, "",
                   "lower")
        )  # fmt: skip
    small = [radius for radius in radii if radius < NARROW]
    narrow = tuple(_error_of_plane(mosaic, radius, seed, NARROW) for radius in small)
    add = partial(Number, "wide: planes below 8 px", "mean error", unit="px", better="lower")
    record.add(
        add(method=OURS, values=tuple(found[radius] for radius in small)),
        add(method="up to 8 px only", values=narrow),
    )


def _error_of_plane(mosaic: Mosaic, radius: float, seed: int, largest: float = 64.0) -> float:
    kernel = Disc(largest).kernel(radius)
    reach = len(kernel) // 2
    sharp = np.pad(mosaic.laid(seed), [(reach, reach), (reach, reach), (0, 0)], mode="symmetric")
    seen = oaconvolve(sharp, kernel[..., None], mode="valid", axes=(0, 1))
    noise = np.random.default_rng(seed).normal(0, NOISE**0.5, seen.shape)
    return float(np.abs(_map_of(seen + noise, largest) - radius).mean())


def _map_of(seen: np.ndarray, largest: float = 64.0) -> np.ndarray:
    picture = seen.astype(np.float32)
    return label_blur_map(estimate_candidates(picture, psf=Disc(largest)), picture)


def subject(shape: tuple[int, int], share: float = 0.25) -> np.ndarray:
    """Return where a thing with a wavy outline is that covers a share of the picture."""
    row, column = (
        at - length * middle
        for at, length, middle in zip(np.indices(shape), shape, (0.52, 0.47), strict=True)
    )
    angle = np.arctan2(row, column)
    waves = 1 + 0.18 * np.sin(3 * angle) + 0.09 * np.sin(7 * angle + 1)
    radius = np.hypot(row, column) / waves
    return radius <= np.sqrt(share * row.size / np.pi / np.mean((1 + 0.0203) ** 2))


small_subject = partial(subject, share=0.03)


def thin_things(shape: tuple[int, int]) -> Iterator[tuple[int, np.ndarray]]:
    """Yield widths in px, and where bars and branches of that width are: one of each."""
    row, column = np.indices(shape)
    across = shape[1] / (2 * len(WIDTHS))
    for number, width in enumerate(WIDTHS):
        bar = np.abs(column - (2 * number + 0.5) * across - 0.1 * (row - shape[0] / 2)) * 0.995
        bend = 0.25 * across * np.sin(2 * np.pi * row / shape[0] + number)
        slope = 0.25 * across * 2 * np.pi / shape[0] * np.cos(2 * np.pi * row / shape[0] + number)
        branch = np.abs(column - (2 * number + 1.5) * across - bend) / np.hypot(1, slope)
        yield width, (bar < width / 2) | (branch < width / 2)


def _layered(
    mosaic: Mosaic, thing: np.ndarray, ground: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return a sharp thing before a blurred ground, and the true radii."""
    sharp = np.where(thing[..., None], mosaic.laid(seed + 1), mosaic.laid(seed))
    radii = np.where(thing, SHARP, ground)
    return simulate_layered_defocus(sharp, ~thing * 1.0, radii, noise_variance=NOISE, rng=seed)


def _measure_outline(
    name: str, mosaic: Mosaic, thing: np.ndarray, ground: float, record: Record, seed: int
) -> None:
    seen, truth = _layered(mosaic, thing, ground, seed)
    error = np.abs(_map_of(seen) - truth)
    away = np.where(thing, -distance_transform_edt(thing), distance_transform_edt(~thing))
    places = {
        "error inside, within 10 px": (away < 0) & (away >= -BESIDE),
        "error farther inside": away < -BESIDE,
        "error outside, within 10 px": (away > 0) & (away <= BESIDE),
        "error outside, 10 to 40 px": (away > BESIDE) & (away <= NEAR),
        "error farther outside": away > NEAR,
    }
    for measure, place in places.items():
        values = (float(error[place].mean()),)
        record.add(
            Number(f"wide: {name} before {ground:g} px", measure, OURS, values, "px", "lower")
        )


def _measure_thin(mosaic: Mosaic, ground: float, record: Record, seed: int) -> None:
    things = dict(thin_things(mosaic.shape))
    thing = np.any(list(things.values()), axis=0)
    seen, truth = _layered(mosaic, thing, ground, seed)
    found = _map_of(seen)
    what = f"wide: thin things before {ground:g} px"
    for width, place in things.items():
        values = (float((found[place] <= THRESHOLD).mean()),)
        record.add(Number(what, f"shown, {width} px wide", OURS, values, "%", "higher"))
    values = (float(np.abs(found - truth)[~thing].mean()),)
    record.add(Number(what, "error beside", OURS, values, "px", "lower"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder of sharp pictures; scikit-image's own")
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    record = Record({})
    measure_wide(whole_sharp_pictures(arguments.data), record, quick=arguments.quick, seed=0)
    print(table(record, record.rows(), (OURS,)))


if __name__ == "__main__":
    main()
