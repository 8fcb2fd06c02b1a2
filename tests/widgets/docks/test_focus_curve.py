import csv
import threading

import dask.array as da
import numpy as np
import pytest
from matplotlib.backend_bases import MouseEvent
from qtpy.QtWidgets import QFileDialog

from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.docks.focus_curve import NO_STACK, FocusCurveWidget
from napari_defocus.widgets.forms.planes_field import PlanesField
from napari_defocus.widgets.forms.region_field import RegionField
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.stack_analysis import StackAnalysis
from napari_defocus.widgets.layers.image_layers import shown_plane

pytestmark = pytest.mark.display

RADII = np.array([6.0, 3.0, 1.0, 2.5, 5.0], np.float32)


def sweep(radii=RADII):
    """Half of each plane has the radius, the other half is blurred by 7 px."""
    maps = np.full((*np.shape(radii), 8, 10), 7, np.float32)
    maps[..., :5] = np.asarray(radii)[..., None, None]
    return maps


def choose(widget):
    """Choose the only stack, if it is not chosen by itself."""
    if widget.form.layer is None:
        [_, widget.form.blur_maps.value] = widget.form.blur_maps.choices


@pytest.fixture
def drawn(opened, qtbot):
    def draw():
        widget = opened(FocusCurveWidget)
        choose(widget)
        qtbot.waitUntil(lambda: widget.curve is not None and widget._running is None)
        return widget

    return draw


@pytest.fixture
def until_read(qtbot):
    """Wait until a widget has a curve other than one that it had."""

    def wait(widget, before):
        def read():
            return widget.curve not in (None, before) and widget._running is None

        qtbot.waitUntil(read)

    return wait


def lines(widget):
    share, radius = widget.plot.share_axes.lines[0], widget.plot.radius_axes.lines[0]
    return share.get_ydata(), radius.get_ydata()


def marked(widget):
    line = widget.plot.share_axes.lines[1]
    return line.get_xdata()[0] if line.get_visible() else None


def click(plot, plane):
    x, y = plot.share_axes.transData.transform((plane, 5))
    plot.callbacks.process("button_press_event", MouseEvent("button_press_event", plot, x, y, 1))


def analysed(viewer, layer):
    wanted = StackAnalysis(
        plane=shown_plane(layer, viewer.dims),
        estimation=MapSettings(),
        mask=MaskSettings(threshold=3.0),
    )
    return add_results(viewer, wanted.run(JobCache()).layers)


def test_share_in_focus_and_median_radius_are_drawn_over_the_planes(viewer, drawn):
    maps = sweep()
    maps[4] = np.nan
    viewer.add_image(maps, name="sweep")
    widget = drawn()
    share, radius = lines(widget)
    np.testing.assert_array_equal(share, [0, 0, 50, 0, np.nan])
    np.testing.assert_array_equal(radius, [6.5, 5, 4, 4.75, np.nan])
    assert widget.status.value == (
        "Sharpest: plane 2, 50% in focus, median 4.00 px\n"
        "It rests on all pixels, sure or not: there is no confidence."
    )


def test_threshold_decides_what_is_in_focus(viewer, drawn, until_read):
    viewer.add_image(sweep())
    widget = drawn()
    before, widget.form.threshold.value = widget.curve, 4
    until_read(widget, before)
    np.testing.assert_array_equal(lines(widget)[0], [0, 50, 50, 50, 0])


def test_masks_that_were_made_along_with_the_maps_decide_at_once(viewer, drawn, method):
    stack = viewer.add_image(np.random.default_rng(0).random((3, 32, 48)).astype(np.float32))
    blur_map, _, _ = analysed(viewer, stack)
    viewer.layers.selection = {blur_map}
    widget = drawn()
    assert widget.form.blur_maps.value == blur_map
    assert widget.form.mask.value.name.endswith("in focus")
    assert not widget.form.threshold.enabled
    np.testing.assert_array_equal(lines(widget)[0], [100, 100, 100])
    assert widget.curve.median_confidence == pytest.approx(0.5, abs=0.01)
    assert widget.status.value.endswith("It rests on the 50% of each plane that are sure.")


