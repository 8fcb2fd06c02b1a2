"""Which part of a plane is analysed: all of it, what is in view, or what shapes enclose.

No Qt here, as in `layers`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from napari.components import Dims, ViewerModel
from napari.layers import Image, Shapes
from numpy.typing import NDArray

from napari_defocus.widgets.layers.image_layers import (
    NotAnalysableError,
    Plane,
    check_pixels,
    finest,
    picture_axes,
    shown_index,
    shown_position,
    sizes_at,
    unwrapped,
)

LEAST_SIDE = 3
"""In px: smaller parts are no pictures."""

WITH_AREA = ("rectangle", "ellipse", "polygon")
"""The types of shapes that enclose something."""

Choice: TypeAlias = Literal["whole", "visible"] | Shapes
"""What chooses the part: nothing, the field of view, or the shapes of a layer."""

Points = NDArray[np.floating]

_ELLIPSE_CORNERS = 100
_ROUNDING = 1e-4
"""In px: what a transform there and back may add to a coordinate."""


@dataclass(frozen=True, eq=False)
class Region:
    """A part of a plane.

    Attributes
    ----------
    rows, columns : slice
        In px of the whole plane, with start and stop.
    inside : (H, W) bool ndarray or None
        Which pixels of the part count; None if all do.
    name : str
        What chose it, in words; empty for the whole plane.
    """

    rows: slice
    columns: slice
    inside: NDArray[np.bool_] | None = None
    name: str = ""


def region_of(layer: Image, viewer: ViewerModel, choice: Choice) -> Region:
    """Return the part of the plane of an image layer that a viewer shows.

    Parameters
    ----------
    layer : napari.layers.Image
    viewer : napari.components.ViewerModel or napari.Viewer
        Says which plane is shown, and what of it is in view.
    choice : {"whole", "visible"} or napari.layers.Shapes
        The whole plane; the pixels whose centres the canvas shows; or the box around all shapes
        of a layer that enclose something and are shown, or around the selected ones if any
        are selected. The shapes may lie on the picture by any transform.

    Raises
    ------
    NotAnalysableError
        If no plane is shown, nothing of it is in view, there is no canvas, or there are no
        shapes; if the part lies beside the picture, or is less than 3 px high or wide.

    Examples
    --------
    >>> import numpy as np
    >>> from napari.components import ViewerModel
    >>> viewer = ViewerModel()
    >>> image = viewer.add_image(np.zeros((50, 60)))
    >>> shapes = viewer.add_shapes([[10, 20], [29, 40]], shape_type="rectangle")
    >>> region = region_of(image, viewer, shapes)
    >>> region.rows, region.columns
    (slice(10, 30, None), slice(20, 41, None))
    """
    layer = unwrapped(layer)
    shape = finest(layer).shape
    index = shown_index(layer, viewer.dims, shape)
    height, width = sizes_at(index, shape)
    if choice == "whole":
        return Region(slice(0, height), slice(0, width))
    to_plane = _to_plane(layer, viewer.dims, index)
    if choice == "visible":
        box = _box(to_plane(_view_corners(viewer)), (height, width))
        return Region(*_checked(*box, "the visible field"), name="visible field")
    shapes = unwrapped(choice)
    outlines = [to_plane(outline) for outline in _outlines(shapes, viewer.dims)]
    rows, columns = _checked(*_box(np.concatenate(outlines), (height, width)), "the shape")
    check_pixels((rows.stop - rows.start, columns.stop - columns.start))
    return Region(rows, columns, _inside(outlines, rows, columns), f"shapes “{shapes.name}”")


def empty_shapes(shapes: Shapes) -> None:
    """Let shapes be outlines: their fill would cover what was measured inside of them."""
    shapes = unwrapped(shapes)
    if len(shapes.data) and np.any(np.asarray(shapes.face_color)[:, 3]):
        shapes.face_color = "transparent"
        shapes.refresh()
    shapes.current_face_color = "transparent"


def plane_in(plane: Plane, region: Region) -> Plane:
    """Return the part of a whole plane that a region is; the plane itself if it is all of it.

    Parameters
    ----------
    plane : Plane
        What `shown_plane` returns.
    region : Region
        What `region_of` returns for the same layer and viewer.
    """
    part = plane.part(region.rows, region.columns, inside=region.inside, region=region.name)
    return part if part.is_part or part.inside is not None else plane


def _to_plane(
    layer: Image, dims: Dims, index: tuple[int | slice, ...]
) -> Callable[[Points], Points]:
    """Return what takes world coordinates along the displayed axes to a plane's pixels.

    The world's are (n, 2), in the order of the axes, and so are the plane's, rows and columns.
    """
    matrix, origin = _linear(layer.world_to_data, layer.ndim)
    shown = picture_axes(index)
    displayed = sorted(dims.displayed)

    def to_plane(world: Points) -> Points:
        points = np.tile(np.array(dims.point, float), (len(world), 1))
        points[:, displayed] = world
        return (points[:, -layer.ndim :] @ matrix.T + origin)[:, shown]

    return to_plane


def _linear(transform: Callable[[Points], Any], ndim: int) -> tuple[Points, Points]:
    """Return the matrix and the offset of a linear transform of single points."""
    origin = np.asarray(transform(np.zeros(ndim)))
    return np.stack([transform(unit) - origin for unit in np.eye(ndim)], axis=1), origin


def _view_corners(viewer: ViewerModel) -> Points:
    """Return the world coordinates of the canvas' corners along the displayed axes: (4, 2).

    Not from the layer's `corner_pixels`: of several scales, they are whole chunks, and those
    of an earlier view that was wider.
    """
    if getattr(viewer, "window", None) is None:
        raise NotAnalysableError(
            "there is no window, so no field is visible. Choose the whole picture or shapes."
        )
    if viewer.dims.ndisplay != 2:
        raise NotAnalysableError("it is seen in 3-D. Switch the viewer to 2-D to use what you see.")
    camera = viewer.scene.camera
    half = np.array(viewer.canvas.viewbox_size(viewer.layers)) / camera.zoom / 2
    signs = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    corners = np.array(camera.center[-2:]) + signs * half
    return corners if viewer.dims.displayed[0] < viewer.dims.displayed[1] else corners[:, ::-1]


def _outlines(shapes: Shapes, dims: Dims) -> list[Points]:
    """Return the world coordinates of the corners of all shapes that count: (n, 2) each."""
    first = dims.ndim - shapes.ndim
    shown = [axis - first for axis in sorted(dims.displayed) if axis >= first]
    if len(shown) != 2:
        raise NotAnalysableError(
            f"the shapes “{shapes.name}” do not lie in the plane that is shown."
        )
    if not shapes.data:
        raise NotAnalysableError(f"there are no shapes in “{shapes.name}”. Draw one first.")
    at = shown_position(shapes, dims)
    chosen = sorted(shapes.selected_data) or range(len(shapes.data))
    outlines = [
        _outline(shapes.data[n], shapes.shape_type[n])
        for n in chosen
        if shapes.shape_type[n] in WITH_AREA and _is_shown(shapes.data[n], at, shown)
    ]
    if not outlines:
        which = "selected shapes" if shapes.selected_data else "shapes"
        raise NotAnalysableError(
            f"none of the {which} in “{shapes.name}” encloses a part of the plane that is "
            "shown. Draw a rectangle, an ellipse or a polygon."
        )
    matrix, origin = _linear(shapes.data_to_world, shapes.ndim)
    return [(outline @ matrix.T + origin)[:, shown] for outline in outlines]


def _is_shown(corners: Points, at: NDArray[np.int_], shown: list[int]) -> bool:
    """Tell whether the sliders stand where a shape is."""
    sliced = [axis for axis in range(corners.shape[1]) if axis not in shown]
    low, high = np.round([corners.min(axis=0), corners.max(axis=0)])
    return bool(((low <= at) & (at <= high))[sliced].all())


def _outline(corners: Points, shape_type: str) -> Points:
    """Return the corners of a shape; of an ellipse, which napari keeps as its box, its own."""
    if shape_type != "ellipse":
        return np.asarray(corners, float)
    angle = np.linspace(0, 2 * np.pi, _ELLIPSE_CORNERS, endpoint=False)
    axes = np.stack([corners[1] - corners[0], corners[2] - corners[1]]) / 2
    return corners.mean(axis=0) + np.stack([np.cos(angle), np.sin(angle)], axis=1) @ axes


def _box(points: Points, shape: tuple[int, int]) -> tuple[slice, slice]:
    """Return the pixels of a picture whose centres lie in the box around points."""
    low = np.maximum(np.ceil(points.min(axis=0) - _ROUNDING).astype(int), 0)
    stop = np.minimum(np.floor(points.max(axis=0) + _ROUNDING).astype(int) + 1, shape)
    rows, columns = (slice(int(a), int(b)) for a, b in zip(low, stop, strict=True))
    return rows, columns


def _checked(rows: slice, columns: slice, what: str) -> tuple[slice, slice]:
    """Return rows and columns, if they are enough; `what` chose them."""
    height, width = rows.stop - rows.start, columns.stop - columns.start
    if height <= 0 or width <= 0:
        raise NotAnalysableError(f"{what} lies beside the picture.")
    if min(height, width) < LEAST_SIDE:
        raise NotAnalysableError(
            f"{what} is too small: {height} x {width} px of the picture. "
            f"It takes {LEAST_SIDE} px a side."
        )
    return rows, columns


def _inside(outlines: list[Points], rows: slice, columns: slice) -> NDArray[np.bool_] | None:
    """Return which pixels of a part lie in any of the outlines; None if all do."""
    shape = rows.stop - rows.start, columns.stop - columns.start
    inside = np.zeros(shape, bool)
    for outline in outlines:
        corners = outline - (rows.start, columns.start)
        if _is_upright_box(corners):
            inside[_box(corners, shape)] = True
        else:
            inside |= _filled(corners, shape)
    if not inside.any():
        raise NotAnalysableError("the shape is too small: it encloses no pixel of the picture.")
    return None if inside.all() else inside


def _filled(corners: Points, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which pixels have their centre within a polygon, by the even-odd rule.

    Row by row, so that an outline of thousands of corners takes no longer; scikit-image asks
    every pixel about every corner.
    """
    height, width = shape
    crossed = np.zeros((height, width + 1), bool)
    for (y0, x0), (y1, x1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        first, stop = np.clip(np.ceil(sorted((y0, y1))), 0, height).astype(int)
        rows = np.arange(first, stop)
        if rows.size:
            columns = np.ceil(x0 + (rows - y0) * (x1 - x0) / (y1 - y0))
            crossed[rows, np.clip(columns, 0, width).astype(int)] ^= True
    return np.logical_xor.accumulate(crossed, axis=1)[:, :-1]


def _is_upright_box(corners: Points) -> bool:
    """Tell whether every side of a rectangle runs along the picture's rows or columns."""
    if len(corners) != 4:
        return False
    sides = np.abs(np.roll(corners, -1, axis=0) - corners)
    return bool((sides.min(axis=1) < _ROUNDING).all())
