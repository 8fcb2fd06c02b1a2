"""What a file is, by its first bytes, where it is none of the pictures that Pillow may decode."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

READ_FORMATS = "PNG, JPEG, TIFF, WebP, BMP and GIF"
"""The formats that are read without an extra."""


class MicroscopeFormat(NamedTuple):
    """A format of a maker of microscopes: in words, and the package whose reader reads it."""

    told: str
    package: str


_ND2 = MicroscopeFormat("an ND2 file of Nikon", "bioio_nd2")
_MICROSCOPES = {
    b"ZISRAWFILE": MicroscopeFormat("a CZI file of ZEISS", "bioio_czi"),
    b"\xda\xce\xbe\x0a": _ND2,
    b"\x70\0\0\0": MicroscopeFormat("a LIF file of Leica", "bioio_lif"),
}
"""By the first bytes."""

_OLD_ND2_START = b"\0\0\0\x0cjP  "
"""Files of Nikon before 2010 are JPEG 2000 files; only their name tells them from others."""


class SlideFormat(NamedTuple):
    """A format of a maker of slide scanners, in words, and the name that OpenSlide has for it."""

    told: str
    vendor: str


_HAMAMATSU = SlideFormat("a slide of Hamamatsu", "hamamatsu")
_MIRAX = SlideFormat("a slide of 3DHISTECH", "mirax")
_SAKURA = SlideFormat("a slide of Sakura", "sakura")
_VENTANA = SlideFormat("a slide of Ventana", "ventana")

_SLIDE_STARTS = (
    (b"[Virtual Microscope Specimen]", _HAMAMATSU),
    (b"[Uncompressed Virtual Microscope Specimen]", _HAMAMATSU),
)
_TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_SQLITE_START = b"SQLite format 3"

_START = 1024
"""How many bytes are looked at."""

_HEIC_BRANDS = frozenset({b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"heif"})
_AVIF_BRANDS = frozenset({b"avif", b"avis"})
_RAW_BRAND = b"crx "

_RAW_STARTS = (b"FUJIFILMCCD-RAW", b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"FOVb")
"""Fujifilm, Olympus (three), Panasonic, Sigma. Raw files of other cameras begin as a TIFF does."""

_RAW_PHOTOMETRIC = frozenset({32803, 34892})
"""A mosaic of colours, and a demosaicked one (DNG)."""

_DNG_VERSION = 50706
_CANON_RAW = slice(8, 10), b"CR"

_READ_STARTS = (b"\x89PNG", b"\xff\xd8", b"GIF8", b"II*\0", b"MM\0*")
"""The first bytes of files that are read if they are whole."""

_EXPORT = "save it as PNG or TIFF first"
EXPORT_STACK = "save it as OME-TIFF or OME-Zarr with Fiji or bioformats2raw"
"""What can be done with a microscope's file; "first" follows."""

_EXPORT_FRAMES = "save its frames as pictures first"

_KINDS: tuple[tuple[int, bytes, str, str], ...] = (
    (0, b"%PDF", "a PDF document", _EXPORT),
    (0, b"%!PS", "a PostScript document", _EXPORT),
    (0, b"8BPS", "a Photoshop document", _EXPORT),
    (0, b"gimp xcf", "a picture of GIMP", _EXPORT),
    (0, b"\0\0\0\x0cjP  ", "a JPEG 2000 picture", _EXPORT),
    (0, b"\xff\x4f\xff\x51", "a JPEG 2000 picture", _EXPORT),
    (0, b"\0\0\0\x0cJXL ", "a JPEG XL picture", _EXPORT),
    (0, b"\xff\x0a", "a JPEG XL picture", _EXPORT),
    (0, b"v/1\x01", "an OpenEXR picture", "save it as a float TIFF first"),
    (0, b"#?RADIANCE", "a Radiance picture", "save it as a float TIFF first"),
    (0, b"SIMPLE  =", "a FITS file", "save its picture as a float TIFF first"),
    (128, b"DICM", "a DICOM file", "save its picture as TIFF first"),
    (0, b"\x89HDF", "an HDF5 file", f"{EXPORT_STACK} first"),
    (0, b"\x93NUMPY", "an array of NumPy", "load it in Python and give the functions the array"),
    (0, b"\x1a\x45\xdf\xa3", "a video", _EXPORT_FRAMES),
    (0, b"PK\x03\x04", "a ZIP archive", "unpack it first"),
)
"""Where to look, the bytes there, what the file is then, and what to do with it."""


