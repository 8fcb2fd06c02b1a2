"""Where the pixels of a plane come from, as lines of a script that reads them: no Qt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from napari_defocus.io.pictures import read_picture
from napari_defocus.widgets.jobs.cache import fingerprint
from napari_defocus.widgets.jobs.estimation import Picture
from napari_defocus.widgets.layers import samples
from napari_defocus.widgets.layers.preferences import PLUGIN

PHOTOGRAPHS = ("dandelion", "brushes")
RAMP = "ramp"

_LONGEST_LINE = 88
"""In letters; what ruff and Black allow by default."""

_LONGEST_NAME = 30

_SIMULATED_RAMP = [
    "rows, columns = np.mgrid[:300, :300]",
    "true_blur = np.asarray(0.92 + 0.003 * columns + 0.011 * rows, np.float32)",
    "sharp = resize(grass() / 255.0, (300, 300), anti_aliasing=True)",
]
"""As `samples.simulated_ramp` makes it."""


@dataclass(frozen=True)
class PictureSource:
    """Where a script gets its picture from.

    Attributes
    ----------
    reading : list of str
        Lines after which the variable `image` holds the pixels.
    message : str
        An expression: what to say if they are others than those that were analysed.
    constants : sequence of str
        Lines above them: the file.
    """

    reading: list[str]
    message: str
    constants: Sequence[str] = ()


_OTHER_FILE = 'f"{PICTURE_FILE} is another picture than was analysed in napari."'
_OTHER_SAMPLE = '"The sample is another picture than was analysed in napari."'


def picture_source(picture: Picture, picture_file: Path | None = None) -> PictureSource:
    """Find out what a script has to read to get the pixels of a plane.

    Parameters
    ----------
    picture : Picture
    picture_file : Path, optional
        A file (.npy, .tif, ...) that holds the layer's data, or the plane alone. By default the
        layer's own file or sample, if it still holds these pixels; if nothing does, the script
        asks for a file.

    Raises
    ------
    ValueError
        If `picture_file` holds other pixels, or cannot be read.
    """
    if picture_file is not None:
        found = _of_file(picture, picture_file)
        if found is None:
            raise ValueError(
                f"picture_file is {picture_file}; it takes a file with the pixels of "
                f"“{picture.plane.name}”"
            )
        return found
    layer = picture.plane.layer()
    if layer is not None and layer.source.sample and layer.source.sample[0] == PLUGIN:
        found = _of_sample(picture, layer.source.sample[1])
    elif layer is not None and layer.source.path:
        found = _of_file(picture, Path(layer.source.path))
    else:
        found = None
    return found or _to_be_named(picture)


def _of_file(picture: Picture, path: Path) -> PictureSource | None:
    """Return how a file is read; None if it does not hold the pixels, however it is read."""
    for function, read in _readers(path).items():
        # Readers raise whatever other people's files lead them into.
        try:
            whole = read(path)
        except Exception:
            continue
        for index in (picture.plane.index, ()):
            if _is_picture(whole, index, picture):
                reading = _picked(f"{function}(PICTURE_FILE)", index)
                return PictureSource(reading, _OTHER_FILE, [_file_line(path.absolute())])
    return None


def _readers(path: Path) -> dict[str, Callable[[Path], Any]]:
    """Return what may read a file, by the names that a script calls it by."""
    if path.suffix.lower() == ".npy":
        return {"np.load": np.load}
    import imageio.v3 as iio

    # The second is how napari itself reads.
    return {"read_picture": read_picture, "iio.imread": iio.imread}


def _is_picture(whole: Any, index: tuple[int | slice, ...], picture: Picture) -> bool:
    """Tell whether an index picks the picture's pixels out of an array."""
    expected = picture.plane.data if index else picture.image
    if tuple(whole.shape) != tuple(expected.shape):
        return False
    return fingerprint(np.array(whole[index])) == picture.key[0]


def _picked(expression: str, index: tuple[int | slice, ...]) -> list[str]:
    if all(at == slice(None) for at in index):
        return [f"image = {expression}"]
    return [f"whole = {expression}", f"image = np.array(whole[{_index_text(index)}])"]


def _index_text(index: tuple[int | slice, ...]) -> str:
    bounds = ((at.start, at.stop) if isinstance(at, slice) else (at,) for at in index)
    return ", ".join(":".join("" if n is None else str(int(n)) for n in each) for each in bounds)


def _file_line(path: Path) -> str:
    """Return the line that names a file; a long path with one folder a line."""
    line = f"PICTURE_FILE = Path({text_literal(str(path))})"
    if len(line) <= _LONGEST_LINE:
        return line
    parts = (f"    {text_literal(part)}," for part in path.parts)
    return "\n".join(["PICTURE_FILE = Path(", *parts, ")"])


def _of_sample(picture: Picture, name: str) -> PictureSource | None:
    """Return how a sample of ours is made; None if the layer holds something else by now."""
    if name in PHOTOGRAPHS:
        [(data, *_)] = getattr(samples, name)()
        lines = [f'sample = files("napari_defocus.samples") / "{name}.jpg"']
        made = "read_picture(sample)"
    elif name == RAMP:
        data, lines = samples.simulated_ramp()[1][0], _SIMULATED_RAMP
        made = "simulate_defocus(sharp, true_blur, noise_variance=1e-06, rng=0)"
    else:
        return None
    index = picture.plane.index
    if not _is_picture(data, index, picture):
        return None
    return PictureSource([*lines, *_picked(made, index)], _OTHER_SAMPLE)


def _to_be_named(picture: Picture) -> PictureSource:
    constants = (
        f"# Name the file of the layer {text_literal(shortened(picture.plane.name))} here: nothing "
        "says where its",
        "# pixels come from. One that napari has saved it in will do.",
        'PICTURE_FILE = Path("your-picture.tif")',
    )
    reading = _picked("iio.imread(PICTURE_FILE)", picture.plane.index)
    return PictureSource(reading, _OTHER_FILE, constants)


def text_literal(text: str) -> str:
    """Return a text as Python writes it, on one line, in the quotes that ruff likes."""
    found = repr(text)
    return found if "'" in text or '"' in text else f'"{found[1:-1]}"'


def shortened(name: str) -> str:
    """Return the beginning of a name, for comments."""
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"
