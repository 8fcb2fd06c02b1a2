"""Pictures in, results out: decoding by content, and files that appear whole or not at all."""

from __future__ import annotations

import io
import json
import os
import secrets
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import ExifTags, Image, UnidentifiedImageError

import napari_defocus
from napari_defocus.image import prepare_image
from napari_defocus.psf import Disc
from napari_defocus.settings import MapSettings

PILLOW_FORMATS = ("PNG", "JPEG", "WEBP", "BMP")
"""What Pillow may decode; some of its other formats start programs (EPS) or have no pixels."""

TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
PNG_START = b"\x89PNG\r\n\x1a\n"
PNG_BIT_DEPTH_AT = 24

COLOR_MAP = "viridis"
NOT_TRUSTED_COLOR = (0.35, 0.35, 0.35)
SHOWN_SIDE = (480, 1600)
"""Shortest and longest length, in px, of the longer side of a map that is drawn."""

DIMMED = 0.35
OUTLINE_COLOR = (1.0, 0.85, 0.0)


class UnreadablePicture(ValueError):
    """No picture could be read; the message is one line with the path and the reason."""


class UnwritableResult(OSError):
    """A result cannot be written; the message is one line with the path and the reason."""


def read_picture(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Read one picture, at its full depth and upright.

    The content decides how it is read, not the name. Palettes and CMYK become RGB, grey with
    opacity becomes RGBA, and the orientation that a camera noted (EXIF) is applied.

    Parameters
    ----------
    path : path-like
        A PNG, JPEG, TIFF, WebP or BMP file.

    Returns
    -------
    (H, W) or (H, W, 3) or (H, W, 4) ndarray
        bool for 1 bit a pixel, uint8, uint16, or the dtype of the TIFF.

    Raises
    ------
    UnreadablePicture
        If there is no such file, it holds no picture, is cut off or damaged, holds more than
        one plane or picture, has an unknown colour model, or has more pixels than Pillow
        accepts (twice `PIL.Image.MAX_IMAGE_PIXELS`).

    Examples
    --------
    >>> import tempfile, pathlib, numpy as np, PIL.Image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "grey.png")
    ...     PIL.Image.fromarray(np.full((4, 5), 7, np.uint8)).save(file)
    ...     read_picture(file).shape
    (4, 5)
    """
    path = Path(path)
    try:
        picture, orientation = _decode(path)
        return np.ascontiguousarray(_upright(picture, orientation))
    # Decoders raise whatever the damaged bytes led them into: struct.error, SyntaxError, ...
    except Exception as error:
        raise UnreadablePicture(f"cannot read {path}: {_reading_failure(error)}") from error


def _decode(path: Path) -> tuple[NDArray[Any], int]:
    with path.open("rb") as file:
        start = file.read(PNG_BIT_DEPTH_AT + 1)
    if start.startswith(TIFF_STARTS):
        return _decode_tiff(path)
    with Image.open(path, formats=PILLOW_FORMATS) as image:
        orientation = int(image.getexif().get(ExifTags.Base.Orientation, 1))
        if getattr(image, "is_animated", False) and image.format != "MPO":
            raise ValueError("it is animated; single pictures are read")
        # Pillow cuts 16-bit colour down to 8 bits.
        if start.startswith(PNG_START) and start[PNG_BIT_DEPTH_AT] == 16:
            return _decode_deep_png(path), orientation
        return _pillow_pixels(image), orientation


def _decode_deep_png(path: Path) -> NDArray[Any]:
    import imagecodecs

    return _opacity_last(imagecodecs.png_decode(path.read_bytes()))


def _pillow_pixels(image: Image.Image) -> NDArray[Any]:
    if image.has_transparency_data:
        image = image.convert("RGBA")
    elif image.mode not in ("1", "L", "RGB"):
        image = image.convert("RGB")
    return np.asarray(image)


def _decode_tiff(path: Path) -> tuple[NDArray[Any], int]:
    import tifffile

    with tifffile.TiffFile(path) as tiff:
        series = _only_series(tiff)
        page = series.keyframe
        _refuse_cut_off(page, tiff.filehandle.size)
        pixels = series.asarray()
        if series.axes.startswith("S"):
            pixels = np.moveaxis(pixels, 0, -1)
        orientation = page.tags.valueof("Orientation", default=1)
        return _tiff_colors(pixels, page), int(orientation)


def _only_series(tiff: Any) -> Any:
    if len(tiff.series) != 1:
        raise ValueError(f"it holds {len(tiff.series)} pictures; a single one is read")
    series = tiff.series[0]
    if series.axes not in ("YX", "YXS", "SYX"):
        shape = " x ".join(map(str, series.shape))
        raise ValueError(
            f"it is a stack of shape {shape} (axes {series.axes}); "
            "stacks are not read yet, save one plane"
        )
    _refuse_bomb(series.keyframe.imagelength * series.keyframe.imagewidth)
    return series


def _refuse_bomb(pixels: int) -> None:
    limit = Image.MAX_IMAGE_PIXELS
    if limit is not None and pixels > 2 * limit:
        raise ValueError(f"it has {pixels} pixels; up to {2 * limit} are read")


def _refuse_cut_off(page: Any, size: int) -> None:
    ends = (at + length for at, length in zip(page.dataoffsets, page.databytecounts, strict=True))
    # Found here because a JPEG-compressed strip that is cut off decodes without an error.
    if max(ends) > size:
        raise ValueError("the file is cut off")


def _tiff_colors(pixels: NDArray[Any], page: Any) -> NDArray[Any]:
    model = page.photometric.name
    # tifffile decodes YCbCr only where JPEG does it along the way.
    if model in ("MINISBLACK", "RGB") or (model == "YCBCR" and "JPEG" in page.compression.name):
        return _opacity_last(pixels)
    if model == "MINISWHITE":
        return np.invert(pixels) if pixels.dtype.kind == "u" else pixels
    if model == "PALETTE":
        return np.moveaxis(page.colormap[:, pixels], 0, -1)
    if model == "SEPARATED" and pixels.shape[2:] == (4,):
        return _rgb_from_cmyk(pixels)
    raise ValueError(f"its colour model {model} is not read")


def _rgb_from_cmyk(inks: NDArray[Any]) -> NDArray[Any]:
    full = np.iinfo(inks.dtype).max
    light = 1.0 - inks / full
    return np.rint(light[..., :3] * light[..., 3:] * full).astype(inks.dtype)


def _opacity_last(pixels: NDArray[Any]) -> NDArray[Any]:
    """Turn grey with opacity into RGBA; refuse what is neither grey nor colour."""
    channels = pixels[0, 0].size
    if channels == 1:
        return pixels.reshape(pixels.shape[:2])
    if channels == 2:
        return pixels[..., [0, 0, 0, 1]]
    if channels not in (3, 4):
        raise ValueError(f"it has {channels} channels; 1 to 4 are read")
    return pixels


def _upright(pixels: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Undo the camera's orientation: EXIF and TIFF tag 274, values 1 to 8."""
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


