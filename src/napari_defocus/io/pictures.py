"""One picture out of a file, decoded by its content."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from struct import unpack
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, UnidentifiedImageError

from napari_defocus.core.writing import in_one_line
from napari_defocus.io.camera_files import decode_heic, decode_raw
from napari_defocus.io.file_kinds import is_heic, is_raw, kind_of, microscope_format
from napari_defocus.io.microscope_files import open_microscope_file
from napari_defocus.io.slides import is_for_openslide, open_slide, told_choice_of_slide
from napari_defocus.io.tiff_series import picture_number, told_choice

PILLOW_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "GIF")
"""What Pillow may decode. Some of its other formats start programs (EPS) or have no pixels."""

TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
PNG_START = b"\x89PNG\r\n\x1a\n"
PNG_BIT_DEPTH_AT = 24

_FOR_STACKS = (
    "napari-defocus batch reads stacks, plane by plane, and sharpest makes one sharp picture of "
    "planes through focus"
)

_OF_PROGRAMS = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError)
"""Errors that decoders raise by accident on damaged files. Their text tells a user little."""


class UnreadablePicture(ValueError):
    """No picture could be read; the message is one line with the path and the reason.

    Examples
    --------
    >>> try:
    ...     read_picture("nowhere.png")
    ... except UnreadablePicture as error:
    ...     print(error)
    cannot read nowhere.png: there is no such file
    """


@contextmanager
def reading(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn whatever damaged bytes lead decoders into to an UnreadablePicture that says why."""
    try:
        yield
    except UnreadablePicture:
        raise
    except Exception as error:
        raise UnreadablePicture(f"cannot read {path}: {reading_failure(error, path)}") from error


def read_picture(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Read one picture, at its full depth and upright.

    The content decides how it is read, not the name. Palettes and CMYK become RGB, grey with
    opacity becomes RGBA, and the orientation that a camera noted (EXIF) is applied. Of a slide,
    the largest level is read, see `told_choice_in`.

    Parameters
    ----------
    path : path-like
        A PNG, JPEG, TIFF, WebP, BMP or GIF file; slides of many makers are TIFF. HEIC pictures
        of phones are read with the extra "heic", raw files of cameras with the extra "raw": these
        are developed into linear light, as RGB of 16 bits. CZI, ND2 and LIF files of one plane are
        read with the extra "microscopes", slides such as MIRAX with the extra "slides".

    Returns
    -------
    (H, W) or (H, W, 3) or (H, W, 4) ndarray
        bool for 1 bit a pixel, uint8, uint16, or the dtype of the TIFF.

    Raises
    ------
    UnreadablePicture
        If there is no such file, it holds no picture, is cut off or damaged, is a stack or an
        animation, holds several pictures of similar size, has an unknown colour model, or has
        more pixels than Pillow accepts (twice `PIL.Image.MAX_IMAGE_PIXELS`).

    Examples
    --------
    >>> import tempfile, pathlib, numpy as np, PIL.Image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "grey.png")
    ...     PIL.Image.fromarray(np.full((4, 5), 7, np.uint8)).save(file)
    ...     read_picture(file).shape
    (4, 5)
    """
    with reading(path):
        picture, orientation = _decode(Path(path))
        return np.ascontiguousarray(upright(picture, orientation))


def told_choice_in(path: str | os.PathLike[str]) -> str:
    """Return in words what `read_picture` takes of a file that holds more; else "".

    That is of slides, such as "the largest of 4 levels; left out: label of 600 x 400 px".
    """
    import tifffile

    # What is wrong with a file is told when it is read.
    with suppress(Exception):
        if is_for_openslide(Path(path)):
            return told_choice_of_slide(Path(path))
        if is_tiff(Path(path)):
            with tifffile.TiffFile(path) as tiff:
                return told_choice(tiff)
    return ""


class PictureForm(NamedTuple):
    """The frames of an animation, 1 of a single picture, and the shape and dtype of each."""

    frames: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]


def picture_form(path: Path) -> PictureForm:
    """Return what `read_picture` or `read_frame` give, but of no TIFF.

    Pixels are decoded only where that is the way to know: PNG with 16 bits, HEIC and raw files.
    Elsewhere damage may be found only when they are read.
    """
    with reading(path):
        if _is_deep_png(path) or is_heic(path) or is_raw(path):
            picture = read_picture(path)
            return PictureForm(1, picture.shape, picture.dtype)
        with _opened(path) as (image, orientation):
            width, height = image.size[::-1] if orientation in (5, 6, 7, 8) else image.size
            mode = _mode(image)
            channels = {"1": (), "L": (), "RGB": (3,), "RGBA": (4,)}[mode]
            dtype = np.dtype(bool if mode == "1" else np.uint8)
            return PictureForm(_frames(image), (height, width, *channels), dtype)


def read_frame(path: Path, number: int) -> NDArray[Any]:
    """Return a frame of an animation, as a viewer shows it: what changes is drawn on the rest."""
    with reading(path), _opened(path) as (image, orientation):
        mode = _mode(image)
        image.seek(number)
        return np.ascontiguousarray(upright(np.asarray(image.convert(mode)), orientation))


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Image.Image, int]]:
    """Lend a picture of which no pixels are decoded yet, and its orientation."""
    with Image.open(path, formats=PILLOW_FORMATS) as image:
        yield image, int(image.getexif().get(ExifTags.Base.Orientation, 1))


def _frames(image: Image.Image) -> int:
    """Return how many frames an animation has; a JPEG with previews beside it (MPO) is none."""
    return 1 if image.format == "MPO" else int(getattr(image, "n_frames", 1))


def _mode(image: Image.Image) -> str:
    """Return in which of Pillow's modes a picture is read, and all frames of an animation."""
    if image.has_transparency_data:
        return "RGBA"
    if _frames(image) > 1:
        return "RGB"
    return image.mode if image.mode in ("1", "L") else "RGB"


