import gc
import weakref

import numpy as np
import pytest

from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.display.cursor_text import show_under_cursor, text_under_cursor
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import (
    blur_map_layer,
    confidence_layer,
    in_focus_layer,
    not_trusted_layer,
)
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY

RADIUS, SURE = 3.21, 0.94


@pytest.fixture
def leaf(viewer, texture):
    return viewer.add_image(texture, name="leaf", scale=(0.5, 0.5))


def results_on(layer, viewer, radius=RADIUS, sure=SURE, mask=1, cover=None, **settings):
    plane, made = shown_plane(layer, viewer.dims), MapSettings(**settings)
    confidence = confidence_layer(plane, np.full(plane.shape, sure), made, 3e-5)
    results = [blur_map_layer(plane, np.full(plane.shape, radius), made, 3e-5), confidence]
    if mask is not None:
        mask = np.full(plane.shape, mask, np.uint8)
        results.append(in_focus_layer(plane, mask, MaskSettings(threshold=4.0), made, 3e-5))
    if cover is not None:
        results.append(not_trusted_layer(confidence, cover))
    return results


def moved_to(viewer, *position):
    """Move the cursor as napari does, and return the coordinates that it tells."""
    viewer.mouse_over_canvas = True
    viewer.cursor.position = position
    viewer.update_status_from_cursor()
    return viewer.status["coordinates"]


def test_status_tells_blur_confidence_and_focus_on_the_picture_and_on_its_results(viewer, leaf):
    layers = add_results(viewer, results_on(leaf, viewer, cover=0.5))
    for layer in layers:
        viewer.layers.selection.active = layer
        coordinates = layer.get_status((10.0, 20.0), world=True)["coords"]
        assert moved_to(viewer, 10.0, 20.0) == f"{coordinates}: 3.2 px, confidence 0.94, in focus"
    viewer.layers.selection.active = leaf
    usual = leaf.get_status((10.0, 20.0), world=True)["coordinates"]
    assert moved_to(viewer, 10.0, 20.0) == f"{usual}; 3.2 px, confidence 0.94, in focus"


def test_nothing_is_told_that_is_not_known(viewer, leaf, texture):
    layers = add_results(viewer, results_on(leaf, viewer, mask=0))
    viewer.layers.selection.active = leaf
    for layer, told in (
        (None, "3.2 px, confidence 0.94, blurred like its surroundings"),
        (layers[1], "3.2 px, blurred like its surroundings"),
        (layers[0], "blurred"),
        (layers[2], ""),
    ):
        if layer is not None:
            viewer.layers.remove(layer)
        assert text_under_cursor(viewer) == told
    other = viewer.add_image(texture, name="other")
    add_results(viewer, results_on(leaf, viewer))
    viewer.layers.selection.active = other
    assert text_under_cursor(viewer) == ""


def test_nothing_is_told_beside_the_picture_and_without_a_value(viewer, leaf):
    blur_map, *_ = add_results(viewer, results_on(leaf, viewer, mask=None))
    blur_map.data[4, 6] = np.nan
    assert "px" not in moved_to(viewer, 2, 3)
    assert "3.2 px" in moved_to(viewer, 2, 4)
    assert "px" not in moved_to(viewer, -1, 4)
    viewer.layers.selection.active = None
    viewer.update_status_from_cursor()
    assert viewer.status == "Ready"


def test_low_confidence_is_not_trusted(viewer, leaf):
    add_results(viewer, results_on(leaf, viewer, sure=0.31))
    assert moved_to(viewer, 3, 4).endswith(
        "3.2 px, confidence 0.31 (not trusted: details fit several radii), "
        "in focus like its surroundings"
    )


def test_place_without_details_is_said_to_be_one(viewer, leaf):
    add_results(viewer, results_on(leaf, viewer, sure=0.08, mask=2))
    assert moved_to(viewer, 3, 4).endswith(
        "3.2 px, confidence 0.08 (not trusted: no details here), in focus or not is not known"
    )


@pytest.mark.parametrize(("cover", "trusted"), [(0.25, True), (0.4, False), (0.0, False)])
def test_what_is_trusted_is_what_the_cover_leaves_open(viewer, leaf, cover, trusted):
    add_results(viewer, results_on(leaf, viewer, sure=0.31, cover=cover))
    assert ("not trusted" not in moved_to(viewer, 3, 4)) == trusted


def test_values_are_those_that_the_layers_hold_now(viewer, leaf):
    blur_map, *_ = add_results(viewer, results_on(leaf, viewer))
    blur_map.data = np.full_like(blur_map.data, 5.0)
    assert "5.0 px" in moved_to(viewer, 3, 4)
    add_results(viewer, results_on(leaf, viewer, radius=1.5))
    assert "1.5 px" in moved_to(viewer, 3, 5)


def test_each_of_several_results_tells_its_own_run_and_the_picture_the_newest(viewer, leaf):
    old = add_results(viewer, results_on(leaf, viewer, smoothness=20.0))
    new = add_results(
        viewer,
        results_on(leaf, viewer, radius=1, sure=0.7, mask=0, smoothness=30.0),
        keep_earlier=True,
    )
    for layers, told in (
        (old, "3.2 px, confidence 0.94, in focus"),
        ([*new, leaf], "1.0 px, confidence 0.70, blurred like its surroundings"),
    ):
        for layer in layers:
            viewer.layers.selection.active = layer
            assert text_under_cursor(viewer) == told


