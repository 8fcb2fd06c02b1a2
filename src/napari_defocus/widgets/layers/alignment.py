"""Another layer on a plane: which part of it belongs to a part, and whether it lies there.

No Qt here, as in `layers`.
"""

import numpy as np
from napari.layers import Layer
from numpy.typing import NDArray

from napari_defocus.widgets.layers.image_layers import Plane, corner, picture_axes, sizes_at


def same_part(
    index: tuple[int | slice, ...], shape: tuple[int, ...], plane: Plane
) -> tuple[int | slice, ...]:
    """Return an index of a whole plane in another layer's data, cut as a plane is cut.

    It is `index` itself if the other layer has not the height and width of the whole plane: it may
    be as large as the part.
    """
    if sizes_at(index, shape) != plane.whole_shape:
        return index
    cuts = iter(plane.cuts)
    return tuple(at if isinstance(at, int) else next(cuts) for at in index)


def lies_on(layer: Layer, index: tuple[int | slice, ...], plane: Plane) -> bool:
    """Tell whether a layer's corners, at an index of its data, are where a plane's are.

    To half a pixel; the layer is as high and wide there as the plane.
    """
    image = plane.layer()
    if image is None:
        return False
    expected = _corners(image, plane.index, plane.shape)
    found = _corners(layer, index, plane.shape)
    pixel = np.linalg.norm(expected[3] - expected[0]) / np.linalg.norm(np.subtract(plane.shape, 1))
    return bool(np.abs(found - expected).max() < pixel / 2)


def _corners(
    layer: Layer, index: tuple[int | slice, ...], shape: tuple[int, int]
) -> NDArray[np.floating]:
    """Return the world coordinates of a plane's corner pixels along its own axes: (4, 2)."""
    shown = picture_axes(index)
    points = np.tile(np.array(corner(index), float), (4, 1))
    points[:, shown] += np.array(list(np.ndindex(2, 2))) * np.subtract(shape, 1)
    return np.array([layer.data_to_world(point) for point in points])[:, shown]
