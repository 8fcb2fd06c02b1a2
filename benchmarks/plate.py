"""A plate of simulated fields with known faults: are the flags right, and how long does it take?

    python benchmarks/plate.py --quick              # 24 fields of 0.1 megapixels
    python benchmarks/plate.py --wells 48           # a part of the plate of 384
    python benchmarks/plate.py                      # 384 fields of 1 megapixel

Rows A to H are stained cells, from few to many; the others tissue (`immunohistochemistry` of
scikit-image). A well is in focus, or 2, 4 or 8 px out of focus, empty, saturated, or moved by 20
px while the shutter was open. All have noise, and 8 bits. The limits are those of `LIMITS`, as a
lab would set them for such plates; it is told what the defaults give.

The time is that of `measure_batch` on two workers, with its table and its report; kernels are
compiled before. Where other programs use the same cores, the seconds of the processors say more:
half of them is the time on two free ones.
"""

import argparse
import csv
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import PIL.Image
from scipy.ndimage import uniform_filter1d
from skimage.data import immunohistochemistry

from napari_defocus import (
    FieldLimits,
    Settings,
    measure_batch,
    simulate_defocus,
    write_report,
)
from napari_defocus.batch.cluster import dask_client
from napari_defocus.settings import MapSettings

EXPECTED = {
    "in focus": "",
    "2 px": "out of focus",
    "4 px": "out of focus",
    "8 px": "out of focus",
    "empty": "empty",
    "saturated": "saturated",
    "motion": "not defocus",
}
KINDS = ("in focus", "in focus", *EXPECTED)
"""Of the wells, again and again: a third is in focus."""

RADII = {"2 px": 2.0, "4 px": 4.0, "8 px": 8.0}
LIMITS = FieldLimits(max_one_direction=0.6, max_share_saturated=0.02)
NOISE, MOVED = 0.005, 20
CELLS = (100, 300, 900)
"""A megapixel."""


def cells(rng, side, density):
    """Nuclei of different sizes, brightness and texture on a dark ground."""
    count, reach = max(6, round(density * side**2 / 1e6)), 24
    seen = np.zeros((side + 2 * reach, side + 2 * reach))
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    for top, left in rng.integers(0, side, (count, 2)):
        long, short, angle = rng.uniform(9, 20), rng.uniform(7, 12), rng.uniform(0, np.pi)
        along = row * np.cos(angle) + column * np.sin(angle)
        across = column * np.cos(angle) - row * np.sin(angle)
        inside = (1 - np.hypot(along / long, across / short)) * short + 0.5
        part = seen[top : top + 2 * reach + 1, left : left + 2 * reach + 1]
        np.maximum(part, rng.uniform(0.4, 1) * inside.clip(0, 1), out=part)
    body = seen[reach:-reach, reach:-reach]
    return 0.03 + 0.6 * body * (1 + 0.25 * texture(rng, side))


def texture(rng, side):
    """Noise with amplitudes that fall as f^-0.7, as chromatin has them."""
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side))
    frequency[0, 0] = np.inf
    white = np.fft.rfft2(rng.standard_normal((side, side)))
    shown = np.fft.irfft2(white * frequency**-0.7, s=(side, side))
    return np.clip(shown / shown.std(), -2, 2)


def tissue(rng, side):
    """A part of a stained section, as sharp as its pixels, mirrored until it fills the field."""
    picture = immunohistochemistry().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3)) / 255
    more = side + 256
    wide = np.pad(picture, ((0, more), (0, more), (0, 0)), mode="symmetric")
    top, left = rng.integers(0, 256, 2)
    return wide[top : top + side, left : left + side]


def field(kind, row, rng, side):
    """Return what a well shows, 8 bits."""
    stained = row < 8
    sharp = cells(rng, side, CELLS[row % len(CELLS)]) if stained else tissue(rng, side)
    if kind in RADII:
        sharp = simulate_defocus(sharp, np.full((side, side), RADII[kind]))
    elif kind == "empty":
        sharp = np.full_like(sharp, 0.03 if stained else 0.9)
    elif kind == "saturated":
        sharp = sharp * (5 if stained else 1.9)
    elif kind == "motion":
        sharp = uniform_filter1d(sharp, MOVED, axis=int(rng.integers(2)))
    noisy = sharp + rng.normal(0, NOISE, sharp.shape)
    return np.rint(255 * noisy.clip(0, 1)).astype(np.uint8)


