"""The widget that shows why the map says what it says under the mouse."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from magicgui.widgets import CheckBox, ComboBox, Container, Label, Widget
from napari.components import ViewerModel
from napari.layers import Image, Layer
from qtpy.QtCore import Qt, QTimer

from napari_defocus.widgets.display.probing import (
    NothingKnownError,
    Probed,
    image_of,
    image_to_probe,
    lay_down_tools,
    may_pin,
    probed,
)
from napari_defocus.widgets.display.window_outline import WindowOutline
from napari_defocus.widgets.forms.accessibility import describe
from napari_defocus.widgets.forms.image_panel import ImagePanel
from napari_defocus.widgets.forms.likelihood_canvas import LikelihoodCanvas
from napari_defocus.widgets.forms.qt_lifetime import when_destroyed
from napari_defocus.widgets.forms.run_panel import wrap
from napari_defocus.widgets.forms.tabs import become_a_tab
from napari_defocus.widgets.layers.result_metadata import pictures_in

INTERVAL = 40
"""Least time between two updates while the mouse moves, in ms."""

PATIENCE = 300
"""Time until the outline is tried again if napari was not ready, in ms."""

LINES = 7
"""Of text, for which there is always room: else the curve would jump."""

STILL = 4
"""How far, in px of the screen, a click may move."""


class ProbeWidget(Container[Widget]):
    """Show what is known about the blur under the mouse, and of what part of the picture.

    It estimates nothing: it shows what the other widgets have found.

    Attributes
    ----------
    image : magicgui.widgets.ComboBox
        The image layer.
    follow : magicgui.widgets.CheckBox
        Whether the mouse is followed; a click pins the place and switches it off.
    outlined : magicgui.widgets.CheckBox
        Whether the analysed window is outlined in the picture.
    text : magicgui.widgets.Label
        The explanation in words, or why there is none.
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        self._viewer = napari_viewer
        self._position: tuple[float, ...] | None = None
        self._watching = False
        self._outline = WindowOutline(napari_viewer, on_deleted=lambda: self._on_outline_deleted())
        self.image = ComboBox(
            name="image",
            label="image",
            choices=self._images,
            tooltip="The image layer whose blur is explained. It must have been measured.",
        )
        self.follow = CheckBox(
            name="follow",
            text="Follow the mouse",
            value=True,
            tooltip="Explain the place under the mouse. A click pins a place, to study it.",
        )
        self.outlined = CheckBox(
            name="outlined",
            text="Outline the frame",
            value=True,
            tooltip="Show in the picture what part of it the curve was measured on.",
        )
        self.text = Label(name="text", label=" ", value="")
        super().__init__()
        self.extend([self.image, self.follow, self.outlined, self.text])
        self._curve = LikelihoodCanvas(on_shown=lambda: self.start(), on_hidden=lambda: self.stop())
        self.native.layout().insertWidget(len(self) - 1, self._curve, 1)
        self._make_room_for_text()
        describe([self.image, self.follow, self.outlined])
        self._timer = QTimer(self.native)
        self._timer.setSingleShot(True)
        self._timer.timeout.connect(lambda: self.refresh())
        when_destroyed(self.native, self, lambda probe: probe.stop())
        become_a_tab(self.native)
        self.image.changed.connect(lambda _: self.refresh())
        self.outlined.changed.connect(lambda _: self.refresh())
        self.reset_choices()
        self.set_image(image_to_probe(napari_viewer, ImagePanel.cache))

    def _make_room_for_text(self) -> None:
        wrap(self.text)
        native = self.text.native
        native.setAlignment(Qt.AlignLeft | Qt.AlignTop)
        native.setMinimumHeight(LINES * native.fontMetrics().lineSpacing())

    def _images(self, _: Any) -> list[Image]:
        return pictures_in(self._viewer.layers)

    def set_image(self, layer: Layer | None) -> None:
        """Choose an image layer, or the one that a result layer was made of."""
        image = image_of(self._viewer.layers, layer)
        if image is None:
            return
        if image not in self.image.choices:
            self.reset_choices()
        if image in self.image.choices:
            self.image.value = image

    def refresh(self) -> None:
        """Explain the same place again, after something new was found."""
        if not self._watching or self._position is None:
            return
        self._timer.stop()
        try:
            found = self._probed(self._position)
        except NothingKnownError as reason:
            self._show_nothing(str(reason))
        else:
            self._show(found)

    def start(self) -> None:
        """Watch the mouse; done whenever the widget comes into sight.

        A brush that is still at work rests from then on, and the map is selected: a click pins a
        place, and paints nothing.
        """
        if self._watching:
            return
        self._watching = True
        lay_down_tools(self._viewer, self.image.value)
        self._viewer.mouse_move_callbacks.append(self._on_move)
        self._viewer.mouse_drag_callbacks.append(self._on_press)
        self._viewer.events.theme.connect(self._on_theme)
        self._viewer.dims.events.current_step.connect(self._on_dims)
        self._curve.dress(self._viewer.theme)
        if self._position is None:
            self._show_nothing("Move the mouse over the picture; a click pins the place.")
        else:
            self.refresh()

    def stop(self) -> None:
        """Watch no longer, and take the outline away; done whenever the widget is out of sight."""
        if not self._watching:
            return
        self._watching = False
        self._viewer.mouse_move_callbacks.remove(self._on_move)
        self._viewer.mouse_drag_callbacks.remove(self._on_press)
        self._viewer.events.theme.disconnect(self._on_theme)
        self._viewer.dims.events.current_step.disconnect(self._on_dims)
        self._outline.remove()

    def _probed(self, position: tuple[float, ...]) -> Probed:
        return probed(self._viewer, self.image.value, position, ImagePanel.cache)

    def _show(self, found: Probed) -> None:
        self._curve.draw_explanation(found.explanation)
        self.text.value = str(found.explanation)
        if not self.outlined.value:
            self._outline.remove()
        elif not self._outline.show(found.image, found.corners):
            self._timer.start(PATIENCE)

    def _show_nothing(self, reason: str) -> None:
        self._outline.hide()
        self._curve.draw_nothing()
        self.text.value = reason

    def _on_move(self, _: Any, event: Any) -> None:
        if not self.follow.value:
            return
        self._position = tuple(event.position)
        self._refresh_soon()

    def _on_press(self, viewer: Any, event: Any) -> Iterator[None]:
        if event.button != 1 or event.modifiers or not may_pin(viewer):
            return
        pressed = np.array(event.pos)
        yield
        while event.type == "mouse_move":
            yield
        if np.hypot(*(np.array(event.pos) - pressed)) <= STILL:
            self.pin(tuple(event.position))

    def pin(self, position: tuple[float, ...]) -> None:
        """Explain a place, given in world coordinates, and stay there."""
        try:
            self._probed(position)
        except NothingKnownError as reason:
            self._show_nothing(str(reason))
            return
        self.follow.value = False
        self._position = position
        self.refresh()

    def _on_dims(self, _: Any = None) -> None:
        """Follow the sliders: the mouse is over another plane now."""
        if not self.follow.value or self._position is None:
            return
        dims = self._viewer.dims
        self._position = tuple(
            at if axis in dims.displayed else dims.point[axis]
            for axis, at in enumerate(self._position[: dims.ndim])
        )
        self._refresh_soon()

    def _refresh_soon(self) -> None:
        """Refresh once for all that happens within `INTERVAL`."""
        if not 0 <= self._timer.remainingTime() <= INTERVAL:
            self._timer.start(INTERVAL)

    def _on_theme(self, _: Any = None) -> None:
        self._curve.dress(self._viewer.theme)
        self.refresh()

    def _on_outline_deleted(self) -> None:
        self.outlined.value = False
