"""A form that scrolls where its dock is not as high as it is."""

from qtpy.QtCore import QEvent, QSize, Qt
from qtpy.QtWidgets import QFrame, QScrollArea, QVBoxLayout, QWidget

LEAST_HEIGHT = 240
"""In px, of a scrolling form: a few fields, and what runs them."""


class ScrollingForm(QScrollArea):
    """A form as wide as it must be, no higher than there is room: a window never has to grow."""

    def __init__(self, form: QWidget) -> None:
        super().__init__()
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.NoFrame)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarAlwaysOff)
        self.setWidget(form)

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return how large it would like to be."""
        return self._beside_bar(self.widget().sizeHint())

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return how large it must be."""
        least = self._beside_bar(self.widget().minimumSizeHint())
        return least.boundedTo(QSize(least.width(), LEAST_HEIGHT))

    def event(self, event: QEvent) -> bool:
        """Tell the dock when fields come and go."""
        if event.type() == QEvent.LayoutRequest:
            self.updateGeometry()
        return bool(super().event(event))

    def _beside_bar(self, size: QSize) -> QSize:
        frame = 2 * self.frameWidth()  # napari's style gives it one
        return size + QSize(self.verticalScrollBar().sizeHint().width() + frame, frame)


def make_scrolling(native: QWidget) -> None:
    """Put all that lies in a widget into a form that scrolls inside of it."""
    form = QWidget()
    layout = native.layout()
    form.setLayout(layout)
    layout.addStretch()
    outer = QVBoxLayout(native)
    outer.setContentsMargins(0, 0, 0, 0)
    outer.addWidget(ScrollingForm(form))
