"""Results in a viewer: how they say what made them, and how they get there.

No Qt here, as in `layers`.
"""

from typing import Any

from napari.components import LayerList, ViewerModel
from napari.layers import Layer
from napari.types import LayerDataTuple

from napari_defocus import __version__
from napari_defocus.widgets.layers import Plane

METADATA_KEY = "napari_defocus"
"""Where a result layer's metadata say how it was made."""

BLUR_MAP = "blur map"
CONFIDENCE = "confidence"
NOT_TRUSTED = "not trusted"
IN_FOCUS = "in focus"
MEASURED_PSF = "measured PSF"

PLACEMENT = ("scale", "translate", "rotate", "shear", "affine", "units", "axis_labels")
"""The keywords that say where a layer lies."""


def provenance(
    plane: Plane, result: str, settings: dict[str, Any], noise_variance: float, **more: Any
) -> dict[str, Any]:
    """Return the metadata of a result: what it is, of which layer, and what made it.

    Parameters
    ----------
    plane : Plane
        What it was made from.
    result : str
        One of the names above.
    settings : dict
    noise_variance : float
        The variance that was used, found or given; intensities in [0, 1].
    **more
        What else is worth knowing.
    """
    made = {
        "version": __version__,
        "result": result,
        "source": plane.name,
        "noise_variance": float(noise_variance),
        "settings": settings,
    }
    return {METADATA_KEY: made | more}


def made_by_us(layer: Layer) -> str | None:
    """Return what result a layer holds, None if it is no result of ours."""
    made = layer.metadata.get(METADATA_KEY, {})
    return made.get("result") if isinstance(made, dict) else None


def layer_of_result(layers: LayerList, result: str, source: str) -> Layer | None:
    """Return the layer that holds a result of the layer named `source`, if there is one."""
    for layer in layers:
        if made_by_us(layer) == result and layer.metadata[METADATA_KEY].get("source") == source:
            return layer
    return None


def show_results(viewer: ViewerModel, results: list[LayerDataTuple]) -> list[Layer]:
    """Put results into a viewer; those of an earlier run on the same layer are updated.

    Parameters
    ----------
    viewer : napari.components.ViewerModel or napari.Viewer
    results : list of LayerDataTuple
        From the functions above.

    Returns
    -------
    list of napari.layers.Layer
        The layers that hold the results now. An updated layer keeps the colours, the
        opacity and the visibility that its user gave it.
    """
    return [_shown_result(viewer, *result) for result in results]


def _shown_result(viewer: ViewerModel, data: Any, keywords: dict[str, Any], kind: str) -> Layer:
    layer = _earlier_result(viewer.layers, keywords)
    if layer is None:
        layer = viewer.add_layer(Layer.create(data, keywords, kind))
        if kind == "image" and keywords["metadata"][METADATA_KEY]["result"] != MEASURED_PSF:
            layer.colorbar.visible = True
        return layer
    layer.data = data
    for name in PLACEMENT:
        if name in keywords:
            setattr(layer, name, keywords[name])
    layer.metadata = {**layer.metadata, **keywords["metadata"]}
    if kind == "image":
        layer.contrast_limits_range = keywords["contrast_limits"]
        layer.contrast_limits = keywords["contrast_limits"]
    return layer


def _earlier_result(layers: LayerList, keywords: dict[str, Any]) -> Layer | None:
    """Find the layer of that name, unless it is somebody else's work."""
    made = keywords["metadata"][METADATA_KEY]
    for layer in layers:
        if layer.name == keywords["name"] and made_by_us(layer) == made["result"]:
            return layer
    return None