def make_plate(folder, wells, side, seed):
    """Write the fields of wells spread over the plate; return the kind of each."""
    folder.mkdir()
    truth = {}
    for number in np.linspace(0, 383, wells).round().astype(int).tolist():
        name = f"{'ABCDEFGHIJKLMNOP'[number // 24]}{number % 24 + 1:02d}"
        rng = np.random.default_rng((seed, number))
        truth[name] = KINDS[len(truth) % len(KINDS)]
        shown = field(truth[name], number // 24, rng, side)
        PIL.Image.fromarray(shown).save(folder / f"{name}.png", compress_level=1)
    return truth


def flags_in(table):
    with table.open(encoding="utf-8", newline="") as file:
        return {row["well"]: row for row in csv.DictReader(file)}


def is_right(kind, flags):
    """Tell whether a field has the flag that it should, and if it should have none, none."""
    return EXPECTED[kind] in flags.split("; ") if EXPECTED[kind] else not flags


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wells", type=int, default=384)
    parser.add_argument("--side", type=int, default=1000, help="px")
    parser.add_argument("--stride", type=int, default=MapSettings.stride, help="px")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="24 fields of 320 x 320 px")
    parser.add_argument("--out", type=Path, help="a folder that is kept, for the report")
    given = parser.parse_args()
    if given.quick:
        given.wells, given.side = 24, 320
    with tempfile.TemporaryDirectory() as scratch:
        place = given.out or Path(scratch)
        place.mkdir(exist_ok=True)
        truth = make_plate(place / "fields", given.wells, given.side, given.seed)
        settings = Settings(map=MapSettings(stride=given.stride))
        with dask_client(workers=given.workers) as client:
            compile_kernels(Path(scratch), settings, client)
            begun, worked = time.perf_counter(), processor_seconds(client)
            report = measure_batch(
                place / "fields",
                place / "measured",
                settings=settings,
                limits=LIMITS,
                client=client,
            )
            seconds = time.perf_counter() - begun
            worked = processor_seconds(client) - worked
        by_limits = flags_in(report.table)
        by_defaults = flags_in(write_report(place / "measured").table)
        write_report(place / "measured", limits=LIMITS)
        tell(truth, by_limits, by_defaults, seconds, worked, given)


def processor_seconds(client):
    return sum(client.run(time.process_time).values()) + time.process_time()


def compile_kernels(scratch, settings, client):
    folder = scratch / "small"
    make_plate(folder, 2 * len(KINDS), 128, 1)
    measure_batch(folder, scratch / "compiled", settings=settings, client=client)


def tell(truth, rows, by_defaults, seconds, worked, given):
    right = Counter()
    for well, kind in truth.items():
        good = is_right(kind, rows[well]["flags"])
        right[kind] += good
        if not good:
            row = rows[well]
            numbers = (row["median_known_radius_px"], row["share_sure"], row["one_direction"])
            print(f"{well}, {kind}: flags {row['flags']!r}, radius, known, direction {numbers}")
    counts = Counter(truth.values())
    print("\n| kind | flags right |\n|---|---:|")
    for kind, count in counts.items():
        print(f"| {kind} | {right[kind]} of {count} |")
    share, each = sum(right.values()) / len(truth), worked / len(truth)
    print(f"| all | {100 * share:.1f} % |\n")
    usual = sum(is_right(kind, by_defaults[well]["flags"]) for well, kind in truth.items())
    trusted = sum((not rows[well]["flags"]) == (kind == "in focus") for well, kind in truth.items())
    print(f"By the default limits {usual} of {len(truth)} are right.")
    print(f"Flagged or not, whatever the flag, is right for {trusted} of {len(truth)}.")
    print(
        f"{len(truth)} fields of {given.side} x {given.side} px, stride {given.stride}, "
        f"{given.workers} workers: {seconds:.0f} s, {each:.1f} s of a processor for a field; 384 "
        f"fields would take {384 * each / 2 / 60:.0f} min of two free cores"
    )


if __name__ == "__main__":
    main()
