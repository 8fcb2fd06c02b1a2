"""Results as the bytes of files: values as TIFF that says what made it, drawings as PNG."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

import napari_defocus
from napari_defocus.image import prepare_image
from napari_defocus.psf import Disc
from napari_defocus.settings import MapSettings

COLOR_MAP = "viridis"
NOT_TRUSTED_COLOR = (0.35, 0.35, 0.35)
SHOWN_SIDE = (480, 1600)
"""Shortest and longest length, in px, of the longer side of a map that is drawn."""

DIMMED = 0.35
OUTLINE_COLOR = (1.0, 0.85, 0.0)


def blur_map_tiff(
    blur_map: ArrayLike, settings: Mapping[str, Any], scale_name: str = Disc.scale_name
) -> bytes:
    """Encode the values of a blur map as a TIFF file.

    Parameters
    ----------
    blur_map : (H, W) array_like
        Blur scale, in px; NaN where it is not trusted.
    settings : mapping
        What made the map; anything that JSON can hold.
    scale_name : str
        What the PSF family's scale measures.

    Returns
    -------
    bytes
        A float32 TIFF, deflate-compressed. Its ImageDescription is a JSON object that says
        the quantity, the unit, the version of this package and the settings.
    """
    quantity = f"defocus blur {scale_name.removesuffix(' (px)')}"
    return _tiff(blur_map, {"quantity": quantity, "unit": "px"}, settings)


def confidence_tiff(confidence: ArrayLike, settings: Mapping[str, Any]) -> bytes:
    """Encode a confidence map, (H, W) in [0, 1], as a float32 TIFF file like `blur_map_tiff`."""
    return _tiff(confidence, {"quantity": "confidence of the blur map", "unit": "1"}, settings)


def _tiff(values: ArrayLike, what: Mapping[str, str], settings: Mapping[str, Any]) -> bytes:
    import tifffile

    description = {
        **what,
        "software": "napari-defocus",
        "version": napari_defocus.__version__,
        "settings": dict(settings),
    }
    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer,
        np.asarray(values, np.float32),
        photometric="minisblack",
        compression="zlib",
        description=json.dumps(description),
        software=f"napari-defocus {napari_defocus.__version__}",
        metadata=None,
    )
    return buffer.getvalue()


def settings_in_tiff(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what a TIFF of `blur_map_tiff` says made it; nothing if it is another file."""
    import tifffile

    # Damaged files raise anything; reading them as pictures says what is wrong with them.
    with suppress(Exception), tifffile.TiffFile(path) as tiff:
        return dict(json.loads(tiff.pages.first.description)["settings"])
    return {}


def blur_map_png(
    blur_map: ArrayLike,
    max_scale: float = MapSettings.max_radius,
    scale_name: str = Disc.scale_name,
    min_confidence: float = 0.0,
) -> bytes:
    """Draw a blur map in colour, with a colour bar in px, as a PNG file.

    Parameters
    ----------
    blur_map : (H, W) array_like
        Blur scale, in px; NaN, drawn grey, where it is not trusted.
    max_scale : float
        The scale, in px, at the upper end of the colour bar; the lower end is 0 px.
    scale_name : str
        What the PSF family's scale measures, with its unit.
    min_confidence : float
        Below what confidence the map is not trusted; told if it is above 0.

    Returns
    -------
    bytes
        A PNG file: one picture pixel a pixel of the map, unless the map is very small or
        very large.
    """
    note = f"grey: confidence below {min_confidence:g}" if min_confidence > 0 else ""
    return _drawing(blur_map, COLOR_MAP, max_scale, f"blur {scale_name}", note)


def confidence_png(confidence: ArrayLike) -> bytes:
    """Draw a confidence map, (H, W) in [0, 1], in grey with a colour bar, as a PNG file."""
    return _drawing(confidence, "gray", 1.0, "confidence")


def _drawing(
    values: ArrayLike, color_map: str, highest: float, label: str, note: str = ""
) -> bytes:
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    shown = np.asarray(values, np.float32)
    width, height = _shown_size(*shown.shape)
    height, margin, bar_room, note_room, dpi = max(height, 240), 20, 100, 20 * bool(note), 100
    across, up = width + bar_room + 2 * margin, height + note_room + 2 * margin
    figure = Figure(figsize=(across / dpi, up / dpi), dpi=dpi)
    bottom, tall = (margin + note_room) / up, height / up
    map_axes = figure.add_axes((margin / across, bottom, width / across, tall))
    bar_axes = figure.add_axes(((width + 2 * margin) / across, bottom, margin / across, tall))
    colors = colormaps[color_map].with_extremes(bad=NOT_TRUSTED_COLOR)
    drawn = map_axes.imshow(shown, cmap=colors, vmin=0.0, vmax=highest)
    map_axes.set_axis_off()
    figure.colorbar(drawn, cax=bar_axes, label=label)
    figure.text(margin / across, margin / 2 / up, note)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _shown_size(height: int, width: int) -> tuple[int, int]:
    side = max(height, width)
    zoom = float(np.clip(side, *SHOWN_SIDE)) / side
    return max(round(width * zoom), 1), max(round(height * zoom), 1)


def mask_png(mask: ArrayLike) -> bytes:
    """Encode an in-focus mask as a PNG file that people can look at.

    Parameters
    ----------
    mask : (H, W) array_like
        Non-zero in focus, 0 out of focus.

    Returns
    -------
    bytes
        An 8-bit grey PNG: 255 (white) in focus, 0 (black) out of focus.
    """
    return _png(np.where(np.asarray(mask) != 0, 255, 0).astype(np.uint8))


def overlay_png(
    image: ArrayLike, mask: ArrayLike, intensity_range: tuple[float, float] | None = None
) -> bytes:
    """Show an in-focus mask on its picture, as a PNG file.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The picture; what `napari_defocus.image.prepare_image` takes.
    mask : (H, W) array_like
        Non-zero in focus, 0 out of focus.
    intensity_range : (float, float), optional
        The intensities shown as black and white, instead of the dtype's range.

    Returns
    -------
    bytes
        An 8-bit RGB PNG: the part out of focus dimmed, a thin outline around the rest.
    """
    focused = np.asarray(mask) != 0
    color = np.clip(prepare_image(image, intensity_range).color, 0.0, 1.0)
    shown = np.where(focused[..., None], color, DIMMED * color)
    shown = np.broadcast_to(shown, (*focused.shape, 3)).copy()
    shown[_outline(focused)] = OUTLINE_COLOR
    return _png(np.rint(255.0 * shown).astype(np.uint8))


def _outline(focused: NDArray[np.bool_]) -> NDArray[np.bool_]:
    from scipy.ndimage import binary_erosion

    thickness = max(1, round(max(focused.shape) / 1000))
    inner: NDArray[np.bool_] = binary_erosion(focused, iterations=thickness, border_value=1)
    return focused & ~inner


def _png(pixels: NDArray[np.uint8]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    return buffer.getvalue()
