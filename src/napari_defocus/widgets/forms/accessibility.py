"""Forms for whoever works without a mouse or without seeing them: names, and the order of Tab."""

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Any

from magicgui.widgets import Container, Widget
from qtpy.QtCore import Qt
from qtpy.QtWidgets import QAbstractSpinBox, QComboBox, QLayout, QScrollArea, QWidget


def describe(fields: Iterable[Widget]) -> None:
    """Let readers of the screen say the name of each field, and its tooltip.

    Parts of a field, such as a slider and the number beside it, have its name.
    """
    for field in fields:
        text = getattr(field, "text", "")
        name = (text if isinstance(text, str) else "") or str(field.label).strip()
        if isinstance(field, Container) and not name:
            describe(field)
            continue
        for native in (field.native, *field.native.findChildren(QWidget)):
            if native is field.native or native.focusPolicy() & Qt.TabFocus:
                native.setAccessibleName(name)
                native.setAccessibleDescription(field.tooltip or "")


def tab_in_reading_order(native: QWidget) -> None:
    """Let the Tab key go through a widget from top to bottom, whenever its fields were made."""
    stops = list(_stops(native))
    for before, after in pairwise(stops):
        QWidget.setTabOrder(before, after)


def set_shortcut(button: Any, keys: str) -> None:
    """Let keys press a button, and let its tooltip say which."""
    button.native.setShortcut(keys)
    button.tooltip = f"{button.tooltip} ({keys})"


def _stops(widget: QWidget) -> Iterator[QWidget]:
    """Return what takes the focus in a widget, in the order of its layout."""
    if widget.focusPolicy() & Qt.TabFocus:
        yield widget
    if isinstance(widget, QAbstractSpinBox | QComboBox):
        return
    if isinstance(widget, QScrollArea) and widget.widget() is not None:
        yield from _stops(widget.widget())
    elif widget.layout() is not None:
        yield from _stops_in(widget.layout())


def _stops_in(layout: QLayout) -> Iterator[QWidget]:
    for place in range(layout.count()):
        item = layout.itemAt(place)
        if item.widget() is not None:
            yield from _stops(item.widget())
        elif item.layout() is not None:
            yield from _stops_in(item.layout())
