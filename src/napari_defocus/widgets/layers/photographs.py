"""Photographs that napari itself does not open: HEIC, as phones take them. No Qt here."""

from collections.abc import Callable, Sequence
from pathlib import Path

from napari.types import LayerDataTuple

from napari_defocus.io.pictures import read_picture

Reader = Callable[[str | Sequence[str]], list[LayerDataTuple]]


def heic_reader(path: str | Sequence[str]) -> Reader:
    """Return what opens HEIC photographs; the manifest says which files these are."""
    return open_photographs


def open_photographs(path: str | Sequence[str]) -> list[LayerDataTuple]:
    """Return a layer for each photograph, upright, with its own name.

    Raises
    ------
    UnreadablePicture
        If one is damaged, or the extra that reads it is missing: it says what to install.
    """
    paths = [path] if isinstance(path, str) else path
    return [(read_picture(each), {"name": Path(each).stem}, "image") for each in paths]