def test_confidence_of_another_map_is_not_told(viewer, leaf):
    add_results(viewer, results_on(leaf, viewer))
    another, *_ = results_on(leaf, viewer, radius=2.0, psf="gaussian")
    add_results(viewer, [another])
    assert text_under_cursor(viewer) == "2.0 px, in focus"


def test_of_a_stack_only_the_plane_with_results_has_numbers(viewer):
    stack = viewer.add_image(np.random.default_rng(0).random((5, 32, 48)), scale=(4, 1, 1))
    for plane, radius in ((1, 2.0), (3, 4.0)):
        viewer.dims.set_current_step(0, plane)
        results = results_on(stack, viewer, radius=radius, smoothness=10.0 * plane)
        add_results(viewer, results, keep_earlier=True)
    viewer.layers.selection.active = stack
    for plane, told in ((1, "2.0 px, confidence 0.94, in focus"), (3, "4.0 px"), (2, "")):
        viewer.cursor.position = 4 * plane, 10, 10
        assert text_under_cursor(viewer).startswith(told)
        assert bool(text_under_cursor(viewer)) == bool(told)
    viewer.dims.ndisplay = 3
    viewer.cursor.position = 4, 10, 10
    assert text_under_cursor(viewer) == ""


def test_map_of_a_crop_at_another_scale_is_read_where_the_cursor_is(viewer, leaf):
    made = {"result": "blur map", "source": "leaf"}
    values = np.arange(12.0).reshape(3, 4)
    viewer.add_image(
        values, scale=(5, 5), translate=(10, 20), metadata={METADATA_KEY: made}, name="crop"
    )
    viewer.layers.selection.active = leaf
    viewer.cursor.position = 16, 29
    assert text_under_cursor(viewer) == "6.0 px"
    viewer.cursor.position = 5, 29
    assert text_under_cursor(viewer) == ""


def test_tooltip_tells_the_same_where_tooltips_are_shown(viewer, leaf):
    add_results(viewer, results_on(leaf, viewer))
    viewer.layers.selection.active = leaf
    moved_to(viewer, 3, 4)
    assert viewer.tooltip.text == ""
    viewer.tooltip.visible = True
    for column in (5, 6):
        moved_to(viewer, 3, column)
        assert viewer.tooltip.text == "3.2 px, confidence 0.94, in focus"
    moved_to(viewer, -3, 5)
    assert viewer.tooltip.text == ""


def test_features_of_a_labels_layer_stay_in_its_tooltip(viewer, leaf):
    *_, mask = add_results(viewer, results_on(leaf, viewer))
    mask.features = {"index": [1], "name": ["sharp"]}
    viewer.tooltip.visible = True
    viewer.layers.selection.active = mask
    moved_to(viewer, 3, 4)
    usual, ours = viewer.tooltip.text.rsplit("\n", 1)
    assert "name: sharp" in usual
    assert ours == "3.2 px, confidence 0.94, in focus"


def test_several_selected_layers_get_one_text(viewer, leaf):
    blur_map, *_ = add_results(viewer, results_on(leaf, viewer))
    viewer.layers.selection = {leaf, blur_map}
    viewer.mouse_over_canvas = True
    viewer.cursor.position = 3, 4
    viewer.update_status_from_cursor()
    assert f"leaf: {leaf.data[6, 8]:.3f}"[:-1] in viewer.status
    assert viewer.status.endswith("    3.2 px, confidence 0.94, in focus")


def test_status_of_somebody_else_is_left_alone(viewer, leaf):
    add_results(viewer, results_on(leaf, viewer))
    viewer.cursor.position = 3, 4
    for status in ("Ready", "Saved leaf.tif"):
        viewer.status = status
        assert viewer.status == status


def test_viewer_is_told_once_and_nothing_holds_on_to_layers(viewer, texture):
    emitters = viewer.events.status, viewer.tooltip.events.text
    before = [len(emitter.callbacks) for emitter in emitters]

    def shown():
        layer = viewer.add_image(texture, name="leaf")
        for _ in range(3):
            layers = add_results(viewer, results_on(layer, viewer))
            show_under_cursor(viewer)
        moved_to(viewer, 3, 4)
        return [weakref.ref(found) for found in (layer, *layers)]

    alive = shown()
    assert [len(emitter.callbacks) for emitter in emitters] == [1 + count for count in before]
    # napari itself holds on to the layer that was active last.
    viewer.layers.clear()
    viewer.add_image(texture, name="other")
    gc.collect()
    assert [found() for found in alive] == [None] * 4


def test_results_are_layers_like_all_others(viewer, leaf):
    for layer in add_results(viewer, results_on(leaf, viewer)):
        own = [name for name in vars(layer) if callable(getattr(type(layer), name, None))]
        assert own == [], "no method of this layer is another one than of its class"


@pytest.mark.display
def test_status_bar_of_a_window_says_it(make_napari_viewer, texture):
    from qtpy.QtWidgets import QLabel

    window = make_napari_viewer()
    layer = window.add_image(texture, name="leaf")
    add_results(window, results_on(layer, window))
    window.mouse_over_canvas = True
    window.cursor.position = 3, 4
    told = "3.2 px, confidence 0.94, in focus"
    window.update_status_from_cursor()
    labels = window.window._qt_window.statusBar().findChildren(QLabel)
    assert any(label.text().endswith(told) for label in labels)


@pytest.mark.display
def test_viewer_that_is_lent_to_a_plugin_tells_it_too(window, texture):
    layer = window.add_image(texture, name="leaf")
    add_results(window, results_on(layer, window))
    assert moved_to(window, 3, 4).endswith("3.2 px, confidence 0.94, in focus")
