"""Veils over what is not trusted, for a picture and each part that was measured: no Qt."""

from napari.components import LayerList
from napari.layers import Layer
from napari.types import LayerDataTuple

from napari_defocus.widgets.layers.result_layers import not_trusted_layer
from napari_defocus.widgets.layers.result_metadata import (
    CONFIDENCE,
    NOT_TRUSTED,
    layer_of_result,
    region_of_result,
    results_of,
)


def covers_of(layers: LayerList, name: str, min_confidence: float) -> list[LayerDataTuple]:
    """Return what covers the map of a picture, and those of its parts, where they are less sure.

    Each is made of the newest confidence. At 0 nothing is covered: then only covers that are there
    already are returned, empty.
    """
    newest: dict[str, Layer] = {}
    for confidence in results_of(layers, CONFIDENCE, name):
        newest.setdefault(region_of_result(confidence), confidence)
    return [
        not_trusted_layer(confidence.as_layer_data_tuple(), min_confidence)
        for region, confidence in newest.items()
        if min_confidence > 0 or layer_of_result(layers, NOT_TRUSTED, name, region) is not None
    ]