def test_line_follows_the_slider_and_a_click_moves_the_slider(viewer, drawn):
    layer = viewer.add_image(sweep(), scale=(5, 1, 1), translate=(10, 0, 0))
    widget = drawn()
    viewer.dims.set_point(0, 25)
    assert marked(widget) == 3
    click(widget.plot, 0.8)
    assert viewer.dims.point[0] == 15
    assert marked(widget) == 1
    assert layer.ndim == 3
    widget.best_button.changed.emit(True)
    assert viewer.dims.point[0] == 20


def test_click_goes_to_the_plane_of_the_stack_beside_a_longer_one(viewer, drawn):
    viewer.add_labels(np.zeros((2, 20, 8, 10), int))
    viewer.add_image(sweep(), translate=(7, 0, 0))
    widget = drawn()
    widget.go_to(2)
    assert viewer.dims.point[1] == 9
    assert marked(widget) == 2


def test_of_two_sliders_the_curve_runs_along_one_where_the_other_stands(viewer, drawn):
    movie = sweep(np.stack([RADII, RADII[::-1] + 0.5]))
    viewer.add_image(movie, axis_labels=("t", "z", "y", "x"))
    viewer.dims.set_current_step((0, 1), (0, 0))
    widget = drawn()
    assert widget.form.names() == ["t", "z"]
    np.testing.assert_array_equal(lines(widget)[1], (RADII + 7) / 2)
    viewer.dims.set_current_step(0, 1)
    np.testing.assert_array_equal(lines(widget)[1], (RADII[::-1] + 7.5) / 2)
    widget.go_to_sharpest()
    assert viewer.dims.current_step[:2] == (1, 2)
    widget.form.along.value = 0
    np.testing.assert_array_equal(lines(widget)[1], [4, 4.25])
    assert marked(widget) == 1


def test_planes_along_another_axis_are_those_that_were_analysed(viewer, drawn, method):
    stack = viewer.add_image(np.random.default_rng(0).random((32, 5, 48)).astype(np.float32))
    viewer.dims.order = (1, 0, 2)
    blur_map, *_ = analysed(viewer, stack)
    viewer.layers.selection = {blur_map}
    blur_map.data[:, 3] = 1
    blur_map.data = blur_map.data.copy()
    widget = drawn()
    np.testing.assert_allclose(lines(widget)[1], [2.5, 2.5, 2.5, 1, 2.5])
    widget.go_to_sharpest()
    assert viewer.dims.current_step[1] == marked(widget)


def test_new_data_of_the_layer_are_read_again(viewer, drawn, until_read):
    layer = viewer.add_image(sweep())
    widget = drawn()
    before, layer.data = widget.curve, sweep(RADII[::-1])
    until_read(widget, before)
    np.testing.assert_array_equal(lines(widget)[1], (RADII[::-1] + 7) / 2)


@pytest.mark.parametrize("planes", [(3,), (7,), (2, 3)])
def test_stack_that_gets_another_shape_gets_another_curve(viewer, drawn, until_read, planes):
    layer = viewer.add_image(sweep())
    widget = drawn()
    viewer.dims.set_current_step(0, 4)
    before, layer.data = widget.curve, sweep(np.ones(planes))
    viewer.dims.set_current_step(0, 0)
    until_read(widget, before)
    assert lines(widget)[1].tolist() == [4.0] * planes[-1]
    assert widget.form.slider == len(planes) - 1


def test_masks_that_come_with_the_first_analysis_are_taken_though_they_come_last(
    window, docked, method, qtbot
):
    stack = window.add_image(np.random.default_rng(0).random((3, 32, 48)).astype(np.float32))
    widget = docked(FocusCurveWidget)
    assert widget.form.layer is None, "a picture is no blur map unless it is chosen"
    analysed(window, stack)
    qtbot.waitUntil(lambda: widget.curve is not None and widget._running is None)
    assert widget.form.layer.name.endswith("blur (px)")
    assert widget.form.mask.value.name.endswith("in focus")
    assert lines(widget)[0].tolist() == [100, 100, 100]


