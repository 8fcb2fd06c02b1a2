"""What is known under the mouse."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from napari.components import ViewerModel
from napari.utils.theme import get_theme
from qtpy.QtCore import QPoint, Qt
from qtpy.QtTest import QTest
from skimage.data import gravel

from napari_defocus import explain_pixel, simulate_defocus
from napari_defocus.core.progress import silent
from napari_defocus.settings import MapSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.display.probing import (
    NothingKnownError,
    corners_of,
    image_of,
    image_to_probe,
    may_pin,
    pixel_at,
    probed,
)
from napari_defocus.widgets.display.window_outline import WindowOutline
from napari_defocus.widgets.docks import probe
from napari_defocus.widgets.docks.probe import INTERVAL, ProbeWidget
from napari_defocus.widgets.forms.image_panel import ImagePanel
from napari_defocus.widgets.jobs.estimation import (
    JobCache,
    Picture,
    analysed_picture,
    estimated_map,
)
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import blur_map_layer

SIDE = 120
TURNED = {"scale": (0.5, 0.5), "rotate": 30, "translate": (7, -3), "units": ("um", "um")}


@pytest.fixture(scope="module")
def blurred():
    return simulate_defocus(gravel()[:SIDE, :SIDE], np.full((SIDE, SIDE), 3.0), rng=0)


@pytest.fixture
def cache():
    return JobCache()


def measure(viewer, layer, cache):
    """Analyse the shown plane, as the other widgets do."""
    picture = Picture.of(shown_plane(layer, viewer.dims))
    return picture, estimated_map(picture, MapSettings(), cache, silent)


def show(outline, image, corners):
    while not outline.show(image, corners):
        time.sleep(0.01)


def test_what_is_told_is_what_is_known_of_the_pixel_there(viewer, blurred, cache):
    image = viewer.add_image(blurred, **TURNED)
    _, found = measure(viewer, image, cache)
    told = probed(viewer, image, image.data_to_world((30.3, 70.4)), cache)
    candidates = cache.analysed.latest(image).candidates
    expected = explain_pixel(
        candidates, 30, 70, blur_map=found.values, confidence=found.confidence, image=blurred
    )
    assert str(told.explanation) == str(expected)
    assert (told.explanation.row, told.explanation.column) == (30, 70)
    assert told.explanation.blur == found.values[30, 70]
    assert told.image is image


def test_candidates_alone_are_told_before_there_is_a_map(viewer, blurred, cache):
    image = viewer.add_image(blurred)
    picture = Picture.of(shown_plane(image, viewer.dims))
    analysed_picture(picture, MapSettings(), cache, silent)
    assert probed(viewer, image, (30, 30), cache).explanation.blur is None


def test_of_a_stack_only_the_measured_plane_is_known(viewer, blurred, cache):
    stack = viewer.add_image(np.stack([blurred * 0, blurred, blurred]), scale=(2, 1, 1))
    viewer.dims.set_point(0, 2)
    measure(viewer, stack, cache)
    told = probed(viewer, stack, (2, 40, 50), cache)
    assert (told.explanation.row, told.explanation.column) == (40, 50)
    assert set(told.corners[:, 0]) == {1}
    with pytest.raises(NothingKnownError, match="plane 1 was"):
        probed(viewer, stack, (4, 40, 50), cache)


def test_place_that_nobody_has_measured_is_said_to_be_unknown(viewer, blurred, cache):
    image = viewer.add_image(blurred.copy())
    with pytest.raises(NothingKnownError, match="Nothing is known here yet: measure the picture"):
        probed(viewer, image, (3, 3), cache)
    with pytest.raises(NothingKnownError, match="no image"):
        probed(viewer, None, (3, 3), cache)
    measure(viewer, image, cache)
    with pytest.raises(NothingKnownError, match="outside"):
        probed(viewer, image, (3, SIDE), cache)
    image.data = 1 - image.data
    with pytest.raises(NothingKnownError, match="was changed"):
        probed(viewer, image, (3, 3), cache)


def test_part_of_a_plane_has_its_own_rows_and_columns(viewer):
    stack = viewer.add_image(np.zeros((4, 60, 80)), scale=(1, 2, 2))
    index, shape = (3, slice(10, 40), slice(20, 70)), (30, 50)
    assert pixel_at(stack, index, shape, (3, 2 * 12, 2 * 25)) == (2, 5)
    for outside in ((3, 2 * 9, 50), (3, 24, 2 * 70)):
        with pytest.raises(NothingKnownError, match="outside"):
            pixel_at(stack, index, shape, outside)
    corners = corners_of((-0.5, 4, 25, 49.5), index, shape)
    np.testing.assert_array_equal(corners.min(axis=0), (3, 10, 24))
    np.testing.assert_array_equal(corners.max(axis=0), (3, 35, 69))


def test_outline_lies_on_the_window(viewer, blurred, cache):
    image = viewer.add_image(blurred, **TURNED)
    measure(viewer, image, cache)
    outline = WindowOutline(viewer, lambda: None)
    for place in ((60, 60), (80, 70)):
        told = probed(viewer, image, image.data_to_world(place), cache)
        show(outline, told.image, told.corners)
        [drawn] = outline.layer.data
        np.testing.assert_allclose(drawn.min(axis=0), told.explanation.window[:2])
        np.testing.assert_allclose(np.ptp(drawn, axis=0), 41)
        world = image.data_to_world(drawn[0])
        np.testing.assert_allclose(outline.layer.data_to_world(drawn[0]), world)
    assert [layer.name for layer in viewer.layers] == ["blurred", "probe"]
    image.translate = (100, 50)
    show(outline, told.image, told.corners)
    np.testing.assert_allclose(outline.layer.data_to_world(drawn[0]), image.data_to_world(drawn[0]))


def test_outline_changes_neither_sliders_nor_what_is_seen(viewer):
    image = viewer.add_image(np.zeros((3, 50, 60)), scale=(3, 2, 2))
    before = viewer.dims.range, viewer.dims.point, tuple(viewer.scene.camera.center)
    outline = WindowOutline(viewer, lambda: None)
    show(
        outline,
        image,
        corners_of((-0.5, -0.5, 49.5, 59.5), (1, slice(None), slice(None)), (50, 60)),
    )
    assert (viewer.dims.range, viewer.dims.point, tuple(viewer.scene.camera.center)) == before
    outline.remove()
    assert list(viewer.layers) == [image]


def test_outline_leaves_the_brush_and_the_selection_alone(viewer):
    image = viewer.add_image(np.zeros((60, 60)))
    labels = viewer.add_labels(np.zeros((60, 60), np.uint8))
    labels.mode = "paint"
    outline = WindowOutline(viewer, lambda: None)
    show(outline, image, corners_of((3, 3, 44, 44), (slice(None), slice(None)), (60, 60)))
    assert viewer.layers.selection == {labels}
    assert viewer.layers.selection.active is labels
    assert labels.mode == "paint"
    assert not may_pin(viewer)
    outline.remove()
    assert viewer.layers.selection.active is labels
    labels.mode = "pan_zoom"
    assert may_pin(viewer)


def test_line_of_the_outline_is_as_wide_at_every_zoom(viewer):
    image = viewer.add_image(np.zeros((5, 60, 60)), scale=(0.1, 0.5, 0.5))
    outline = WindowOutline(viewer, lambda: None)
    show(outline, image, corners_of((3, 3, 44, 44), (2, slice(None), slice(None)), (60, 60)))
    for zoom in (1.0, 16.0):
        viewer.scene.camera.zoom = zoom
        assert outline.layer.edge_width[0] * 0.5 * zoom == pytest.approx(2)


def test_outline_may_be_deleted_by_hand(viewer):
    image = viewer.add_image(np.zeros((60, 60)))
    deleted = []
    outline = WindowOutline(viewer, lambda: deleted.append(True))
    corners = corners_of((3, 3, 44, 44), (slice(None), slice(None)), (60, 60))
    show(outline, image, corners)
    viewer.layers.remove("probe")
    assert deleted == [True]
    assert outline.layer is None
    outline.remove()
    show(outline, image, corners)
    viewer.layers.clear()
    assert deleted == [True, True]


def test_picture_of_a_result_is_the_one_that_it_was_made_of(viewer, blurred, cache):
    other = viewer.add_image(np.zeros((9, 9)), name="other")
    image = viewer.add_image(blurred, name="stones")
    picture, found = measure(viewer, image, cache)
    layer = blur_map_layer(picture.plane, found.values, MapSettings(), found.noise_variance)
    [shown] = add_results(viewer, [layer])
    assert image_of(viewer.layers, shown) is image
    assert image_to_probe(viewer, cache) is image
    viewer.layers.selection.active = other
    assert image_to_probe(viewer, cache) is image, "nothing is known of the other"
    assert image_to_probe(viewer, JobCache()) is other
    assert image_to_probe(ViewerModel(), cache) is None


# --- the widget -----------------------------------------------------------------------------


@pytest.fixture
def beside(viewer, qtbot, blurred):
    """The probe beside a viewer's model with a measured picture; watching."""
    image = viewer.add_image(blurred, name="stones")
    measure(viewer, image, ImagePanel.cache)
    widget = ProbeWidget(viewer)
    qtbot.addWidget(widget.native)
    widget.start()
    yield widget
    widget.stop()


