"""A run as a Python script that gives the same arrays without napari: no Qt, any thread."""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from napari_defocus import __version__
from napari_defocus.settings import MapSettings, MaskSettings, RefocusSettings
from napari_defocus.widgets.export.script_picture import PictureSource, picture_source
from napari_defocus.widgets.export.script_text import (
    call,
    differing,
    import_block,
    literal,
    shortened,
    text_literal,
)
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.distances import Distances
from napari_defocus.widgets.jobs.estimation import Picture
from napari_defocus.widgets.jobs.map_source import EstimatedSource, MapSource
from napari_defocus.widgets.jobs.restoration import Refocusing, Restoration
from napari_defocus.widgets.layers.seeds import Seeds

Work = Analysis | Restoration | Refocusing | Distances

_FINGERPRINT = '''
def fingerprint(image):
    """Return what tells pictures apart: a digest of shape, dtype and pixels."""
    what = repr((image.shape, image.dtype.str)).encode()
    digest = hashlib.blake2b(what, digest_size=16)
    digest.update(np.ascontiguousarray(image).data)
    return digest.hexdigest()
'''


@dataclass
class _Script:
    """A script that is being written.

    Attributes
    ----------
    names : list of str
        What it takes from `napari_defocus`.
    imports, constants, steps : list of str
        Lines.
    """

    names: list[str] = field(default_factory=list)
    imports: list[str] = field(default_factory=list)
    constants: list[str] = field(default_factory=list)
    steps: list[str] = field(default_factory=list)

    def step(self, target: str, function: str, *arguments: str, **keywords: str) -> None:
        """Add a call of a public function."""
        self.names.append(function)
        self.steps += call(function, arguments, keywords, target=target)


def script_of(work: Work, picture_file: Path | None = None) -> str:
    """Return a Python script that does what a run does, with the same arrays bit for bit.

    It needs napari-defocus but not napari, and writes nothing: the results are its variables
    `candidates`, `blur_map`, `confidence` and `in_focus`, as far as they were wanted; of a
    restoration `all_in_focus` and `refocused`, of distances `depth`. It says so if its picture
    is not the one that was analysed.

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
    script = _Script()
    if isinstance(work, Analysis):
        _write_analysis(script, work)
    else:
        _write_from_map(script, work)
    return _composed(script, picture, source)


def _composed(script: _Script, picture: Picture, source: PictureSource) -> str:
    imports = ["import hashlib", "import sys", "import numpy as np"]
    names = {"napari_defocus": [*script.names, *source.names]}
    layer = text_literal(shortened(picture.plane.name))
    constants = [*source.constants, f'FINGERPRINT = "{picture.key[0]}"']
    lines = [
        f'"""Repeat a run of napari-defocus {__version__} without napari: the same arrays.',
        "",
        "Run it, or import its variables; it writes nothing.",
        '"""',
        "",
        *import_block({*imports, *script.imports, *source.imports}, names),
        "",
        f"# The layer {layer} of napari.",
        *constants,
        *script.constants,
        "",
        *_FINGERPRINT.splitlines(),
        "",
        "",
        *source.reading,
        "if fingerprint(image) != FINGERPRINT:",
        *call("print", [source.message], {"file": "sys.stderr"}, indent=4),
        "",
        *script.steps,
    ]
    return "\n".join(lines) + "\n"


def _write_analysis(script: _Script, work: Analysis) -> None:
    inside = work.plane.inside
    if inside is not None:
        told = "Which pixels the shapes of the region enclose: what is outside does not count."
        _write_array(script, "inside", inside, told)
    _write_candidates(script, work.estimation)
    if work.blur_map:
        _write_map(script, work.estimation)
    if work.blur_map and work.confidence:
        script.step("confidence", "confidence_map", "candidates", "blur_map")
        if inside is not None:
            script.steps.append("confidence[inside == 0] = 0")
    if work.mask is not None:
        seeds = _write_seeds(script, work.seeds)
        said = differing(work.mask, [each.name for each in fields(MaskSettings)])
        keywords = said | seeds
        script.step("in_focus", "segment_in_focus", "candidates", "image", **keywords)
        if inside is not None:
            script.steps.append("in_focus[inside == 0] = 0")


