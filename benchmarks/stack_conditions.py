"""Our composites beside those of other programs, on the same stacks: PSNR, seconds and memory.

`stacks.py --peers` starts this. A row is a condition, means over the pictures. Planes are those of
`moving_stacks`: 9 of them, 16 bits, focus moves by 1 px of blur a plane. The PSNR is that of
`stacks.py --moving`: after one factor of brightness, without the outermost 16 px. Composites that
lie elsewhere, by whole pixels and parts, are no worse for that. Peers are told which stacks have
moved; ours finds out.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from moving_stacks import taken
from pictures import picture_paths
from scipy.ndimage import gaussian_filter, shift
from skimage.registration import phase_cross_correlation
from skimage.util import img_as_float
from stack_peers import FULL, PEERS

from napari_defocus.core.image import LUMA_WEIGHTS

SMOOTH, NOISE = 1e-6, 1e-4
MOVED = "+move"
EDGE = 16
LEAST_MOTION = 0.1
"""px by which a composite may lie elsewhere and counts as in place: what noise makes of it."""

SIZES = {"15 planes of 1 MP": (15, 1000, 1000), "10 planes of 3 MP": (10, 1500, 2000)}
"""Stacks in colour whose seconds and memory are told."""

COSTS = "seconds", "seconds on processors", "memory, MB"

CONDITIONS = {
    "smooth depth": ("slanted", SMOOTH, {}),
    "step": ("step", SMOOTH, {}),
    "noise": ("slanted", NOISE, {}),
    "flicker": ("slanted", SMOOTH, {"flicker": 0.25}),
    "drift": ("slanted", SMOOTH, {"drift": 3, "breathing": 0.02}),
    "highlights": ("slanted", SMOOTH, {"clipped": True}),
}


def report_peers(arguments: argparse.Namespace) -> None:
    """Print PSNR in dB for each condition, then seconds and memory of larger stacks."""
    stacks, sharp = simulated(arguments)
    tables: dict[str, dict[str, str]] = {name: {} for name in CONDITIONS}
    for size in SIZES:
        tables |= {f"{what}, {size}": {} for what in COSTS}
    for peer in arguments.only or PEERS:
        try:
            composites, _ = composited(peer, stacks)
            costs = {size: costs_of(peer, size) for size in SIZES}
        except subprocess.CalledProcessError as error:
            told = (error.stderr or "nothing").strip().splitlines()[-1]
            print(f"{peer} failed: {told}", file=sys.stderr)
            continue
        for condition in CONDITIONS:
            found = [
                compared(composites[key], sharp[key]) for key in stacks if key.startswith(condition)
            ]
            tables[condition][peer] = f"{np.mean(found):.1f}"
        for size, found in costs.items():
            for what, cost in zip(COSTS, found, strict=True):
                tables[f"{what}, {size}"][peer] = cost
        if arguments.look:
            look(arguments.look, peer, composites, sharp)
    print_table(tables)


def simulated(arguments: argparse.Namespace) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return stacks, (9, H, W, 3) uint16, and what they show, by "condition/picture"."""
    from stacks import position_at, with_highlights

    stacks, sharp = {}, {}
    for path in picture_paths(arguments.data)[:: arguments.every]:
        scene = img_as_float(imageio.imread(path))[..., :3].astype(np.float32)
        for name, (shape, variance, options) in CONDITIONS.items():
            seen = with_highlights(scene) if "clipped" in options else scene

            def focus(row: np.ndarray, column: np.ndarray, shape: str = shape) -> np.ndarray:
                return position_at(shape, 9, row, column)

            made = taken(seen, focus, noise_variance=variance, **options)
            key = f"{name}/{path.stem}{MOVED if 'drift' in options else ''}"
            stacks[key] = np.rint(made.planes.clip(0, 1) * FULL).astype(np.uint16)
            sharp[key] = made.sharp
    return stacks, sharp


