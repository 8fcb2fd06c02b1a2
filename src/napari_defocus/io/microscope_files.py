"""Files of microscopes' own formats (CZI, ND2, LIF), read lazily by bioio's readers."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from napari_defocus.core.extras import extra_package, is_there
from napari_defocus.core.writing import in_one_line
from napari_defocus.io.file_kinds import EXPORT_STACK, MicroscopeFormat, microscope_format

if TYPE_CHECKING:
    import dask.array as da

EXTRA = "microscopes"

_PLANE_BY_PLANE = {"chunk_dims": ["Y", "X"]}
"""What those readers take that would else read all planes of a stack at once."""

_OPTIONS: dict[str, dict[str, Any]] = {
    "bioio_czi": _PLANE_BY_PLANE,
    "bioio_lif": _PLANE_BY_PLANE,
    "bioio_nd2": {},
}
_OF_ZEISS, _OF_LEICA = "bioio_czi", "bioio_lif"

_MOST_LISTED = 6
_COLORS = (3, 4)


@dataclass(frozen=True, eq=False)
class MicroscopeScene:
    """What a file of a microscope holds, or one of its scenes.

    Attributes
    ----------
    data : dask.array.Array
        (..., H, W) or (..., H, W, 3 or 4); planes are read when they are computed.
    axes : str
        A letter an axis. Scenes of one form are along p, if none was chosen.
    pixel_size : dict of str to float
    units : dict of str to str
        In the spelling of UDUNITS: "micrometer", and "second" along t.
    channel_names : tuple of str
        Of the channels along c; empty if there is no such axis.
    """

    data: da.Array
    axes: str
    pixel_size: dict[str, float]
    units: dict[str, str]
    channel_names: tuple[str, ...]


def open_microscope_file(path: Path, scene: int | None = None) -> MicroscopeScene:
    """Open a CZI, ND2 or LIF file: one of its scenes, or all of them if they are of one form.

    Tiles of a mosaic are put together. Axes of length 1 are left out. ValueError, the end of a
    sentence, is raised if the extra "microscopes" is not installed, there is no such scene, or the
    scenes differ and none was chosen.
    """
    reader, known = _reader_of(path)
    names = tuple(map(str, reader.scenes))
    if scene is not None:
        _check_scene(scene, len(names))
        return _opened(reader, known, scene)
    opened = [_opened(reader, known, number) for number in range(len(names))]
    if len(opened) == 1:
        return opened[0]
    forms = {(each.axes, each.data.shape, each.data.dtype) for each in opened}
    if len(forms) > 1:
        raise ValueError(
            f"it holds {len(names)} scenes of different forms ({_listed(names, opened)}); "
            "scene chooses one (open_source(path, scene=0), or sharpest --scene 0 in a terminal)"
        )
    return _beside_each_other(opened)


def lacks_extra(path: Path) -> bool:
    """Return whether a file is a CZI, ND2 or LIF file whose reader is not installed."""
    known = microscope_format(path) if path.is_file() else None
    return known is not None and not is_there(known.package)


def ome_xml_of(path: Path) -> str | None:
    """Return what a file notes of its microscope as OME-XML; None if that cannot be told."""
    reader, _ = _reader_of(path)
    # What of the metadata cannot be translated is not known, and the pixels are read all the same.
    with suppress(Exception), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return str(reader.ome_metadata.to_xml())
    return None


def leica_objective(path: Path) -> Mapping[str, str]:
    """Return what a LIF file notes of its objective, as Leica calls it; nothing of other files.

    Such as NumericalAperture, RefractionIndex and Immersion; those of the first scene that has any.
    """
    known = microscope_format(path)
    if known is None or known.package != _OF_LEICA:
        return {}
    reader, _ = _reader_of(path)
    noted = (each.attrib for each in reader.metadata.iter() if "NumericalAperture" in each.attrib)
    return next(noted, {})


def _reader_of(path: Path) -> tuple[Any, MicroscopeFormat]:
    known = microscope_format(path)
    if known is None:
        raise ValueError("it is no file of a microscope")
    package = extra_package(known.package, EXTRA, known.told, EXPORT_STACK)
    with _by_the_library(known):
        reader = package.Reader(path, **_OPTIONS[known.package])
        names, held = reader.scenes, _scenes_held(path, known)
    if not names:
        raise ValueError(f"it is {known.told}, and holds no picture")
    if held > len(names):
        raise ValueError(
            f"it is {known.told}: it has {held} scenes, and notes only {len(names)} of them; "
            f"{EXPORT_STACK} first"
        )
    return reader, known


def _scenes_held(path: Path, known: MicroscopeFormat) -> int:
    """Return how many scenes a CZI file holds: its reader counts those that its XML names."""
    if known.package != _OF_ZEISS:
        return 0
    from aicspylibczi import CziFile

    with path.open("rb") as file:
        parts = CziFile(file).get_dims_shape()
    return len({scene for part in parts for scene in range(*part.get("S", (0, 0)))})


@contextmanager
def _by_the_library(known: MicroscopeFormat) -> Iterator[None]:
    """Say what the file is if a reader of others cannot read it."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        raise ValueError(
            f"it is {known.told}, which could not be read ({in_one_line(error)})"
        ) from error


