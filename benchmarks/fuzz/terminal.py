"""Random runs of the terminal command, inside of this process, for run.py."""

import functools
import io
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import tifffile
from PIL import Image
from typer.testing import CliRunner

from benchmarks.fuzz import values as odd
from benchmarks.fuzz.call import Call
from napari_defocus.cli.app import app

COMMANDS = ("map", "segment", "restore", "refocus", "depth", "explain", "sharpest")
MORE_COMMANDS = ("calibrate", "compare-psf", "batch", "", "none")

_NUMBERS = ("0", "1", "2.5", "-1", "nan", "inf", "1e300", "1e-300", "x", "", "999999999999999999")
_OPTIONS: dict[str, tuple[str, ...]] = {
    "--psf": ("disc", "polygon:5", "gaussian", "annulus:9", "none.npz", "photo.jpg", "", "\0"),
    "--noise-variance": _NUMBERS,
    "--max-radius": ("3", *_NUMBERS),
    "--window": ("17", "41", "18", *_NUMBERS),
    "--stride": ("4", *_NUMBERS),
    "--smoothness": _NUMBERS,
    "--color-sigma": _NUMBERS,
    "--mode": ("curve", "paper", "none"),
    "--linearize": ("srgb", "none"),
    "--camera-softness": ("0", "0.6", "5.1", "-1", "soft"),
    "--threshold": _NUMBERS,
    "--min-confidence": _NUMBERS,
    "--risk": _NUMBERS,
    "--tv-weight": _NUMBERS,
    "--focus": _NUMBERS,
    "--aperture": _NUMBERS,
    "--focal-length": ("50", *_NUMBERS),
    "--f-number": ("2", *_NUMBERS),
    "--focus-distance": ("2", *_NUMBERS),
    "--pixel-pitch": ("5", *_NUMBERS),
    "--px-per-plane": _NUMBERS,
    "--map": ("map.tif", "grey.png", "none.tif"),
    "--seeds": ("grey.png", "map.tif", "none.png"),
    "--settings": ("settings.json", "text.png", "none.json"),
    "--sharp": ("grey.png", "none.png"),
    "--scales": ("1,2", "1", "x", ",", "nan,nan"),
    "--output": (
        "out/a.tif",
        "out/a.png",
        "out",
        "none/a.tif",
        "out/a.npz",
        "grey.png",
        "/dev/null",
    ),
    "--confidence": ("out/c.tif", "out/c.png", "out/c"),
    "--overlay": ("out/o.png",),
    "--regions": ("out/r.csv",),
    "--save-settings": ("out/s.json", "settings.json"),
}
_FLAGS = ("--shot-noise", "--force", "--json", "--quiet", "--none")


def terminal_call(rnd: Random) -> Call:
    """Return a run of the command with pictures, whole and broken, and options, right and wrong."""
    command = rnd.choice([*COMMANDS, *COMMANDS, *MORE_COMMANDS])
    files = sorted(path.name for path in _pictures().iterdir())
    arguments = [command] if command else []
    arguments += [rnd.choice(files) for _ in range(rnd.choice([0, 1, 1, 1, 1, 1, 2]))]
    if command == "explain":
        arguments += [rnd.choice(["3", "-1", "x", "99999"]), "5"]
    if command == "batch":
        arguments = ["batch", rnd.choice(["none", "text.png/x"]), "--output", "out/b"]
    for option in rnd.sample(list(_OPTIONS), rnd.choice([0, 1, 1, 2, 3])):
        arguments += [option, rnd.choice(_OPTIONS[option])]
    if rnd.random() < 0.2:
        arguments += ["--intensity-range", rnd.choice(_NUMBERS), rnd.choice(_NUMBERS)]
    arguments += rnd.sample(_FLAGS, rnd.choice([0, 0, 1]))
    if rnd.random() < 0.05:
        arguments = [rnd.choice(_NUMBERS), *arguments]
    return Call(_run, {"arguments": arguments}, _ended_as_it_should)