def composited(
    peer: str, stacks: dict[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    """Let a peer put stacks together, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder, "stacks.npz"), Path(folder, "made.npz")
        np.savez(given, **stacks)
        script = Path(__file__).with_name("stack_peers.py")
        run = subprocess.run(
            [sys.executable, script, peer, given, made], capture_output=True, text=True, check=True
        )
        with np.load(made) as held:
            return dict(held), json.loads(run.stdout.splitlines()[-1])


def costs_of(peer: str, size: str) -> list[str]:
    """Return seconds, those of all threads on processors, and MB beyond the stack that is given."""
    _, told = composited(peer, {size: of_noise(*SIZES[size])})
    memory = told["megabytes"] - told["before"]
    return [f"{told['seconds'][size]:.1f}", f"{told['busy'][size]:.1f}", f"{memory:.0f}"]


def compared(picture: np.ndarray, sharp: np.ndarray) -> float:
    """Return the PSNR after one factor of brightness, without the edge."""
    inner = np.s_[EDGE:-EDGE, EDGE:-EDGE]
    seen, truth = picture[inner].astype(float), part_shown(picture, sharp)[inner].astype(float)
    seen = seen * (seen * truth).sum() / (seen**2).sum()
    return float(-10 * np.log10(np.mean((seen - truth) ** 2)))


def part_shown(picture: np.ndarray, sharp: np.ndarray) -> np.ndarray:
    """Return what a composite shows of the scene: some peers cut off what not all planes have."""
    size = picture.shape[:2]
    spare = [whole - kept for whole, kept in zip(sharp.shape, size, strict=False)]
    places = list(np.ndindex(spare[0] + 1, spare[1] + 1))
    normed = picture / np.linalg.norm(picture)

    def likeness(place: tuple[int, ...]) -> float:
        part = sharp[place[0] :, place[1] :][: size[0], : size[1]]
        return float((part * normed).sum() / np.linalg.norm(part))

    top, left = max(places, key=likeness) if len(places) > 1 else places[0]
    return moved_onto(picture, sharp[top:, left:][: size[0], : size[1]])


def moved_onto(picture: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Move the truth by the part of a pixel by which a composite lies elsewhere."""
    seen, truth = (each @ np.array(LUMA_WEIGHTS) for each in (picture, part))
    steps, _, _ = phase_cross_correlation(seen, truth, upsample_factor=50, normalization=None)
    if np.abs(steps).max() < LEAST_MOTION:
        return part
    return shift(part, (*steps, 0), order=5, mode="nearest")


def of_noise(count: int, height: int, width: int) -> np.ndarray:
    """Return planes of noise, blurred along a ramp of focus: (count, height, width, 3) uint16."""
    rng = np.random.default_rng(0)
    fine = gaussian_filter(rng.standard_normal((height, width)), 0.5)
    focus = np.linspace(2, count - 3, width)
    blurred = np.stack([0.5 + 0.1 * gaussian_filter(fine, at / 2) for at in range(count)])
    away = np.rint(np.abs(np.arange(count)[:, None] - focus)).astype(int)
    planes = blurred[away[:, None, :], np.arange(height)[:, None], np.arange(width)]
    values = np.rint(planes.clip(0, 1) * FULL).astype(np.uint16)
    return np.repeat(values[..., None], 3, axis=-1)


def print_table(tables: dict[str, dict[str, str]]) -> None:
    peers = list(next(iter(tables.values())))
    print(f"| | {' | '.join(peers)} |\n" + "|---" * (len(peers) + 1) + "|")
    for name, found in tables.items():
        print(f"| {name} | {' | '.join(found[peer] for peer in peers)} |")


def look(
    folder: Path, peer: str, composites: dict[str, np.ndarray], sharp: dict[str, np.ndarray]
) -> None:
    """Write composites, and 10 times what is wrong with them, above each other."""
    folder.mkdir(exist_ok=True)
    for key, picture in composites.items():
        truth, seen = part_shown(picture, sharp[key]), picture.astype(float)
        seen = seen * (seen * truth).sum() / (seen**2).sum()
        shown = np.concatenate([seen, 0.5 + 10 * (seen - truth)]).clip(0, 1)
        name = f"{key}-{peer}".replace("/", "-").replace(" ", "-").replace(",", "")
        imageio.imwrite(folder / f"{name}.png", np.rint(255 * shown).astype(np.uint8))
