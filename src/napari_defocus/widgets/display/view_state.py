"""What a viewer showed before one surface alone was shown in 3-D, to be restored: no Qt."""

import weakref
from dataclasses import dataclass
from typing import Any, Self

from napari.components import ViewerModel
from napari.layers import Image, Layer, Surface


@dataclass(frozen=True)
class CameraView:
    """How a camera looks: its centre in world units, its zoom, its angles in degrees."""

    center: tuple[float, ...]
    zoom: float
    angles: tuple[float, float, float]

    @classmethod
    def of(cls, viewer: ViewerModel) -> Self:
        """Return how a viewer's camera looks now."""
        camera = viewer.scene.camera
        return cls(tuple(camera.center), float(camera.zoom), tuple(camera.angles))

    def restore(self, viewer: ViewerModel) -> None:
        """Let a viewer's camera look like that again."""
        camera = viewer.scene.camera
        camera.angles, camera.center, camera.zoom = self.angles, self.center, self.zoom


class ViewState:
    """What a viewer showed before a relief, and when it is to show it again.

    It is a callback of the viewer, for as long as the relief is there, and lives no longer.

    Parameters
    ----------
    viewer : napari.components.ViewerModel
    image_layer : napari.layers.Image
        Whose relief will be shown.
    """

    relief: weakref.ref[Surface]

    def __init__(self, viewer: ViewerModel, image_layer: Image) -> None:
        self._viewer = weakref.ref(viewer)
        self._image = weakref.ref(image_layer)
        self._visible = _visible(viewer)
        active = viewer.layers.selection.active
        self._active = None if active is None else weakref.ref(active)
        self._flat = self._deep = CameraView.of(viewer)
        self._ndisplay = viewer.dims.ndisplay
        self._axes = viewer.dims.order, viewer.dims.point

    def view_of(self, image_layer: Image) -> CameraView | None:
        """Return how the relief is looked at, if it is of that picture."""
        viewer = self._viewer()
        if viewer is None or self._image() is not image_layer:
            return None
        return CameraView.of(viewer) if viewer.dims.ndisplay == 3 else self._deep

    def wait(self) -> None:
        """Restore it when the relief is removed; between 2-D and 3-D, show what is seen there."""
        viewer = self._viewer()
        if viewer is not None:
            viewer.layers.events.removed.connect(self)
            viewer.dims.events.ndisplay.connect(self)

    def __call__(self, event: Any) -> None:
        """Show what is to be seen after a layer was removed, or the viewer was switched."""
        viewer, relief = self._viewer(), self.relief()
        if viewer is None:
            return
        if relief is None or relief not in viewer.layers:
            self.restore()
        elif event.type == "ndisplay" and viewer.dims.ndisplay == 2:
            # napari is still busy with its axes: removing a layer now would break its sliders.
            self._deep = CameraView.of(viewer)
            self._show_visible(viewer)
            self._go_to_plane(viewer)
        elif event.type == "ndisplay":
            self._visible, self._flat = _visible(viewer), CameraView.of(viewer)
            self._axes = viewer.dims.order, viewer.dims.point
            show_alone(viewer, relief)
            self._deep.restore(viewer)

    def restore(self) -> None:
        """Restore it, and take the relief away."""
        viewer, relief = self._viewer(), self.relief()
        if viewer is None:
            return
        viewer.layers.events.removed.disconnect(self)
        viewer.dims.events.ndisplay.disconnect(self)
        was_shown, view = viewer.dims.ndisplay == 3, CameraView.of(viewer)
        if not was_shown:
            self._axes = viewer.dims.order, viewer.dims.point
        if relief in viewer.layers:
            viewer.layers.remove(relief)
        if was_shown:
            viewer.dims.ndisplay = self._ndisplay
            self._show_visible(viewer)
        else:
            # napari fits its view to the axes that are left.
            view.restore(viewer)
        self._go_to_plane(viewer)
        active = self._active and self._active()
        if active in viewer.layers:
            viewer.layers.selection.active = active

    def _show_visible(self, viewer: ViewerModel) -> None:
        """Show what was visible, as it was looked at."""
        relief = self.relief()
        if relief is not None:
            relief.visible = False
        for reference in self._visible:
            layer = reference()
            if layer is not None:
                layer.visible = True
        self._flat.restore(viewer)

    def _go_to_plane(self, viewer: ViewerModel) -> None:
        """Go to the plane that was shown: napari has followed the camera with its sliders."""
        order, point = self._axes
        # The relief of a picture has one axis more, and without its layer a stack has fewer.
        if viewer.dims.ndim == len(order):
            viewer.dims.order, viewer.dims.point = order, point


def _visible(viewer: ViewerModel) -> list[weakref.ref[Layer]]:
    return [weakref.ref(layer) for layer in viewer.layers if layer.visible]


def show_alone(viewer: ViewerModel, relief: Surface) -> None:
    """Hide every other layer."""
    for layer in viewer.layers:
        layer.visible = layer is relief


def view_state(viewer: ViewerModel) -> ViewState | None:
    """Return the state from before the relief that a viewer shows; None if it shows none."""
    waiting: list[Any] = viewer.layers.events.removed.callbacks
    return next((callback for callback in waiting if isinstance(callback, ViewState)), None)
