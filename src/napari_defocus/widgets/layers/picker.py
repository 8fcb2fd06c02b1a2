"""One click in the picture: no Qt, works on a `napari.components.ViewerModel` too."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image, Layer

from napari_defocus.widgets.layers.image_layers import finest


class ClickPicker:
    """Waits for a click in the picture, once it is started, and for no other after it.

    Parameters
    ----------
    viewer : napari.components.ViewerModel or napari.Viewer
    take : callable
        Called with the world coordinates of a click. It returns whether it could use them;
        else the next click is waited for.
    """

    def __init__(self, viewer: ViewerModel, take: Callable[[tuple[float, ...]], bool]) -> None:
        self._viewer = viewer
        self._take = take
        self._mode: tuple[Layer, str] | None = None

    @property
    def waiting(self) -> bool:
        """Whether a click is waited for."""
        return self._on_press in self._viewer.mouse_drag_callbacks

    def start(self) -> None:
        """Wait for a click; the active layer's brush rests until it has come."""
        if self.waiting:
            return
        self._viewer.mouse_drag_callbacks.append(self._on_press)
        active = self._viewer.layers.selection.active
        if active is not None:
            self._mode = active, active.mode
            active.mode = "pan_zoom"

    def stop(self) -> None:
        """Wait no longer."""
        if not self.waiting:
            return
        self._viewer.mouse_drag_callbacks.remove(self._on_press)
        if self._mode is not None:
            layer, mode = self._mode
            layer.mode = mode
            self._mode = None

    def _on_press(self, viewer: Any, event: Any) -> Iterator[None]:
        taken = self._take(tuple(event.position))
        # napari goes through the list of callbacks until then.
        yield
        if taken:
            self.stop()


def value_at(layer: Image, position: tuple[float, ...]) -> float | None:
    """Return the value of an image layer at world coordinates; None outside of it, and for NaN."""
    data = finest(layer)
    at = np.rint(layer.world_to_data(position)).astype(int)
    if any(not 0 <= index < length for index, length in zip(at, data.shape, strict=True)):
        return None
    value = float(np.asarray(data[tuple(at)]))
    return value if np.isfinite(value) else None
