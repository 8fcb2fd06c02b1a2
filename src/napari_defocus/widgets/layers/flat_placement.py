"""Where a picture lies that belongs to all planes of a stack. No Qt here, as in `layers`."""

from __future__ import annotations

from typing import Any

import numpy as np
from napari.utils.transforms import CompositeAffine


def of_all_planes(placed: dict[str, Any]) -> dict[str, Any] | None:
    """Return where a picture lies that is seen at all planes; None if planes are tilted."""
    names = ("scale", "translate", "rotate", "shear")
    in_layer = CompositeAffine(**{name: placed[name] for name in names}, ndim=3)
    affine = np.asarray(placed["affine"], float)
    for matrix in (in_layer.linear_matrix, affine[:3, :3]):
        if matrix[0, 1:].any() or matrix[1:, 0].any():
            return None
    flat = in_layer.set_slice([1, 2])
    return {
        "scale": flat.scale,
        "translate": flat.translate,
        "rotate": flat.rotate,
        "shear": flat.shear,
        "affine": affine[1:, 1:],
        "units": placed["units"][1:],
        "axis_labels": placed["axis_labels"][1:],
    }