def _reading_failure(error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    if isinstance(error, IsADirectoryError):
        return "it is a folder"
    if isinstance(error, UnidentifiedImageError):
        return "it is no picture (PNG, JPEG, TIFF, WebP or BMP)"
    return _in_one_line(error)


def _in_one_line(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(text.split())


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


def check_results(
    paths: Iterable[Path], *, force: bool = False, source: Path | None = None
) -> None:
    """Make sure, before any long work, that results can be written.

    Parameters
    ----------
    paths : iterable of Path
        The files to come.
    force : bool
        Whether a file that exists may be overwritten.
    source : Path, optional
        The picture that is read; it is never overwritten.

    Raises
    ------
    UnwritableResult
        If the folder of a result is missing or takes no new file, a result exists and `force`
        is not set, it is a folder, a device or `source`, or two results are one file.
    """
    seen: set[Path] = set()
    for path in paths:
        target = path.resolve()
        refusal = "it is given twice" if target in seen else _refusal(target, force, source)
        if refusal:
            raise UnwritableResult(f"cannot write {path}: {refusal}")
        seen.add(target)


def _refusal(target: Path, force: bool, source: Path | None) -> str | None:
    if not target.parent.is_dir():
        return f"there is no folder {target.parent}"
    if target.is_dir():
        return "it is a folder"
    if target.exists():
        if not target.is_file():
            return "it is no regular file"
        if source is not None and source.exists() and target.samefile(source):
            return "it is the picture that is read"
        if not force:
            return "it exists already (force overwrites it)"
    return _creation_failure(target.parent)


def _creation_failure(folder: Path) -> str | None:
    probe = _unused_name(folder)
    try:
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        return _in_one_line(error)
    return None


def _unused_name(folder: Path) -> Path:
    return folder / f".napari-defocus-{secrets.token_hex(8)}.part"


def write_results(contents: Mapping[Path, bytes], *, force: bool = False) -> None:
    """Write files that belong together: all of them whole, or none.

    Every file is written and synchronised under a temporary name in its own folder first;
    then all get their names.

    Parameters
    ----------
    contents : mapping of Path to bytes
        What goes into which file.
    force : bool
        Whether files that exist are overwritten.

    Raises
    ------
    UnwritableResult
        For the reasons of `check_results`, or if writing fails, for instance because the disk
        is full. No temporary file stays behind, and files that existed are as they were.
    """
    check_results(contents, force=force)
    parts = {path: _unused_name(path.resolve().parent) for path in contents}
    try:
        for path, part in parts.items():
            _write_through(part, contents[path])
        for path, part in parts.items():
            part.replace(path.resolve())
    except OSError as error:
        raise UnwritableResult(f"cannot write {path}: {_in_one_line(error)}") from error
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)


def _write_through(path: Path, content: bytes) -> None:
    with path.open("xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
