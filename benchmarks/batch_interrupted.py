"""Kill a batch, and its workers, at random moments: are the results those of an undisturbed run?

    python benchmarks/batch_interrupted.py --kills 12 --seed 0

Photographs of two sizes, one of them damaged, a stack, and, with --large, a picture that is
measured in parts are measured once without a disturbance. Then the same batch is started again
and again: each run but the last is ended by SIGKILL at a random moment, or by Ctrl-C, or loses
a worker process. Every file of the folder's results and tables is compared, and that no process
and no temporary file is left. Prints what happened to each run, and "the same" or what differs.
"""

import argparse
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import PIL.Image
import psutil
import tifffile
from skimage import data

PHOTOGRAPHS = 10
DEADLINE = 900


def make_inputs(folder, large):
    folder.mkdir()
    astronaut, camera = data.astronaut(), data.camera()
    for number in range(PHOTOGRAPHS):
        side = 160 if number % 2 else 240
        top = 10 * number
        PIL.Image.fromarray(astronaut[top : top + side, :side]).save(folder / f"p{number}.png")
    (folder / "damaged.png").write_bytes(b"\x89PNG\r\n\x1a\n and no more")
    planes = np.stack([camera[20 * z : 20 * z + 200, :220] for z in range(8)])
    scale = {"resolution": (4.0, 4.0), "metadata": {"axes": "ZYX", "unit": "um"}}
    tifffile.imwrite(folder / "stack.tif", planes, imagej=True, **scale)
    if large:
        wide = np.tile(np.pad(camera, ((0, 512), (0, 512)), mode="symmetric"), (2, 3))
        PIL.Image.fromarray(wide[:2020, :2020]).save(folder / "wide.png")


def started(inputs, output):
    wanted = ("--confidence", "--mask", "--workers", "2")
    command = [sys.executable, "-c", "from napari_defocus.cli.app import main; main()"]
    return subprocess.Popen(
        [*command, "batch", str(inputs), "-o", str(output), *wanted],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def workers_of(process):
    children = psutil.Process(process.pid).children(recursive=True)
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


def disturb(process, chance, longest):
    """Let a run be for a while, end a worker in one of two runs, and then the run itself."""
    what = []
    time.sleep(chance.uniform(2.0, longest))
    workers = workers_of(process)
    if workers and chance.random() < 0.5:
        chance.choice(workers).kill()
        what.append("killed a worker")
        time.sleep(chance.uniform(0.5, longest))
        workers = workers_of(process)
    how = chance.choice((signal.SIGKILL, signal.SIGKILL, signal.SIGINT))
    process.send_signal(how)
    process.wait(DEADLINE)
    what.append("killed the batch" if how == signal.SIGKILL else "Ctrl-C")
    what.append(f"exit code {process.returncode}")
    if process.returncode not in (-9, 130, 1):
        what.append(process.stderr.read())
    _, left = psutil.wait_procs(workers, timeout=10)
    assert not left, f"{len(left)} workers outlived the batch"
    return ", ".join(what)


def contents(folder):
    """All bytes but those of the hidden notes."""
    files = (path for path in folder.rglob("*") if path.is_file())
    seen = {path.relative_to(folder): path for path in files}
    return {name: path.read_bytes() for name, path in seen.items() if name.parts[0] != ".batch"}


def finished_planes(folder):
    return len(rows_of(folder))


def rows_of(folder):
    notes = folder.glob(".batch/sources/*/plane*.json")
    return [note for note in notes if "-at-" not in note.name]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--large", action="store_true")
    given = parser.parse_args()
    chance = random.Random(given.seed)
    with tempfile.TemporaryDirectory() as scratch:
        inputs, calm, disturbed = (Path(scratch, name) for name in ("in", "calm", "disturbed"))
        make_inputs(inputs, given.large)
        started(inputs, calm).wait(DEADLINE)
        begun = time.perf_counter()
        # Kernels are compiled by now.
        started(inputs, Path(scratch, "again")).wait(DEADLINE)
        lasts = time.perf_counter() - begun
        print(f"undisturbed  {lasts:.0f} s, {finished_planes(calm)} planes")
        for _ in range(given.kills):
            if finished_planes(disturbed) == finished_planes(calm):
                break
            process = started(inputs, disturbed)
            what = disturb(process, chance, 0.4 * lasts)
            parts = len(list(disturbed.rglob("plane*-at-*.json")))
            more = f" and {parts} parts" if parts else ""
            done = finished_planes(disturbed)
            print(f"{what}; {done} planes{more} are finished", flush=True)
        process = started(inputs, disturbed)
        process.wait(DEADLINE)
        print(f"the last run ends with exit code {process.returncode}")
        compare(contents(calm), contents(disturbed))


def compare(calm, disturbed):
    unlike = sorted(
        str(name)
        for name in calm.keys() | disturbed.keys()
        if calm.get(name) != disturbed.get(name)
    )
    print(f"{len(calm)} files, {sum(map(len, calm.values())) / 1e6:.1f} MB:", end=" ")
    print("the same" if not unlike else f"{len(unlike)} differ: {', '.join(unlike[:10])}")
    sys.exit(bool(unlike))


if __name__ == "__main__":
    main()
