"""A focus curve drawn in the colours of napari's theme."""

from typing import Any

import numpy as np
from matplotlib.backends.backend_qtagg import FigureCanvasQTAgg
from matplotlib.backends.qt_compat import _isdeleted
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from napari.utils.theme import get_theme
from numpy.typing import NDArray
from qtpy.QtCore import Signal

SHARE_COLOR = "#12a87b"
RADIUS_COLOR = "#e0812c"
"""Both are legible on dark and on light ground."""

LEAST_SIZE = (260, 220)
MOST_HEIGHT = 360
FONT_SIZE = 8

_SIZE = (3.2, 2.4)
_BESIDE, _BELOW, _ABOVE = 0.55, 0.5, 0.12
"""What lies around the axes, in inches. A layout engine would measure it at every drawing, and
every step of a slider draws."""

_ALPHA_OF_FRAME = 0.4


class FocusCurvePlot(FigureCanvasQTAgg):
    """The share in focus and the median radius over the planes, and which plane is shown.

    Parameters
    ----------
    theme : str
        Name of the viewer's theme.
    """

    chosen = Signal(int)
    """The number of the plane that was clicked on."""

    def __init__(self, theme: str) -> None:
        super().__init__(Figure(figsize=_SIZE))
        self.setMinimumSize(*LEAST_SIZE)
        self.setMaximumHeight(MOST_HEIGHT)
        self.share_axes = self.figure.subplots()
        self.radius_axes = self.share_axes.twinx()
        self._share, self._radius = self._lines()
        # Not part of the picture: moving it takes 1 ms, drawing all again 30 to 60.
        self._shown = self.share_axes.axvline(
            0, linestyle="--", linewidth=1.2, visible=False, animated=True
        )
        self._picture: Any = None
        self._last = -1
        self.mpl_connect("draw_event", lambda _: self._on_drawn())
        self.mpl_connect("resize_event", lambda _: self._fit())
        self.mpl_connect("button_press_event", lambda event: self._on_press(event))
        self._fit()
        self.set_theme(theme)

    def _draw_idle(self) -> None:
        """Draw what was asked for, unless the widget is gone: before 3.11, matplotlib did not look.

        It asks Qt for this method, later.
        """
        if not _isdeleted(self):
            super()._draw_idle()

    def _fit(self) -> None:
        """Leave the room that the labels need, whatever the size."""
        width, height = np.maximum(self.figure.get_size_inches(), 1.5)
        self.figure.subplots_adjust(
            left=_BESIDE / width,
            right=1 - _BESIDE / width,
            bottom=_BELOW / height,
            top=1 - _ABOVE / height,
        )

    def _lines(self) -> tuple[Any, Any]:
        options = {"marker": ".", "markersize": 4, "linewidth": 1.4}
        [share] = self.share_axes.plot([], [], color=SHARE_COLOR, **options)
        [radius] = self.radius_axes.plot([], [], color=RADIUS_COLOR, **options)
        self.share_axes.set_ylabel("in focus (%)", color=SHARE_COLOR, fontsize=FONT_SIZE)
        self.radius_axes.set_ylabel("median radius (px)", color=RADIUS_COLOR, fontsize=FONT_SIZE)
        self.share_axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        return share, radius

    def set_theme(self, theme: str) -> None:
        """Take the colours of one of napari's themes."""
        colors = get_theme(theme)
        ground, text = colors.background.as_hex(), colors.text.as_hex()
        self.figure.set_facecolor(ground)
        for axes, color in ((self.share_axes, SHARE_COLOR), (self.radius_axes, RADIUS_COLOR)):
            axes.set_facecolor("none")
            axes.tick_params(axis="y", colors=color, labelsize=FONT_SIZE)
            axes.tick_params(axis="x", colors=text, labelsize=FONT_SIZE)
            for spine in axes.spines.values():
                spine.set(color=text, alpha=_ALPHA_OF_FRAME)
        self.share_axes.xaxis.label.set_color(text)
        self._shown.set_color(text)
        self.draw_idle()

    def show_curve(
        self, share: NDArray[np.floating], radius: NDArray[np.floating], axis: str
    ) -> None:
        """Draw a curve.

        Parameters
        ----------
        share, radius : (N,) ndarray
            Of every plane, from 0 to 1, and in px; gaps where NaN.
        axis : str
            What the planes are counted along.
        """
        planes = np.arange(len(share))
        self._last = len(share) - 1
        self._share.set_data(planes, 100 * share)
        self._radius.set_data(planes, radius)
        self.share_axes.set_xlim(-0.5, max(self._last, 0) + 0.5)
        self.share_axes.set_ylim(*_limits(100 * share, 1.0))
        self.radius_axes.set_ylim(*_limits(radius, 0.5))
        self.share_axes.set_xlabel(axis, fontsize=FONT_SIZE)
        self.draw_idle()

    def clear_curve(self) -> None:
        """Draw no curve."""
        nothing = np.array([])
        self.show_curve(nothing, nothing, "")
        self.mark(None)

    def mark(self, plane: int | None) -> None:
        """Draw a line at the plane that is shown; None for none."""
        self._shown.set_visible(plane is not None)
        if plane is not None:
            self._shown.set_xdata([plane, plane])
        if self._picture is None:
            return
        self.restore_region(self._picture)
        self.figure.draw_artist(self._shown)
        self.update()

    def _on_drawn(self) -> None:
        """Keep the picture without the line, and draw the line into it."""
        self._picture = self.copy_from_bbox(self.figure.bbox)
        self.figure.draw_artist(self._shown)

    def _on_press(self, event: Any) -> None:
        if event.xdata is not None and event.button == 1 and self._last >= 0:
            self.chosen.emit(int(np.clip(round(event.xdata), 0, self._last)))


def _limits(values: NDArray[np.floating], least: float) -> tuple[float, float]:
    """Return the ends of an axis from 0 up to a little above the largest value."""
    known = values[np.isfinite(values)]
    return 0.0, 1.08 * max(least, float(known.max()) if known.size else least)
