"""A map of distances, or of blur, as a mesh: a surface of triangles, for 3-D viewers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import check_number
from napari_defocus.core.image import given_reals, prepare_image, shown_colors
from napari_defocus.optics.thin_lens import checked_depth

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_MOST_VERTICES = 250_000
"""The most vertices, unless a step is given. Chosen by hand."""

_RANGE = (1, 99)
"""Percentiles of the distances that are near and far. Chosen by hand."""


@dataclass(frozen=True)
class DepthSurface:
    """A surface of triangles, as `depth_surface` and `blur_surface` make it.

    Attributes
    ----------
    vertices : (V, 3) float32 ndarray
        z, y, x of each corner, in px of the picture: y and x are row and column, and z grows
        towards who looks at it.
    faces : (F, 3) int32 ndarray
        The three corners of each triangle, as indices of `vertices`: counter-clockwise for who
        looks at the picture. Every vertex is a corner of at least one.
    colors : (V, 3) float32 ndarray or None
        Red, green and blue of each vertex, in [0, 1].
    """

    vertices: Float32
    faces: NDArray[np.int32]
    colors: Float32 | None


def depth_surface(
    depth: ArrayLike,
    image: ArrayLike | None = None,
    *,
    step: int | None = None,
    largest_jump: float = 0.05,
    relief: float = 0.5,
    intensity_range: tuple[float, float] | None = None,
) -> DepthSurface:
    r"""Make a surface from a map of distances, to look at in three dimensions.

    It is a relief on top of the picture, in px,

    .. math:: z = \text{relief} \cdot \max(H, W) \,
        \frac{d_{\text{far}} - d}{d_{\text{far}} - d_{\text{near}}}

    where near and far are the 1st and the 99th percentile of the distances d. So z is 0 at far, and
    grows towards you in napari's 3-D view as it first opens. It is not a scale model. Distances far
    outside of near and far are drawn at a limit. The surface has a hole where a distance is
    infinite or NaN, and is torn where distances jump.

    Parameters
    ----------
    depth : (H, W) array_like
        Distance in any unit, above 0, such as from `depth_from_blur`. Infinity and NaN are
        left out.
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like, optional
        A picture of the same height and width that gives the colours, see
        `estimate_candidates`; opacity is left out.
    step : int, optional
        Take every `step`-th row and column. By default the surface has up to 250 000 vertices.
    largest_jump : float, optional
        No triangle spans distances whose difference is more than this share of the smallest.
    relief : float, optional
        The distance of near and far in z, as a share of the longer side.
    intensity_range : (float, float), optional
        The intensities of `image` that are drawn black and white.

    Returns
    -------
    DepthSurface

    Raises
    ------
    TypeError
        If `depth` holds no real numbers, `image` is not a picture, `step` is not a whole number, or
        another argument is not a number.
    ValueError
        If `depth` has another number of axes than two, or distances of 0 or below, `image` has
        another size, `step` is not from 1 to below the shorter side, `largest_jump` or
        `relief` is not above 0, or no triangle is left.

    Examples
    --------
    In napari: ``viewer.add_surface((surface.vertices, surface.faces),
    vertex_colors=surface.colors)``.

    >>> import numpy as np
    >>> surface = depth_surface([[1.00, 1.02, 1.04], [1.00, 1.02, 2.00]])
    >>> surface.vertices.round(2)
    array([[1.5 , 0.  , 0.  ],
           [1.47, 0.  , 1.  ],
           [1.44, 0.  , 2.  ],
           [1.5 , 1.  , 0.  ],
           [1.47, 1.  , 1.  ]], dtype=float32)
    >>> surface.faces
    array([[0, 3, 1],
           [1, 4, 2],
           [1, 3, 4]], dtype=int32)
    """
    distance = checked_depth(depth)
    if distance.ndim != 2 or min(distance.shape) < 2:
        raise ValueError(f"depth has shape {distance.shape}; it takes (H, W), 2 px or more a side")
    check_number("largest_jump", largest_jump, lambda j: j > 0, "a number above 0")
    check_number("relief", relief, lambda r: 0 < r < math.inf, "a finite number above 0")
    color = None if image is None else picture_colors(image, distance.shape, intensity_range)
    rows, columns = _grid(distance.shape, step)
    corner = distance[rows, columns]
    triangles = _triangles(corner, lambda nearest: largest_jump * nearest)
    if not len(triangles):
        raise ValueError(
            "depth leaves no triangle; it takes neighbours that are finite and within "
            f"largest_jump = {largest_jump:g} of each other"
        )
    height = _heights(corner, relief * max(distance.shape))
    return _surface(triangles, height, rows, columns, color)


def blur_surface(
    blur_map: ArrayLike,
    *,
    max_scale: float,
    step: int | None = None,
    largest_jump: float = 0.5,
    relief: float = 0.5,
) -> DepthSurface:
    """Make a surface from a blur map, to look at in three dimensions.

    What is in focus stands out: z = relief max(H, W) (1 - r / max_scale), in px of the picture.
    So a px of blur is as high in every picture of a size, and a map that says the same
    everywhere is flat. Whether what is blurred lies before or behind the focus, the blur does
    not say: it is drawn behind. The surface has a hole where the blur is not known, and is torn
    where it jumps.

    Parameters
    ----------
    blur_map : (H, W) array_like
        Scale in px, from 0 up, such as from `estimate_blur_map`. NaN is left out.
    max_scale : float
        The scale, in px, that is drawn at z = 0, such as the largest of the PSF family.
    step : int, optional
        See `depth_surface`.
    largest_jump : float, optional
        No triangle spans scales whose difference is more than this, in px.
    relief : float, optional
        How far 0 px and `max_scale` are apart in z, as a share of the longer side.

    Returns
    -------
    DepthSurface
        Without colours.

    Raises
    ------
    TypeError, ValueError
        As `depth_surface`, if `blur_map` is infinite or below 0 somewhere, or `max_scale` is
        not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> surface = blur_surface([[0.0, 0.2, 4.0], [0.0, 0.2, 4.0]], max_scale=8.0)
    >>> surface.vertices.round(2)
    array([[1.5 , 0.  , 0.  ],
           [1.46, 0.  , 1.  ],
           [1.5 , 1.  , 0.  ],
           [1.46, 1.  , 1.  ]], dtype=float32)
    """
    scale = _checked_scale(blur_map)
    for name, value in (("max_scale", max_scale), ("relief", relief)):
        check_number(name, value, lambda v: 0 < v < math.inf, "a finite number above 0")
    check_number("largest_jump", largest_jump, lambda j: j > 0, "a number above 0")
    rows, columns = _grid(scale.shape, step)
    corner = scale[rows, columns]
    triangles = _triangles(corner, lambda _: largest_jump)
    if not len(triangles):
        raise ValueError(
            "blur_map leaves no triangle; it takes neighbours that are known and within "
            f"largest_jump = {largest_jump:g} px of each other"
        )
    height = relief * max(scale.shape) * (1 - corner / max_scale)
    return _surface(triangles, height, rows, columns)


def picture_colors(
    image: ArrayLike, shape: tuple[int, ...], intensity_range: tuple[float, float] | None
) -> Float32:
    """Return the colours of a picture of that height and width, (H, W, 3) in [0, 1]."""
    picture = prepare_image(image, intensity_range)
    if picture.shape != shape:
        raise ValueError(f"image has height and width {picture.shape}; it takes the map's, {shape}")
    return np.broadcast_to(shown_colors(picture), (*shape, 3))


def _checked_scale(blur_map: ArrayLike) -> Float64:
    scale = given_reals("blur_map", blur_map)
    if scale.ndim != 2 or min(scale.shape) < 2:
        raise ValueError(f"blur_map has shape {scale.shape}; it takes (H, W), 2 px or more a side")
    if np.isinf(scale).any() or (scale < 0).any():
        raise ValueError("blur_map has values that are infinite or below 0; it takes px, or NaN")
    return scale


def _surface(
    triangles: NDArray[np.intp],
    height: Float64,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    color: Float32 | None = None,
) -> DepthSurface:
    """Return the surface of those triangles of a grid, whose corners are `height` high."""
    used, faces = np.unique(triangles, return_inverse=True)
    row, column = (np.broadcast_to(index, height.shape).ravel()[used] for index in (rows, columns))
    return DepthSurface(
        vertices=np.stack([height.ravel()[used], row, column], axis=1).astype(np.float32),
        faces=faces.reshape(-1, 3).astype(np.int32),
        colors=None if color is None else color[row, column],
    )


def _grid(shape: tuple[int, ...], step: int | None) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows, (R, 1), and columns, (1, C), that are taken, about the picture's middle."""
    if step is None:
        step = 1
        while math.prod(-(-side // step) for side in shape) > _MOST_VERTICES:
            step += 1
        step = min(step, min(shape) - 1)
    takes = f"a whole number from 1 to below the shorter side, {min(shape)} px, or None"
    check_number("step", step, lambda s: 1 <= s < min(shape), takes, Integral)
    rows, columns = (np.arange((side - 1) % step // 2, side, step) for side in shape)
    return rows[:, None], columns[None]


def _triangles(corner: Float64, jump_at: Callable[[Float64], Any]) -> NDArray[np.intp]:
    """Return the triangles of a grid of values that tear nowhere: flat indices, (F, 3).

    Where the smallest value of a triangle is v, its values may be `jump_at(v)` apart.
    """
    index = np.arange(corner.size).reshape(corner.shape)
    above, below = index[:-1], index[1:]
    upper = np.stack([above[:, :-1], below[:, :-1], above[:, 1:]], axis=-1)
    lower = np.stack([above[:, 1:], below[:, :-1], below[:, 1:]], axis=-1)
    triangles = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    values = corner.ravel()[triangles]
    triangles = triangles[np.isfinite(values).all(axis=1)]
    values = corner.ravel()[triangles]
    smallest = values.min(axis=1)
    return triangles[values.max(axis=1) - smallest <= jump_at(smallest)]


def _heights(corner: Float64, height: float) -> Float64:
    """Return z of distances: 0 at their 99th percentile, `height` at their 1st."""
    finite = corner[np.isfinite(corner)]
    near, far = np.percentile(finite, _RANGE)
    if near == far:
        near, far = finite.min(), finite.max()
    span = far - near
    if span == 0:
        return np.zeros(corner.shape)
    return height * (far - np.clip(corner, near - span, far + span)) / span
