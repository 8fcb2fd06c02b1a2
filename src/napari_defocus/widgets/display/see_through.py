"""Maps are half transparent while seeds are painted: whoever paints must see the picture. No Qt."""

import weakref
from typing import Any

from napari.components import ViewerModel
from napari.layers import Labels, Layer

from napari_defocus.widgets.layers.image_layers import unwrapped
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    NOT_TRUSTED,
    made_by_us,
)

SEEN_THROUGH = 0.5
"""Times the opacity that a layer had."""

_COVERING = (BLUR_MAP, CONFIDENCE, NOT_TRUSTED)


class SeeThrough:
    """Lets the picture be seen through its maps while a brush is at work on a layer of seeds.

    Parameters
    ----------
    viewer : napari.components.ViewerModel
    """

    def __init__(self, viewer: ViewerModel) -> None:
        self._viewer = viewer
        self._seeds: weakref.ref[Labels] | None = None
        self._opacity: weakref.WeakKeyDictionary[Layer, tuple[float, float]] = (
            weakref.WeakKeyDictionary()
        )
        for signal in self._signals():
            signal.connect(self._update)

    def _signals(self) -> list[Any]:
        layers = self._viewer.layers
        return [layers.selection.events.active, layers.events.inserted, layers.events.removed]

    def watch(self, layer: Labels | None) -> None:
        """Follow the brush of a layer, or of none, instead of the one before."""
        before, layer = self._watched(), unwrapped(layer)
        if before is not None:
            before.events.mode.disconnect(self._update)
        self._seeds = None if layer is None else weakref.ref(layer)
        if layer is not None:
            layer.events.mode.connect(self._update)
        self._update()

    def end(self) -> None:
        """Follow nothing any more, and leave all layers as they were."""
        self.watch(None)
        for signal in self._signals():
            signal.disconnect(self._update)

    def _watched(self) -> Labels | None:
        return None if self._seeds is None else self._seeds()

    def is_painting(self) -> bool:
        """Tell whether a stroke of the mouse would be a seed."""
        seeds = self._watched()
        active = unwrapped(self._viewer.layers.selection.active)
        return seeds is not None and active is seeds and str(seeds.mode) != "pan_zoom"

    def _update(self, _: Any = None) -> None:
        if not self.is_painting():
            for layer, (before, thin) in list(self._opacity.items()):
                # Whoever has moved the slider meanwhile knows better.
                if layer.opacity == thin:
                    layer.opacity = before
            self._opacity.clear()
            return
        for layer in map(unwrapped, self._viewer.layers):
            if made_by_us(layer) in _COVERING and layer not in self._opacity:
                before = layer.opacity
                layer.opacity = SEEN_THROUGH * before
                self._opacity[layer] = before, layer.opacity
