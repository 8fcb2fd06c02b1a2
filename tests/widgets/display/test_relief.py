import gc
import math
import weakref

import numpy as np
import pytest

from napari_defocus.settings import MapSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.display.relief import hide_relief, show_relief
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import blur_map_layer, confidence_layer
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY

PLACED = {
    "scale": (0.5, 0.25),
    "translate": (3.0, -4.0),
    "rotate": 20.0,
    "units": ("um", "um"),
    "axis_labels": ("y", "x"),
}


@pytest.fixture
def leaf(viewer, texture):
    return viewer.add_image(texture, name="leaf", **PLACED)


def slope(shape, largest=4.0):
    return np.linspace(0, largest, math.prod(shape), dtype=np.float32).reshape(shape)


def results_on(layer, viewer, blur=None, sure=1.0, **options):
    plane = shown_plane(layer, viewer.dims)
    blur = slope(plane.shape) if blur is None else blur
    sure = np.broadcast_to(np.float32(sure), plane.shape).copy()
    results = [
        blur_map_layer(plane, blur, MapSettings(), 3e-5),
        confidence_layer(plane, sure, MapSettings(), 3e-5),
    ]
    return add_results(viewer, results, **options)


def depth_on(layer, viewer, depth, **options):
    plane = shown_plane(layer, viewer.dims)
    made = {"result": "depth", "source": layer.name}
    keywords = {"name": "leaf depth (m)", "metadata": {METADATA_KEY: made}, **plane.placement}
    return add_results(viewer, [(plane.expanded(depth), keywords, "image")], **options)


def corners(relief):
    used = np.unique(relief.faces)
    return relief.vertices[used], relief.texcoords[used]


def state(viewer):
    camera, dims = viewer.scene.camera, viewer.dims
    return {
        "visible": {layer.name: layer.visible for layer in viewer.layers},
        "active": viewer.layers.selection.active,
        "camera": np.round([*camera.center[-2:], camera.zoom, *camera.angles], 6).tolist(),
        "dims": (dims.ndisplay, dims.order, dims.point),
    }


def test_relief_shows_the_picture_on_the_heights_of_its_blur(viewer, leaf):
    blur_map, _ = results_on(leaf, viewer)
    relief = show_relief(viewer, leaf)
    assert relief.name == "leaf relief"
    place, on_texture = corners(relief)
    height, rows, columns = place.T
    assert len(place) == leaf.data.size
    blur = blur_map.data[rows.astype(int), columns.astype(int)]
    px = 0.3 * max(leaf.data.shape) / 8
    np.testing.assert_allclose(np.ptp(height), 4 * px, rtol=1e-4)
    np.testing.assert_allclose(height - height.max(), px * (blur.min() - blur), atol=1e-3)
    world = np.array([relief.data_to_world(corner) for corner in place[::97]])
    expected = [leaf.data_to_world(corner) for corner in place[::97, 1:]]
    np.testing.assert_allclose(world[:, 1:], expected, atol=1e-3)
    assert relief.axis_labels == ("height", "y", "x")
    # The texture's first row is the picture's: from below, it is the last one.
    assert relief.texture.shape == (*leaf.data.shape, 3)
    texel = np.floor(on_texture * leaf.data.shape[::-1]).astype(int)
    np.testing.assert_array_equal(texel[:, 0], columns)
    np.testing.assert_array_equal(leaf.data.shape[0] - 1 - texel[:, 1], rows)
    np.testing.assert_allclose(relief.texture[..., 0] / 255, leaf.data, atol=0.01)


def test_relief_is_seen_alone_in_3d_and_from_its_front(viewer, leaf):
    results_on(leaf, viewer)
    relief = show_relief(viewer, leaf)
    assert viewer.dims.ndisplay == 3
    assert [layer for layer in viewer.layers if layer.visible] == [relief]
    assert len(relief._view_faces) == len(relief.faces)
    toward, down, right = viewer.scene.camera.view_direction
    assert toward < -0.7
    assert 0.2 < math.hypot(down, right) < 0.7


@pytest.mark.parametrize("how", ["asked", "asked in 2-D", "deleted"])
def test_way_back_leaves_the_viewer_as_it_was(viewer, leaf, texture, how):
    results_on(leaf, viewer)
    viewer.add_image(texture, name="hidden", visible=False)
    viewer.layers.selection.active = leaf
    viewer.scene.camera.zoom, viewer.scene.camera.center = 3.7, (0, 11.0, 5.0)
    before = state(viewer)
    relief = show_relief(viewer, leaf)
    if how == "asked in 2-D":
        viewer.dims.ndisplay = 2
    if how == "deleted":
        viewer.layers.remove(relief)
    else:
        assert hide_relief(viewer)
    assert state(viewer) == before
    assert not hide_relief(viewer)


