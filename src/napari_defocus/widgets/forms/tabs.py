"""Docks of ours are tabs of one another: below each other they outgrow small windows."""

from qtpy.QtCore import QEvent, QObject, Qt, Signal
from qtpy.QtWidgets import QDockWidget, QMainWindow, QWidget

_OURS = "napari_defocus_dock"

_ENDS = " (Defocus)", " (napari-defocus)"
"""What napari puts after the name of a dock that its menus open, and one that a script opens."""


def dock_name(widget: str) -> str:
    """Return what napari calls the dock of a widget of ours when its menus open it."""
    return widget + _ENDS[0]


class _Usher(QObject):
    """Waits until a widget is put into a dock, gives that a place before it is shown, and goes."""

    docked = Signal()

    def __init__(self, native: QWidget) -> None:
        super().__init__(native)
        # When the dock is in its window, and before Qt, which then queues showing it, makes room.
        self.docked.connect(self._give_place, Qt.QueuedConnection)
        native.installEventFilter(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802
        if event.type() == QEvent.ParentChange and isinstance(watched.parent(), QDockWidget):
            watched.removeEventFilter(self)
            self.docked.emit()
        return False

    def _give_place(self) -> None:
        _join(self.parent())
        _shorten_title(self.parent())
        self.deleteLater()


def become_a_tab(native: QWidget) -> None:
    """Let the dock that a widget is put into be a tab of the one of ours that is there already.

    Whoever moves the dock elsewhere finds it there again.
    """
    native.setProperty(_OURS, True)
    _Usher(native)


def _join(native: QWidget) -> None:
    dock = native.parent()
    window = dock.parent() if isinstance(dock, QDockWidget) else None
    if not isinstance(window, QMainWindow):
        return
    others = [each for each in window.findChildren(QDockWidget) if _is_beside(window, each, dock)]
    if others:
        window.tabifyDockWidget(others[-1], dock)
        dock.show()
        dock.raise_()


def _shorten_title(native: QWidget) -> None:
    """Let the tab of a dock say the name of the widget alone: several tabs have little room."""
    dock = native.parent()
    if isinstance(dock, QDockWidget):
        title = dock.windowTitle()
        for end in _ENDS:
            title = title.removesuffix(end)
        dock.setWindowTitle(title)


def _is_beside(window: QMainWindow, other: QDockWidget, dock: QDockWidget) -> bool:
    """Tell whether another dock is ours, and in sight where this one has come."""
    return (
        other is not dock
        and not other.isHidden()
        and not other.isFloating()
        and window.dockWidgetArea(other) == window.dockWidgetArea(dock)
        and other.widget() is not None
        and bool(other.widget().property(_OURS))
    )
