"""Map and mask follow sliders and seeds, and nothing is estimated again for it."""

import threading

import numpy as np
import pytest
from qtpy.QtCore import QPoint, Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QSlider

import napari_defocus
from napari_defocus import segment_in_focus, simulate_defocus
from napari_defocus.widgets.docks.defocus import DefocusWidget
from napari_defocus.widgets.forms.image_panel import ImagePanel
from napari_defocus.widgets.jobs import estimation

pytestmark = pytest.mark.display


@pytest.fixture
def settled(qtbot):
    def wait(widget):
        qtbot.wait(20)
        qtbot.waitUntil(lambda: not widget._live_labels.is_busy)
        for _ in range(5):
            # Each lets at least one more layer be shown, however late its timer comes.
            qtbot.wait(5)

    return wait


@pytest.fixture
def measured(viewer, opened, finish, method, texture):
    viewer.add_image(texture, name="leaf")
    widget = opened(DefocusWidget)
    finish(widget)
    assert (len(method.labelings), len(method.segmentations)) == (1, 1)
    return widget


def test_threshold_changes_the_mask_alone(viewer, measured, settled, method):
    assert viewer.layers["leaf in focus"].data.max() == 0
    assert "In focus: 0% of the picture (blur up to 2 px)" in measured.status.value
    measured.settings.threshold.value = 3.0
    settled(measured)
    assert viewer.layers["leaf in focus"].data.min() == 1
    assert measured.status.value.startswith("Blur: median 2.5 px")
    assert "In focus: 100% of the picture (blur up to 3 px)" in measured.status.value
    assert [call["threshold"] for call in method.segmentations] == [2.0, 3.0]
    assert len(method.labelings) == len(method.estimations) == 1


def test_slider_shows_what_was_found_and_moving_it_takes_the_number(viewer, measured, settled):
    fields = measured.settings.threshold_fields
    assert (fields.found.value, fields.slider.value) == (True, 2.0)
    made = viewer.layers["leaf in focus"].metadata["napari_defocus"]
    assert (made["settings"]["threshold"], made["threshold found"]) == (2.0, True)
    fields.slider.value = 3.0
    settled(measured)
    made = viewer.layers["leaf in focus"].metadata["napari_defocus"]
    assert (made["settings"]["threshold"], "threshold found" in made) == (3.0, False)
    assert not fields.found.value
    fields.found.value = True
    settled(measured)
    assert (fields.found.value, fields.slider.value) == (True, 2.0)
    assert viewer.layers["leaf in focus"].data.max() == 0


@pytest.mark.parametrize("field", ["map_smoothness", "map_color_sigma"])
def test_smoothness_and_colour_step_of_the_map_change_the_map_alone(
    viewer, measured, settled, method, field
):
    method.radius = 4.0
    getattr(measured.settings, field).value = 0.5
    settled(measured)
    assert np.all(viewer.layers["leaf blur (px)"].data == 4.0)
    assert (len(method.labelings), len(method.segmentations)) == (2, 1)
    assert method.labelings[1][field.removeprefix("map_")] == 0.5


@pytest.mark.parametrize("field", ["mask_smoothness", "mask_color_sigma"])
def test_smoothness_and_colour_step_of_the_mask_change_the_mask_alone(
    measured, settled, method, field
):
    getattr(measured.settings, field).value = 0.5
    settled(measured)
    assert (len(method.labelings), len(method.segmentations)) == (1, 2)
    assert method.segmentations[1][field.removeprefix("mask_")] == 0.5


def test_only_where_the_slider_rests_is_worked_out(measured, settled, method):
    for threshold in (2.5, 3.0, 3.5, 4.0):
        measured.settings.threshold.value = threshold
    settled(measured)
    assert [call["threshold"] for call in method.segmentations] == [2.0, 4.0]


def test_mask_that_is_not_wanted_any_more_is_not_shown(
    viewer, measured, settled, method, qtbot, monkeypatch
):
    started, go_on = threading.Event(), threading.Event()
    segment = method.segment_in_focus

    def slow(candidates, image, *, threshold, **arguments):
        if threshold == 3.0:
            started.set()
            go_on.wait(600)
        return segment(candidates, image, threshold=threshold, **arguments)

    monkeypatch.setitem(vars(napari_defocus), "segment_in_focus", slow)
    seen = []
    mask = viewer.layers["leaf in focus"]
    mask.events.set_data.connect(lambda _: seen.append(int(mask.data.max())))
    measured.settings.threshold.value = 3.0
    qtbot.waitUntil(started.is_set)
    measured.settings.threshold.value = 1.0
    qtbot.wait(100)
    go_on.set()
    settled(measured)
    assert mask.data.max() == 0
    assert 1 not in seen


def test_slider_that_comes_back_leaves_what_is_shown(viewer, measured, settled, method):
    measured.settings.threshold.value = 3.0
    measured.settings.threshold_fields.found.value = True
    settled(measured)
    assert viewer.layers["leaf in focus"].data.max() == 0
    assert len(method.segmentations) == 1


def test_what_needs_another_estimation_waits_for_the_button(measured, settled, method, finish):
    measured.settings.max_radius.value = 6.0
    measured.settings.threshold.value = 3.0
    settled(measured)
    assert len(method.estimations) == len(method.segmentations) == 1
    finish(measured)
    assert len(method.estimations) == 2
    assert method.segmentations[-1]["threshold"] == 3.0


def test_nothing_follows_if_it_is_not_wanted_until_it_is(measured, settled, method):
    measured.live.value = False
    measured.settings.threshold.value = 3.0
    settled(measured)
    assert len(method.segmentations) == 1
    measured.live.value = True
    settled(measured)
    assert len(method.segmentations) == 2


