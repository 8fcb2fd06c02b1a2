"""What is to be worked on: photographs, stacks and slides, opened without reading their pixels."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.extras import need_large_extra
from napari_defocus.io.file_kinds import is_raw, microscope_format
from napari_defocus.io.lazy_arrays import lazy_array
from napari_defocus.io.microscope_files import open_microscope_file
from napari_defocus.io.ome_zarr import RGB_COLORS, is_zarr, read_ome_zarr
from napari_defocus.io.picture_files import Inputs, as_paths, find_sources, in_stack_order
from napari_defocus.io.pictures import (
    UnreadablePicture,
    is_tiff,
    picture_form,
    read_frame,
    read_picture,
    reading,
)
from napari_defocus.io.provenance import SHARPEST_PIXELS, mark_of
from napari_defocus.io.slides import is_for_openslide, open_slide
from napari_defocus.io.source import Source
from napari_defocus.io.tiff_reader import open_tiff

if TYPE_CHECKING:
    import dask.array as da

__all__ = ["Source", "find_sources", "open_source", "open_stack"]


@dataclass(frozen=True, eq=False)
class _Photograph:
    """A photograph as a reader of regions: it is decoded whole."""

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def __getitem__(self, region: tuple[slice, ...]) -> NDArray[Any]:
        return read_picture(self.path)[region]


@dataclass(frozen=True, eq=False)
class _Animation:
    """An animation as a reader of regions: each frame is decoded whole."""

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def __getitem__(self, region: tuple[slice, ...]) -> NDArray[Any]:
        numbers = range(*region[0].indices(self.shape[0]))
        return np.stack([read_frame(self.path, number) for number in numbers])[:, *region[1:]]


def open_source(path: str | os.PathLike[str], scene: int | None = None) -> Source:
    """Open a photograph, a stack or a slide; no pixels are read.

    - PNG, JPEG, WebP, BMP, GIF, HEIC and raw files: what `read_picture` gives, as one block. Of
      an animation each frame is a plane along t, and a block.
    - TIFF of one page, or of many (ImageJ, OME-TIFF, LSM, STK, slides), tiled or not: the
      largest level of the picture, without labels and previews. Tiles, strips, or parts of an
      uncompressed page are read one by one. Values, colours and orientation are those of
      `read_picture`; pixel size and units those of `pixel_size_in_tiff`. An OME-TIFF may name
      planes that were not recorded, or whose file is missing: they are 0.
    - OME-Zarr 0.4 and 0.5, folders: the largest level of the first picture. Three channels become
      colours if the store says that they are pure red, green and blue. All other channels are
      planes, even three of uint8, because a store does not say that they belong together.
    - CZI, ND2 and LIF, with the extra "microscopes": planes are read one by one, tiles of a mosaic
      are put together. Scenes of one form are planes along p.
    - MIRAX, VMS, BIF and Sakura's slides, with the extra "slides": the largest level.

    Parameters
    ----------
    path : path-like
    scene : int, optional
        Which scene of a CZI, ND2 or LIF file to take, from 0. It is needed if they differ in shape.

    Returns
    -------
    Source

    Raises
    ------
    UnreadablePicture
        In one line: there is no such file, it is cut off or damaged, holds no picture or several,
        or no real numbers; there is no such scene, or the extra that reads it is not installed.
    ValueError
        If a scene is chosen of a file that has none.
    ImportError
        If the extra "large" is not installed.

    Examples
    --------
    >>> import pathlib, tempfile, tifffile, numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "stack.tif")
    ...     tifffile.imwrite(
    ...         file, np.zeros((3, 4, 5), np.uint8), imagej=True, resolution=(4, 4),
    ...         metadata={"axes": "ZYX", "unit": "um", "spacing": 1.5})
    ...     stack = open_source(file)
    ...     [stack.label_of(index) for index in stack.planes()], stack.plane((2,)).shape
    (['z=0', 'z=1', 'z=2'], (4, 5))
    >>> stack.pixel_size["z"], stack.pixel_size["x"], stack.units["x"]
    (1.5, 0.25, 'micrometer')
    """
    need_large_extra()
    path = Path(path)
    if scene is not None and (path.is_dir() or (path.is_file() and not microscope_format(path))):
        raise ValueError(f"scene is {scene}, but {path} has none; CZI, ND2 and LIF files have")
    if path.is_dir():
        if not is_zarr(path):
            raise UnreadablePicture(
                f"cannot read {path}: it is a folder, but not an OME-Zarr store"
            )
        return _zarr_source(path)
    with reading(path):
        if microscope_format(path):
            return _microscope_source(path, scene)
        if is_for_openslide(path):
            data, pixel_size = open_slide(path)
            return Source(path, data, "yxs", pixel_size, dict.fromkeys(pixel_size, "micrometer"))
        if is_tiff(path) and not is_raw(path):
            data, axes, (pixel_size, units) = open_tiff(path)
            return Source(path, data, axes, pixel_size, units)
        return Source(path, *_photograph(path), {}, {})


def _microscope_source(path: Path, scene: int | None) -> Source:
    found = open_microscope_file(path.absolute(), scene)
    return Source(
        path,
        found.data,
        found.axes,
        found.pixel_size,
        found.units,
        channel_names=found.channel_names,
    )


def _photograph(path: Path) -> tuple[da.Array, str]:
    """Return a photograph, or the frames of an animation, and their axes."""
    frames, shape, dtype = picture_form(path)
    axes = "yxs"[: len(shape)]
    if frames == 1:
        return lazy_array(_Photograph(path.absolute(), shape, dtype), shape), axes
    animation = _Animation(path.absolute(), (frames, *shape), dtype)
    return lazy_array(animation, (1, *shape)), f"t{axes}"


def _zarr_source(path: Path) -> Source:
    picture = read_ome_zarr(path)
    data, axes = picture.levels[0], picture.axes
    if tuple(color.upper().lstrip("#") for color in picture.channel_colors) == RGB_COLORS:
        channels = axes.find("c")
        if channels >= 0 and data.shape[channels] == 3:
            import dask.array as da

            data, axes = da.moveaxis(data, channels, -1), axes.replace("c", "") + "s"
            data = data.rechunk({-1: 3})
    return Source(path, data, axes, picture.pixel_size, picture.units)


# Pictures that are planes of one stack.


def open_stack(inputs: Inputs, scene: int | None = None) -> Source:
    """Open a stack: one file, or pictures of one plane that are its planes; no pixels are read.

    Parameters
    ----------
    inputs : path-like, or iterable of path-like
        A stack as `open_source` takes it; or a folder, several pictures, or patterns, see
        `find_sources`. Several pictures are planes in the natural order of their names: slice2
        comes before slice10. They are along z, and each may have channels, c, beside.
    scene : int, optional
        Which scene of each CZI, ND2 or LIF file to take, from 0.

    Returns
    -------
    Source
        Its `path` is the folder, or the first picture. Pixel size and units are those of the
        pictures where all agree.

    Raises
    ------
    UnreadablePicture
        As `find_sources` and `open_source`; if there is only one picture, or one of them has
        several planes, or another shape or dtype than the others: the message names it.

    Examples
    --------
    >>> import pathlib, tempfile, PIL.Image, numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for number in (2, 10, 1):
    ...         plane = PIL.Image.fromarray(np.full((4, 5), number, np.uint8))
    ...         plane.save(pathlib.Path(folder, f"slice{number}.png"))
    ...     stack = open_stack(folder)
    ...     stack.axes, stack.data[:, 0, 0].compute().tolist()
    ('zyx', [1, 2, 10])
    """
    need_large_extra()
    given = as_paths(inputs)
    files = in_stack_order(find_sources(given))
    if len(given) == 1 and files == given:
        return _one_scene(open_source(given[0], scene))
    if not files:
        raise UnreadablePicture("cannot read a stack: there are no files")
    place = given[0] if len(given) == 1 and given[0].is_dir() else files[0]
    if len(files) == 1:
        raise UnreadablePicture(
            f"cannot read {place} as a stack: it is one picture, {files[0].name}; give two or "
            "more, or the file itself if it is a stack"
        )
    return _as_planes(place, [_as_plane(open_source(path, scene)) for path in files])


def _one_scene(source: Source) -> Source:
    """Refuse several scenes: they are no planes through focus."""
    if source.axes.startswith("p") and source.path.is_file() and microscope_format(source.path):
        raise UnreadablePicture(
            f"cannot read {source.path} as a stack: it holds {source.data.shape[0]} scenes; scene "
            "chooses one (in a terminal --scene, from 0)"
        )
    return source


def _as_plane(picture: Source) -> Source:
    """Return a picture without axes of length 1; refuse it if it has planes beside channels."""
    if mark_of(picture.path).get("quantity") == SHARPEST_PIXELS:
        raise UnreadablePicture(
            f"cannot read {picture.path} as a plane of a stack: it was made of the sharpest pixels "
            "of a stack"
        )
    sizes = dict(zip(picture.plane_axes, picture.plane_shape, strict=True))
    kept = "".join(axis for axis, size in sizes.items() if size > 1)
    if kept not in ("", "c"):
        held = " and ".join(f"{sizes[axis]} along {axis}" for axis in kept)
        raise UnreadablePicture(
            f"cannot read {picture.path} as a plane of a stack: it has {held}; pictures of one "
            "plane are taken, or a single file that is a stack"
        )
    index = tuple(slice(None) if axis in kept else 0 for axis in sizes)
    axes = kept + picture.axes[len(sizes) :]
    return Source(picture.path, picture.data[index], axes, picture.pixel_size, picture.units)


def _as_planes(place: Path, pictures: list[Source]) -> Source:
    import dask.array as da

    _check_alike(pictures)
    first = pictures[0]
    same = {
        axis: step
        for axis, step in first.pixel_size.items()
        if axis in "yx" and all(each.pixel_size.get(axis) == step for each in pictures)
    }
    units = {axis: unit for axis, unit in first.units.items() if axis in same}
    data = da.stack([each.data for each in pictures])
    return Source(place, data, f"z{first.axes}", same, units, tuple(each.path for each in pictures))


def _check_alike(pictures: list[Source]) -> None:
    forms = [(each.axes, each.data.shape, each.data.dtype) for each in pictures]
    usual, _ = Counter(forms).most_common(1)[0]
    for picture, form in zip(pictures, forms, strict=True):
        if form != usual:
            raise UnreadablePicture(
                f"cannot read {picture.path} as a plane of a stack: it is {_told_form(*form)}, and "
                f"others are {_told_form(*usual)}"
            )


def _told_form(axes: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> str:
    sizes = dict(zip(axes, shape, strict=True))
    more = f" of {sizes['s']} colours" if "s" in sizes else ""
    more += f" of {sizes['c']} channels" if "c" in sizes else ""
    return f"{sizes['x']} x {sizes['y']} px{more}, {dtype}"