def test_button_of_the_viewer_switches_between_the_picture_and_its_relief(viewer, leaf):
    results_on(leaf, viewer)
    before = state(viewer)
    relief = show_relief(viewer, leaf)
    viewer.scene.camera.angles = 5, -30, 12
    view = state(viewer)["camera"]
    for _ in range(2):
        viewer.dims.ndisplay = 2
        seen = state(viewer)
        assert not seen["visible"].pop("leaf relief")
        assert seen["visible"] == before["visible"]
        assert seen["camera"] == before["camera"]
        viewer.dims.ndisplay = 3
        assert [layer for layer in viewer.layers if layer.visible] == [relief]
        assert state(viewer)["camera"] == view
    viewer.dims.ndisplay = 2
    leaf.visible = False
    viewer.dims.ndisplay = 3
    hide_relief(viewer)
    assert not leaf.visible, "what was hidden in the meantime stays hidden"


def test_layer_that_is_gone_in_the_meantime_does_not_stop_the_way_back(viewer, leaf):
    blur_map, confidence = results_on(leaf, viewer)
    show_relief(viewer, leaf)
    viewer.layers.remove(blur_map)
    assert viewer.dims.ndisplay == 3
    assert hide_relief(viewer)
    assert leaf.visible
    assert not confidence.visible


def test_viewer_is_emptied_while_a_relief_is_shown(viewer, leaf):
    results_on(leaf, viewer)
    show_relief(viewer, leaf)
    viewer.layers.clear()
    assert viewer.dims.ndisplay == 2
    assert not hide_relief(viewer)


def test_more_exaggeration_is_higher_under_the_same_camera(viewer, leaf):
    results_on(leaf, viewer)
    before = state(viewer)
    first = show_relief(viewer, leaf)
    viewer.scene.camera.angles, viewer.scene.camera.zoom = (5, -30, 12), 7.0
    view = state(viewer)["camera"][2:]
    second = show_relief(viewer, leaf, exaggeration=2)
    assert state(viewer)["camera"][2:] == pytest.approx(view)
    np.testing.assert_allclose(
        np.ptp(corners(second)[0][:, 0]), 2 * np.ptp(corners(first)[0][:, 0]), rtol=1e-4
    )
    assert first not in viewer.layers
    hide_relief(viewer)
    assert state(viewer) == before


def test_relief_is_dimmed_where_the_blur_is_not_trusted_and_torn_where_it_jumps(viewer, leaf):
    blur = np.ones(leaf.data.shape)
    blur[:, 64:] = 5
    sure = np.ones(leaf.data.shape)
    sure[:40] = 0.4
    results_on(leaf, viewer, blur, sure)
    relief = show_relief(viewer, leaf)
    ratio = relief.texture[..., 0] / 255 / leaf.data
    np.testing.assert_allclose(ratio[40:], 1, atol=0.03)
    np.testing.assert_allclose(ratio[:40], 0.5, atol=0.03)
    beside = relief.vertices[relief.faces][..., 2] < 64
    assert (beside.all(axis=1) | ~beside.any(axis=1)).all()
    everything = show_relief(viewer, leaf, min_confidence=0.0)
    np.testing.assert_allclose(everything.texture[..., 0] / 255, leaf.data, atol=0.01)


def test_heights_may_be_distances(viewer, leaf):
    depth = np.broadcast_to(np.linspace(2, 3, leaf.data.shape[1]), leaf.data.shape).copy()
    depth[:10, :10] = np.nan
    depth_on(leaf, viewer, depth)
    relief = show_relief(viewer, leaf, heights="depth")
    place, _ = corners(relief)
    assert len(place) == leaf.data.size - 100
    assert place[place[:, 2] == 0, 0].min() > place[place[:, 2] == 127, 0].max()


def test_heights_are_those_of_the_newest_map(viewer, leaf):
    results_on(leaf, viewer)
    results_on(leaf, viewer, blur=np.ones(leaf.data.shape), keep_earlier=True)
    place, _ = corners(show_relief(viewer, leaf))
    assert np.ptp(place[:, 0]) == 0


def test_large_picture_has_at_most_half_a_million_triangles_but_all_of_its_pixels(viewer):
    layer = viewer.add_image(np.random.default_rng(0).random((900, 1100), np.float32))
    results_on(layer, viewer, blur=np.full((900, 1100), 2.0))
    relief = show_relief(viewer, layer)
    assert 100_000 < len(relief.faces) <= 500_000
    assert relief.texture.shape == (900, 1100, 3)