def test_nothing_follows_before_there_is_a_result(viewer, opened, settled, method, texture, finish):
    viewer.add_image(texture, name="leaf")
    finish(opened(DefocusWidget))
    widget = opened(DefocusWidget)
    widget.settings.threshold.value = 3.0
    settled(widget)
    assert [call["threshold"] for call in method.segmentations] == [2.0], "it has shown nothing"


def test_nothing_follows_on_a_picture_that_was_changed(viewer, measured, settled, method):
    viewer.layers["leaf"].data = viewer.layers["leaf"].data[::-1]
    measured.settings.threshold.value = 3.0
    settled(measured)
    assert len(method.segmentations) == 1


def test_slider_moved_during_a_run_counts_after_it(viewer, measured, settled, method, qtbot):
    measured.settings.max_radius.value = 6.0
    run = measured.run()
    measured.settings.threshold.value = 3.0
    with qtbot.waitSignal(run.finished):
        pass
    settled(measured)
    assert [call["threshold"] for call in method.segmentations] == [2.0, 2.0, 3.0]


def test_strokes_and_undo_change_the_mask(viewer, measured, settled, method):
    seeds = measured.add_seeds()
    settled(measured)
    assert len(method.segmentations) == 1, "nothing is painted yet"
    seeds.paint((20, 30), 2)
    settled(measured)
    painted = method.segmentations[-1]["seeds"]
    assert painted[20, 30] == 2
    assert len(method.segmentations) == 2
    seeds.undo()
    settled(measured)
    assert len(method.segmentations) == 3
    assert not method.segmentations[-1]["seeds"].any()
    seeds.redo()
    settled(measured)
    np.testing.assert_array_equal(method.segmentations[-1]["seeds"], painted)
    assert viewer.layers.selection.active == seeds, "the brush stays where it is"
    assert len(method.estimations) == len(method.labelings) == 1


def test_seeds_that_were_let_go_are_not_watched(measured, settled, method):
    seeds = measured.add_seeds()
    seeds.paint((20, 30), 1)
    settled(measured)
    measured.seeds.value = None
    settled(measured)
    assert method.segmentations[-1]["seeds"] is None
    count = len(method.segmentations)
    seeds.paint((40, 50), 2)
    settled(measured)
    assert len(method.segmentations) == count


def test_cancel_stops_what_follows_too(measured, settled, method):
    measured.settings.threshold.value = 3.0
    measured.cancel()
    settled(measured)
    assert len(method.segmentations) == 1


@pytest.fixture(scope="module")
def stones(gravel):
    radius = np.full((160, 160), 4.0)
    radius[:, :80] = 0.5
    picture = simulate_defocus(gravel, radius, noise_variance=1e-6, rng=0)
    return picture.astype(np.float32)


def test_large_picture_has_a_rough_mask_first_and_then_that_of_the_function(
    viewer, opened, qtbot, settled, stones, monkeypatch
):
    monkeypatch.setattr(estimation, "LARGE", 1000)
    viewer.add_image(stones, name="stones")
    widget = opened(DefocusWidget)
    rough = []
    run = widget.run()
    run.previewed.connect(lambda layers: rough.append([made["name"] for _, made, _ in layers]))
    with qtbot.waitSignal(run.finished):
        pass
    assert rough == [["stones blur (px)", "stones in focus"]]
    assert "preview" not in viewer.layers["stones in focus"].metadata["napari_defocus"]
    seen = []
    mask = viewer.layers["stones in focus"]
    mask.events.set_data.connect(lambda _: seen.append(mask.data.copy()))
    widget.settings.threshold.value = 1.0
    settled(widget)
    candidates = ImagePanel.cache.analysed.latest(viewer.layers["stones"]).candidates
    expected = segment_in_focus(candidates, stones, threshold=1.0)
    np.testing.assert_array_equal(mask.data, expected)
    assert (seen[0] == expected).mean() > 0.9


def test_slider_and_brush_of_a_real_window(
    make_napari_viewer_proxy, qtbot, method, texture, settled
):
    window = make_napari_viewer_proxy(show=True)
    window.add_image(texture, name="leaf")
    widget = DefocusWidget(window)
    window.window.add_dock_widget(widget)
    widget.run_button.native.click()
    qtbot.waitUntil(lambda: widget._running is None and "leaf in focus" in window.layers)
    slider = widget.settings.threshold.slider.native.findChild(QSlider)
    for _ in range(20):
        QTest.keyClick(slider, Qt.Key_Right)
    settled(widget)
    assert widget.settings.threshold.value > 2.0
    assert method.segmentations[-1]["threshold"] == widget.settings.threshold.value

    canvas, drawn = window.__wrapped__.window._qt_viewer.canvas.native, []
    canvas._vispy_canvas.events.draw.connect(lambda _: drawn.append(True))
    widget.seeds_button.native.click()
    qtbot.waitUntil(lambda: bool(drawn))
    qtbot.wait(200)
    middle = QPoint(canvas.width() // 2, canvas.height() // 2)
    QTest.mousePress(canvas, Qt.LeftButton, pos=middle)
    for step in range(1, 6):
        QTest.mouseMove(canvas, middle + QPoint(4 * step, 0))
    QTest.mouseRelease(canvas, Qt.LeftButton, pos=middle + QPoint(20, 0))
    settled(widget)
    painted = method.segmentations[-1]["seeds"]
    assert painted is not None
    assert painted.any()
    QTest.keyClick(canvas, Qt.Key_Z, Qt.ControlModifier)
    settled(widget)
    assert not method.segmentations[-1]["seeds"].any(), "Ctrl+Z takes it back"
