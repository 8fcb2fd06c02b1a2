"""Results too large for memory: OME-Zarr stores, and what is read of them when it is shown.

No Qt here, as in `layers`.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

from napari.types import LayerDataTuple

from napari_defocus import __version__
from napari_defocus.core.extras import need_large_extra
from napari_defocus.io.lazy_arrays import lazy_array
from napari_defocus.io.ome_zarr import StoredArray
from napari_defocus.io.ome_zarr_writer import OmeZarrWriter, new_ome_zarr
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, Plane
from napari_defocus.widgets.layers.result_layers import in_levels
from napari_defocus.widgets.layers.result_metadata import BLUR_MAP, IN_FOCUS, METADATA_KEY, STORE

_PLANE_LETTERS = "tcz"
_ENDING = ".ome.zarr"
_ON_DISK = {BLUR_MAP: "blur (px)"}


@dataclass(frozen=True)
class Place:
    """Where the stores of a run are put.

    Attributes
    ----------
    folder : Path or None
        As the user says. None is a folder of this Python: a store there goes when nothing
        shows it any more, at the latest when Python ends.
    """

    folder: Path | None = None

    def new_store(
        self,
        result: str,
        plane: Plane,
        *,
        axes: dict[str, int],
        shape: tuple[int, ...],
        dtype: Any,
        estimation: MapSettings,
        mask: MaskSettings | None,
    ) -> OmeZarrWriter:
        """Begin a store for a result, under a name that is free: nothing is replaced.

        `axes` says by a letter each axis of the store which axis of the plane's layer it is.

        Raises
        ------
        NotAnalysableError
            If the folder is missing, or packages are.
        """
        placed = plane.placement
        shaping = asdict(mask) if mask is not None and result == IN_FOCUS else {}
        units = {letter: str(placed["units"][axis]) for letter, axis in axes.items()}
        with disk_errors_refused():
            need_large_extra()
            return new_ome_zarr(
                _free(self.path, f"{plane.name} {_ON_DISK.get(result, result)}"),
                shape=shape,
                dtype=dtype,
                axes="".join(axes),
                pixel_size={a: abs(float(placed["scale"][axis])) for a, axis in axes.items()},
                units={a: unit for a, unit in units.items() if unit != "pixel"},
                attributes={
                    "version": __version__,
                    "quantity": result,
                    "unit": "px" if result == BLUR_MAP else "",
                    "source": plane.name,
                    "settings": asdict(estimation) | shaping,
                },
                labels=result == IN_FOCUS,
            )

    @property
    def path(self) -> Path:
        """The folder."""
        return _own_folder() if self.folder is None else self.folder

    def check_room(self, size: int) -> None:
        """Refuse results that need more bytes than the disk has, before any work.

        Raises
        ------
        NotAnalysableError
            If there are fewer bytes, or no such folder.
        """
        if not self.path.is_dir():
            raise NotAnalysableError(f"there is no folder {self.path} to keep its results in.")
        free = shutil.disk_usage(self.path).free
        if size > free:
            raise NotAnalysableError(
                f"its results take up to {size / 1e9:.1f} GB, and {self.path} has "
                f"{free / 1e9:.1f} GB left. Choose another folder in “keep "
                "in”, or a smaller region."
            )

    def lifetime_text(self) -> str:
        """Return what to say about how long results are kept."""
        if self.folder is not None:
            return f"Kept in {self.folder}"
        return (
            "Read from the disk as you look at it; gone when napari is closed. Save it, or choose "
            "a folder in “keep in” before you measure."
        )

    def layer(
        self, layer: LayerDataTuple, store: Path, axes: str, plane: Plane | None = None
    ) -> LayerDataTuple:
        """Return a layer that reads a finished store, instead of its data.

        Parameters
        ----------
        axes : str
            The letters of the store's axes in the order of the layer's.
        plane : Plane, optional
            Which plane of a stack it lies on, if it has no axes of planes.
        """
        levels = self._levels(store, axes)
        if plane is not None:
            levels = [plane.expanded(level) for level in levels]
        _, keywords, kind = layer
        store_metadata = {"path": str(store), "temporary": self.folder is None}
        made = {**keywords["metadata"][METADATA_KEY], STORE: store_metadata}
        return in_levels(
            LayerDataTuple((None, keywords | {"metadata": {METADATA_KEY: made}}, kind)), levels
        )

    def _levels(self, path: Path, axes: str) -> list[Any]:
        """Return the pyramid of a store as dask arrays, whose axes are in the order of `axes`."""
        import zarr

        group = zarr.open_group(path, mode="r")
        owner = _Store(path)
        if self.folder is None:
            weakref.finalize(owner, shutil.rmtree, path, ignore_errors=True)
        names = list(group["0"].metadata.dimension_names)
        order = [names.index(letter) for letter in axes]
        numbers = sorted(int(name) for name in group.array_keys())
        levels = [StoredArray(group[str(n)], path, owner) for n in numbers]
        return [lazy_array(level, level.array.chunks).transpose(order) for level in levels]


UNTIL_CLOSED = Place()
"""Results are kept until nothing shows them any more."""


@dataclass(frozen=True, eq=False)
class _Store:
    """A store that somebody may still read: its file goes, if it is ours, when this does."""

    path: Path


@cache
def _own_folder() -> Path:
    folder = tempfile.TemporaryDirectory(prefix="napari-defocus-", ignore_cleanup_errors=True)
    _temporary_folders.append(folder)
    return Path(folder.name)


_temporary_folders: list[tempfile.TemporaryDirectory[str]] = []
"""Removed when Python ends."""


def _free(folder: Path, name: str) -> Path:
    """Return a path that nothing has, for a store of that name."""
    plain = re.sub(r'[\\/:*?"<>|\x00-\x1f]', "-", name).strip(" .") or "result"
    numbered = (f"{plain}{_ENDING}" if n == 1 else f"{plain} {n}{_ENDING}" for n in count(1))
    paths = (folder / each for each in numbered)
    return next(p for p in paths if not os.path.lexists(p) and not _part(p).exists())


def _part(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")


@contextmanager
def disk_errors_refused() -> Iterator[None]:
    """Let what the disk and missing packages say reach the user as a refusal."""
    try:
        yield
    except (OSError, ImportError) as error:
        raise NotAnalysableError(f"its results cannot be kept: {error}") from error


@contextmanager
def whole_or_gone(writers: Mapping[str, OmeZarrWriter]) -> Iterator[None]:
    """Leave nothing of stores whose work was ended by an error or by Cancel."""
    try:
        yield
    except BaseException:
        for writer in writers.values():
            for left in (writer.part, writer.path):
                shutil.rmtree(left, ignore_errors=True)
        raise


def letters_of(axis_labels: tuple[str, ...], planes: list[int], ndim: int) -> str:
    """Return a letter for each axis of a layer, as stores name them: t, c, z for planes, y, x.

    `planes` are those of its axes that are no rows and no columns. Their letters are taken from
    the labels where they fit.

    Raises
    ------
    NotAnalysableError
        If there are more of them than a store has.
    """
    if len(planes) > len(_PLANE_LETTERS):
        raise NotAnalysableError(
            f"it has {len(planes)} sliders; large results are kept for up to 3. Choose “the one "
            "shown”."
        )
    labels = [axis_labels[axis].lower()[:1] for axis in planes]
    usual = {0: "", 1: "z", 2: "tz", 3: "tcz"}[len(planes)]
    # Stores keep this order, whatever the letters are.
    fits = set(labels) <= {*_PLANE_LETTERS} and labels == sorted({*labels}, key="tcz".index)
    plane_letters = iter(labels if fits else usual)
    picture = iter("yx")
    return "".join(next(plane_letters if axis in planes else picture) for axis in range(ndim))
