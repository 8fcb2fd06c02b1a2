"""How OME-Zarr 0.5 says what an array is: order and types of axes, pixel size, units, colours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from napari_defocus.io.ome_zarr import RGB_COLORS

VERSION = "0.5"

_MOST_AXES = 5
_AXIS_TYPES = {"t": "time", "c": "channel", "z": "space", "y": "space", "x": "space"}
_PLACE_OF_AXIS = {"t": 0, "z": 2, "y": 3, "x": 4}
_PLACE_OF_OTHERS = 1


def stored_order(axes: str) -> list[int]:
    """Return which given axis is stored at each place: time, others and colours, space."""
    places = [_PLACE_OF_AXIS.get(letter, _PLACE_OF_OTHERS) for letter in axes]
    return sorted(range(len(axes)), key=places.__getitem__)


def stored_names(axes: str) -> list[str]:
    """Return the axes as they are stored, and named: colours are channels."""
    return [axes[i].replace("s", "c") for i in stored_order(axes)]


def check_form(shape: tuple[int, ...], dtype: np.dtype[Any], axes: str, tile: int) -> None:
    """Raise ValueError or TypeError if OME-Zarr cannot hold an array."""
    names = stored_names(axes)
    others = sum(name not in _AXIS_TYPES for name in names)
    if len(set(names)) < len(names) or not {"y", "x"} <= set(names) or not axes.isalpha():
        raise ValueError(
            f"axes is {axes!r}; it takes a letter an axis, all different, y and x among them, "
            "and c or s, not both"
        )
    if len(names) > _MOST_AXES or others > 1:
        raise ValueError(
            f"axes is {axes!r}; OME-Zarr takes up to {_MOST_AXES}, "
            "and one at most besides t, c (or s), z, y, x"
        )
    if len(shape) != len(axes) or min(shape) < 1:
        raise ValueError(f"shape is {tuple(shape)}; axes {axes!r} take {len(axes)} sizes above 0")
    if dtype.kind not in "buif":
        raise TypeError(f"dtype is {dtype}; it takes bool or a real number")
    if tile < 16:
        raise ValueError(f"tile is {tile}; it takes 16 px or more")


def check_named_axes(name: str, given: Mapping[str, Any] | None, axes: str) -> None:
    """Raise ValueError if `pixel_size` or `units` name an axis that is none of `axes`."""
    unknown = sorted(set(given or {}) - set(axes))
    if unknown:
        raise ValueError(f"{name} has the axes {', '.join(unknown)}; axes is {axes!r}")


def description(
    axes: str,
    pixel_size: Mapping[str, float],
    units: Mapping[str, str],
    *,
    name: str,
    levels: int,
    labels: bool,
    rgb_of: np.dtype[Any] | None = None,
) -> dict[str, Any]:
    """Return what stands under the key "ome" of a store, for axes as `new_ome_zarr` takes them.

    Each of the levels is half as high and wide as the one before. `labels` are names or a mask;
    `rgb_of` is the dtype of values that are red, green and blue.
    """
    about: dict[str, Any] = {
        "version": VERSION,
        "multiscales": [_multiscale(axes, pixel_size, units, name, levels)],
    }
    if labels:
        about["image-label"] = {"version": VERSION}
    if rgb_of is not None:
        about["omero"] = {"channels": [_color_channel(i, rgb_of) for i in range(3)]}
    return about


def _multiscale(
    axes: str, pixel_size: Mapping[str, float], units: Mapping[str, str], name: str, levels: int
) -> dict[str, Any]:
    from ome_zarr_models.v05.axes import Axis
    from ome_zarr_models.v05.multiscales import Dataset, Multiscale

    given = [axes[i] for i in stored_order(axes)]
    names = stored_names(axes)
    described = [
        Axis(name=name, type=_AXIS_TYPES.get(name), unit=units.get(letter))
        for name, letter in zip(names, given, strict=True)
    ]
    base = [float(pixel_size.get(letter, 1.0)) for letter in given]
    datasets = []
    for level in range(levels):
        scale = [s * 2**level if n in "yx" else s for s, n in zip(base, names, strict=True)]
        # The middle of a coarse pixel is between those of the fine ones.
        middle = [(coarse - fine) / 2 for coarse, fine in zip(scale, base, strict=True)]
        datasets.append(Dataset.build(path=str(level), scale=scale, translation=middle))
    model = Multiscale(axes=described, datasets=tuple(datasets), name=name)
    return dict(model.model_dump(mode="json", exclude_none=True))


def _color_channel(number: int, dtype: np.dtype[Any]) -> dict[str, Any]:
    white = float(np.iinfo(dtype).max) if dtype.kind in "ui" else 1.0
    return {
        "label": ("red", "green", "blue")[number],
        "color": RGB_COLORS[number],
        "active": True,
        "window": {"min": 0.0, "max": white, "start": 0.0, "end": white},
    }
