"""The analysed window as a rectangle in the picture.

No Qt here, as in `layers`.
"""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image, Shapes
from numpy.typing import NDArray

from napari_defocus import __version__
from napari_defocus.widgets.layers.image_layers import move_to, placement
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY

PROBE = "probe"
OUTLINE_COLOR = "#ffd400"
OUTLINE_WIDTH = 2.0
"""In px of the screen."""


class WindowOutline:
    """A rectangle in the viewer around what was analysed, made when it is first shown.

    Parameters
    ----------
    viewer : napari.components.ViewerModel or napari.Viewer
    on_deleted : callable
        Called when somebody else than this object takes its layer away.

    Attributes
    ----------
    layer : napari.layers.Shapes or None
        None while there is nothing to show.
    """

    def __init__(self, viewer: ViewerModel, on_deleted: Callable[[], None]) -> None:
        self._viewer = viewer
        self._on_deleted = on_deleted
        self._image: Image | None = None
        self._compiling: threading.Thread | None = None
        self._hidden = False
        self.layer: Shapes | None = None

    def show(self, image: Image, corners: NDArray[np.floating]) -> bool:
        """Outline a window of an image instead of another one; False if napari cannot draw yet.

        Ask again then. Corners are (4, D), in the layer's data coordinates.
        """
        if not self._ready():
            return False
        if self._image is not image:
            self.remove()
            self._add(image, corners)
        elif self.layer is not None and not np.array_equal(self.layer.data, [corners]):
            self.layer.data = [corners]
        if self._hidden and self.layer is not None:
            self.layer.visible = True
        self._hidden = False
        if self.layer is not None:
            move_to(self.layer, _placement(image))
        self.fit_zoom()
        return True

    def hide(self) -> None:
        """Show no rectangle for now; napari takes some tenths of a second to make a new one."""
        if self._image is not None and self._image not in self._viewer.layers:
            self.remove()
        if self.layer is not None and self.layer.visible:
            self.layer.visible = False
            self._hidden = True

    def _ready(self) -> bool:
        """Have napari compile what it draws shapes with, in a thread.

        The first shape after an installation takes seconds, the first of a session some tenths
        of one; that must not stop the mouse.
        """
        if self._compiling is None:
            corners = np.array([(0, 0), (0, 1), (1, 1), (1, 0)], float)
            self._compiling = threading.Thread(
                target=lambda: Shapes([corners], shape_type="rectangle"), daemon=True
            )
            self._compiling.start()
        return not self._compiling.is_alive()

    def remove(self) -> None:
        """Take the rectangle away."""
        layer, self.layer = self.layer, None
        self._image, self._hidden = None, False
        if layer is None:
            return
        self._viewer.layers.events.removed.disconnect(self._on_removed)
        self._viewer.scene.camera.events.zoom.disconnect(self._on_zoom)
        if layer in self._viewer.layers:
            self._viewer.layers.remove(layer)

    def fit_zoom(self) -> None:
        """Make its line as wide on the screen as it was."""
        if self.layer is None:
            return
        ends = self.layer.data[0][:2]
        drawn = np.linalg.norm(np.subtract(*(self.layer.data_to_world(end) for end in ends)))
        zoom = self._viewer.scene.camera.zoom
        width = OUTLINE_WIDTH / zoom * np.linalg.norm(np.subtract(*ends)) / drawn
        if not np.allclose(self.layer.edge_width, width, rtol=0.02):
            self.layer.edge_width = width
            # Setting it does not draw it.
            self.layer.refresh()

    def _add(self, image: Image, corners: NDArray[np.floating]) -> None:
        layer = Shapes(
            [corners],
            shape_type="rectangle",
            name=PROBE,
            face_color="transparent",
            edge_color=OUTLINE_COLOR,
            metadata={METADATA_KEY: {"version": __version__, "result": PROBE}},
            **_placement(image),
        )
        layer.editable = False
        layers = self._viewer.layers
        selected = set(layers.selection)
        layers.append(layer)
        # What is new is selected; whoever paints goes on painting.
        layers.selection.intersection_update(selected)
        layers.selection.update(selected)
        self._image, self.layer = image, layer
        layers.events.removed.connect(self._on_removed)
        self._viewer.scene.camera.events.zoom.connect(self._on_zoom)

    def _on_zoom(self, _: Any = None) -> None:
        self.fit_zoom()

    def _on_removed(self, event: Any) -> None:
        if self.layer is not None and event.value == self.layer:
            self.remove()
            self._on_deleted()


def _placement(image: Image) -> dict[str, Any]:
    return placement(image, (slice(None),) * image.ndim)
