"""Results as the bytes of files: values as TIFF that says what made it, drawings as PNG."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from napari_defocus.core.color_range import color_limit
from napari_defocus.core.image import prepare_image, shown_colors
from napari_defocus.io.provenance import ALL_IN_FOCUS, mark_in_tiff, marked_png, signature
from napari_defocus.psf import BLUR_RADIUS

_BLUR_QUANTITY = "defocus blur"
_EARLIER_UNITS = {
    "standard deviation (px)": "twice that",
    "outer radius (px)": "sqrt(1 + obstruction^2) times that",
    "equal-area radius (px)": "up to 1.1 times that",
}
"""The old units of maps of some lenses, and how to convert them."""
_CONFIDENCE_QUANTITY = "confidence of the blur map"

COLOR_MAP = "viridis"
NOT_TRUSTED_COLOR = (0.35, 0.35, 0.35)
DEPTH_COLOR_MAP = "magma_r"
BEYOND_COLOR = (0.6, 0.8, 0.95)
DEPTH_RANGE = (2, 98)
"""Percentiles of distances at the ends of the colour bar."""

LEAST_DEPTH_RANGE = 0.01
"""The least distance of the ends of the colour bar, as a share of the nearer one."""

SHOWN_SIDE = (480, 1600)
"""Shortest and longest length, in px, of the longer side of a map that is drawn."""

DIMMED = 0.35
OUTLINE_COLOR = (1.0, 0.85, 0.0)


def blur_map_tiff(
    blur_map: ArrayLike,
    settings: Mapping[str, Any],
    scale_name: str = BLUR_RADIUS,
    *,
    made: Mapping[str, Any] | None = None,
    pixel_size: tuple[float, float] | None = None,
) -> bytes:
    """Encode a blur map, (..., H, W) in px, NaN where it is not trusted, as a TIFF file.

    It is float32, deflate-compressed, a page for each plane. Its ImageDescription is a JSON object.
    It has the quantity, the unit, the version of this package, the settings that made the map, the
    shape, and all of `made`, such as its source. The height and width of a pixel, in m, become the
    resolution that other programs show.
    """
    return _tiff(blur_map, said_of_map(scale_name), settings, made, pixel_size)


def said_of_map(scale_name: str) -> dict[str, str]:
    """Return what a blur map says it holds; `scale_name` is what the PSF family's scale measures.

    Examples
    --------
    >>> said_of_map("blur radius (px)")["quantity"]
    'defocus blur radius'
    """
    what = scale_name.removesuffix(" (px)").removeprefix("blur ")
    quantity = f"{_BLUR_QUANTITY} {what}"
    return {"quantity": quantity, "unit": "px", "scale": scale_name}


def confidence_tiff(
    confidence: ArrayLike,
    settings: Mapping[str, Any],
    *,
    made: Mapping[str, Any] | None = None,
    pixel_size: tuple[float, float] | None = None,
) -> bytes:
    """Encode a confidence map, (..., H, W) in [0, 1], as a TIFF file like `blur_map_tiff`."""
    what = {"quantity": _CONFIDENCE_QUANTITY, "unit": "1"}
    return _tiff(confidence, what, settings, made, pixel_size)


def left_as_it_was_tiff(left: ArrayLike, settings: Mapping[str, Any]) -> bytes:
    """Encode how far a picture was left as it was, (H, W) in [0, 1], as `confidence_tiff` does."""
    return _tiff(left, {"quantity": "share left as it was", "unit": "1"}, settings)


def depth_tiff(depth: ArrayLike, settings: Mapping[str, Any]) -> bytes:
    """Encode distances, (H, W) in m, as a float32 TIFF file like `blur_map_tiff`.

    They are infinite where the blur is more than any distance has, NaN where not trusted.
    """
    return _tiff(depth, {"quantity": "distance from the lens", "unit": "m"}, settings)


def defocus_tiff(defocus_um: ArrayLike, settings: Mapping[str, Any]) -> bytes:
    """Encode a microscope's defocus, (H, W) in um, as a float32 TIFF file like `blur_map_tiff`."""
    return _tiff(defocus_um, {"quantity": "distance from the focus", "unit": "um"}, settings)


