"""How files of this package are known: what they say of themselves, whatever they are called."""

from __future__ import annotations

import json
import os
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from PIL import Image

import napari_defocus
from napari_defocus.io.ome_zarr import OUR_KEY, is_zarr
from napari_defocus.io.pictures import PNG_START, TIFF_STARTS

SOFTWARE = "napari-defocus"

_JPEG_START = b"\xff\xd8\xff"

ALL_IN_FOCUS, REFOCUSED = "all-in-focus picture", "refocused picture"
SHARPEST_PIXELS = "picture of the sharpest pixels"

_PICTURES = (ALL_IN_FOCUS, REFOCUSED, SHARPEST_PIXELS, "all in focus", "refocused")
"""Quantities of results that can be measured like other pictures. The last two are napari's."""


def signature() -> dict[str, str]:
    """Return what every result says of what made it."""
    return {"software": SOFTWARE, "version": napari_defocus.__version__}


def mark_of(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what any file or folder says of itself if this package made it; else nothing.

    That is, among others, the `quantity` that it holds, such as "defocus blur radius". No pixels
    are read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "mask.png")
    ...     Image.new("L", (4, 5)).save(file)
    ...     _ = file.write_bytes(marked_png(file.read_bytes(), "in-focus mask"))
    ...     mark_of(file)["quantity"], mark_of(folder)
    ('in-focus mask', {})
    """
    place = Path(path)
    # Damaged files raise anything; reading them as pictures says what is wrong with them.
    with suppress(Exception):
        if place.is_dir():
            return _mark_in_store(place) if is_zarr(place) else {}
        with place.open("rb") as file:
            start = file.read(len(PNG_START))
        if start == PNG_START:
            with Image.open(place, formats=("PNG",)) as image:
                return said_by(image.info.get("Description", ""))
        if start.startswith(_JPEG_START):
            with Image.open(place, formats=("JPEG",)) as image:
                return said_by(image.info.get("comment", b"").decode())
        if start.startswith(TIFF_STARTS):
            return mark_in_tiff(place)
    return {}


def is_picture(mark: dict[str, Any]) -> bool:
    """Return whether a file with this mark shows a scene, as those without a mark do."""
    return not mark or mark.get("quantity") in _PICTURES


def mark_in_tiff(path: str | os.PathLike[str], *, ome: bool = True) -> dict[str, Any]:
    """Return what a TIFF of this package says of itself, if wanted in OME-XML too; else nothing."""
    import tifffile

    with suppress(Exception), tifffile.TiffFile(path) as tiff:
        said = said_by(tiff.pages.first.description)
        return said or _said_by_ome((ome and tiff.ome_metadata) or "")
    return {}


def plain_json(name: str, value: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is read again of a mapping that is written as JSON; TypeError if it cannot be."""
    try:
        plain: dict[str, Any] = json.loads(json.dumps(dict(value)))
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name} takes what JSON can hold: {error}") from error
    return plain


def said_by(text: str) -> dict[str, Any]:
    """Return what a text of JSON says if this package wrote it; else nothing."""
    with suppress(TypeError, ValueError):
        found = json.loads(text)
        if isinstance(found, dict) and found.get("software") == SOFTWARE:
            return found
    return {}


def _said_by_ome(text: str) -> dict[str, Any]:
    if SOFTWARE not in text:
        return {}
    elements = ElementTree.fromstring(text).iter()
    return next(
        (said_by(each.text or "") for each in elements if each.tag.endswith("}Description")), {}
    )


def _mark_in_store(folder: Path) -> dict[str, Any]:
    about = json.loads((folder / "zarr.json").read_text("utf-8"))
    return dict(about["attributes"][OUR_KEY])


def marked_png(content: bytes, quantity: str) -> bytes:
    """Return a PNG file that says what it holds, such as "in-focus mask", and what made it."""
    about = {"quantity": quantity, **signature()}
    texts = {"Software": " ".join(signature().values()), "Description": json.dumps(about)}
    after_header = len(PNG_START) + 25
    chunks = b"".join(
        _chunk(b"tEXt", f"{keyword}\0{text}".encode("latin-1")) for keyword, text in texts.items()
    )
    return content[:after_header] + chunks + content[after_header:]


def _chunk(kind: bytes, body: bytes) -> bytes:
    checked = kind + body
    return len(body).to_bytes(4, "big") + checked + zlib.crc32(checked).to_bytes(4, "big")
