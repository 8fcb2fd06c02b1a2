"""Everything that is measured against the truth and against peers, in one command, offline.

    python benchmarks/run_all.py [--quick] [--data FOLDER] [--compare OLD.json] [--out FOLDER]

Accuracy on pictures of known blur, of wide blur, on outlined photographs, on pairs of pictures
whose masks complement each other, and on real pictures with a known answer, the calibration of the
confidence, the energy of labels, restoration, time and memory, and what each step beyond the paper
gains.
Prints one Markdown table. With --out, writes peers.md, ablation.md, their plots and numbers.json
there: `--out docs/measured` brings the documentation up to date. With --compare, tells what became
better or worse than in an earlier numbers.json, beyond the spread. All of it takes about 25 minutes
on two cores, --quick 3; --only measures some parts, the others stay as they are in --out; with no
part it writes the pages again. A part that fails is told at the end, and does not stop the others.
Needs `pip install --group bench`.
"""

import argparse
import time
import traceback
from collections.abc import Callable
from pathlib import Path

import numpy as np
from ablation import measure_ablation
from accuracy import measure_accuracy
from complements import measure_complements
from energy import measure_energy
from in_focus import measure_photographs
from pages import ablation_page, main_table, peers_page
from pictures import middle, photographs, whole_sharp_pictures
from plots import drawn
from real_numbers import measure_real
from record import Record, circumstances, compared, load
from restoration import as_floats, measure_restoration
from scenes import groups
from sizes import measure_sizes
from wide import measure_wide

from napari_defocus.core.writing import write_results

PARTS = (
    "accuracy",
    "wide",
    "photographs",
    "complements",
    "real",
    "energy",
    "restoration",
    "sizes",
    "ablation",
)
NUMBERS = "numbers.json"
QUICK_SOURCES = 2
ENERGY_SIDE, QUICK_ENERGY_SIDE = 240, 120
QUICK_PHOTOGRAPHS, ENERGY_PHOTOGRAPHS = 1, 4


def main() -> None:
    arguments = parsed_arguments()
    before = Record.read(arguments.compare) if arguments.compare else None
    sources = whole_sharp_pictures(arguments.data)
    photos = photographs(arguments.photos)
    if arguments.quick:
        photos = dict(list(photos.items())[:QUICK_PHOTOGRAPHS])
    sources = dict(list(sources.items())[: arguments.pictures])
    settings = {
        "quick": arguments.quick,
        "seed": arguments.seed,
        "pictures": list(sources),
        "photographs": list(photos),
        "pictures from": "`--data`" if arguments.data else "scikit-image",
    }
    record, failed = Record({}), []
    for part, measure in measurements(sources, photos, record, arguments).items():
        if part in arguments.only:
            if not succeeds(part, measure, record, settings):
                failed.append(part)
            elif arguments.out:
                write_pages(record, arguments.out)
    if arguments.out and not arguments.only:
        write_pages(record, arguments.out)
    print(main_table(record))
    if before:
        print("\n" + compared(before, record))
    if failed:
        raise SystemExit(f"failed, see above: {', '.join(failed)}")


def succeeds(part: str, measure: Callable[[], None], record: Record, settings: dict) -> bool:
    """Measure a part; minutes of other parts shall not be lost because of it."""
    began, made = time.monotonic(), circumstances(**settings)
    record.part = part
    try:
        measure()
    except Exception:
        traceback.print_exc()
        record.numbers = [number for number in record.numbers if number.part != part]
        return False
    minutes = round((time.monotonic() - began) / 60, 1)
    record.made[part] = made | {"minutes": minutes, "load at the end": load()}
    print(f"-- {part}, {minutes} min\n", flush=True)
    return True


def parsed_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="less of everything, in 3 minutes")
    parser.add_argument("--data", type=Path, help="folder of sharp pictures; scikit-image's own")
    parser.add_argument("--photos", type=Path, help="folder of the outlined photographs")
    parser.add_argument("--real", type=Path, help="folder of real pictures with known answers")
    parser.add_argument("--compare", type=Path, help="numbers.json of an earlier run")
    parser.add_argument("--out", type=Path, help="folder for pages, plots and numbers.json")
    parser.add_argument("--only", nargs="*", choices=PARTS, default=PARTS, help="some parts")
    parser.add_argument("--seed", type=int, default=0, help="of noise and layers")
    parser.add_argument("--pictures", type=int, help="only so many of the sharp ones, from 2")
    arguments = parser.parse_args()
    if arguments.quick and arguments.pictures is None:
        arguments.pictures = QUICK_SOURCES
    if arguments.pictures is not None and arguments.pictures < 2:
        parser.error(f"--pictures is {arguments.pictures}; it takes a whole number from 2 up")
    beside = arguments.data and arguments.data.resolve().parent
    for name in ("photos", "real"):
        if getattr(arguments, name) is None and beside and (beside / name).is_dir():
            setattr(arguments, name, beside / name)
    if arguments.real is None:
        arguments.only = [part for part in arguments.only if part != "real"]
    return arguments


def measurements(
    sources: dict[str, np.ndarray],
    photos: dict[str, np.ndarray],
    record: Record,
    arguments: argparse.Namespace,
) -> dict[str, Callable[[], None]]:
    """Return what each part does."""
    quick, seed = arguments.quick, arguments.seed
    sharp = {name: as_floats(middle(source)) for name, source in sources.items()}
    some = dict(list(photos.items())[:ENERGY_PHOTOGRAPHS])
    side = QUICK_ENERGY_SIDE if quick else ENERGY_SIDE
    return {
        "accuracy": lambda: measure_accuracy(groups(sources, quick=quick, seed=seed), record),
        "wide": lambda: measure_wide(sources, record, quick=quick, seed=seed),
        "photographs": lambda: measure_photographs(photos, record),
        "complements": lambda: measure_complements(sources, record, quick=quick),
        "real": lambda: measure_real(arguments.real, record),
        "energy": lambda: measure_energy(some, side, record),
        "restoration": lambda: measure_restoration(sharp, record, quick=quick),
        "sizes": lambda: measure_sizes(record, quick=quick),
        "ablation": lambda: measure_ablation(sources, record, quick=quick, seed=seed),
    }


def write_pages(record: Record, folder: Path) -> None:
    """Write all pages and plots, whole or not at all; other parts stay as they are there."""
    folder.mkdir(parents=True, exist_ok=True)
    earlier = folder / NUMBERS
    record = Record(dict(record.made), list(record.numbers))
    if earlier.exists():
        record.keep_others_of(Record.read(earlier))
    plots = drawn(record)
    contents = {folder / name: content for name, content in plots.items()}
    contents[folder / "peers.md"] = peers_page(record, plots).encode()
    if "ablation" in record.made:
        contents[folder / "ablation.md"] = ablation_page(record).encode()
    contents[earlier] = record.as_json()
    write_results(contents, force=True)


if __name__ == "__main__":
    main()
