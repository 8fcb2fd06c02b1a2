"""The window fits on a screen of 1366 x 768 px, whatever of ours is open in it."""

from pathlib import Path

import numpy as np
import pytest
from npe2 import PluginManifest
from npe2.manifest.utils import import_python_name
from qtpy.QtCore import Qt
from qtpy.QtWidgets import (
    QAbstractButton,
    QAbstractSlider,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QScrollArea,
)

import napari_defocus
from napari_defocus.widgets.docks.defocus import DefocusWidget
from napari_defocus.widgets.docks.probe import ProbeWidget
from napari_defocus.widgets.forms.tabs import become_a_tab

pytestmark = pytest.mark.display

WIDTH, HEIGHT = 1366, 700
"""Of the window, in px: its title and a panel take the rest of 768."""


def widget_classes():
    manifest = PluginManifest.from_file(Path(napari_defocus.__file__).with_name("napari.yaml"))
    homes = {each.id: each.python_name for each in manifest.contributions.commands}
    widgets = manifest.contributions.widgets
    return {each.display_name: import_python_name(homes[each.command]) for each in widgets}


@pytest.fixture
def small(window, texture):
    """A viewer whose window has that size and is in sight, with a photograph and a stack."""
    window.add_image(np.stack([texture] * 3), name="stack")
    window.add_image(np.stack([texture] * 3, axis=-1), name="photo", rgb=True)
    native = qt_window(window)
    native.resize(WIDTH, HEIGHT)
    native.show()
    settle()
    return window


def qt_window(viewer):
    return viewer.__wrapped__.window._qt_window


def settle():
    for _ in range(3):
        QApplication.processEvents()


def dock(viewer, widget, name):
    made = viewer.__wrapped__.window.add_dock_widget(widget, name=name)
    settle()
    return made


def undock(viewer, docked):
    """Take a widget out of its dock, to be put into another one as if it were new."""
    widget = docked.widget()
    viewer.__wrapped__.window.remove_dock_widget(docked)
    become_a_tab(widget)


def is_in_sight(widget):
    return not widget.visibleRegion().isEmpty()


def assert_fits(viewer, what):
    native = qt_window(viewer)
    assert native.height() == HEIGHT, what
    assert native.minimumSizeHint().height() <= HEIGHT, what
    assert native.minimumSizeHint().width() <= WIDTH, what


def show_all(widget):
    """Show every field that a form may show, and a long message."""
    for field in widget:
        field.show()
    if hasattr(widget, "status"):
        widget.status.value = "Something went wrong, and there is a lot to say about it. " * 4
    settle()


def test_window_fits_with_every_widget_and_every_pair_of_them_as_tabs(small):
    widgets = {name: made(small) for name, made in widget_classes().items()}
    assert len(widgets) == 6
    for first in list(widgets):
        below = dock(small, widgets.pop(first), first)
        assert_fits(small, first)
        for second, widget in widgets.items():
            above = dock(small, widget, second)
            assert_fits(small, (first, second))
            assert above in qt_window(small).tabifiedDockWidgets(below), (first, second)
            assert is_in_sight(above), "the newest one is in front"
            undock(small, above)
        undock(small, below)


def test_window_fits_with_all_fields_of_each_widget_and_those_below_roll_into_sight(small):
    scrolling = {}
    for name, made in widget_classes().items():
        widget = made(small)
        docked = dock(small, widget, name)
        assert_fits(small, name)
        show_all(widget)
        assert_fits(small, name)
        form = docked.widget().findChild(QScrollArea, options=Qt.FindDirectChildrenOnly)
        if form is not None:
            assert form.viewport().width() >= form.widget().minimumSizeHint().width(), name
            scrolling[name] = form.verticalScrollBar().maximum() > 0
            button = widget.run_button.native
            form.ensureWidgetVisible(button)
            settle()
            assert button.visibleRegion().boundingRect() == button.rect(), name
        undock(small, docked)
    assert scrolling["Sharpest plane"], "or the test rolls nothing"
    assert not scrolling["Calibrate a lens"], "there is room for all of it"


def test_every_field_of_each_widget_has_a_name_for_readers_of_the_screen(small):
    kinds = QAbstractButton, QAbstractSlider, QAbstractSpinBox, QComboBox
    for name, made in widget_classes().items():
        widget = made(small)
        fields = [each for kind in kinds for each in widget.native.findChildren(kind)]
        assert len(fields) > 2, name
        for field in fields:
            if field.focusPolicy() & Qt.TabFocus:
                said = field.accessibleName() or getattr(field, "text", str)()
                assert said.strip(), (name, field)


def test_fields_of_a_short_form_lie_together_at_its_top(small):
    widget = widget_classes()["Calibrate a lens"](small)
    dock(small, widget, "Calibrate a lens")
    tops = [
        field.native.mapTo(widget.native, field.native.rect().topLeft()).y()
        for field in (widget.pictures, widget.status)
    ]
    assert 0 < tops[0] < tops[1] < 300
    assert widget.native.height() > 450


def test_every_page_and_tool_of_defocus_fits_and_comes_to_the_front(small, method, finish):
    widget, native = DefocusWidget(small), qt_window(small)
    defocus = dock(small, widget, "Defocus")
    finish(widget)
    widget.image.value = small.layers["stack"]
    for title, section in widget.pages.sections.items():
        widget.pages.show(title)
        settle()
        assert_fits(small, title)
        assert is_in_sight(section.heading), title
    form = widget.pages.native
    assert form.verticalScrollBar().isVisible(), "or the test shows no bar beside the fields"
    assert form.viewport().width() >= form.widget().minimumSizeHint().width()
    tools = widget.tools.open_probe, widget.tools.open_focus_curve, widget.tools.open_sharpest_plane
    for press in (*tools, *tools):
        defocus.raise_()
        settle()
        assert is_in_sight(widget.native)
        press()
        settle()
        assert_fits(small, press)
        assert not is_in_sight(widget.native), "what was opened is in front, the second time, too"
    assert len(native.tabifiedDockWidgets(defocus)) == len(tools)
    widget.add_seeds()
    settle()
    assert_fits(small, "seeds")


def test_dock_that_was_moved_stays_where_it_is_put(small):
    native = qt_window(small)
    first = dock(small, DefocusWidget(small), "Defocus")
    second = dock(small, ProbeWidget(small), "Probe")
    native.addDockWidget(Qt.LeftDockWidgetArea, second)
    for show in (second.hide, second.show):
        show()
        settle()
    assert native.dockWidgetArea(second) == Qt.LeftDockWidgetArea
    assert second not in native.tabifiedDockWidgets(first)