def is_heic(path: Path) -> bool:
    """Return whether a file is a HEIC or HEIF picture, as phones take them."""
    brands = _brands(_start_of(path))
    return bool(brands & _HEIC_BRANDS) and not brands & _AVIF_BRANDS


def is_raw(path: Path) -> bool:
    """Return whether a file has the raw values of a camera's sensor; TIFFs are looked into."""
    start = _start_of(path)
    if start.startswith(_RAW_STARTS) or _RAW_BRAND in _brands(start):
        return True
    place, maker = _CANON_RAW
    if not start.startswith((b"II*\0", b"MM\0*")):
        return False
    return start[place] == maker or _holds_a_mosaic(path)


def _holds_a_mosaic(path: Path) -> bool:
    import tifffile

    try:
        with tifffile.TiffFile(path) as tiff:
            first = tiff.pages.first
            pages = [first, *(first.pages or ())]
            return _DNG_VERSION in first.tags or any(
                page.tags.valueof("PhotometricInterpretation") in _RAW_PHOTOMETRIC for page in pages
            )
    except Exception:  # it is damaged, which is told when it is read
        return False


def microscope_format(path: Path) -> MicroscopeFormat | None:
    """Return the format of a microscope's file (CZI, ND2, LIF); None for all others."""
    start = _start_of(path)
    if path.suffix.lower() == ".nd2" and start.startswith(_OLD_ND2_START):
        return _ND2
    return next((known for mark, known in _MICROSCOPES.items() if start.startswith(mark)), None)


def slide_format(path: Path) -> SlideFormat | None:
    """Return the format of a slide that OpenSlide reads; None for all other files.

    Those are slides of several files, such as MIRAX, and slides whose tiles overlap, such as BIF.
    Slides that are plain TIFF files (.svs, .ndpi, .scn, .qptiff) are none of these.
    """
    start, ending = _start_of(path), path.suffix.lower()
    if ending == ".mrxs" and (path.with_suffix("") / "Slidedat.ini").is_file():
        return _MIRAX
    if ending == ".svslide" and start.startswith(_SQLITE_START):
        return _SAKURA
    if ending == ".bif" and start.startswith(_TIFF_STARTS):
        return _VENTANA
    return next((known for mark, known in _SLIDE_STARTS if start.startswith(mark)), None)


def kind_of(path: Path) -> str:
    """Return what a file is that cannot be read, and what can be done, as the end of a sentence."""
    start = _start_of(path)
    if not start:
        return "it is empty"
    if start.startswith(_READ_STARTS):
        return "it is cut off or damaged"
    brands = _brands(start)
    if brands & _AVIF_BRANDS:
        return _told("an AVIF picture", _EXPORT)
    if brands:
        return _told("a video", _EXPORT_FRAMES)
    if start.startswith(b"RIFF") and start[8:12] == b"AVI ":
        return _told("a video", _EXPORT_FRAMES)
    for at, mark, kind, advice in _KINDS:
        if start[at:].startswith(mark):
            return _told(kind, advice)
    if start.lstrip().startswith((b"<?xml", b"<svg")):
        return _told("an XML or SVG file", _EXPORT)
    if _is_text(start):
        return f"it is a text file; {READ_FORMATS} pictures are read"
    return f"its format is not known; {READ_FORMATS} pictures are read"


def _told(kind: str, advice: str) -> str:
    return f"it is {kind}, which is not read; {advice}"


def _start_of(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_START)


def _brands(start: bytes) -> set[bytes]:
    """Return the brands of an ISO media file, such as HEIC, AVIF, MP4 or CR3; none of others."""
    if start[4:8] != b"ftyp":
        return set()
    box = start[8 : int.from_bytes(start[:4], "big")]
    names = [box[at : at + 4] for at in range(0, len(box) - 3, 4)]
    return {*names[:1], *names[2:]}


def _is_text(start: bytes) -> bool:
    try:
        text = start.decode("utf-8")
    except UnicodeDecodeError as error:
        # A character may be cut in two at the end of what is looked at.
        if error.start < len(start) - 3:
            return False
        text = start[: error.start].decode("utf-8")
    return all(letter.isprintable() or letter.isspace() for letter in text)