def _run(arguments: list[str]) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(_pictures(), folder, dirs_exist_ok=True)
        (folder / "out").mkdir()
        before = _everything_in(folder)
        placed = [_placed(folder, argument) for argument in arguments]
        result = CliRunner().invoke(app, placed)
        after = _everything_in(folder)
        new = {path for path, content in after.items() if before.get(path) != content}
        return {
            "result": result,
            "new": {path: after[path] for path in new},
            "gone": set(before) - set(after),
            "forced": "--force" in arguments,
        }


def _placed(folder: Path, argument: str) -> str:
    known = (folder / argument).exists() or argument.startswith(("out/", "none"))
    return str(folder / argument) if argument and known and "\0" not in argument else argument


def _everything_in(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def _ended_as_it_should(ended: dict[str, Any], arguments: dict[str, Any]) -> None:
    result, new = ended["result"], ended["new"]
    crashed = result.exception is not None and not isinstance(result.exception, SystemExit)
    assert not crashed, f"{type(result.exception).__name__}: {result.exception}"
    assert "Traceback" not in result.output
    assert result.exit_code in (0, 1, 2), f"exit code {result.exit_code}"
    assert not ended["gone"], f"gone: {ended['gone']}"
    assert not any(re.search(r"\.(part|levels|old)$", path) for path in new), f"left: {set(new)}"
    if result.exit_code:
        assert not new, f"it failed, and wrote {set(new)}"
        assert result.stderr.strip() or not arguments["arguments"], "it failed without a word"
        complaint = result.stderr.splitlines()
        usage = any(line.startswith("Usage") for line in complaint)
        assert usage or len(complaint) == 1, f"{len(complaint)} lines: {result.stderr[:300]}"
    for path, content in new.items():
        _CHECKS.get(Path(path).suffix, _not_empty)(content)


def _not_empty(content: bytes) -> None:
    assert content


def _whole_tiff(content: bytes) -> None:
    assert np.isfinite(tifffile.imread(io.BytesIO(content))).any()


def _whole_picture(content: bytes) -> None:
    Image.open(io.BytesIO(content)).load()


_CHECKS: dict[str, Callable[[bytes], None]] = {".tif": _whole_tiff, ".png": _whole_picture}


@functools.cache
def _pictures() -> Path:
    """Return a folder of small pictures, whole and broken, made once a process."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    rnd = Random(0)
    grey = (odd.texture(rnd, (40, 48)) * 255).astype(np.uint8)
    color = np.random.default_rng(0).integers(0, 256, (40, 48, 3), np.uint8)
    Image.fromarray(grey).save(folder / "grey.png")
    Image.fromarray(color).save(folder / "color.png")
    Image.fromarray(color).save(folder / "photo.jpg")
    Image.fromarray(color).quantize(9).save(folder / "palette.png", transparency=3)
    Image.fromarray(grey > 128).save(folder / "bits.png")
    Image.fromarray(color).convert("CMYK").save(folder / "cmyk.jpg")
    Image.new("L", (2, 2)).save(folder / "tiny.png")
    tifffile.imwrite(folder / "map.tif", np.full((40, 48), 1.5, np.float32))
    tifffile.imwrite(folder / "nan.tif", np.full((40, 48), np.nan, np.float32))
    tifffile.imwrite(folder / "stack.tif", np.stack([grey] * 3), metadata={"axes": "ZYX"})
    tifffile.imwrite(folder / "complex.tif", grey.astype(np.complex64))
    (folder / "cut.png").write_bytes((folder / "color.png").read_bytes()[:1000])
    (folder / "cut.tif").write_bytes((folder / "map.tif").read_bytes()[:-1000])
    (folder / "text.png").write_text("no picture")
    (folder / "empty.jpg").touch()
    (folder / "settings.json").write_text('{"map": {"window": 41}}')
    (folder / "store.zarr").mkdir()
    (folder / "store.zarr" / "zarr.json").write_text("{")
    return folder
