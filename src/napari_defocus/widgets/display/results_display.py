"""Results of an analysis shown: the brush stays where it is, the veil follows the confidence."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from napari.components import ViewerModel
from napari.layers import Layer
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.widgets.display.add_results import add_results_stepwise, move_to_top
from napari_defocus.widgets.display.covers import covers_of
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    DEFOCUS,
    IN_FOCUS,
    METADATA_KEY,
    REGION,
    layer_of_result,
    made_by_us,
)


class ResultsDisplay:
    """Puts the results of an analysis into a viewer, while somebody may be painting seeds.

    Parameters
    ----------
    viewer : napari.components.ViewerModel
    seeds : callable
        Returns the layer that is chosen for seeds, or None.
    """

    def __init__(self, viewer: ViewerModel, seeds: Callable[[], Layer | None]) -> None:
        self._viewer, self._seeds = viewer, seeds

    def showing(
        self, results: list[LayerDataTuple], *, keep_earlier: bool = False
    ) -> Iterator[Layer]:
        """Show results step by step; whoever paints seeds goes on painting on their layer."""
        selection = self._viewer.layers.selection
        painted = selection.active
        for layer in add_results_stepwise(self._viewer, results, keep_earlier=keep_earlier):
            # Other widgets hide the map that they make on the way.
            if made_by_us(layer) == BLUR_MAP and not layer.visible:
                layer.visible = True
            yield layer
        if painted is not None and painted == self._seeds():
            move_to_top(self._viewer, painted)
            selection.active = painted

    def choose_first(self, results: list[LayerDataTuple]) -> None:
        """Make the map the active layer, or the mask, unless somebody paints seeds."""
        selection, made = self._viewer.layers.selection, results[0][1]["metadata"][METADATA_KEY]
        first = self._newest(made["result"], made)
        if first is not None and (selection.active is None or selection.active != self._seeds()):
            selection.active = first

    def cover(self, name: str, min_confidence: float) -> None:
        """Cover what is not trusted by the confidence layers of a picture and its parts."""
        for cover in covers_of(self._viewer.layers, name, min_confidence):
            for _ in self.showing([cover]):
                pass

    def confidence(self, results: list[LayerDataTuple]) -> NDArray[np.floating] | None:
        """Return the confidence that is shown of what results are of, if it is."""
        made = results[0][1]["metadata"][METADATA_KEY]
        layer = self._newest(CONFIDENCE, made)
        if layer is None:
            return None
        # Of a pyramid, the smallest level tells enough, and is read at once.
        return np.asarray(layer.data[-1] if layer.multiscale else layer.data)

    def shown_beside(self, results: list[LayerDataTuple]) -> list[LayerDataTuple]:
        """Return the map and the mask that are shown of what results are of, if they are not among
        them: a slider renews one and leaves the other.
        """
        made = results[0][1]["metadata"][METADATA_KEY]
        renewed = {keywords["metadata"][METADATA_KEY]["result"] for _, keywords, _ in results}
        wanted = [name for name in (BLUR_MAP, DEFOCUS, IN_FOCUS) if name not in renewed]
        found = [layer for name in wanted if (layer := self._newest(name, made)) is not None]
        return [layer.as_layer_data_tuple() for layer in found if not layer.multiscale]

    def _newest(self, result: str, made: dict[str, Any]) -> Layer | None:
        """Return the newest layer of a result of the same part of the same picture."""
        region = (made.get(REGION) or {}).get("of", "")
        return layer_of_result(self._viewer.layers, result, made["source"], region)