def is_tiff(path: Path) -> bool:
    """Return whether a file begins as a TIFF does."""
    with path.open("rb") as file:
        return file.read(4).startswith(TIFF_STARTS)


def _is_deep_png(path: Path) -> bool:
    with path.open("rb") as file:
        start = file.read(PNG_BIT_DEPTH_AT + 1)
    return start.startswith(PNG_START) and start[PNG_BIT_DEPTH_AT] == 16


def _decode(path: Path) -> tuple[NDArray[Any], int]:
    if is_raw(path):
        return decode_raw(path), 1
    if microscope_format(path):
        return _decode_microscope_file(path), 1
    if is_for_openslide(path):
        return _at_once(open_slide(path)[0]), 1
    if is_tiff(path):
        return _decode_tiff(path)
    if is_heic(path):
        return _opacity_last(decode_heic(path)), 1
    with _opened(path) as (image, orientation):
        if (frames := _frames(image)) > 1:
            raise ValueError(
                f"it is an animation of {frames} frames; napari-defocus batch measures each frame"
            )
        # Pillow cuts 16-bit colour down to 8 bits.
        if _is_deep_png(path):
            import imagecodecs

            return _opacity_last(imagecodecs.png_decode(path.read_bytes())), orientation
        mode = _mode(image)
        return np.asarray(image if image.mode == mode else image.convert(mode)), orientation


def _decode_microscope_file(path: Path) -> NDArray[Any]:
    found = open_microscope_file(path)
    if found.axes not in ("yx", "yxs"):
        raise ValueError(f"it is {_told_stack(found.data.shape, found.axes.upper())}")
    return _at_once(found.data)


def _at_once(data: Any) -> NDArray[Any]:
    """Return the pixels of a dask array, (H, W[, colours]), if they are not too many."""
    _refuse_bomb(data.shape[0] * data.shape[1])
    return np.asarray(data.compute(scheduler="synchronous"))


