"""Random calls of what reads and writes files."""

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import napari_defocus as nd
from benchmarks.fuzz.call import Call, anything_returned, measured_family, recipe, some
from napari_defocus.settings import MapSettings, MaskSettings, RefocusSettings, RestorationSettings


@recipe("Settings")
def _settings(rnd: Random) -> Call:
    kinds = {
        "map": MapSettings,
        "mask": MaskSettings,
        "restoration": RestorationSettings,
        "refocus": RefocusSettings,
    }
    name = rnd.choice(list(kinds))
    kind = kinds[name]
    defaults = {f: getattr(kind(), f) for f in kind.__dataclass_fields__}
    chosen = rnd.sample(list(defaults), rnd.randint(1, len(defaults)))

    def build(**given: Any) -> Any:
        with tempfile.TemporaryDirectory() as folder:
            settings = nd.Settings(**{name: kind(**given)})
            settings.save(Path(folder, "s.json"))
            # JSON has no whole numbers as large as those of Python.
            large = any(isinstance(v, int) and abs(v) > 2**53 for v in given.values())
            loaded = nd.Settings.load(Path(folder, "s.json"))
            assert large or loaded == settings, "loaded as another"
            return settings

    return Call(build, {f: defaults[f] for f in chosen}, anything_returned, names=(name,))


@recipe("Settings.load")
def _settings_file(rnd: Random) -> Call:
    with tempfile.TemporaryDirectory() as folder:
        nd.Settings().save(Path(folder, "s.json"))
        content = Path(folder, "s.json").read_bytes()
    spoilt = _spoilt_bytes(rnd, content)
    return _loading(spoilt, nd.Settings.load)


@recipe("MeasuredPSF.load")
def _psf_file(rnd: Random) -> Call:
    with tempfile.TemporaryDirectory() as folder:
        measured_family().save(Path(folder, "p.npz"))
        content = Path(folder, "p.npz").read_bytes()
    spoilt = _spoilt_bytes(rnd, content)
    return _loading(spoilt, nd.MeasuredPSF.load)


@recipe("ThinLens.from_exif")
def _lens_file(rnd: Random) -> Call:
    spoilt = _spoilt_bytes(rnd, _photograph())

    def load(path: Path) -> Any:
        return nd.ThinLens.from_exif(path, focus_distance_m=2.0, pixel_pitch_um=5.0)

    return _loading(spoilt, load)


@functools.cache
def _photograph() -> bytes:
    import io

    from PIL import Image

    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0x920A: 50.0, 0x829D: 2.8})
    buffer = io.BytesIO()
    Image.new("RGB", (30, 20)).save(buffer, "JPEG", exif=exif)
    return buffer.getvalue()


def _loading(content: bytes, load: Callable[[Path], Any]) -> Call:
    """Return a call that reads a file; its name, or that of the content, is in messages."""

    def loaded() -> Any:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "file.spoilt")
            path.write_bytes(content)
            return load(path)

    return Call(loaded, {}, anything_returned, False, ("file.spoilt",))


def _spoilt_bytes(rnd: Random, content: bytes) -> bytes:
    """Return a file that is cut off, or of which some bytes are others."""
    if rnd.random() < 0.3:
        return content[: rnd.randrange(len(content))]
    changed = bytearray(content)
    for _ in range(rnd.choice([0, 1, 1, 2, 5, 40])):
        changed[rnd.randrange(len(changed))] = rnd.choice(
            [0, 34, 44, 48, 57, 255, rnd.randrange(256)]
        )
    return bytes(changed)


@recipe("measure_batch")
def _batch(rnd: Random) -> Call:
    """Only what is refused: whole batches start processes, and have tests of their own."""
    arguments = some(rnd, min_confidence=[0.5], block_size=[10, 256])
    call = functools.partial(nd.measure_batch, rnd.choice(["none.png", ["none.png"], []]))
    names = ("none.png", "/dev/null/none")
    return Call(
        functools.partial(call, "/dev/null/none"), arguments, anything_returned, False, names
    )
