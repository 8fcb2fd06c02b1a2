"""From an image layer to the plane that is analysed; for the way back see `result_layers`.

No Qt here: everything works on a `napari.components.ViewerModel` too.
"""

import weakref
from dataclasses import dataclass, replace
from typing import Any, Self, TypeVar

import numpy as np
from napari.components import Dims, LayerList
from napari.layers import Image, Labels, Layer
from napari.utils.transforms import CompositeAffine
from numpy.typing import ArrayLike, NDArray

T = TypeVar("T")

MAX_PIXELS = 64_000_000
"""Larger planes are refused by all that needs them as a whole: they would fill the memory."""

LARGEST_IN_MEMORY = 32_000_000
"""In px: blur maps and masks of larger planes are measured part by part, and kept on the disk."""


class NotAnalysableError(ValueError):
    """The layer, as it is shown now, has no plane to analyse; the message says why."""


@dataclass(frozen=True, eq=False)
class Plane:
    """One plane of an image layer or a part of it, not read yet, and where it lies.

    Attributes
    ----------
    layer : weak reference to napari.layers.Image
        The layer that it belongs to; it does not keep the layer alive.
    name : str
        The layer's name.
    data : array
        The layer's data, of level 0 if there are several.
    index : tuple of int or slice
        What picks the plane out of `data`; slices with start and stop pick a part.
    placement : dict
        The layer's scale, translate, rotate, shear, affine, units and axis labels, with
        `translate` moved to the plane.
    contrast_limits : (float, float)
        The layer's own: how it is shown.
    inside : (H, W) bool ndarray or None
        Which pixels of a part count; None if all do.
    region : str
        What chose the part, in words; empty for a whole plane.
    """

    layer: weakref.ref[Image]
    name: str
    data: Any
    index: tuple[int | slice, ...]
    placement: dict[str, Any]
    contrast_limits: tuple[float, float]
    inside: NDArray[np.bool_] | None = None
    region: str = ""

    def __eq__(self, other: object) -> bool:
        """Tell whether it is the same plane of the same data, wherever the layer lies."""
        return (
            isinstance(other, Plane)
            and self.layer == other.layer
            and self.data is other.data
            and self.index == other.index
            and np.array_equal(self.inside, other.inside)  # type: ignore[arg-type]
        )

    def values(self) -> NDArray[Any]:
        """Return a copy of the plane's pixels; dask computes this plane and no other.

        Raises
        ------
        NotAnalysableError
            If the plane is too large.
        """
        check_pixels(self.shape)
        # A script reads it in this order, and sums alike.
        found = self.data[self.index]
        if isinstance(found, np.ma.MaskedArray):
            return np.ma.array(found, copy=True, order="C")
        return np.array(found, order="C")

    def read(self) -> NDArray[Any]:
        """Return a copy of the plane's pixels to be measured, see `values`.

        NaN and masked pixels are not known.

        Raises
        ------
        NotAnalysableError
            If the plane has infinite pixels, is too large, or its colours are inks.
        """
        layer = self.layer()
        if layer is not None and _shows_inks(layer):
            raise NotAnalysableError(
                "its file is a JPEG of inks (CMYK), whose black ink is taken for opacity here. "
                "Save it as RGB, and open that."
            )
        image = self.values()
        _check_values(image)
        return image

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in px; nothing is read."""
        height, width = (
            len(range(length)[cut]) for length, cut in zip(self.whole_shape, self.cuts, strict=True)
        )
        return height, width

    @property
    def whole_shape(self) -> tuple[int, int]:
        """Height and width, in px, of the plane that it is a part of."""
        height, width = sizes_at(self.index, self.data.shape)
        return height, width

    @property
    def cuts(self) -> tuple[slice, slice]:
        """Which rows and columns of the whole plane it has."""
        rows, columns = (at for at in self.index if isinstance(at, slice))
        return rows, columns

    @property
    def is_part(self) -> bool:
        """Whether it is less than the whole plane."""
        return self.shape != self.whole_shape

    @property
    def sliders(self) -> list[int]:
        """Which axes of the layer are not displayed: planes lie along them."""
        return [axis for axis, at in enumerate(self.index) if isinstance(at, int)]

    def at_position(self, position: tuple[int, ...]) -> Self:
        """Return the plane at another position of the sliders."""
        steps = iter(position)
        return self.at(tuple(next(steps) if isinstance(at, int) else at for at in self.index))

    def at(self, index: tuple[int | slice, ...]) -> Self:
        """Return what another index picks out of the same layer, lying where that lies."""
        offset = np.subtract(corner(index), corner(self.index))
        return replace(self, index=index, placement=_moved(self.placement, offset))

    def part(
        self,
        rows: slice,
        columns: slice,
        *,
        inside: NDArray[np.bool_] | None = None,
        region: str = "",
    ) -> Self:
        """Return a part of the plane that it belongs to, see `Plane`.

        Rows and columns are those of the whole plane, with start and stop.
        """
        cuts = iter((rows, columns))
        index = tuple(at if isinstance(at, int) else next(cuts) for at in self.index)
        return replace(self.at(index), inside=inside, region=region)

    def counted(self, result: NDArray[Any]) -> NDArray[Any]:
        """Return a copy of a result, 0 where the pixels do not count, see `inside`."""
        if self.inside is None:
            return result.copy()
        return np.where(self.inside, result, result.dtype.type(0))

    def expanded(self, result: NDArray[Any]) -> NDArray[Any]:
        """Return a result of the plane's height and width with the layer's number of axes."""
        return np.expand_dims(result, tuple(self.sliders))

    def is_current(self, layers: LayerList) -> bool:
        """Tell whether the layer is still in the list, with the data that were read."""
        layer = self.layer()
        return layer is not None and layer in layers and finest(layer) is self.data


def _check_values(image: NDArray[Any]) -> None:
    if image.dtype.kind == "f" and np.isinf(image).any():
        raise NotAnalysableError(
            "it has infinite pixels. Replace them by NaN, which says that they are not known."
        )


def _shows_inks(layer: Image) -> bool:
    """Return whether a layer has four channels from a JPEG: these have no opacity, but inks."""
    path, channels = layer.source.path, finest(layer).shape[-1] if layer.rgb else 0
    return channels == 4 and str(path or "").lower().endswith((".jpg", ".jpeg"))


def check_pixels(shape: tuple[int, int]) -> None:
    """Refuse planes that are too large, see `MAX_PIXELS`."""
    pixels = np.prod(shape)
    if pixels > MAX_PIXELS:
        raise NotAnalysableError(
            f"it has {pixels / 1e6:.0f} million pixels, more than "
            f"{MAX_PIXELS / 1e6:.0f} million at a time. Choose a region of it, such as the "
            "visible field."
        )


def shown_plane(layer: Image, dims: Dims) -> Plane:
    """Return the plane of an image layer that a viewer shows.

    It may be grey, RGB or RGBA; one picture, a stack, several scales, dask.

    Raises
    ------
    NotAnalysableError
        If the layer is shown as a volume, or the sliders are outside of it.
    """
    return plane_at(layer, shown_index(layer, dims, finest(layer).shape))


def plane_at(layer: Image, index: tuple[int | slice, ...]) -> Plane:
    """Return the plane of an image layer that an index picks."""
    layer = unwrapped(layer)
    return Plane(
        layer=weakref.ref(layer),
        name=layer.name,
        data=finest(layer),
        index=index,
        placement=placement(layer, index),
        contrast_limits=_pair(layer.contrast_limits),
    )


def unwrapped(lent: T) -> T:
    """Return the viewer or layer behind the proxy that plugins are lent: that lives and dies."""
    return getattr(lent, "__wrapped__", lent)


def finest(layer: Image | Labels) -> Any:
    """Return a layer's data, of level 0 if there are several."""
    return layer.data[0] if layer.multiscale else layer.data


