"""Labels as the part of a plane that is judged: tissue or cells, not the glass beside them.

No Qt here, as in `layers`.
"""

import numpy as np
from napari.components import Dims
from napari.layers import Labels

from napari_defocus.widgets.layers.alignment import lies_on
from napari_defocus.widgets.layers.image_layers import (
    NotAnalysableError,
    Plane,
    finest,
    shown_index,
    unwrapped,
)
from napari_defocus.widgets.layers.region import Region


def region_of_labels(plane: Plane, labels: Labels, dims: Dims) -> Region:
    """Return all of a plane, of which only counts what has a label that is not 0.

    Parameters
    ----------
    plane : Plane
        The whole plane that is shown.
    labels : napari.layers.Labels
        With the axes of the image, or of its planes alone: then it holds for all of them.
    dims : napari.components.Dims

    Raises
    ------
    NotAnalysableError
        If the layer lies elsewhere, or marks nothing there.
    """
    layer = unwrapped(labels)
    index = shown_index(layer, dims, finest(layer).shape)
    marked = np.asarray(finest(layer)[index]) != 0
    if marked.shape != plane.shape or not lies_on(layer, index, plane):
        raise NotAnalysableError(
            f"the labels “{layer.name}” lie elsewhere than the picture, or have another size."
        )
    if not marked.any():
        raise NotAnalysableError(f"the labels “{layer.name}” mark nothing of the plane shown.")
    rows, columns = (slice(0, length) for length in plane.shape)
    return Region(rows, columns, None if marked.all() else marked, f"labels “{layer.name}”")
