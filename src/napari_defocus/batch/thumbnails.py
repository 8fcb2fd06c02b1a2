"""Small pictures of a field: how it looks, a detail at full size, its blur, its outlines.

Those of the blur have the radius of each pixel in their palette, in steps of 1 % or less. So what
is in focus by another limit is outlined again without a measurement.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from napari_defocus.batch.blur_histogram import on_scale
from napari_defocus.core.image import prepare_image, shown_colors
from napari_defocus.io.encoders import COLOR_MAP, NOT_TRUSTED_COLOR, OUTLINE_COLOR
from napari_defocus.io.provenance import marked_png, signature
from napari_defocus.psf import MAX_RADIUS

SIDE = 200
"""px of the longer side of a thumbnail, and of the sides of a detail."""

_QUALITY = 75
"""Of JPEG, from 0 to 100: files of 3 to 15 kB."""

WIDEST = 16.0
"""px: the radius at which the colours end."""

BLUR, OUTLINE, DETAIL = "-blur.png", "-outline.png", "-detail.jpg"
"""How the names of a field's other small pictures end, beside NAME.jpg."""

_LEVELS = 255
"""Radii that a palette tells apart; its first colour is for what is not known."""


def beside(thumbnail: Path, ending: str) -> Path:
    """Return where another small picture of the field of NAME.jpg is."""
    return thumbnail.with_name(thumbnail.name.removesuffix(".jpg") + ending)


def remove_small_pictures(thumbnail: Path) -> None:
    """Remove the small pictures of a field, as far as they are there."""
    for path in (thumbnail, *(beside(thumbnail, ending) for ending in (BLUR, OUTLINE, DETAIL))):
        path.unlink(missing_ok=True)


def small_pictures(
    thumbnail: Path,
    picture: NDArray[Any],
    blur_map: NDArray[Any],
    known: NDArray[np.bool_],
    intensity_range: tuple[float, float] | None = None,
) -> dict[Path, bytes]:
    """Return the files of a field, but for its outlines.

    Parameters
    ----------
    thumbnail : Path
        Where the picture goes, NAME.jpg; the others go beside it.
    picture : (H, W) or (H, W, 3) or (H, W, 4) ndarray
    blur_map : (H, W) ndarray
        In px.
    known : (H, W) bool ndarray
        Where the blur is known, and counts.
    intensity_range : (float, float), optional
        The intensities that are shown as black and white.
    """
    color = shown_colors(prepare_image(picture, intensity_range))
    whole, size = as_image(color), small_size(*color.shape[:2])
    small = whole.resize(size[::-1], Image.Resampling.BOX)
    detail = whole.crop(_liveliest(np.asarray(whole), known))
    rows, columns = (
        ((np.arange(few) + 0.5) * many / few).astype(int)
        for few, many in zip(size, known.shape, strict=True)
    )
    sampled = np.ix_(rows, columns)
    return encoded(thumbnail, small, detail, blur_map[sampled], known[sampled])


def encoded(
    thumbnail: Path,
    small: Image.Image,
    detail: Image.Image,
    radii: NDArray[Any],
    known: NDArray[np.bool_],
) -> dict[Path, bytes]:
    """Return the files of a field whose picture and blur are as small as they are shown."""
    return {
        thumbnail: _jpeg(small),
        beside(thumbnail, DETAIL): _jpeg(detail),
        beside(thumbnail, BLUR): blur_png(radii, known),
    }


def as_image(color: NDArray[np.floating]) -> Image.Image:
    """Return colours, (H, W, 1 or 3) in [0, 1], as a picture of 8 bits."""
    shown = np.rint(255 * color).astype(np.uint8)
    return Image.fromarray(shown[..., 0] if shown.shape[2] == 1 else shown)


def small_size(height: int, width: int) -> tuple[int, int]:
    """Return the height and width of a thumbnail, in px.

    Examples
    --------
    >>> small_size(1000, 500), small_size(20, 30)
    ((200, 100), (20, 30))
    """
    zoom = min(1.0, SIDE / max(height, width))
    return max(1, round(zoom * height)), max(1, round(zoom * width))


