"""A run as a Python script that gives the same arrays without napari: no Qt, any thread.

Its layout is one that ruff and Black leave as it is, whatever length of lines they are set to:
calls have their arguments on one short line, or one a line with a comma after the last.
"""

from __future__ import annotations

import ast
import base64
import zlib
from collections.abc import Iterator
from dataclasses import asdict, fields
from numbers import Integral
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

import napari_defocus
from napari_defocus.psf import AUTO
from napari_defocus.settings import MapSettings
from napari_defocus.widgets.export.script_picture import picture_source, shortened, text_literal
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.distances import Distances
from napari_defocus.widgets.jobs.estimation import Picture
from napari_defocus.widgets.jobs.map_source import EstimatedSource
from napari_defocus.widgets.jobs.restoration import Refocusing, Restoration

Work = Analysis | Restoration | Refocusing | Distances

_IMPORTS = """\
import base64
import hashlib
import sys
import zlib
from importlib.resources import files
from pathlib import Path

import imageio.v3 as iio
import numpy as np
from napari_defocus import PUBLIC
from skimage.data import grass
from skimage.transform import resize"""
"""All that a script may need, in the order of ruff."""

_SCRIPT = Template('''"""Repeat a run of napari-defocus $version without napari: the same arrays.

Run it, or import its variables; it writes nothing.
"""

$imports

# The layer $layer of napari.
$constants


def fingerprint(image):
    """Return what tells pictures apart: a digest of shape, dtype and pixels."""
    what = repr((image.shape, image.dtype.str)).encode()
    digest = hashlib.blake2b(what, digest_size=16)
    digest.update(np.ascontiguousarray(image).data)
    return digest.hexdigest()


$reading
if fingerprint(image) != FINGERPRINT:
    print(
        $message,
        file=sys.stderr,
    )

$steps
''')


_CONFIDENCE = "confidence = confidence_map(candidates, blur_map)"


def script_of(work: Work, picture_file: Path | None = None) -> str:
    """Return a Python script that does what a run does, with the same arrays bit for bit.

    It needs napari-defocus but not napari, and writes nothing: the results are its variables
    `candidates`, `blur_map`, `confidence` and `in_focus`, as far as they were wanted; of a
    restoration `all_in_focus`, `left_as_it_was` and `refocused`, of distances `depth`. It says so
    if its picture is not the one that was analysed.

    Parameters
    ----------
    work : Analysis, Restoration, Refocusing or Distances
    picture_file : Path, optional
        Where the caller has saved the layer's data or the plane (.npy, .tif). By default the
        layer's own file or sample, if it still holds the pixels; if nothing does, the script
        begins with a line in which the user names a file.

    Returns
    -------
    str
        UTF-8 text, laid out as ruff does it.

    Raises
    ------
    NotAnalysableError
        If the plane cannot be read.
    ValueError
        If `picture_file` does not hold the plane's pixels, or the blur map is a layer's: a
        script cannot make it again.
    """
    picture = Picture.of(work.plane)
    source = picture_source(picture, picture_file)
    arrays = _arrays(work) if isinstance(work, Analysis) else {}
    packed = (_packed(name, *found) for name, found in arrays.items())
    constants = [*source.constants, f'FINGERPRINT = "{picture.key[0]}"', *packed]
    steps = _analysis(work) if isinstance(work, Analysis) else _from_map(work)
    parts = {
        "version": napari_defocus.__version__,
        "layer": text_literal(shortened(picture.plane.name)),
        "constants": "\n".join(constants),
        "reading": "\n".join(source.reading),
        "message": source.message,
        "steps": "\n".join(
            [*(_unpacked(name, found) for name, (found, _) in arrays.items()), *steps]
        ),
    }
    imports = _imports(_SCRIPT.substitute(parts, imports=""))
    return _SCRIPT.substitute(parts, imports=imports)


def _imports(script: str) -> str:
    """Return the imports of those names that a script uses."""
    used = {node.id for node in ast.walk(ast.parse(script)) if isinstance(node, ast.Name)}
    public = sorted(used & {*dir(napari_defocus)})
    block = "\n".join(["(", *(f"    {name}," for name in public), ")"])
    lines = _IMPORTS.splitlines()
    needed = [line for line in lines if not line or line.split()[-1] in {*used, "PUBLIC"}]
    return "\n".join(needed).replace("PUBLIC", block)


def _call(target: str, function: str, *arguments: str, **keywords: str) -> str:
    """Return a call whose value a variable gets."""
    if not keywords:
        return f"{target} = {function}({', '.join(arguments)})"
    given = [*arguments, *(f"{name}={value}" for name, value in keywords.items())]
    return "\n".join([f"{target} = {function}(", *(f"    {each}," for each in given), ")"])


def _literal(value: Any) -> str:
    """Return a text, a number, a bool or None as Python writes it; numbers to the last digit."""
    if isinstance(value, str):
        return text_literal(value)
    if value is None or isinstance(value, bool):
        return repr(value)
    if isinstance(value, Integral):
        return repr(int(value))
    return repr(float(value)) if np.isfinite(value) else f'float("{float(value)}")'


def _unusual(settings: Any, *names: str) -> dict[str, str]:
    """Return as keywords those settings that are not as their class has them; by default all."""
    values = {name: getattr(settings, name) for name in names or (f.name for f in fields(settings))}
    usual = type(settings)
    return {n: _literal(value) for n, value in values.items() if value != getattr(usual, n)}


