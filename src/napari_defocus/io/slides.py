"""Slides that are no plain TIFF files (MIRAX, VMS, BIF and others), read lazily by OpenSlide."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.extras import extra_package, is_there
from napari_defocus.io.file_kinds import slide_format
from napari_defocus.io.lazy_arrays import block_side, lazy_array

if TYPE_CHECKING:
    import dask.array as da

EXTRA = "slides"

_TILE = 512
"""px of the blocks of a slide that does not say how large its tiles are."""

_OPAQUE = 255

_ALSO_TIFF = "ventana"
"""Without OpenSlide they are read as TIFF files are, with tiles that overlap beside each other."""


@dataclass(frozen=True, eq=False)
class SlidePixels:
    """The largest level of a slide, RGB; regions are decoded. What was not scanned is white."""

    path: Path
    shape: tuple[int, ...]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of what is read."""
        return np.dtype(np.uint8)

    def __getitem__(self, region: tuple[slice, ...]) -> NDArray[Any]:
        """Read a region, one slice of step 1 an axis."""
        rows, columns, colors = region
        size = (columns.stop - columns.start, rows.stop - rows.start)
        with _opened(self.path) as slide:
            read = np.asarray(slide.read_region((columns.start, rows.start), 0, size))
        return _on_white(read)[..., colors]


def is_for_openslide(path: Path) -> bool:
    """Return whether a file is a slide that OpenSlide reads, or would if it were installed."""
    known = slide_format(path)
    if known is None or known.vendor != _ALSO_TIFF:
        return known is not None
    if not is_there("openslide"):
        return False
    import openslide

    return bool(openslide.OpenSlide.detect_format(path) == known.vendor)


def open_slide(path: Path) -> tuple[da.Array, dict[str, float]]:
    """Open the largest level of a slide: (H, W, 3) uint8, and the size of its pixels in um.

    ValueError, the end of a sentence, is raised if the extra "slides" is not installed or OpenSlide
    cannot read the file.
    """
    with _opened(path) as slide:
        width, height = slide.dimensions
        noted = slide.properties
        steps = {axis: _step(noted.get(f"openslide.mpp-{axis}")) for axis in "yx"}
        tiles = [
            int(noted.get(f"openslide.level[0].tile-{side}", _TILE)) for side in ("height", "width")
        ]
    blocks = (block_side(tiles[0], height), block_side(tiles[1], width), 3)
    data = lazy_array(SlidePixels(path.absolute(), (height, width, 3)), blocks)
    return data, {axis: step for axis, step in steps.items() if step > 0}


def told_choice_of_slide(path: Path) -> str:
    """Return in words what is read of a slide, and what is left out."""
    with _opened(path) as slide:
        told = [f"the largest of {slide.level_count} levels"] if slide.level_count > 1 else []
        others = ", ".join(sorted(slide.associated_images))
        return "; ".join([*told, f"left out: {others}"] if others else told)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    known = slide_format(path)
    kind = "no slide" if known is None else known.told
    openslide = extra_package("openslide", EXTRA, kind, "save it as a pyramidal TIFF")
    try:
        with openslide.OpenSlide(path) as slide:
            yield slide
    except openslide.OpenSlideError as error:
        raise ValueError(f"it is {kind}, which OpenSlide could not read ({error})") from error


def _on_white(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return RGB of RGBA, on white: pixels that were not scanned are transparent."""
    opacity = pixels[..., 3:].astype(np.uint16)
    if opacity.min(initial=_OPAQUE) == _OPAQUE:
        return np.ascontiguousarray(pixels[..., :3])
    mixed = (pixels[..., :3] * opacity + _OPAQUE * (_OPAQUE - opacity)) // _OPAQUE
    return mixed.astype(np.uint8)


def _step(text: str | None) -> float:
    try:
        return float(text or 0)
    except ValueError:
        return 0.0
