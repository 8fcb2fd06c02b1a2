"""Fields on pages, behind tabs."""

from magicgui.widgets import Container, Widget
from qtpy.QtCore import QSize
from qtpy.QtWidgets import QFrame, QScrollArea, QTabWidget, QWidget

from napari_defocus.widgets.forms.run_panel import widen_labels

WIDTH = 400
"""In px, of a page: room for the widest field, and a bar to scroll it."""


class Pages:
    """Forms of which one is shown at a time."""

    def __init__(self) -> None:
        self.native = QTabWidget()
        self.native.setDocumentMode(True)
        self.native.tabBar().setDrawBase(False)
        self._pages: list[Container[Widget]] = []

    def add(self, title: str, tooltip: str, fields: list[Widget]) -> None:
        """Add a page."""
        page: Container[Widget] = Container()
        # Only rows that come after the container's own making get labels of equal width.
        page.extend(fields)
        page.margins = (0, 6, 0, 6)
        native: QWidget = page.native
        widen_labels(native)
        native.layout().addStretch(1)
        scrolling = _ScrollingPage()
        scrolling.setWidget(native)
        number = self.native.addTab(scrolling, title)
        self.native.setTabToolTip(number, tooltip)
        self._pages.append(page)

    def show(self, title: str) -> None:
        """Bring the page of a title to the front."""
        titles = [self.native.tabText(number) for number in range(self.native.count())]
        self.native.setCurrentIndex(titles.index(title))

    def reset_choices(self) -> None:
        """Look for choices again on all pages."""
        for page in self._pages:
            page.reset_choices()


class _ScrollingPage(QScrollArea):
    """A page no wider than it must be, and no higher: the dock has to fit into small windows."""

    def __init__(self) -> None:
        super().__init__()
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.NoFrame)
        self.setMinimumWidth(WIDTH)

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return how large it would like to be."""
        return QSize(WIDTH, self.widget().sizeHint().height())