def _check_scene(scene: int, count: int) -> None:
    if not 0 <= scene < count:
        raise ValueError(f"scene is {scene}; it has scenes 0 to {count - 1}")


def _opened(reader: Any, known: MicroscopeFormat, scene: int) -> MicroscopeScene:
    with _by_the_library(known):
        reader.set_scene(scene)
        mosaic = "M" in reader.dims.order
        array = reader.mosaic_xarray_dask_data if mosaic else reader.xarray_dask_data
    data, axes = _in_order(array, blue_first=known.package == _OF_ZEISS)
    steps = dict(_steps(reader, array))
    kept = {axis: step for axis, step in steps.items() if axis in axes}
    units = {axis: "second" if axis == "t" else "micrometer" for axis in kept}
    names = tuple(map(str, array.coords["C"].values)) if "c" in axes and "C" in array.coords else ()
    return MicroscopeScene(data, axes, kept, units, names)


def _in_order(array: Any, *, blue_first: bool) -> tuple[da.Array, str]:
    """Return planes before rows, columns and colours, without axes of length 1."""
    import dask.array as da

    data = da.Array(array.data.dask, array.data.name, array.data.chunks, array.data.dtype)
    if data.dtype.kind not in "buif":
        raise ValueError(f"it holds {data.dtype}; real numbers are read")
    letters = [str(name).lower() for name in array.dims]
    kept = [at for at, size in enumerate(data.shape) if size > 1 or letters[at] in "yx"]
    order = sorted(kept, key=lambda at: "yxs".find(letters[at]))
    axes = "".join(letters[at] for at in order)
    single = tuple(slice(None) if at in kept else 0 for at in range(data.ndim))
    places = {at: place for place, at in enumerate(sorted(kept))}
    data = data[single].transpose([places[at] for at in order])
    if axes.endswith("s"):
        if data.shape[-1] not in _COLORS:
            raise ValueError(f"it has {data.shape[-1]} colours; 3 or 4 are read")
        # That is the order in which CZI keeps colours, and its reader leaves them so.
        if blue_first:
            data = data[..., [2, 1, 0, 3][: data.shape[-1]]]
    return data, axes


def _steps(reader: Any, array: Any) -> Iterator[tuple[str, float]]:
    """Yield how far neighbours are apart along an axis: um, and s along t."""
    known = _calibrated(array)
    sizes = reader.physical_pixel_sizes
    for axis, step in (("z", sizes.Z), ("y", sizes.Y), ("x", sizes.X)):
        if step and step > 0 and axis in known:
            yield axis, float(step)
    interval = reader.time_interval
    if interval is not None and interval.total_seconds() > 0:
        yield "t", float(interval.total_seconds())


def _calibrated(array: Any) -> str:
    """Return the axes whose steps are measured: ND2 notes 1 um of those that are not."""
    noted = array.attrs.get("unprocessed")
    metadata = noted.get("metadata") if isinstance(noted, dict) else None
    channels = getattr(metadata, "channels", None) or ()
    if not channels:
        return "zyx"
    calibrated = zip("xyz", channels[0].volume.axesCalibrated, strict=False)
    return "".join(axis for axis, known in calibrated if known)


def _beside_each_other(scenes: list[MicroscopeScene]) -> MicroscopeScene:
    import dask.array as da

    first = scenes[0]
    same = {
        axis: step
        for axis, step in first.pixel_size.items()
        if all(each.pixel_size.get(axis) == step for each in scenes)
    }
    data = da.stack([each.data for each in scenes])
    units = {axis: first.units[axis] for axis in same}
    return MicroscopeScene(data, f"p{first.axes}", same, units, first.channel_names)


def _listed(names: tuple[str, ...], scenes: list[MicroscopeScene]) -> str:
    told = [
        f"{number} {name}: {' x '.join(map(str, each.data.shape))} (axes {each.axes})"
        for number, (name, each) in enumerate(zip(names, scenes, strict=True))
    ]
    return ", ".join(told[:_MOST_LISTED] + ["..."] * (len(told) > _MOST_LISTED))
