"""The widget that shows why the map says what it says under the mouse."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from magicgui.widgets import CheckBox, ComboBox, Container, Label, Widget
from matplotlib import rc_context
from matplotlib.backends.backend_qtagg import FigureCanvasQTAgg
from matplotlib.figure import Figure
from napari.components import ViewerModel
from napari.layers import Image, Layer
from napari.utils.theme import get_theme
from qtpy.QtCore import Qt, QTimer

from napari_defocus import PixelExplanation, draw_explanation
from napari_defocus.widgets.image_panel import ImagePanel
from napari_defocus.widgets.probing import (
    NothingKnownError,
    Probed,
    WindowOutline,
    image_of,
    image_to_probe,
    may_pin,
    probed,
)
from napari_defocus.widgets.results import made_by_us
from napari_defocus.widgets.run_panel import wrap

INTERVAL = 40
"""Least time between two updates while the mouse moves, in ms."""

PATIENCE = 300
"""Time until the outline is tried again if napari was not ready, in ms."""

HEIGHTS = 200, 400
"""Least and largest height of the drawing, in px."""

SIZE = (3.0, 2.2)
"""In inches, to begin with: docks become as wide as what is in them."""

FONT_SIZE = 8
MARGINS = {"left": 62, "right": 12, "bottom": 42, "top": 24}
"""Around the axes, in px at 100 dots an inch."""

LINES = 5
"""Of text, for which there is always room: else the curve would jump."""

_COLORED = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color")
_FILLED = ("axes.facecolor", "figure.facecolor")

STILL = 4
"""How far, in px of the screen, a click may move."""


class ProbeWidget(Container[Widget]):
    """Show what is known about the blur under the mouse, and of what part of the picture.

    It estimates nothing: it shows what the other widgets have found.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel

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
            text="Outline the window",
            value=True,
            tooltip="Show in the picture what part of it the curve was measured on.",
        )
        self.text = Label(name="text", label=" ", value="")
        super().__init__()
        self.extend([self.image, self.follow, self.outlined, self.text])
        self._curve = CurveCanvas(self)
        self.native.layout().insertWidget(len(self) - 1, self._curve, 1)
        self._make_room_for_text()
        self._timer = QTimer(self.native)
        self._timer.setSingleShot(True)
        self._timer.timeout.connect(lambda: self.refresh())
        self.native.destroyed.connect(lambda: self.stop())
        self.image.changed.connect(lambda _: self.refresh())
        self.outlined.changed.connect(lambda _: self.refresh())
        self.reset_choices()
        self.set_image(image_to_probe(napari_viewer, ImagePanel.kept))

    def _make_room_for_text(self) -> None:
        wrap(self.text)
        native = self.text.native
        native.setAlignment(Qt.AlignLeft | Qt.AlignTop)
        native.setMinimumHeight(LINES * native.fontMetrics().lineSpacing())

    def _images(self, _: Any) -> list[Image]:
        layers = self._viewer.layers
        return [layer for layer in layers if isinstance(layer, Image) and not made_by_us(layer)]

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
        """Watch the mouse; done whenever the widget comes into sight."""
        if self._watching:
            return
        self._watching = True
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
        return probed(self._viewer, self.image.value, position, ImagePanel.kept)

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


class CurveCanvas(FigureCanvasQTAgg):
    """Where the curve is drawn, in the colours of napari's theme.

    Axes and labels are drawn when they change; a curve is drawn on a copy of them, which is ten
    times as fast.

    Parameters
    ----------
    owner : ProbeWidget
        Told when the canvas comes into sight and goes out of it.
    """

    def __init__(self, owner: ProbeWidget) -> None:
        super().__init__(Figure(figsize=SIZE))
        self._owner = owner
        self._frame: tuple[Any, ...] = ()
        self._empty: Any = None
        self.setMinimumHeight(HEIGHTS[0])
        self.setMaximumHeight(HEIGHTS[1])
        self.mpl_connect("draw_event", lambda _: self._on_drawn())
        self._axes = self.figure.subplots()
        self.draw_nothing()

    def dress(self, theme: str) -> None:
        """Take on the colours of one of napari's themes."""
        colors = get_theme(theme)
        text, ground = colors.text.as_hex(), colors.background.as_hex()
        style = dict.fromkeys(_COLORED, text) | dict.fromkeys(_FILLED, ground)
        self.figure.clear()
        with rc_context(style | {"font.size": FONT_SIZE}):
            self._axes = self.figure.subplots()
        self.figure.set_facecolor(ground)
        self._keep_margins()
        self.draw_nothing()

    def draw_explanation(self, explanation: PixelExplanation) -> None:
        """Draw the curve of a pixel instead of what was drawn."""
        self._clear()
        self._axes.set_axis_on()
        draw_explanation(explanation, self._axes, legend=False)
        self._fit_title()
        for artist in self._changing():
            artist.set_animated(True)
        frame = self._axes.get_xlim(), self._axes.get_ylim(), self._axes.get_xlabel()
        if self._empty is None or frame != self._frame:
            self._frame = frame
            self._redraw()
        else:
            self.restore_region(self._empty)
            self._draw_changing()
            self.blit(self.figure.bbox)

    def _fit_title(self) -> None:
        """Write it across the canvas, which is wider than the axes."""
        left, right = self._axes.get_position().intervalx
        self._axes.title.set(fontsize=FONT_SIZE, x=(0.5 - left) / (right - left))

    def draw_nothing(self) -> None:
        """Draw no curve."""
        self._clear()
        self._axes.set_axis_off()
        self._frame = ()
        self._redraw()

    def _clear(self) -> None:
        for artist in (*self._axes.lines, *self._axes.patches):
            artist.remove()
        self._axes.set_title("")

    def _changing(self) -> list[Any]:
        return [*self._axes.patches, *self._axes.lines, self._axes.title]

    def _draw_changing(self) -> None:
        for artist in self._changing():
            self._axes.draw_artist(artist)

    def _redraw(self) -> None:
        self._empty = None
        self.draw_idle()

    def _on_drawn(self) -> None:
        self._empty = self.copy_from_bbox(self.figure.bbox)
        if self._frame:
            self._draw_changing()

    def resizeEvent(self, event: Any) -> None:  # noqa: N802
        """Keep the margins, and have everything drawn anew."""
        self._empty = None
        super().resizeEvent(event)
        self._keep_margins()

    def _keep_margins(self) -> None:
        dots = self.figure.dpi / self.device_pixel_ratio / 100
        width, height = max(self.width(), 120) / dots, max(self.height(), 120) / dots
        self.figure.subplots_adjust(
            left=MARGINS["left"] / width,
            right=1 - MARGINS["right"] / width,
            bottom=MARGINS["bottom"] / height,
            top=1 - MARGINS["top"] / height,
        )

    def showEvent(self, event: Any) -> None:  # noqa: N802
        """Begin to watch the mouse."""
        super().showEvent(event)
        self._owner.start()

    def hideEvent(self, event: Any) -> None:  # noqa: N802
        """Leave the mouse and the picture alone."""
        super().hideEvent(event)
        self._owner.stop()