def test_of_a_stack_the_plane_that_is_shown(viewer):
    stack = viewer.add_image(np.random.default_rng(0).random((5, 32, 48)), scale=(4, 1, 1))
    viewer.dims.set_current_step(0, 3)
    results_on(stack, viewer)
    before = state(viewer)
    for _ in range(2):
        relief = show_relief(viewer, stack)
        np.testing.assert_allclose(relief.texture[..., 0] / 255, stack.data[3], atol=0.01)
        place, _ = corners(relief)
        assert relief.data_to_world(place[place[:, 0].argmin()])[0] == pytest.approx(13, abs=1e-3)
        viewer.dims.ndisplay = 2
        assert state(viewer)["dims"] == before["dims"]
        viewer.dims.ndisplay = 3
    hide_relief(viewer)
    assert state(viewer) == before


def test_errors_are_in_words_and_change_nothing(viewer, leaf):
    before = state(viewer)
    with pytest.raises(ValueError, match="“leaf” has no blur map yet"):
        show_relief(viewer, leaf)
    with pytest.raises(ValueError, match="“leaf” has no distances yet"):
        show_relief(viewer, leaf, heights="depth")
    with pytest.raises(ValueError, match="exaggeration is 0; it takes"):
        show_relief(viewer, leaf, exaggeration=0)
    with pytest.raises(ValueError, match="min_confidence"):
        show_relief(viewer, leaf, min_confidence=2)
    with pytest.raises(ValueError, match="heights is 'sound'"):
        show_relief(viewer, leaf, heights="sound")
    assert state(viewer) == before
    made = {METADATA_KEY: {"result": "blur map", "source": "leaf"}}
    viewer.add_image(np.ones((5, 6)), metadata=made, name="small")
    with pytest.raises(ValueError, match="“small” cannot be the relief of “leaf”: it has 5 x 6 px"):
        show_relief(viewer, leaf)
    assert viewer.dims.ndisplay == 2


def test_nothing_holds_on_to_what_was_shown(viewer, texture):
    emitters = viewer.layers.events.removed, viewer.dims.events.ndisplay
    before = [len(emitter.callbacks) for emitter in emitters]

    def shown():
        layer = viewer.add_image(texture, name="leaf")
        results_on(layer, viewer)
        return weakref.ref(layer), weakref.ref(show_relief(viewer, layer))

    alive = shown()
    hide_relief(viewer)
    # napari itself holds on to the layer that was active last.
    viewer.layers.clear()
    viewer.add_image(texture, name="other")
    gc.collect()
    assert [found() for found in alive] == [None, None]
    assert [len(emitter.callbacks) for emitter in emitters] == before


@pytest.mark.display
def test_relief_in_a_window_shows_the_picture(make_napari_viewer, qapp):
    viewer = make_napari_viewer(show=True)
    picture = np.zeros((60, 80, 3), np.uint8)
    picture[:30, :, 0] = picture[30:, :, 2] = 200
    layer = viewer.add_image(picture)
    results_on(layer, viewer, blur=np.full((60, 80), 2.0))
    show_relief(viewer, layer)
    for _ in range(5):
        qapp.processEvents()
    seen = viewer.screenshot(canvas_only=True, flash=False).astype(int)
    rows = [np.argwhere(seen[..., color] > 150)[:, 0].mean() for color in (0, 2)]
    assert rows[0] < rows[1] - 20, "red above blue"
    viewer.dims.ndisplay = 2
    assert layer.visible


@pytest.mark.display
def test_viewer_that_is_lent_to_a_plugin_shows_it_and_comes_back(window, texture):
    layer = window.add_image(texture)
    results_on(layer, window)
    before = [found.visible for found in window.layers]
    show_relief(window, layer)
    assert window.dims.ndisplay == 3
    assert hide_relief(window)
    assert [found.visible for found in window.layers] == before


@pytest.mark.display
def test_button_of_a_window_switches_between_the_plane_of_a_stack_and_its_relief(
    make_napari_viewer, qapp
):
    viewer = make_napari_viewer()
    stack = viewer.add_image(np.random.default_rng(0).random((5, 32, 48)), scale=(4, 1, 1))
    viewer.dims.set_current_step(0, 3)
    results_on(stack, viewer)
    before = state(viewer)
    relief = show_relief(viewer, stack)
    qapp.processEvents()
    for _ in range(2):
        viewer.dims.ndisplay = 2
        assert state(viewer)["dims"] == before["dims"]
        assert stack.visible
        viewer.dims.ndisplay = 3
        assert relief.visible
    viewer.dims.ndisplay = 2
    viewer.dims.set_point(0, 4)
    hide_relief(viewer)
    assert viewer.dims.point[0] == 4, "the plane that was gone to meanwhile"