def hover(viewer, position):
    for callback in viewer.mouse_move_callbacks:
        callback(viewer, SimpleNamespace(position=position))


def click(viewer, position, *, drag=0):
    event = SimpleNamespace(
        position=position, pos=(50, 50), button=1, type="mouse_press", modifiers=()
    )
    for callback in viewer.mouse_drag_callbacks:
        generator = callback(viewer, event)
        if next(generator, "refused") == "refused":
            continue
        event.pos = (50 + drag, 50)
        for event.type in ("mouse_move", "mouse_release"):
            next(generator, None)


@pytest.mark.display
def test_hover_tells_the_latest_place_once(viewer, beside, qtbot, monkeypatch):
    asked = []

    def counted(viewer, layer, position, cache):
        asked.append(position)
        return probed(viewer, layer, position, cache)

    monkeypatch.setattr(probe, "probed", counted)
    for row in range(20, 60):
        hover(viewer, (row, 70.0))
    assert asked == [], "the mouse is not held up"
    qtbot.waitUntil(lambda: bool(asked))
    assert asked == [(59, 70.0)]
    assert beside.text.value == str(probe_at(viewer, (59, 70)).explanation)


def probe_at(viewer, position):
    return probed(viewer, viewer.layers["stones"], position, ImagePanel.cache)


