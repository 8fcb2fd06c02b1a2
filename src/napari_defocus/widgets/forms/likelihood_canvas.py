"""Where the probe's curve is drawn, fast enough to follow the mouse."""

from collections.abc import Callable
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_qtagg import FigureCanvasQTAgg
from matplotlib.figure import Figure
from napari.utils.theme import get_theme

from napari_defocus import PixelExplanation, draw_explanation

HEIGHTS = 200, 400
"""Least and largest height of the drawing, in px."""

SIZE = (3.0, 2.2)
"""In inches, to begin with: docks become as wide as what is in them."""

FONT_SIZE = 8
MARGINS = {"left": 62, "right": 12, "bottom": 42, "top": 24}
"""Around the axes, in px at 100 dots an inch."""

_COLORED = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color")
_FILLED = ("axes.facecolor", "figure.facecolor")


class LikelihoodCanvas(FigureCanvasQTAgg):
    """Where the curve is drawn, in the colours of napari's theme.

    Axes and labels are drawn when they change; a curve is drawn on a copy of them, which is ten
    times as fast.

    Parameters
    ----------
    on_shown, on_hidden : callable
        Called when the canvas comes into sight and goes out of it.
    """

    def __init__(self, on_shown: Callable[[], None], on_hidden: Callable[[], None]) -> None:
        super().__init__(Figure(figsize=SIZE))
        self._on_shown, self._on_hidden = on_shown, on_hidden
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
        if not self._axes.axison:
            return
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
        """Tell that it came into sight."""
        super().showEvent(event)
        self._on_shown()

    def hideEvent(self, event: Any) -> None:  # noqa: N802
        """Tell that it went out of sight."""
        super().hideEvent(event)
        self._on_hidden()