def test_large_stack_is_read_in_a_thread_and_can_be_cancelled(viewer, opened, qtbot):
    read, cancelled = [], threading.Event()

    def slow(block_info):
        read.append(block_info)
        if len(read) > 5:
            cancelled.wait(600)
        return np.ones((1, 8, 10), np.float32)

    stack = da.map_blocks(slow, chunks=((1,) * 200, (8,), (10,)), dtype=np.float32)
    viewer.add_image(stack, contrast_limits=(0, 8))
    widget = opened(FocusCurveWidget)
    choose(widget)
    running = widget.run()
    qtbot.waitUntil(lambda: len(read) > 5)
    with qtbot.waitSignal(running.finished):
        widget.cancel()
        cancelled.set()
    assert len(read) < 10, "of 200 planes"
    assert widget.curve is None
    assert not widget.save_button.enabled


def test_only_stacks_of_floats_are_offered(viewer, opened):
    viewer.add_image(np.zeros((4, 8, 10), np.uint8), name="picture")
    viewer.add_image(np.zeros((8, 10), np.float32), name="one plane")
    viewer.add_image(np.zeros((4, 8, 10, 3), np.float32), rgb=True, name="colours")
    widget = opened(FocusCurveWidget)
    assert widget.form.blur_maps.choices == (None,)
    assert widget.run() is None
    assert widget.status.value == NO_STACK
    assert not widget.best_button.enabled


def test_removed_stack_takes_its_curve_with_it(window, docked, qtbot):
    layer = window.add_image(sweep())
    widget = docked(FocusCurveWidget)
    choose(widget)
    qtbot.waitUntil(lambda: widget.curve is not None and widget._running is None)
    window.layers.remove(layer)
    qtbot.waitUntil(lambda: widget.status.value == NO_STACK)
    assert lines(widget)[0].size == 0
    assert not widget.save_button.enabled


def test_plot_takes_the_colours_of_the_theme(viewer, drawn):
    viewer.theme = "dark"
    viewer.add_image(sweep())
    widget = drawn()
    dark = sum(widget.plot.figure.get_facecolor()[:3])
    viewer.theme = "light"
    assert dark < 1 < 2 < sum(widget.plot.figure.get_facecolor()[:3])


def test_curve_is_saved_and_no_file_is_replaced_unasked(
    viewer, drawn, tmp_path, monkeypatch, messages
):
    viewer.add_image(sweep(), name="sweep")
    widget = drawn()
    file = tmp_path / "mine.csv"
    file.write_text("mine")
    widget.save(file)
    assert file.read_text() == "mine"
    assert "exists already" in messages()[-1]
    suggested = []

    def choose(parent, title, name, kinds):
        suggested.append(name)
        return str(tmp_path / "sweep"), kinds

    monkeypatch.setattr(QFileDialog, "getSaveFileName", choose)
    widget.save_button.changed.emit(True)
    assert suggested == ["sweep focus.csv"]
    rows = list(csv.DictReader((tmp_path / "sweep.csv").open()))
    assert [float(row["share_in_focus"]) for row in rows] == [0, 0, 0.5, 0, 0]
    assert widget.status.value == "Saved in sweep.csv"


def test_every_field_explains_itself(viewer, opened):
    widget = opened(FocusCurveWidget)
    fields = (*widget.form.fields(), widget.best_button, widget.save_button)
    for field in (*fields, RegionField(viewer), PlanesField()):
        assert len(field.tooltip) > 40


def test_region_field_offers_what_there_is_and_cuts_planes(viewer, qtbot):
    texture = np.random.default_rng(0).random((40, 50))
    image = viewer.add_image(texture)
    field = RegionField(viewer)
    qtbot.addWidget(field.native)
    assert field.value == "whole"
    plane = shown_plane(image, viewer.dims)
    assert field.part_of(plane) is plane
    shapes = viewer.add_shapes([[5, 6], [24, 35]], shape_type="rectangle", name="cells")
    field.reset_choices()
    assert field.value == "whole"
    assert [name for name, _ in field._regions(field)] == [
        "whole picture",
        "visible field",
        "shapes: cells",
    ]
    field.value = shapes
    np.testing.assert_array_equal(field.part_of(plane).read(), texture[5:25, 6:36])
    viewer.layers.remove(shapes)
    field.reset_choices()
    assert field.value == "whole"


def test_planes_field_starts_with_the_plane_that_is_shown(qtbot):
    field = PlanesField()
    qtbot.addWidget(field.native)
    assert not field.all_planes
    field.value = "all"
    assert field.all_planes
