"""Results that are kept on the disk, saved somewhere else: their stores are copied.

No Qt here, as in `layers`.
"""

import secrets
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from napari_defocus.core.writing import UnwritableResult
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY, STORE

ENDING = ".ome.zarr"


class NotAMapError(ValueError):
    """What is to be saved, or a file, is no blur map or confidence; the message says so."""


def is_zarr_name(path: str | Path) -> bool:
    """Return whether a path is named as a Zarr store is."""
    return Path(path).suffix.lower() == ".zarr"


def is_stored(layer: tuple[Any, dict[str, Any], str]) -> bool:
    """Return whether a layer, given as a tuple, is a result of ours that is kept on the disk."""
    made = layer[1].get("metadata", {}).get(METADATA_KEY)
    return isinstance(made, dict) and STORE in made


def copy_store(layer: tuple[Any, dict[str, Any], str], path: Path, *, force: bool = False) -> Path:
    """Copy the store of a result that is kept on the disk, and return the copy, whole or not there.

    A name without .zarr gets the ending .ome.zarr.

    Raises
    ------
    NotAMapError
        If the name is that of another file type, such as .tif.
    OSError
        If it cannot be written, or exists and `force` is not set; if the store is gone.
    """
    name = layer[1].get("name")
    target = path if path.suffix else path.with_name(path.name + ENDING)
    if not is_zarr_name(target):
        raise NotAMapError(
            f"“{name}” is too large for {path.suffix}: it is kept on the disk as OME-Zarr. "
            f"Save it as {path.stem}{ENDING}."
        )
    source = Path(layer[1]["metadata"][METADATA_KEY][STORE]["path"])
    if not source.is_dir():
        raise FileNotFoundError(f"the results of “{name}” are not in {source} any more")
    if target.exists() and not force:
        raise UnwritableResult(f"cannot write {target}: it exists already")
    part = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    try:
        shutil.copytree(source, part)
        if target.exists():
            shutil.rmtree(target)
        part.rename(target)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return target


def write_store(path: str, layers: Sequence[tuple[Any, dict[str, Any], str]]) -> list[str]:
    """Save one large result as `copy_store`, for the manifest, and return its path.

    Raises
    ------
    NotAMapError, OSError
        As `copy_store`, and if the layer is not kept on the disk, or not the only one.
    """
    if len(layers) != 1:
        raise NotAMapError("A large result is saved on its own. Choose its layer only.")
    [layer] = layers
    if not is_stored(layer):
        raise NotAMapError(
            f"“{layer[1].get('name')}” is no large result of this plugin. Save it as another "
            "file type, such as .tif."
        )
    return [str(copy_store(layer, Path(path)))]