def _pair(limits: Any) -> tuple[float, float]:
    low, high = limits
    return float(low), float(high)


def corner(index: tuple[int | slice, ...]) -> tuple[int, ...]:
    """Return the first pixel that an index picks."""
    return tuple(at if isinstance(at, int) else at.start or 0 for at in index)


def picture_axes(index: tuple[int | slice, ...]) -> list[int]:
    """Return which axes an index keeps: rows and columns."""
    return [axis for axis, at in enumerate(index) if not isinstance(at, int)]


def sizes_at(index: tuple[int | slice, ...], shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the lengths of those of an array's axes that an index keeps."""
    return tuple(
        length for length, at in zip(shape, index, strict=False) if not isinstance(at, int)
    )


def shown_index(
    layer: Image | Labels, dims: Dims, shape: tuple[int, ...]
) -> tuple[int | slice, ...]:
    """Return what picks the plane that a viewer shows out of a layer's data, see `shown_plane`."""
    if layer.ndim == 2:
        return (slice(None), slice(None))
    first = dims.ndim - layer.ndim
    shown = {axis - first for axis in dims.displayed if axis >= first}
    if len(shown) != 2:
        raise NotAnalysableError(
            "it is shown as a volume. Switch the viewer to 2-D and go to the plane you want."
        )
    at = shown_position(layer, dims)
    if any(not 0 <= at[axis] < shape[axis] for axis in range(layer.ndim) if axis not in shown):
        raise NotAnalysableError(
            "the viewer shows no plane of it. Move the sliders to where the picture appears."
        )
    return tuple(slice(None) if axis in shown else int(at[axis]) for axis in range(layer.ndim))


def shown_position(layer: Layer, dims: Dims) -> NDArray[np.int_]:
    """Return where the sliders stand in a layer's pixels; displayed axes mean nothing."""
    # As napari slices: only the axes that are not displayed have a say.
    point = [0.0 if axis in dims.displayed else at for axis, at in enumerate(dims.point)]
    return np.round(layer.world_to_data(point)).astype(int)


def move_slider(layer: Layer, dims: Dims, axis: int, number: int) -> None:
    """Move the slider of a layer's axis to where that has this number, in px from 0."""
    at = shown_position(layer, dims)
    at[axis] = number
    dims.set_point(axis + dims.ndim - layer.ndim, layer.data_to_world(at)[axis])


def move_to(layer: Layer, placed: dict[str, Any]) -> None:
    """Let a layer lie where keywords say; what lies there already is not drawn again."""
    for name, wanted in placed.items():
        now = getattr(layer, name)
        if isinstance(wanted, tuple):
            is_there = tuple(now) == wanted
        else:
            now, wanted = (getattr(each, "affine_matrix", each) for each in (now, wanted))
            is_there = np.allclose(now, wanted, rtol=1e-9, atol=1e-12)  # napari rounds
        if not is_there:
            setattr(layer, name, wanted)


def placement(layer: Image, index: tuple[int | slice, ...]) -> dict[str, Any]:
    """Return where a plane of a layer lies, as keywords of a new layer, see `Plane`."""
    placed = {
        "scale": np.array(layer.scale),
        "translate": np.array(layer.translate),
        "rotate": np.array(layer.rotate),
        "shear": np.array(layer.shear),
        "affine": np.array(layer.affine.affine_matrix),
        "units": tuple(layer.units),
        "axis_labels": tuple(layer.axis_labels),
    }
    return _moved(placed, corner(index))


def _moved(placed: dict[str, Any], pixels: ArrayLike) -> dict[str, Any]:
    """Return where a layer lies whose first pixel is another one of the same grid."""
    to_physical = CompositeAffine(
        **{name: placed[name] for name in ("scale", "translate", "rotate", "shear")},
        ndim=len(placed["scale"]),
    )
    return placed | {"translate": np.asarray(to_physical(pixels))}