def _liveliest(shown: NDArray[np.uint8], known: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return the part with most contrast where most is known: left, top, right, bottom."""
    grey = shown if shown.ndim == 2 else shown[..., 1]
    height, width = grey.shape
    best, chosen = -1.0, (0, 0)
    for top in _starts(height):
        for left in _starts(width):
            part = slice(top, top + SIDE), slice(left, left + SIDE)
            worth = float(grey[part][::2, ::2].std()) * (0.01 + float(known[part].mean()))
            if worth > best:
                best, chosen = worth, (top, left)
    top, left = chosen
    return left, top, min(left + SIDE, width), min(top + SIDE, height)


def _starts(length: int) -> range:
    return range(0, max(1, length - SIDE + 1), SIDE // 2)


def _jpeg(picture: Image.Image) -> bytes:
    """Return a JPEG that says that this package made it."""
    said = json.dumps({"quantity": "drawing: thumbnail", **signature()})
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=_QUALITY, optimize=True, comment=said.encode())
    return buffer.getvalue()


def blur_png(blur_map: NDArray[Any], known: NDArray[np.bool_]) -> bytes:
    """Draw a small map, (H, W) in px, in colours of one range from 0 px on; grey if unknown."""
    radii = np.where(known, np.nan_to_num(blur_map), 0.0)
    levels = 1 + np.rint((_LEVELS - 1) * on_scale(radii)).astype(int)
    indexed = np.where(known, np.clip(levels, 1, _LEVELS), 0).astype(np.uint8)
    return _png(indexed, palette(), "drawing: blur radius")


def palette() -> NDArray[np.uint8]:
    """Return the colours of the maps, (256, 3): of what is not known, then of rising radii.

    From `WIDEST` on they are the same: colours are for what is nearly in focus.
    """
    from matplotlib import colormaps

    share = np.linspace(0, 1 / float(on_scale(WIDEST)), _LEVELS)
    colors = colormaps[COLOR_MAP](np.minimum(share, 1))[:, :3]
    return np.rint(255 * np.vstack([NOT_TRUSTED_COLOR, colors])).astype(np.uint8)


def radii_in(content: bytes) -> NDArray[np.float32]:
    """Return the radii, in px, of a file of `blur_png`: (H, W), NaN where it is not known.

    Examples
    --------
    >>> found = radii_in(blur_png(np.array([[1.0, 30.0]]), np.array([[True, False]])))
    >>> found.round(1).tolist()
    [[1.0, nan]]
    """
    with Image.open(io.BytesIO(content), formats=("PNG",)) as drawn:
        levels = np.asarray(drawn).astype(np.float32)
    radii = np.expm1((levels - 1) / (_LEVELS - 1) * np.log1p(np.float32(MAX_RADIUS)))
    return np.where(levels > 0, radii, np.float32(np.nan))


def outline_png(radii: NDArray[Any], limit: float) -> bytes:
    """Draw the outlines of what is blurred by at most `limit` px; transparent elsewhere.

    What is in focus up to the border of the picture has an outline there, too. A dark line beside
    the bright one is seen on bright pictures.
    """
    from scipy.ndimage import binary_dilation, binary_erosion, binary_opening

    focused = binary_opening(np.nan_to_num(radii, nan=np.inf) <= limit)
    bright = focused & ~binary_erosion(focused, iterations=2)
    dark = binary_dilation(bright) & ~bright
    indexed = (bright + 2 * dark).astype(np.uint8)
    colors = np.rint(255 * np.array([(0, 0, 0), OUTLINE_COLOR, (0, 0, 0)])).astype(np.uint8)
    return _png(indexed, colors, "drawing: outline", transparency=bytes([0, 255, 110]))


def _png(
    indexed: NDArray[np.uint8], colors: NDArray[np.uint8], quantity: str, **options: Any
) -> bytes:
    height, width = indexed.shape
    drawn = Image.frombytes("P", (width, height), indexed.tobytes())
    drawn.putpalette(colors.ravel().tolist())
    buffer = io.BytesIO()
    drawn.save(buffer, "PNG", optimize=True, **options)
    return marked_png(buffer.getvalue(), quantity)
