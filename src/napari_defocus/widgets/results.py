"""Results in a viewer: how they say what made them, and how they get there.

No Qt here, as in `layers`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from napari.components import LayerList, ViewerModel
from napari.layers import Labels, Layer, Surface
from napari.types import LayerDataTuple
from napari.utils.transforms import Affine
from numpy.typing import NDArray

from napari_defocus import __version__
from napari_defocus.widgets.layers import Plane

METADATA_KEY = "napari_defocus"
"""Where a result layer's metadata say how it was made."""

BLUR_MAP = "blur map"
CONFIDENCE = "confidence"
NOT_TRUSTED = "not trusted"
IN_FOCUS = "in focus"
MEASURED_PSF = "measured PSF"
ALL_IN_FOCUS = "all in focus"
REFOCUSED = "refocused"
DEPTH = "depth"
DEPTH_SURFACE = "depth surface"

_WITH_COLOR_BAR = (BLUR_MAP, CONFIDENCE, DEPTH)

PLACEMENT = ("scale", "translate", "rotate", "shear", "affine", "units", "axis_labels")
"""The keywords that say where a layer lies."""


@dataclass(frozen=True, eq=False)
class Results:
    """What a run returns.

    Attributes
    ----------
    layers : list of LayerDataTuple
        See `show_results`.
    summary : str
        What to say about them, in a few lines.
    """

    layers: list[LayerDataTuple]
    summary: str


def provenance(plane: Plane, result: str, settings: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return the metadata of a result: what it is, of which layer, and what made it.

    Parameters
    ----------
    plane : Plane
        What it was made from.
    result : str
        One of the names above.
    settings : dict
    **more
        What else is worth knowing.
    """
    made = {
        "version": __version__,
        "result": result,
        "source": plane.name,
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
        From `result_layers` and other modules that make them.

    Returns
    -------
    list of napari.layers.Layer
        The layers that hold the results now. An updated layer keeps the colours, the
        opacity and the visibility that its user gave it, and the contrast limits, too, if
        their range is the same.
    """
    return list(dict.fromkeys(showing_results(viewer, results)))


def showing_results(viewer: ViewerModel, results: list[LayerDataTuple]) -> Iterator[Layer]:
    """Do the work of `show_results` in small steps, for a window that must not stop.

    Yields
    ------
    napari.layers.Layer
        After each step, the layer that it was about.
    """
    for result in results:
        yield from _showing(viewer, *result)


def _showing(
    viewer: ViewerModel, data: Any, keywords: dict[str, Any], kind: str
) -> Iterator[Layer]:
    layer = _earlier_result(viewer.layers, keywords)
    if layer is not None and getattr(layer, "rgb", False) != keywords.get("rgb", False):
        viewer.layers.remove(layer)
        layer = None
    if layer is None:
        layer = viewer.add_layer(Layer.create(data, keywords, kind))
        if keywords["metadata"][METADATA_KEY]["result"] in _WITH_COLOR_BAR:
            yield layer
            layer.colorbar.visible = True
        yield layer
        return
    _set_data(layer, data, keywords)
    for name in PLACEMENT:
        if name in keywords and not _is(getattr(layer, name), keywords[name]):
            setattr(layer, name, keywords[name])
    layer.metadata = {**layer.metadata, **keywords["metadata"]}
    limits = keywords.get("contrast_limits")
    if limits is not None and tuple(layer.contrast_limits_range) != limits:
        layer.contrast_limits_range = limits
        layer.contrast_limits = limits
    yield layer


def prepare_napari() -> None:
    """Have napari load what layers need: in the thread that makes results, not in the window's."""
    Labels(np.zeros((2, 2), np.uint8), features={"index": [0, 1]})


def _is(now: Any, wanted: Any) -> bool:
    """Tell whether a layer lies somewhere already: moving it there redraws all layers."""
    if isinstance(now, Affine):
        now = now.affine_matrix
    if isinstance(wanted, tuple):
        return tuple(now) == wanted
    return bool(np.array_equal(now, wanted))


def _set_data(layer: Layer, data: Any, keywords: dict[str, Any]) -> None:
    if isinstance(layer, Surface):
        # Colours of another number of vertices would not fit the new data.
        layer.vertex_colors = None
        layer.data = data
        layer.vertex_colors = keywords.get("vertex_colors")
    elif isinstance(layer.data, np.ndarray) and _alike(layer.data, data):
        if not np.array_equal(layer.data, data, equal_nan=data.dtype.kind == "f"):
            # Other data of the same shape would make napari build the picture anew.
            layer.data[...] = data
            layer.refresh(extent=False)
            layer.events.data()
    else:
        layer.data = data


def _alike(now: NDArray[Any], data: NDArray[Any]) -> bool:
    return now.shape == data.shape and now.dtype == data.dtype and now.flags.writeable


def _earlier_result(layers: LayerList, keywords: dict[str, Any]) -> Layer | None:
    """Find the layer of that name, unless it is somebody else's work."""
    made = keywords["metadata"][METADATA_KEY]
    for layer in layers:
        if layer.name == keywords["name"] and made_by_us(layer) == made["result"]:
            return layer
    return None