@pytest.mark.display
def test_click_pins_and_another_one_moves_the_pin(viewer, beside, qtbot):
    for place in ((30, 40), (80, 90)):
        click(viewer, place)
        assert beside.text.value == str(probe_at(viewer, place).explanation)
        assert not beside.follow.value
    hover(viewer, (50, 50))
    qtbot.wait(2 * INTERVAL)
    assert beside.text.value == str(probe_at(viewer, (80, 90)).explanation)
    beside.follow.value = True
    hover(viewer, (50, 50))
    qtbot.waitUntil(lambda: beside.text.value == str(probe_at(viewer, (50, 50)).explanation))


@pytest.mark.display
def test_brush_rests_when_the_probe_comes_so_that_a_click_pins_and_paints_nothing(
    viewer, beside, qtbot
):
    beside.stop()
    seeds = viewer.add_labels(np.zeros((SIDE, SIDE), np.uint8))
    seeds.mode = "paint"
    beside.start()
    assert seeds.mode == "pan_zoom"
    assert viewer.layers.selection.active is viewer.layers["stones"]
    click(viewer, (30, 40))
    assert not beside.follow.value, "pinned"


@pytest.mark.display
def test_drag_and_brush_do_not_pin(viewer, beside):
    click(viewer, (30, 40), drag=30)
    assert beside.follow.value
    viewer.add_labels(np.zeros((SIDE, SIDE), np.uint8)).mode = "paint"
    click(viewer, (30, 40))
    assert beside.follow.value
    click(viewer, (-30, 40))
    assert beside.follow.value


@pytest.mark.display
def test_curve_of_the_place_is_drawn(viewer, beside):
    beside.pin((30, 40))
    told = probe_at(viewer, (30, 40)).explanation
    axes = beside._curve.figure.axes[0]
    assert any(np.array_equal(line.get_ydata(), told.log_likelihood) for line in axes.lines)
    assert f"confidence {told.confidence:.2f}" in axes.get_title()
    beside.pin((60, 60))
    curves = [line for line in beside._curve.figure.axes[0].lines if len(line.get_xdata()) > 50]
    assert len(curves) == 1


@pytest.mark.display
def test_refresh_shows_what_a_new_analysis_has_found(viewer, beside):
    beside.pin((30, 40))
    before = beside.text.value
    image = viewer.layers["stones"]
    picture = Picture.of(shown_plane(image, viewer.dims))
    estimated_map(picture, MapSettings(max_radius=4, noise_variance=1e-3), ImagePanel.cache, silent)
    beside.refresh()
    assert beside.text.value != before
    assert beside._curve.figure.axes[0].get_xlim() == (0, 4)