def _arrays(work: Analysis) -> dict[str, tuple[NDArray[Any], str]]:
    """Return the arrays of small whole numbers that a script brings along, and what they are."""
    inside, seeds = work.plane.inside, work.seeds
    found: dict[str, tuple[NDArray[Any], str]] = {}
    if inside is not None:
        what = "Which pixels the shapes of the region enclose: what is outside does not count."
        found["inside"] = inside, what
    if work.mask is not None and seeds is not None and seeds.values.any():
        what = "What was painted, pixel by pixel: 1 in focus, 2 blurred, 0 not known."
        found["seeds"] = seeds.values, what
    return found


def _packed(name: str, array: NDArray[Any], what: str) -> str:
    packed = zlib.compress(np.ascontiguousarray(array, np.uint8).tobytes(), 9)
    text = base64.encodebytes(packed).decode("ascii")
    return f'\n# {what}\n{name.upper()} = """\n{text}"""'


def _unpacked(name: str, array: NDArray[Any]) -> str:
    rows, columns = array.shape
    unpacked = f"zlib.decompress(base64.b64decode({name.upper()}))"
    return (
        f"{name} = np.frombuffer({unpacked}, np.uint8)\n{name} = {name}.reshape({rows}, {columns})"
    )


def _analysis(work: Analysis) -> Iterator[str]:
    arrays = _arrays(work)
    yield from _candidates(work.estimation)
    if work.blur_map:
        yield _blur_map(work.estimation)
    if work.blur_map and work.confidence:
        yield _CONFIDENCE
        if "inside" in arrays:
            yield "confidence[inside == 0] = 0"
    if work.mask is not None:
        seeds = {"seeds": "seeds"} if "seeds" in arrays else {}
        keywords = _unusual(work.mask) | seeds
        if "inside" in arrays and work.mask.threshold == AUTO:
            keywords["within"] = "inside"
        yield _call("in_focus", "segment_in_focus", "candidates", "image", **keywords)
        if "inside" in arrays:
            yield "in_focus[inside == 0] = 0"


def _candidates(settings: MapSettings) -> Iterator[str]:
    light = _unusual(settings, "linearize")
    keywords = _unusual(settings, "noise_variance", "window", "stride", "mode", "camera_softness")
    if settings.shot_noise:
        yield _call("noise", "estimate_shot_noise", "image", **light)
        keywords["noise_variance"] = "noise"
    if (settings.psf, settings.max_radius) != (MapSettings.psf, MapSettings.max_radius):
        is_file = settings.psf.lower().endswith(".npz")
        text = str(Path(settings.psf).absolute()) if is_file else settings.psf
        largest = _literal(settings.family().max_scale)
        yield _call("psf", "psf_from_text", text_literal(text), max_scale=largest)
        keywords["psf"] = "psf"
    yield _call("candidates", "estimate_candidates", "image", **keywords, **light)


def _blur_map(settings: MapSettings) -> str:
    keywords = _unusual(settings, "smoothness", "color_sigma")
    return _call("blur_map", "label_blur_map", "candidates", "image", **keywords)


def _from_map(work: Restoration | Refocusing | Distances) -> Iterator[str]:
    """Return what is made of a picture and its map."""
    source = (work.restoration if isinstance(work, Refocusing) else work).source
    if not isinstance(source, EstimatedSource):
        raise ValueError(
            "The blur map is a layer's, which a script cannot make again. Have it estimated "
            "instead."
        )
    yield from _candidates(source.settings)
    yield _blur_map(source.settings)
    yield _CONFIDENCE
    match work:
        case Distances():
            yield from _distances(work)
        case Refocusing():
            yield from _restoration(work.restoration)
            keywords = {"psf": "candidates.psf", "all_in_focus": "all_in_focus"}
            keywords = _unusual(work.view) | keywords
            yield _call("refocused", "change_focus", "image", "blur_map", **keywords)
        case _:
            yield from _restoration(work)


def _restoration(work: Restoration) -> Iterator[str]:
    light = {} if work.linearize is None else {"linearize": _literal(work.linearize)}
    keywords = {"psf": "candidates.psf", "noise_variance": "noise_variance"}
    blur = "blur_map"
    if work.protect:
        blur, keywords["confidence"] = "safe", "confidence"
        yield _call(blur, "cautious_blur_map", "candidates", "blur_map")
    if work.settings.noise_variance is None:
        yield _call("noise_variance", "estimate_noise_variance", "image", **light)
    else:
        keywords["noise_variance"] = _literal(work.settings.noise_variance)
    keywords |= _unusual(work.settings, "tv_weight") | light
    if not work.show_left:
        yield _call("all_in_focus", "restore_all_in_focus", "image", blur, **keywords)
        return
    keywords["return_fit"] = "True"
    yield _call("all_in_focus, fit", "restore_all_in_focus", "image", blur, **keywords)
    yield "left_as_it_was = fit.left_as_it_was"


def _distances(work: Distances) -> Iterator[str]:
    lens = {name: _literal(value) for name, value in asdict(work.lens).items()}
    yield _call("lens", "ThinLens", **lens)
    keywords = {"side": _literal(work.side)}
    yield _call("depth", "depth_from_blur", "blur_map", "lens", **keywords)
    yield f"depth[confidence < {_literal(work.min_confidence)}] = np.nan"
