"""Fields in sections that open and close, one below the other, in an area that scrolls."""

from magicgui.widgets import Container, Widget
from qtpy.QtCore import Qt, QTimer
from qtpy.QtWidgets import QSizePolicy, QToolButton, QVBoxLayout, QWidget

from napari_defocus.widgets.forms.accessibility import describe, tab_in_reading_order
from napari_defocus.widgets.forms.run_panel import widen_labels
from napari_defocus.widgets.forms.scrolling import ScrollingForm

WIDTH = 416
"""In px, of the sections: room for the widest field, and a bar to scroll it."""


_HEADING = """
QToolButton { font-weight: bold; border: 1px solid transparent; padding: 2px; }
QToolButton:focus { border-color: #3d9be9; }
"""
"""Whoever uses the keyboard sees where it is, on dark and on light."""


class Section(QWidget):
    """A heading that shows and hides the form below it."""

    def __init__(self, title: str, tooltip: str, form: QWidget) -> None:
        super().__init__()
        self.form = form
        self.heading = QToolButton()
        self.heading.setText(title)
        self.heading.setToolTip(tooltip)
        self.heading.setAccessibleName(title)
        self.heading.setAccessibleDescription(tooltip)
        self.heading.setCheckable(True)
        self.heading.setAutoRaise(True)
        self.heading.setFocusPolicy(Qt.StrongFocus)
        self.heading.setStyleSheet(_HEADING)
        self.heading.setToolButtonStyle(Qt.ToolButtonTextBesideIcon)
        self.heading.setSizePolicy(QSizePolicy.Expanding, QSizePolicy.Fixed)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(0)
        layout.addWidget(self.heading)
        layout.addWidget(form)
        self.heading.toggled.connect(self.open)
        self.open(False)

    @property
    def is_open(self) -> bool:
        """Whether the form is shown."""
        return bool(self.heading.isChecked())

    def open(self, wanted: bool = True) -> None:
        """Show the form, or hide it."""
        self.heading.setChecked(wanted)
        self.heading.setArrowType(Qt.DownArrow if wanted else Qt.RightArrow)
        self.form.setVisible(wanted)


class Pages:
    """Forms in sections, of which any may be open.

    Attributes
    ----------
    native : QWidget
        All of them; it scrolls where there is no room.
    sections : dict
        From their titles.
    """

    def __init__(self) -> None:
        content = QWidget()
        self._rows = QVBoxLayout(content)
        self._rows.setContentsMargins(0, 0, 0, 0)
        self._rows.setSpacing(2)
        self._rows.addStretch(1)
        self.native = ScrollingForm(content)
        self.native.setMinimumWidth(WIDTH)
        self.native.setFocusPolicy(Qt.NoFocus)
        self.sections: dict[str, Section] = {}
        self._pages: list[Container[Widget]] = []

    def add(self, title: str, tooltip: str, fields: list[Widget]) -> None:
        """Add a section, closed."""
        page: Container[Widget] = Container()
        # Only rows that come after the container's own making get labels of equal width.
        page.extend(fields)
        page.margins = (8, 2, 2, 8)
        native: QWidget = page.native
        widen_labels(native)
        describe(fields)
        section = Section(title, tooltip, native)
        section.heading.clicked.connect(lambda _: self._roll_to(section))
        self._rows.insertWidget(len(self.sections), section)
        self.sections[title] = section
        self._pages.append(page)

    def show(self, title: str) -> None:
        """Open the section of a title, and roll it into sight."""
        self.sections[title].open()
        self._roll_to(self.sections[title])

    def reset_choices(self) -> None:
        """Look for choices again in all sections."""
        for page in self._pages:
            page.reset_choices()

    def order_tabs(self) -> None:
        """Let the Tab key go from top to bottom."""
        tab_in_reading_order(self.native)

    def _roll_to(self, section: Section) -> None:
        """Roll a section into sight, all of it if there is room."""
        # When it has its new height.
        QTimer.singleShot(0, section, lambda: self._roll_now(section))

    def _roll_now(self, section: Section) -> None:
        self.native.ensureWidgetVisible(section, 0, 0)
        if section.height() > self.native.viewport().height():
            self.native.verticalScrollBar().setValue(section.y())