def _write_candidates(script: _Script, settings: MapSettings) -> None:
    light = differing(settings, ["linearize"])
    said = differing(settings, ["noise_variance", "window", "stride", "mode"])
    if settings.shot_noise:
        script.step("noise", "estimate_shot_noise", "image", **light)
        said["noise_variance"] = "noise"
    lens = _write_lens(script, settings)
    keywords = lens | said | light
    script.step("candidates", "estimate_candidates", "image", **keywords)


def _write_lens(script: _Script, settings: MapSettings) -> dict[str, str]:
    if (settings.psf, settings.max_radius) == (MapSettings.psf, MapSettings.max_radius):
        return {}
    text = settings.psf
    if text.lower().endswith(".npz"):
        text = str(Path(text).absolute())
    largest = literal(settings.family().max_scale)
    script.step("psf", "psf_from_text", text_literal(text), max_scale=largest)
    return {"psf": "psf"}


def _write_map(script: _Script, settings: MapSettings) -> None:
    keywords = differing(settings, ["smoothness", "color_sigma"])
    script.step("blur_map", "label_blur_map", "candidates", "image", **keywords)


def _write_seeds(script: _Script, seeds: Seeds | None) -> dict[str, str]:
    if seeds is None or not seeds.values.any():
        return {}
    told = "What was painted, pixel by pixel: 1 in focus, 2 blurred, 0 not known."
    _write_array(script, "seeds", seeds.values, told)
    return {"seeds": "seeds"}


def _write_array(script: _Script, name: str, array: NDArray[np.generic], told: str) -> None:
    """Let the script make an array of small whole numbers, (H, W), from compressed text."""
    rows, columns = array.shape
    packed = zlib.compress(np.ascontiguousarray(array, np.uint8).tobytes(), 9)
    text = base64.encodebytes(packed).decode("ascii")
    script.imports += ["import base64", "import zlib"]
    script.constants += ["", f"# {told}", f'{name.upper()} = """', *text.splitlines(), '"""']
    script.steps += [
        f"{name} = np.frombuffer(zlib.decompress(base64.b64decode({name.upper()})), np.uint8)",
        f"{name} = {name}.reshape({rows}, {columns})",
    ]


def _write_from_map(script: _Script, work: Restoration | Refocusing | Distances) -> None:
    """Write what is made of a picture and its map."""
    restoration = work.restoration if isinstance(work, Refocusing) else work
    settings = _estimation_of(restoration.source)
    _write_candidates(script, settings)
    _write_map(script, settings)
    script.step("confidence", "confidence_map", "candidates", "blur_map")
    if isinstance(restoration, Distances):
        _write_distances(script, restoration)
        return
    _write_restoration(script, restoration)
    if isinstance(work, Refocusing):
        _write_view(script, work.view)


def _estimation_of(source: MapSource) -> MapSettings:
    if isinstance(source, EstimatedSource):
        return source.settings
    raise ValueError(
        "The blur map is a layer's, which a script cannot make again. Have it estimated instead."
    )


def _write_restoration(script: _Script, work: Restoration) -> None:
    linear = {} if work.linearize is None else {"linearize": literal(work.linearize)}
    keywords = {"psf": "candidates.psf"}
    blur = "blur_map"
    if work.protect:
        blur = "safe"
        script.step(blur, "cautious_blur_map", "candidates", "blur_map")
        keywords["confidence"] = "confidence"
    keywords["noise_variance"] = "noise_variance"
    if work.settings.noise_variance is None:
        script.step("noise_variance", "estimate_noise_variance", "image", **linear)
    else:
        keywords["noise_variance"] = literal(work.settings.noise_variance)
    keywords |= differing(work.settings, ["tv_weight"]) | linear
    script.step("all_in_focus", "restore_all_in_focus", "image", blur, **keywords)


def _write_view(script: _Script, view: RefocusSettings) -> None:
    said = differing(view, [each.name for each in fields(RefocusSettings)])
    keywords = {"psf": "candidates.psf", "all_in_focus": "all_in_focus"}
    keywords = said | keywords
    script.step("refocused", "change_focus", "image", "blur_map", **keywords)


def _write_distances(script: _Script, work: Distances) -> None:
    lens = {each.name: literal(getattr(work.lens, each.name)) for each in fields(work.lens)}
    script.step("lens", "ThinLens", **lens)
    keywords = {"side": literal(work.side), "psf": "candidates.psf"}
    script.step("depth", "depth_from_blur", "blur_map", "lens", **keywords)
    limit = literal(work.min_confidence)
    script.steps.append(f"depth[confidence < {limit}] = np.nan")