def _decode_tiff(path: Path) -> tuple[NDArray[Any], int]:
    import tifffile

    with tifffile.TiffFile(path) as tiff:
        series = _single_plane(tiff)
        page = series.keyframe
        if planes_are_missing(tiff, series) or cut_off(page, tiff.filehandle.size):
            raise ValueError("the file is cut off")
        pixels = series.asarray()
        if series.axes.startswith("S"):
            pixels = np.moveaxis(pixels, 0, -1)
        orientation = page.tags.valueof("Orientation", default=1)
        return tiff_colors(pixels, page), int(orientation)


def _single_plane(tiff: Any) -> Any:
    series = tiff.series[picture_number(tiff)]
    if series.axes not in ("YX", "YXS", "SYX"):
        raise ValueError(f"it is {_told_stack(series.shape, series.axes)}")
    _refuse_bomb(series.keyframe.imagelength * series.keyframe.imagewidth)
    return series


def _told_stack(shape: tuple[int, ...], axes: str) -> str:
    if not shape:
        return "a TIFF without a picture"
    planes = {axis for axis, length in zip(axes, shape, strict=True) if length > 1} - {*"YXS"}
    if planes == {"C"}:
        count = shape[axes.index("C")]
        return f"a picture of {count} channels; napari-defocus batch measures each of them"
    return f"a stack of {' x '.join(map(str, shape))} (axes {axes}); {_FOR_STACKS}"


def _refuse_bomb(pixels: int) -> None:
    limit = Image.MAX_IMAGE_PIXELS
    if limit is not None and pixels > 2 * limit:
        raise ValueError(
            f"it has {pixels} pixels; up to {2 * limit} are read at once "
            "(napari-defocus batch measures larger ones part by part)"
        )


def cut_off(page: Any, size: int) -> bool:
    """Return whether strips or tiles of a page of a TIFF lie beyond the end of its file.

    One that is cut off, and compressed as JPEG, decodes without an error.
    """
    ends = (at + length for at, length in zip(page.dataoffsets, page.databytecounts, strict=True))
    return max(ends, default=0) > size


def planes_are_missing(tiff: Any, series: Any) -> bool:
    """Return whether a file says of more pages than tifffile found; it only logs that."""
    if tiff.is_imagej and series.kind != "imagej":
        return int(tiff.imagej_metadata.get("images", 1)) > len(tiff.pages)
    if series.kind not in ("generic", "uniform"):
        return False
    layout, file, last = tiff.tiff, tiff.filehandle, tiff.pages[-1].offset
    file.seek(last)
    (tags,) = unpack(layout.tagnoformat, file.read(layout.tagnosize))
    file.seek(last + layout.tagnosize + tags * layout.tagsize)
    (following,) = unpack(layout.offsetformat, file.read(layout.offsetsize))
    return following != 0


def color_model(page: Any) -> str:
    """Return how a page of a TIFF says colours, or the number of none that is known."""
    return getattr(page.photometric, "name", str(page.photometric))


def tiff_colors(pixels: NDArray[Any], page: Any) -> NDArray[Any]:
    """Turn pixels of a page of a TIFF, (H, W[, samples]), into grey, RGB or RGBA."""
    model = color_model(page)
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


def upright(pixels: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Undo the camera's orientation: EXIF and TIFF tag 274, values 1 to 8."""
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, 0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


def reading_failure(error: Exception, path: str | os.PathLike[str]) -> str:
    """Return, in one line, why a file could not be read."""
    if isinstance(error, FileNotFoundError):
        return "there is no such file"
    if isinstance(error, IsADirectoryError):
        return "it is a folder; napari-defocus batch measures all pictures in it"
    if isinstance(error, UnidentifiedImageError):
        return kind_of(Path(path))
    if isinstance(error, OSError) and "truncated" in str(error):
        return "the file is cut off"
    if isinstance(error, MemoryError):
        return "there is not enough memory for it"
    if isinstance(error, _OF_PROGRAMS):
        return f"it is damaged ({type(error).__name__}: {in_one_line(error)})"
    return in_one_line(error)
