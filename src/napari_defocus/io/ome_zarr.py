"""OME-Zarr in: axes, pixel size and units, and pixels that are read when they are computed."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.extras import need_large_extra
from napari_defocus.io.lazy_arrays import block_side, lazy_array
from napari_defocus.io.pictures import reading

if TYPE_CHECKING:
    import dask.array as da

OUR_KEY = "napari_defocus"
"""The key of a store's attributes that says what made it, beside the key "ome"."""

RGB_COLORS = ("FF0000", "00FF00", "0000FF")
"""Channels of these colours, in this order, are one picture in colour."""


@dataclass(frozen=True, eq=False)
class OmeZarrPicture:
    """What an OME-Zarr store holds: the levels of a pyramid, the largest first, not yet read.

    There is a letter an axis, y and x are the last two. Pixel size and units, such as 0.25 and
    "micrometer", are those of the largest level, where they are known. The attributes are what a
    store of `new_ome_zarr` says made it, the colours of channels such as "FF0000"; both are empty
    if a store does not say.
    """

    levels: tuple[da.Array, ...]
    axes: str
    pixel_size: dict[str, float]
    units: dict[str, str]
    attributes: dict[str, Any]
    channel_colors: tuple[str, ...]


def is_zarr(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a folder that is, or by its name should be, a Zarr store."""
    folder = Path(path)
    if not folder.is_dir():
        return False
    marks = ("zarr.json", ".zgroup", ".zattrs", ".zarray")
    return folder.suffix.lower() == ".zarr" or any((folder / mark).is_file() for mark in marks)


def read_ome_zarr(path: str | os.PathLike[str]) -> OmeZarrPicture:
    """Read an OME-Zarr store of version 0.4 or 0.5, lazily: its first multiscale picture.

    A store that bioformats2raw made of one picture is read as that picture. UnreadablePicture is
    raised if there is no such folder, or it is not an OME-Zarr store, holds a plate or several
    pictures (the message says which folder to give), has no real numbers, or no axes y and x.

    Examples
    --------
    >>> import pathlib, tempfile, numpy as np
    >>> from napari_defocus.io.ome_zarr_writer import new_ome_zarr
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     writer = new_ome_zarr(
    ...         pathlib.Path(folder, "map.ome.zarr"), shape=(4, 5), dtype="float32", axes="yx",
    ...         pixel_size={"y": 0.25, "x": 0.25}, units={"y": "micrometer", "x": "micrometer"},
    ...         attributes={"settings": {"window": 41}})
    ...     writer.write_region((slice(0, 4), slice(0, 5)), np.ones((4, 5)))
    ...     picture = read_ome_zarr(writer.finish())
    ...     picture.axes, picture.pixel_size["x"], picture.units["x"], picture.attributes
    ('yx', 0.25, 'micrometer', {'settings': {'window': 41}})
    """
    need_large_extra()
    with reading(path):
        return _picture(Path(path).absolute())


def _picture(path: Path) -> OmeZarrPicture:
    group = _opened(path)
    attributes = dict(group.attrs)
    about = attributes.get("ome", attributes)
    if "multiscales" not in about:
        return _picture(_only_picture_below(path, about, sorted(group.group_keys())))
    multiscale = about["multiscales"][0]
    if "axes" not in multiscale:
        raise ValueError("it has no axes; OME-Zarr 0.4 and 0.5 are read")
    declared = [axis if isinstance(axis, dict) else {"name": axis} for axis in multiscale["axes"]]
    letters = _letters(declared)
    arrays = [group[dataset["path"]] for dataset in multiscale["datasets"]]
    _check_arrays(arrays, letters)
    order = [i for i, letter in enumerate(letters) if letter not in "yx"]
    order += [letters.index("y"), letters.index("x")]
    pixel_size, units = _pixel_size_and_units(multiscale, declared, letters)
    channels = about.get("omero", attributes.get("omero", {})).get("channels", [])
    return OmeZarrPicture(
        levels=tuple(_lazy(array, letters, path).transpose(order) for array in arrays),
        axes="".join(letters[i] for i in order),
        pixel_size=pixel_size,
        units=units,
        attributes=dict(attributes.get(OUR_KEY, {})),
        channel_colors=tuple(str(channel.get("color", "")) for channel in channels),
    )


def _opened(path: Path) -> Any:
    import zarr

    if not path.exists():
        raise ValueError("there is no such folder")
    if not path.is_dir():
        raise ValueError("it is not a folder, as OME-Zarr stores are")
    if (path / ".zarray").is_file() or _is_array(path):
        raise ValueError("it is one level of a picture; give the folder that it is in")
    try:
        return zarr.open_group(path, mode="r")
    except FileNotFoundError as error:
        raise ValueError("it is not an OME-Zarr store: it has no zarr.json or .zgroup") from error


def _is_array(path: Path) -> bool:
    about = path / "zarr.json"
    return about.is_file() and json.loads(about.read_text("utf-8")).get("node_type") == "array"


def _only_picture_below(path: Path, about: Mapping[str, Any], groups: list[str]) -> Path:
    """Return the picture in a store of bioformats2raw; say what to give for other layouts."""
    if "plate" in about:
        wells = about["plate"].get("wells") or [{"path": "A/1"}]
        raise ValueError(f"it is a plate; give one field, such as {path / wells[0]['path'] / '0'}")
    if "well" in about:
        images = about["well"].get("images") or [{"path": "0"}]
        raise ValueError(f"it is a well; give one field, such as {path / images[0]['path']}")
    if "bioformats2raw.layout" in about:
        pictures = [name for name in groups if name.isdigit()]
        if len(pictures) == 1:
            return path / pictures[0]
        if pictures:
            first = path / min(pictures, key=int)
            raise ValueError(f"it holds {len(pictures)} pictures; give one, such as {first}")
    raise ValueError("it is not an OME-Zarr picture: it has no multiscales")


_LETTER_OF_TYPE = {"channel": "c", "time": "t"}
"""The letters of axes whose type a store declares, whatever their names are."""


def _letters(declared: list[dict[str, Any]]) -> str:
    """Return a letter an axis: that of its type, the first of its name, or one that is free."""
    letters, names = "", [str(axis["name"]) for axis in declared]
    for axis, name in zip(declared, names, strict=True):
        of_type = _LETTER_OF_TYPE.get(str(axis.get("type")), "")
        wished = [*of_type, *name.lower(), *"qpomnlkjihgfedbavwur"]
        letters += next(a for a in wished if a.isalpha() and a != "s" and a not in letters)
    if "y" not in letters or "x" not in letters:
        raise ValueError(f"its axes are {', '.join(names)}; y and x are needed")
    return letters


def _check_arrays(arrays: list[Any], letters: str) -> None:
    for array in arrays:
        if len(array.shape) != len(letters):
            raise ValueError(f"its data have {len(array.shape)} axes, and it names {len(letters)}")
        if array.dtype.kind not in "buif":
            raise ValueError(f"it holds {array.dtype}; real numbers are read")
        if 0 in array.shape:
            raise ValueError(f"it is empty: its shape is {array.shape}")


@dataclass(frozen=True, eq=False)
class StoredArray:
    """An array of Zarr whose damaged chunks are errors that name the store, at `path`.

    `owner` is kept while anything may be read from the array.
    """

    array: Any
    path: Path
    owner: Any = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the whole."""
        return tuple(self.array.shape)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of what is read."""
        return np.dtype(self.array.dtype)

    def __getitem__(self, region: tuple[slice, ...]) -> NDArray[Any]:
        """Read a region; UnreadablePicture if a chunk of it is damaged."""
        with reading(self.path):
            return np.asarray(self.array[region])


def _lazy(array: Any, letters: str, path: Path) -> da.Array:
    stored = array.shards or array.chunks
    blocks = tuple(
        block_side(chunk, size) if letter in "yx" else chunk
        for chunk, size, letter in zip(stored, array.shape, letters, strict=True)
    )
    data = lazy_array(StoredArray(array, path), blocks)
    return data.astype(data.dtype.newbyteorder("="))


def _pixel_size_and_units(
    multiscale: Mapping[str, Any], declared: list[dict[str, Any]], letters: str
) -> tuple[dict[str, float], dict[str, str]]:
    factors = np.ones(len(letters))
    level = multiscale["datasets"][0]
    for transforms in (level, multiscale):
        for transform in transforms.get("coordinateTransformations") or []:
            factors = factors * np.asarray(transform.get("scale", 1.0), float)
    units = {
        letter: str(axis["unit"])
        for letter, axis in zip(letters, declared, strict=True)
        if axis.get("unit")
    }
    # 1 without a unit is what stores say that do not know.
    pixel_size = {
        letter: float(factor)
        for letter, factor in zip(letters, factors, strict=True)
        if 0 < factor < np.inf and (letter in units or (factor != 1.0 and letter != "c"))
    }
    return pixel_size, units