@pytest.mark.display
def test_unknown_place_empties_the_drawing_and_says_why(viewer, beside, qtbot):
    beside.pin((30, 40))
    qtbot.waitUntil(lambda: "probe" in viewer.layers)
    other = viewer.add_image(np.zeros((30, 30)), name="other")
    beside.reset_choices()
    beside.set_image(other)
    assert "measure the picture first" in beside.text.value
    assert not beside._curve.figure.axes[0].lines
    assert not viewer.layers["probe"].visible
    beside.set_image(viewer.layers["stones"])
    assert "The blur is" in beside.text.value
    assert viewer.layers["probe"].visible


@pytest.mark.display
def test_outline_goes_when_it_is_not_wanted(viewer, beside, qtbot):
    beside.pin((30, 40))
    qtbot.waitUntil(lambda: "probe" in viewer.layers)
    beside.outlined.value = False
    assert "probe" not in viewer.layers
    beside.outlined.value = True
    assert "probe" in viewer.layers
    viewer.layers.remove("probe")
    assert not beside.outlined.value
    beside.pin((50, 40))
    assert "probe" not in viewer.layers


@pytest.mark.display
def test_picture_may_be_deleted_while_it_is_explained(viewer, beside, qtbot):
    beside.pin((30, 40))
    qtbot.waitUntil(lambda: "probe" in viewer.layers)
    viewer.layers.remove("stones")
    beside.reset_choices()
    beside.refresh()
    assert "no image" in beside.text.value
    assert len(viewer.layers) == 0


@pytest.mark.display
def test_slider_is_followed(viewer, qtbot, blurred):
    stack = viewer.add_image(np.stack([blurred, 1 - blurred]), name="stones")
    viewer.dims.set_point(0, 0)
    measure(viewer, stack, ImagePanel.cache)
    widget = ProbeWidget(viewer)
    qtbot.addWidget(widget.native)
    widget.start()
    hover(viewer, (0.0, 30.0, 40.0))
    qtbot.waitUntil(lambda: "The blur is" in widget.text.value)
    viewer.dims.set_point(0, 1)
    qtbot.waitUntil(lambda: "plane 0 was" in widget.text.value)
    viewer.dims.set_point(0, 0)
    qtbot.waitUntil(lambda: "The blur is" in widget.text.value)
    widget.stop()
    assert not viewer.mouse_move_callbacks


@pytest.mark.display
def test_mouse_is_followed_and_clicks_pin_in_a_real_window(
    make_napari_viewer_proxy, qtbot, blurred
):
    viewer = make_napari_viewer_proxy(show=True)
    image = viewer.add_image(blurred, name="stones")
    measure(viewer, image, ImagePanel.cache)
    labels = viewer.add_labels(np.zeros((SIDE, SIDE), np.uint8))
    widget = ProbeWidget(viewer)
    dock = viewer.window.add_dock_widget(widget)
    canvas = viewer.__wrapped__.window._qt_viewer.canvas.native
    qtbot.waitUntil(lambda: widget._watching)
    qtbot.wait(100)
    middle = QPoint(canvas.width() // 2, canvas.height() // 2)
    QTest.mouseMove(canvas, middle + QPoint(9, 5))
    QTest.mouseMove(canvas, middle)
    qtbot.waitUntil(lambda: "probe" in viewer.layers)
    assert viewer.layers.selection == {labels}
    row, column = (round(at) for at in viewer.cursor.position)
    assert f"row {row}, column {column}" in widget._curve.figure.axes[0].get_title()

    labels.mode = "paint"
    QTest.mouseClick(canvas, Qt.LeftButton, pos=middle)
    assert labels.data.any(), "painted"
    assert widget.follow.value, "not pinned"
    labels.mode = "pan_zoom"
    QTest.mouseClick(canvas, Qt.LeftButton, pos=middle)
    assert not widget.follow.value, "pinned"

    for theme in ("light", "dark"):
        viewer.theme = theme
        ground = get_theme(theme).background.as_rgb_tuple()
        drawn = np.asarray(widget._curve.figure.get_facecolor())[:3]
        np.testing.assert_allclose(drawn, np.array(ground) / 255, atol=0.01)

    dock.hide()
    assert "probe" not in viewer.layers
    assert not viewer.mouse_move_callbacks
    dock.show()
    qtbot.waitUntil(lambda: "probe" in viewer.layers)
    viewer.window.remove_dock_widget(dock)
    qtbot.waitUntil(lambda: "probe" not in viewer.layers)
    QTest.mouseMove(canvas, middle + QPoint(20, 20))
    qtbot.wait(2 * INTERVAL)
    assert [layer.name for layer in viewer.layers] == ["stones", "Labels"]
