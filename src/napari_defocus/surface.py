"""A map of distances as a surface of triangles, for 3-D viewers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.depth import checked_depth
from napari_defocus.image import prepare_image
from napari_defocus.psf import check_number

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_MOST_VERTICES = 250_000
_RANGE = (1, 99)


@dataclass(frozen=True)
class DepthSurface:
    """A surface of triangles, as `depth_surface` makes it.

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
    """Make a surface of a map of distances, to be looked at in three dimensions.

    It is a relief on top of the picture: z = relief max(H, W) (far - d) / (far - near), in px,
    where near and far are the 1st and the 99th percentile of the distances d. So z is 0 at far
    and the larger the nearer, which is towards you in napari's 3-D view as it first opens.
    It is no scale model. What lies farther outside of near and far than they are apart is drawn
    no farther out than that. The surface has a hole where a distance is infinite or NaN, and is
    torn where distances jump.

    Parameters
    ----------
    depth : (H, W) array_like
        Distance in any unit, above 0, such as from `depth_from_blur`. Infinity and NaN are
        left out.
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like, optional
        A picture of the same height and width that gives the colours, see
        `estimate_candidates`; opacity is left out.
    step : int, optional
        Take every `step`-th row and column; by default as many as 250 000 vertices allow.
    largest_jump : float, optional
        No triangle spans distances whose difference is more than this share of the smallest.
    relief : float, optional
        How far near and far are apart in z, as a share of the longer side.
    intensity_range : (float, float), optional
        The intensities of `image` that are drawn black and white.

    Returns
    -------
    DepthSurface

    Raises
    ------
    TypeError
        If `depth` holds no real numbers, `image` is no picture, `step` is no whole number, or
        another argument is no number.
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
    color = None if image is None else _colors(image, distance.shape, intensity_range)
    rows, columns = _grid(distance.shape, step)
    corner = distance[rows, columns]
    triangles = _triangles(corner, largest_jump)
    if not len(triangles):
        raise ValueError(
            "depth leaves no triangle; it takes neighbours that are finite and within "
            f"largest_jump = {largest_jump:g} of each other"
        )
    used, faces = np.unique(triangles, return_inverse=True)
    row, column = (np.broadcast_to(index, corner.shape).ravel()[used] for index in (rows, columns))
    z = _heights(corner, relief * max(distance.shape)).ravel()[used]
    return DepthSurface(
        vertices=np.stack([z, row, column], axis=1).astype(np.float32),
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


def _triangles(corner: Float64, largest_jump: float) -> NDArray[np.intp]:
    """Return the triangles of a grid of distances that tear nowhere: flat indices, (F, 3)."""
    index = np.arange(corner.size).reshape(corner.shape)
    above, below = index[:-1], index[1:]
    upper = np.stack([above[:, :-1], below[:, :-1], above[:, 1:]], axis=-1)
    lower = np.stack([above[:, 1:], below[:, :-1], below[:, 1:]], axis=-1)
    triangles = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    distances = corner.ravel()[triangles]
    triangles = triangles[np.isfinite(distances).all(axis=1)]
    distances = corner.ravel()[triangles]
    nearest = distances.min(axis=1)
    return triangles[distances.max(axis=1) - nearest <= largest_jump * nearest]


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


def _colors(
    image: ArrayLike, shape: tuple[int, ...], intensity_range: tuple[float, float] | None
) -> Float32:
    """Return the colours of a picture, (H, W, 3) in [0, 1]."""
    picture = prepare_image(image, intensity_range)
    if picture.shape != shape:
        raise ValueError(
            f"image has height and width {picture.shape}; it takes the depth's, {shape}"
        )
    return np.broadcast_to(np.clip(picture.color, 0, 1), (*shape, 3))