def picture_tiff(picture: ArrayLike, quantity: str, settings: Mapping[str, Any]) -> bytes:
    """Encode a picture, (H, W[, 3 or 4]) in [0, 1], as a float32 TIFF file like `blur_map_tiff`."""
    color = np.ndim(picture) == 3
    return _tiff(picture, {"quantity": quantity, "unit": "1"}, settings, color=color)


def picture_png(picture: ArrayLike, source: ArrayLike, quantity: str = ALL_IN_FOCUS) -> bytes:
    """Encode a picture, (H, W[, 3 or 4]) in [0, 1], as a PNG file that says its quantity.

    What is beyond is clipped, and NaN is transparent. The file has 8 bits a channel if the source,
    which the picture was made from, has no more, else 16.
    """
    import imagecodecs

    dtype = np.uint8 if np.asarray(source).dtype.itemsize == 1 else np.uint16
    shown = _transparent_unknown(np.asarray(picture, np.float32))
    levels = np.iinfo(dtype).max * np.clip(shown, 0.0, 1.0)
    return marked_png(bytes(imagecodecs.png_encode(np.rint(levels).astype(dtype))), quantity)


def lossless_png(picture: NDArray[Any], quantity: str) -> bytes:
    """Encode (H, W[, 3 or 4]) uint8 or uint16 as they are, as a PNG file that says its quantity."""
    import imagecodecs

    native = np.ascontiguousarray(picture, picture.dtype.newbyteorder("="))
    return marked_png(bytes(imagecodecs.png_encode(native)), quantity)


