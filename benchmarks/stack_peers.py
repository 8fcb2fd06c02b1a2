"""Other programs that make one sharp picture of a stack, each in a process of its own.

    python benchmarks/stack_peers.py NAME STACKS.npz OUT.npz      # what stacks.py --peers starts

STACKS.npz holds stacks, (Z, H, W, 3) uint16, by name; one whose name ends in "+move" has moved, and
programs that do not find that out are told so. OUT.npz holds the composites. The seconds of each
call, those of all its threads on processors, and the largest memory of the process before and after
are printed as JSON. A peer that is not installed is left
out of PEERS. focusstacker is none of them: it takes and writes JPEG alone.
"""

import contextlib
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import tifffile
from scipy.ndimage import laplace, uniform_filter
from sizes import megabytes
from skimage.transform import pyramid_expand, pyramid_reduce

from napari_defocus import sharpest_plane
from napari_defocus.core.image import LUMA_WEIGHTS

SIDE = 9
"""px of the squares of the local Laplacian: the best of 3 to 25 px on most stacks."""

LEVELS = 5
FULL = 65535.0


def ours(stack: np.ndarray, moved: bool) -> np.ndarray:
    return sharpest_plane(stack, axes="zyxs").composite


def ours_pixels(stack: np.ndarray, moved: bool) -> np.ndarray:
    return sharpest_plane(stack, axes="zyxs", blend=False).composite


def middle_plane(stack: np.ndarray, moved: bool) -> np.ndarray:
    return stack[len(stack) // 2]


def local_laplacian(stack: np.ndarray, moved: bool) -> np.ndarray:
    """Take each pixel of the plane in which the squared Laplacian is largest over a square."""
    energy = [uniform_filter(laplace(plane @ LUMA_WEIGHTS) ** 2, SIDE) for plane in stack / FULL]
    rows, columns = np.indices(stack.shape[1:3])
    return stack[np.argmax(energy, axis=0), rows, columns]


def laplacian_pyramid(stack: np.ndarray, moved: bool) -> np.ndarray:
    """Take each coefficient of the plane in which it is largest; the coarsest level is the mean."""
    best: list[np.ndarray] = []
    coarsest = 0.0
    for plane in stack / FULL:
        pyramid = decomposed(plane)
        coarsest = coarsest + pyramid.pop() / len(stack)
        best = best or pyramid
        best = [larger(old, new) for old, new in zip(best, pyramid, strict=True)]
    picture = coarsest
    for detail in reversed(best):
        picture = expanded(picture, detail.shape) + detail
    return picture


def larger(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the coefficients, (H, W, 3), whose luminance is the larger in size."""
    takes_other = np.abs(other @ LUMA_WEIGHTS) > np.abs(one @ LUMA_WEIGHTS)
    return np.where(takes_other[..., None], other, one)


def decomposed(plane: np.ndarray) -> list[np.ndarray]:
    """Return what each level adds to the next, and the coarsest level."""
    levels = []
    for _ in range(LEVELS):
        coarse = pyramid_reduce(plane, channel_axis=-1)
        levels.append(plane - expanded(coarse, plane.shape))
        plane = coarse
    return [*levels, plane]


def expanded(coarse: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return pyramid_expand(coarse, channel_axis=-1)[: shape[0], : shape[1]]


def focusweave(stack: np.ndarray, moved: bool) -> np.ndarray:
    from focusweave import FocusStackConfig, run

    moves = {"min_shift": 0.5} if moved else {"no_align": True}
    return run(FocusStackConfig(images=list(stack), keep_size=True, **moves)).image


def openfocus(method: str) -> Callable[[np.ndarray, bool], np.ndarray]:
    """Return a method of OpenFocus, through its command: files of 16 bits in and out.

    It lays planes on the first one, so the one in the middle comes first.
    """

    def composite(stack: np.ndarray, moved: bool) -> np.ndarray:
        from core.cli import run_cli

        order = sorted(range(len(stack)), key=lambda number: (number != len(stack) // 2, number))
        with tempfile.TemporaryDirectory() as folder:
            files, made = written(folder, stack[order]), Path(folder, "made.tif")
            align = "openfocus" if moved else "none"
            options = ["--method", method, "--align", align, "--output", str(made), "--cpu"]
            assert run_cli(["--input", *map(str, files), *options]) == 0
            return scaled(tifffile.imread(made))

    return composite


def written(folder: str, stack: np.ndarray) -> list[Path]:
    files = [Path(folder, f"plane{number:03d}.tif") for number in range(len(stack))]
    for file, plane in zip(files, stack, strict=True):
        tifffile.imwrite(file, plane, photometric="rgb")
    return files


def scaled(picture: np.ndarray) -> np.ndarray:
    return picture.astype(np.float64) * (FULL / np.iinfo(picture.dtype).max)


_OPENFOCUS = {
    "OpenFocus B": "openfocus_b",
    "OpenFocus C": "openfocus_c",
    "OpenFocus guided": "guided_filter",
    "OpenFocus DTCWT": "dtcwt",
}
_OF_NETWORK = {"OpenFocus StackMFF": "stackmffv3"}

PEERS: dict[str, Callable[[np.ndarray, bool], np.ndarray]] = {
    "ours": ours,
    "ours, pixels": ours_pixels,
    "middle plane": middle_plane,
    "local Laplacian": local_laplacian,
    "Laplacian pyramid": laplacian_pyramid,
}
if find_spec("focusweave"):
    PEERS["focusweave"] = focusweave
if find_spec("fusion_methods"):
    PEERS |= {name: openfocus(method) for name, method in _OPENFOCUS.items()}
    if find_spec("torch"):
        PEERS |= {name: openfocus(method) for name, method in _OF_NETWORK.items()}


def main() -> None:
    name, stacks, out = sys.argv[1:]
    seconds, busy, composites = {}, {}, {}
    with np.load(stacks) as held, contextlib.redirect_stdout(sys.stderr):
        for key in held.files:
            stack = held[key]
            before = megabytes()
            start, work = time.perf_counter(), os.times()
            composites[key] = PEERS[name](stack, key.endswith("+move"))
            seconds[key] = time.perf_counter() - start
            busy[key] = sum(os.times()[:4]) - sum(work[:4])
    np.savez(out, **composites)
    told = {"seconds": seconds, "busy": busy, "before": before, "megabytes": megabytes()}
    print(json.dumps(told))


if __name__ == "__main__":
    main()
