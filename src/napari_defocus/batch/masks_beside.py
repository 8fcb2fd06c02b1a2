"""Masks of what counts in the pictures of a batch: found by their names, read plane by plane."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.io.ome_zarr import is_zarr
from napari_defocus.io.open import open_source
from napari_defocus.io.picture_files import PICTURE_SUFFIXES
from napari_defocus.io.pictures import UnreadablePicture

_ADDED = ("", "-mask", "_mask")
"""What the name of a mask may have beyond that of its picture."""


def masks_of(sources: Sequence[Path], within: str | os.PathLike[str]) -> dict[Path, Path]:
    """Return the mask of each source.

    Parameters
    ----------
    sources : sequence of Path
    within : path-like
        A mask for all of them, or a folder with a mask for each: NAME, NAME-mask or NAME_mask
        with any ending of a picture. Pictures of one name from several folders have their masks
        in folders of these names.

    Raises
    ------
    UnreadablePicture
        If a mask is missing, or is not the only one of its picture.
    """
    place = Path(within)
    if place.is_file() or is_zarr(place):
        return dict.fromkeys(sources, place)
    if not place.is_dir():
        raise UnreadablePicture(f"cannot read {place}: there is no such file or folder")
    held: dict[Path, dict[str, list[Path]]] = {}
    found = {source: _fitting(source, place, held) for source in sources}
    missing = [source.name for source, masks in found.items() if not masks]
    if missing:
        more = f" and {len(missing) - 1} others" if len(missing) > 1 else ""
        raise UnreadablePicture(
            f"cannot read {place}: it has no mask for {missing[0]}{more}; a mask has the name of "
            "its picture"
        )
    for source, masks in found.items():
        if len(masks) > 1:
            names = " and ".join(mask.name for mask in masks[:2])
            raise UnreadablePicture(f"cannot read {place}: {source.name} has {names}")
    chosen = {source: fitting[0] for source, fitting in found.items()}
    _check_distinct(chosen)
    return chosen


def _fitting(source: Path, place: Path, held: dict[Path, dict[str, list[Path]]]) -> list[Path]:
    """Return the masks of a source in the folder of its own folder's name, or else in `place`."""
    for folder in (place / source.absolute().parent.name, place):
        if folder not in held:
            held[folder] = _by_name(folder)
        if masks := [mask for end in _ADDED for mask in held[folder].get(_stem(source) + end, [])]:
            return masks
    return []


def _by_name(folder: Path) -> dict[str, list[Path]]:
    named: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if is_zarr(path) or (path.is_file() and path.suffix.lower() in PICTURE_SUFFIXES):
            named.setdefault(_stem(path), []).append(path)
    return named


def _stem(path: Path) -> str:
    return path.stem.removesuffix(".ome")


def _check_distinct(masks: dict[Path, Path]) -> None:
    """Refuse that two pictures of one name share a mask: it is that of one of them."""
    owner: dict[Path, Path] = {}
    for source, mask in masks.items():
        first = owner.setdefault(mask, source)
        if first != source:
            raise UnreadablePicture(
                f"cannot read {mask}: it is the mask of {first} and of {source}; put it into a "
                "folder with the name of the folder of its picture"
            )


@dataclass(frozen=True)
class MaskSource:
    """The mask of a source: a plane for each of its planes, or one for all of them.

    `plane_shape` says how many planes the source has along each axis.
    """

    path: Path
    plane_shape: tuple[int, ...]

    def lazy_plane(self, shape: Sequence[int], index: tuple[int, ...]) -> Any:
        """Return the mask of a plane of a shape, (H, W, ...), as a dask array.

        Raises
        ------
        ValueError
            If it has another height and width, other planes, or no integers.
        """
        mask = open_source(self.path)
        if mask.plane_shape not in ((), self.plane_shape):
            raise ValueError(
                f"the mask {self.path} has {mask.plane_shape} planes; it takes one, or as many as "
                f"its picture, {self.plane_shape}"
            )
        plane = mask.plane(index if mask.plane_shape else ())
        if plane.dtype.kind not in "bui":
            raise ValueError(f"the mask {self.path} has {plane.dtype}; it takes integers")
        if tuple(plane.shape) != tuple(shape[:2]):
            size = " x ".join(map(str, plane.shape[1::-1]))
            raise ValueError(
                f"the mask {self.path} has {size} px{' and colours' * (plane.ndim > 2)}; it takes "
                f"one number for each of the {shape[1]} x {shape[0]} px of its picture"
            )
        return plane

    def plane(self, shape: Sequence[int], index: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return where the mask of a plane is not 0: (H, W)."""
        lazy = self.lazy_plane(shape, index)
        return np.asarray(lazy.compute(scheduler="synchronous") != 0)

    def of_stack(self, path: Path) -> list[Any]:
        """Return the masks of all planes of a source as dask arrays."""
        source = open_source(path)
        return [self.lazy_plane(source.plane(at).shape, at) for at in source.planes()]