def _transparent_unknown(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a picture without NaN, with an opacity of 0 where it had some."""
    colors = picture[..., :3] if picture.ndim == 3 else picture[..., None]
    known = ~np.isnan(colors).any(axis=2, keepdims=True)
    if known.all():
        return picture
    opacity = picture[..., 3:] if picture.shape[2:] == (4,) else np.float32(1)
    return np.concatenate([np.where(known, colors, np.float32(0)), known * opacity], axis=2)


def with_opacity(picture: ArrayLike, source: ArrayLike) -> NDArray[np.float32]:
    """Return a picture, (H, W[, 3]) in [0, 1], with the opacity of another one if it has any."""
    color, given = np.asarray(picture, np.float32), np.asarray(source)
    if given.ndim == 2 or given.shape[2] == 3:
        return color
    full = np.iinfo(given.dtype).max if given.dtype.kind in "ui" else 1
    return np.dstack([color[..., :3], given[..., 3] / np.float32(full)])


def _tiff(
    values: ArrayLike,
    what: Mapping[str, str],
    settings: Mapping[str, Any],
    made: Mapping[str, Any] | None = None,
    pixel_size: tuple[float, float] | None = None,
    color: bool = False,
) -> bytes:
    import tifffile

    array = np.asarray(values, np.float32)
    description = {
        **what,
        **signature(),
        "settings": dict(settings),
        "shape": array.shape,
        **(made or {}),
    }
    buffer = io.BytesIO()
    tifffile.imwrite(
        buffer,
        array,
        photometric="rgb" if color else "minisblack",
        extrasamples=["unassalpha"] if color and array.shape[2:] == (4,) else None,
        compression="zlib",
        description=json.dumps(description, default=_plain),
        software=" ".join(signature().values()),
        metadata=None,
        **_resolution(pixel_size),
    )
    return buffer.getvalue()


def _plain(value: Any) -> Any:
    """Return what JSON can hold for a value of NumPy; the name of anything else."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def _resolution(pixel_size: tuple[float, float] | None) -> dict[str, Any]:
    if pixel_size is None:
        return {}
    height, width = pixel_size
    return {"resolution": (0.01 / width, 0.01 / height), "resolutionunit": "CENTIMETER"}


def description_in_tiff(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what a TIFF of this module says about itself; nothing if it is another file.

    No pixels are read.
    """
    return mark_in_tiff(path, ome=False)


def settings_in_tiff(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what a TIFF of `blur_map_tiff` says made it; nothing if it is another file."""
    return dict(description_in_tiff(path).get("settings", {}))


def holds(description: Mapping[str, Any]) -> str | None:
    """Return what the file of a description holds: "blur map", "confidence", or None."""
    quantity = str(description.get("quantity"))
    if quantity.startswith(_BLUR_QUANTITY):
        return "blur map"
    return "confidence" if quantity == _CONFIDENCE_QUANTITY else None


def check_unit(description: Mapping[str, Any], path: str | os.PathLike[str]) -> None:
    """Refuse what is no map in px, and maps from before all lenses had one unit.

    Raises
    ------
    ValueError
        If the description says so.
    """
    scale, unit = description.get("scale"), description.get("unit", "px")
    if unit not in ("px", "1"):
        what = description.get("quantity")
        raise ValueError(f"{path} holds a {what} in {unit}; it takes a blur map in px")
    if scale in _EARLIER_UNITS:
        raise ValueError(
            f"{path} holds the {scale} of its lens, as early versions wrote it; it takes the "
            f"{BLUR_RADIUS}, {_EARLIER_UNITS[scale]}. Measure the picture again"
        )


def values_in_tiff(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Return the values of a TIFF of `blur_map_tiff` or `confidence_tiff`, (..., H, W) float32.

    They are as they were, bit for bit; ValueError is raised if the file is cut off or damaged.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "stack-blur.tif")
    ...     _ = file.write_bytes(blur_map_tiff(np.ones((1, 4, 5)), {}))
    ...     values_in_tiff(file).shape
    (1, 4, 5)
    """
    import tifffile

    try:
        with tifffile.TiffFile(path) as tiff:
            pages = np.stack([page.asarray() for page in tiff.pages])
        # Files from before stacks were written do not say their shape.
        return pages.reshape(description_in_tiff(path).get("shape", pages.shape[1:]))
    except Exception as error:
        raise ValueError(f"cannot read {path}: the file is cut off or damaged") from error


def blur_map_png(
    blur_map: ArrayLike,
    max_scale: float | None = None,
    scale_name: str = BLUR_RADIUS,
    min_confidence: float = 0.0,
    um_per_px: float | None = None,
) -> bytes:
    """Draw a blur map, (H, W) in px, in colour, with a colour bar, as a PNG file.

    With `um_per_px`, the defocus in um for a blur of 1 px, the bar has um on its other side.

    The bar ends at 0 px and `max_scale`, by default that of `color_limit`. NaN, where the map is
    not trusted, is grey; below which confidence that is, is told if it is above 0. A pixel of the
    map is one of the drawing, unless it is very small or very large.
    """
    note = f"grey: confidence below {min_confidence:g}" if min_confidence > 0 else ""
    values = np.asarray(blur_map)
    limit = color_limit(values) if max_scale is None else max_scale
    return _drawing(
        values,
        COLOR_MAP,
        (0.0, limit),
        f"blur {scale_name.removeprefix('blur ')}",
        note,
        other=None if um_per_px is None else ("defocus (um)", um_per_px),
    )


def depth_png(depth: ArrayLike, min_confidence: float = 0.0) -> bytes:
    """Draw distances, (H, W) in m, in colour, with a colour bar, as a PNG file.

    It is like that of `blur_map_png`; the bar ends at the 2nd and the 98th percentile of the finite
    distances. Where no distance has so much blur they are infinite and light blue, where they are
    not trusted NaN and grey. Both are told.
    """
    distance = np.asarray(depth, np.float32)
    finite, infinite = distance[np.isfinite(distance)], np.isposinf(distance)
    near, far = np.percentile(finite, DEPTH_RANGE) if finite.size else (1.0, 1.0)
    far = max(far, near * (1 + LEAST_DEPTH_RANGE))
    notes = []
    if infinite.any():
        notes.append("light blue: beyond what the lens can tell")
    if np.isnan(distance).any():
        confidence = f"confidence below {min_confidence:g}"
        notes.append(f"grey: {confidence if min_confidence > 0 else 'not known'}")
    shown = np.where(infinite, 2 * far, np.clip(distance, near, far))
    note, beyond = "\n".join(notes), BEYOND_COLOR if infinite.any() else None
    return _drawing(shown, DEPTH_COLOR_MAP, (near, far), "distance (m)", note, beyond)


def confidence_png(confidence: ArrayLike) -> bytes:
    """Draw a confidence map, (H, W) in [0, 1], in grey with a colour bar, as a PNG file."""
    return _drawing(confidence, "gray", (0.0, 1.0), "confidence")


def left_as_it_was_png(left: ArrayLike) -> bytes:
    """Draw how far a picture was left as it was, (H, W) in [0, 1], as `confidence_png` does."""
    return _drawing(left, "gray", (0.0, 1.0), "left as it was")


def _drawing(
    values: ArrayLike,
    color_map: str,
    ends: tuple[float, float],
    label: str,
    note: str = "",
    beyond: tuple[float, float, float] | None = None,
    other: tuple[str, float] | None = None,
) -> bytes:
    """Draw values with a colour bar, NaN grey; `beyond` is the colour above its upper end.

    `other` is the label of a second unit, and what one of the first is in it.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    shown = np.asarray(values, np.float32)
    width, height = _shown_size(*shown.shape)
    height, margin, bar_room, dpi = max(height, 240), 20, 100, 100
    note_room = 20 * len(note.splitlines())
    other_room = 0 if other is None else 60
    across, up = width + other_room + bar_room + 2 * margin, height + note_room + 2 * margin
    figure = Figure(figsize=(across / dpi, up / dpi), dpi=dpi)
    bottom, tall = (margin + note_room) / up, height / up
    map_axes = figure.add_axes((margin / across, bottom, width / across, tall))
    left = width + other_room + 2 * margin
    bar_axes = figure.add_axes((left / across, bottom, margin / across, tall))
    colors = colormaps[color_map].with_extremes(bad=NOT_TRUSTED_COLOR, over=beyond)
    drawn = map_axes.imshow(shown, cmap=colors, vmin=ends[0], vmax=ends[1])
    map_axes.set_axis_off()
    figure.colorbar(drawn, cax=bar_axes, label=label, extend="max" if beyond else "neither")
    if other is not None:
        second, factor = other
        of_second = (lambda value: value * factor, lambda value: value / factor)
        bar_axes.secondary_yaxis("left", functions=of_second).set_ylabel(second)
    figure.text(margin / across, margin / 2 / up, note)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return marked_png(buffer.getvalue(), f"drawing: {label}")


def _shown_size(height: int, width: int) -> tuple[int, int]:
    side = max(height, width)
    zoom = float(np.clip(side, *SHOWN_SIDE)) / side
    return max(round(width * zoom), 1), max(round(height * zoom), 1)


def mask_png(mask: ArrayLike) -> bytes:
    """Encode a mask, (H, W), as an 8-bit grey PNG file.

    White (255) is in focus, 1; black blurred, 0; grey (128) not known, 2.
    """
    grey = np.array([0, 255, 128], np.uint8)
    return _png(grey[np.asarray(mask).astype(np.uint8)], "in-focus mask")


def overlay_png(
    image: ArrayLike, mask: ArrayLike, intensity_range: tuple[float, float] | None = None
) -> bytes:
    """Show an in-focus mask, (H, W), on its picture, as an 8-bit RGB PNG file.

    What is out of focus is dimmed, and there is a thin outline around the rest. A picture that
    fills less than half of the `intensity_range`, shown as black and white, is brightened.
    """
    focused = np.asarray(mask) == 1
    color = shown_colors(prepare_image(image, intensity_range))
    shown = np.where(focused[..., None], color, DIMMED * color)
    shown = np.broadcast_to(shown, (*focused.shape, 3)).copy()
    shown[_outline(focused)] = OUTLINE_COLOR
    return _png(np.rint(255.0 * shown).astype(np.uint8), "drawing: what is in focus")


def alpha_png(
    image: ArrayLike, alpha: ArrayLike, intensity_range: tuple[float, float] | None = None
) -> bytes:
    """Encode a picture with an opacity, (H, W) from 0 to 1, as an 8-bit RGBA PNG file."""
    color = shown_colors(prepare_image(image, intensity_range))
    opacity = np.asarray(alpha, np.float32)[..., None]
    shown = np.concatenate([np.broadcast_to(color, (*color.shape[:2], 3)), opacity], axis=2)
    return _png(np.rint(255.0 * shown).astype(np.uint8), "picture: what is in focus")


def _outline(focused: NDArray[np.bool_]) -> NDArray[np.bool_]:
    from scipy.ndimage import binary_erosion

    thickness = max(1, round(max(focused.shape) / 1000))
    inner: NDArray[np.bool_] = binary_erosion(focused, iterations=thickness, border_value=1)
    return focused & ~inner


def _png(pixels: NDArray[np.uint8], quantity: str) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    return marked_png(buffer.getvalue(), quantity)
