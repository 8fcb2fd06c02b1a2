"""Where the pixels of a plane come from, as lines of a script that reads them: no Qt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from napari_defocus.io.pictures import read_picture
from napari_defocus.widgets.export.script_text import longer_than_a_line, shortened, text_literal
from napari_defocus.widgets.jobs.cache import fingerprint
from napari_defocus.widgets.jobs.estimation import Picture
from napari_defocus.widgets.layers.preferences import PLUGIN

PHOTOGRAPHS = ("dandelion", "brushes")
RAMP = "ramp"

_READ_PICTURE = "from napari_defocus.io.pictures import read_picture"
_IMAGEIO = "import imageio.v3 as iio"
_SAMPLE_FILES = "from importlib.resources import files"

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
    imports : tuple of str
        What these lines import.
    names : tuple of str
        What they take from `napari_defocus`.
    constants : list of str
        Lines above them: the file.
    """

    reading: list[str]
    message: str
    imports: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    constants: tuple[str, ...] = ()


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
    for expression, needed, read in _readers(path):
        # Readers raise whatever other people's files lead them into.
        try:
            whole = read(path)
        except Exception:
            continue
        for index in (picture.plane.index, ()):
            if _is_picture(whole, index, picture):
                return PictureSource(
                    _picked(expression, index),
                    'f"{PICTURE_FILE} is another picture than was analysed in napari."',
                    (*needed, "from pathlib import Path"),
                    constants=tuple(_file_lines(path.absolute())),
                )
    return None


def _readers(path: Path) -> list[tuple[str, tuple[str, ...], Callable[[Path], Any]]]:
    """Return how to read a file: as a line, what it imports, and as a function."""
    if path.suffix.lower() == ".npy":
        return [("np.load(PICTURE_FILE)", (), np.load)]
    import imageio.v3 as iio

    # The second is how napari itself reads.
    return [
        ("read_picture(PICTURE_FILE)", (_READ_PICTURE,), read_picture),
        ("iio.imread(PICTURE_FILE)", (_IMAGEIO,), iio.imread),
    ]


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
    return ", ".join(_slice_text(at) if isinstance(at, slice) else str(int(at)) for at in index)


def _slice_text(at: slice) -> str:
    bounds = ["" if bound is None else str(int(bound)) for bound in (at.start, at.stop)]
    step = [] if at.step in (None, 1) else [str(int(at.step))]
    return ":".join(bounds + step)


def _file_lines(path: Path) -> list[str]:
    """Return the line that names a file; a long path in pieces."""
    line = f"PICTURE_FILE = Path({text_literal(str(path))})"
    if not longer_than_a_line(line):
        return [line]
    pieces = [""]
    for part in path.parts:
        longer = str(Path(pieces[-1], part))
        if longer_than_a_line(f"    {text_literal(longer)},") and pieces[-1]:
            pieces.append(part)
        else:
            pieces[-1] = longer
    return ["PICTURE_FILE = Path(", *(f"    {text_literal(piece)}," for piece in pieces), ")"]


def _of_sample(picture: Picture, name: str) -> PictureSource | None:
    """Return how a sample of ours is made; None if the layer holds something else by now."""
    from napari_defocus.widgets.layers import samples

    message = '"The sample is another picture than was analysed in napari."'
    index = picture.plane.index
    if name in PHOTOGRAPHS:
        [(photograph, *_)] = getattr(samples, name)()
        if not _is_picture(photograph, index, picture):
            return None
        lines = [f'sample = files("napari_defocus.samples") / "{name}.jpg"']
        lines += _picked("read_picture(sample)", index)
        return PictureSource(lines, message, (_SAMPLE_FILES, _READ_PICTURE))
    if name != RAMP or not _is_picture(samples.simulated_ramp()[1][0], index, picture):
        return None
    simulated = "simulate_defocus(sharp, true_blur, noise_variance=1e-06, rng=0)"
    needed = ("from skimage.data import grass", "from skimage.transform import resize")
    lines = [*_SIMULATED_RAMP, *_picked(simulated, index)]
    return PictureSource(lines, message, needed, ("simulate_defocus",))


def _to_be_named(picture: Picture) -> PictureSource:
    name = text_literal(shortened(picture.plane.name))
    return PictureSource(
        _picked("iio.imread(PICTURE_FILE)", picture.plane.index),
        'f"{PICTURE_FILE} is another picture than was analysed in napari."',
        (_IMAGEIO, "from pathlib import Path"),
        constants=(
            f"# Name the file of the layer {name} here: nothing says where its",
            "# pixels come from. One that napari has saved it in will do.",
            'PICTURE_FILE = Path("your-picture.tif")',
        ),
    )
