"""A mosaic of 100 megapixels: memory, time for a pixel, and accuracy, against pieces of 1 MP.

    python benchmarks/large.py --data FOLDER_OF_SHARP_PICTURES [--side 10000] [--work FOLDER]

Sharp pictures, turned and mirrored, side by side, blurred by a smooth map of 0.9 to 5.9 px, with
white noise, as an OME-Zarr of 8 bits and three colours. `napari-defocus batch` measures it into an
OME-Zarr with a map and its confidence. Then pieces of 1024 x 1024 px of it are measured on their
own, as arrays.

Prints a Markdown table: the peak of the memory of all processes together (proportional set size),
seconds for a megapixel, and the mean absolute error over the same pixels, those of the pieces but
for their outer 64 px.
"""

import argparse
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil
from pictures import SIDE, sharp_pictures

from napari_defocus import estimate_blur_map, simulate_defocus
from napari_defocus.io.ome_zarr import read_ome_zarr
from napari_defocus.io.ome_zarr_writer import new_ome_zarr
from napari_defocus.io.open import open_source

NOISE = 1e-6
REGION, HALO = 1024, 24
PERIOD = 2900
PIECE, RIM = 1024, 64


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("--data", type=Path, default=Path("../shared/data/sharp"))
    options.add_argument("--side", type=int, default=10_000, help="of the mosaic, in px")
    options.add_argument("--pieces", type=int, default=6)
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--block-size", type=int, default=1024)
    options.add_argument("--work", type=Path, help="keep the mosaic and its map here")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = given.work or Path(temporary)
        mosaic = work / "mosaic.ome.zarr"
        if not mosaic.exists():
            make_mosaic(mosaic, list(sharp_pictures(given.data).values()), given.side)
        seconds, memory = measure(mosaic, work / "out", given.workers, given.block_size)
        report(mosaic, found_map(work / "out"), seconds, memory, given.pieces)


def make_mosaic(path: Path, pictures: list[np.ndarray], side: int) -> None:
    writer = new_ome_zarr(path, shape=(side, side, 3), dtype="uint8", axes="yxs", attributes={})
    for top in range(0, side, REGION):
        print(f"\rmaking the mosaic: {100 * top // side} %", end="", file=sys.stderr)
        for left in range(0, side, REGION):
            stop = min(top + REGION, side), min(left + REGION, side)
            low = max(top - HALO, 0), max(left - HALO, 0)
            high = min(stop[0] + HALO, side), min(stop[1] + HALO, side)
            rows, columns = np.arange(low[0], high[0]), np.arange(low[1], high[1])
            blurred = simulate_defocus(
                sharp_part(pictures, rows, columns),
                truth(rows, columns),
                noise_variance=NOISE,
                rng=[top, left],
            )
            inside = blurred[top - low[0] :, left - low[1] :][: stop[0] - top, : stop[1] - left]
            region = slice(top, stop[0]), slice(left, stop[1]), slice(0, 3)
            writer.write_region(region, np.rint(255 * inside.clip(0, 1)).astype(np.uint8))
    print("\r", end="", file=sys.stderr)
    writer.finish()


def sharp_part(pictures: list[np.ndarray], rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return part of an endless mosaic: pictures in a fixed disorder."""
    part = np.empty((len(rows), len(columns), 3))
    for tile_row in np.unique(rows // SIDE):
        for tile_column in np.unique(columns // SIDE):
            drawn = np.random.default_rng([tile_row, tile_column])
            picture = as_color(pictures[drawn.integers(len(pictures))])
            picture = np.rot90(picture, drawn.integers(4))[:: drawn.choice([-1, 1])]
            i, j = (
                np.flatnonzero(rows // SIDE == tile_row),
                np.flatnonzero(columns // SIDE == tile_column),
            )
            part[i[0] : i[-1] + 1, j[0] : j[-1] + 1] = picture[
                np.ix_(rows[i] % SIDE, columns[j] % SIDE)
            ]
    return part


def as_color(picture: np.ndarray) -> np.ndarray:
    intensity = picture / 255 if picture.dtype == np.uint8 else picture
    return intensity if intensity.ndim == 3 else np.repeat(intensity[..., None], 3, axis=2)


def truth(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    waves = np.outer(np.sin(2 * np.pi * rows / PERIOD), np.sin(2 * np.pi * columns / PERIOD))
    return (3.4 + 2.5 * waves).astype(np.float32)


def measure(mosaic: Path, output: Path, workers: int, block_size: int) -> tuple[float, int]:
    """Run the batch; return its seconds, and the most bytes that its processes had at once."""
    program = Path(sys.executable).with_name("napari-defocus")
    command = [program, "batch", mosaic, "-o", output, "--confidence"]
    command += ["--workers", workers, "--block-size", block_size]
    start = time.perf_counter()
    process = subprocess.Popen([str(word) for word in command])
    most = [0]
    watch = threading.Thread(target=watch_memory, args=(process.pid, most), daemon=True)
    watch.start()
    if process.wait():
        sys.exit("the batch failed")
    return time.perf_counter() - start, most[0]


def watch_memory(pid: int, most: list[int]) -> None:
    while psutil.pid_exists(pid):
        used = 0
        try:
            root = psutil.Process(pid)
            for process in (root, *root.children(recursive=True)):
                used += process.memory_full_info().pss
        except psutil.Error:
            pass
        most[0] = max(most[0], used)
        time.sleep(1)  # a look costs as much as 25 ms of a core


def found_map(output: Path) -> Path:
    (path,) = output.rglob("*blur.ome.zarr")
    return path


def report(mosaic: Path, found: Path, seconds: float, memory: int, count: int) -> None:
    image = open_source(mosaic).data
    blur_map = read_ome_zarr(found).levels[0]
    side = image.shape[0]
    starts = np.linspace(0, side - PIECE, count).astype(int) // REGION * REGION
    estimate_blur_map(image[:300, :300].compute())
    alone, errors = [], []
    for top, left in zip(starts, np.roll(starts, 1), strict=True):
        piece = image[top : top + PIECE, left : left + PIECE].compute()
        begin = time.perf_counter()
        radius, _ = estimate_blur_map(piece, return_confidence=True)
        alone.append(time.perf_counter() - begin)
        inside = slice(RIM, PIECE - RIM)
        true = truth(np.arange(top, top + PIECE), np.arange(left, left + PIECE))
        of_whole = blur_map[top : top + PIECE, left : left + PIECE].compute()
        errors.append([np.abs(one - true)[inside, inside].mean() for one in (of_whole, radius)])
    of_whole, of_piece = np.mean(errors, axis=0)
    each = seconds / side**2 * 1e6, np.median(alone) / PIECE**2 * 1e6
    print("| | peak memory, GB | s for 1 MP | error, px |")
    print("|---|---|---|---|")
    print(f"| {side**2 / 1e6:.0f} MP | {memory / 1e9:.2f} | {each[0]:.2f} | {of_whole:.4f} |")
    print(f"| 1 MP | | {each[1]:.2f} | {of_piece:.4f} |")
    print(f"| ratio | | {each[0] / each[1]:.2f} | {of_whole / of_piece:.3f} |")


if __name__ == "__main__":
    main()
