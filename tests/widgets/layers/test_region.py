import numpy as np
import pytest
from napari.components import ViewerModel

from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.map_source import EstimatedSource, source_of_layer
from napari_defocus.widgets.layers import image_layers as layers
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, shown_plane
from napari_defocus.widgets.layers.region import plane_in, region_of
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY
from napari_defocus.widgets.layers.seeds import add_seeds_layer, shown_seeds

PLACED = {
    "scale": (0.5, 0.25),
    "translate": (3.0, -4.0),
    "rotate": 20.0,
    "shear": (0.1,),
    "affine": [[1.1, 0.2, 5.0], [0.0, 0.9, -2.0], [0.0, 0.0, 1.0]],
}
BOX = [[10, 20], [10, 59], [29, 59], [29, 20]]
BOX_OF_10 = [[10, 20], [10, 29], [19, 29], [19, 20]]
DIAMOND = [[10, 40], [30, 60], [50, 40], [30, 20]]


@pytest.fixture
def viewer():
    return ViewerModel()


@pytest.fixture
def picture(viewer, texture):
    return viewer.add_image(texture, name="leaf", **PLACED)


def bounds(region):
    return region.rows.start, region.rows.stop, region.columns.start, region.columns.stop


def part_of(viewer, image, choice):
    return plane_in(shown_plane(image, viewer.dims), region_of(image, viewer, choice))


def analysed(plane, cache=None):
    wanted = Analysis(plane=plane, estimation=MapSettings(), mask=MaskSettings(threshold=3.0))
    return wanted.run(cache or JobCache())


def test_whole_picture_is_the_plane_itself(viewer, picture):
    plane = shown_plane(picture, viewer.dims)
    assert plane_in(plane, region_of(picture, viewer, "whole")) is plane
    assert not plane.is_part


def test_shape_is_found_in_the_pictures_pixels_whatever_lies_between(viewer, picture):
    same_place = viewer.add_shapes([np.array(BOX)], shape_type="rectangle", **PLACED)
    corners = [picture.data_to_world(corner) for corner in BOX]
    elsewhere = viewer.add_shapes(
        [np.array(corners) / (3, 2) - (7, 5)],
        shape_type="polygon",
        scale=(3, 2),
        translate=(21, 10),
    )
    for shapes in (same_place, elsewhere):
        region = region_of(picture, viewer, shapes)
        assert bounds(region) == (10, 30, 20, 60)
        assert region.inside is None


def test_box_holds_all_shapes_or_the_selected_ones(viewer, texture):
    picture = viewer.add_image(texture)
    shapes = viewer.add_shapes(
        [BOX_OF_10, np.add(BOX_OF_10, (40, 40)) * (1, 1.5)], shape_type=["rectangle", "ellipse"]
    )
    region = region_of(picture, viewer, shapes)
    assert bounds(region) == (10, 60, 20, 104)
    box, ellipse = region.inside[:20], region.inside[20:]
    assert box[:10, :10].all()
    assert box.sum() == 100
    assert not ellipse[20, 70], "a corner of the ellipse's box"
    assert ellipse.sum() == pytest.approx(np.pi / 4 * 9 * 13.5, rel=0.1)
    shapes.selected_data = {0}
    assert bounds(region_of(picture, viewer, shapes)) == (10, 20, 20, 30)


def test_shape_that_reaches_over_the_border_is_clipped(viewer, texture):
    picture = viewer.add_image(texture)
    shapes = viewer.add_shapes([[[-20, 100], [9.4, 500]]], shape_type="rectangle")
    assert bounds(region_of(picture, viewer, shapes)) == (0, 10, 100, 128)


def test_shape_on_a_picture_of_several_scales_is_in_pixels_of_the_finest(viewer, texture):
    picture = viewer.add_image([texture, texture[::2, ::2]], multiscale=True)
    shapes = viewer.add_shapes([BOX], shape_type="polygon")
    part = part_of(viewer, picture, shapes)
    assert part.shape == (20, 40)
    np.testing.assert_array_equal(part.read(), texture[10:30, 20:60])


@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1), (1, 0, 2)])
def test_of_a_stack_shapes_on_the_shown_plane_count(viewer, order):
    stack = np.random.default_rng(0).random((40, 50, 60))
    picture = viewer.add_image(stack, scale=(5, 0.5, 0.5))
    viewer.dims.order = order
    sliced, rows, columns = order[0], *sorted(order[1:])
    boxes = []
    for at, first in ((7, 3), (9, 20)):
        box = np.full((4, 3), at)
        box[:, rows] = first + np.array([0, 0, 9, 9])
        box[:, columns] = first + np.array([0, 14, 14, 0])
        boxes.append(box)
    shapes = viewer.add_shapes(boxes, shape_type="polygon", scale=(5, 0.5, 0.5))
    for at, first in ((7, 3), (9, 20)):
        viewer.dims.set_point(sliced, picture.data_to_world((at, at, at))[sliced])
        part = part_of(viewer, picture, shapes)
        assert bounds(region_of(picture, viewer, shapes)) == (first, first + 10, first, first + 15)
        expected = stack.take(at, sliced)[first : first + 10, first : first + 15]
        np.testing.assert_array_equal(part.read(), expected)
    viewer.dims.set_point(sliced, picture.data_to_world((8, 8, 8))[sliced])
    with pytest.raises(NotAnalysableError, match="part of the plane that is shown"):
        region_of(picture, viewer, shapes)


@pytest.mark.parametrize(
    ("shapes", "kind", "words"),
    [
        ([], "rectangle", "there are no shapes in “mine”"),
        ([[[5, 5], [6, 90]]], "rectangle", "the shape is too small: 2 x 86 px"),
        ([[[500, 5], [600, 90]]], "rectangle", "the shape lies beside the picture"),
        ([[[5, 5], [60, 90]]], "line", "none of the shapes in “mine” encloses"),
    ],
)
def test_shapes_that_make_no_part_are_refused_in_words(viewer, texture, shapes, kind, words):
    picture = viewer.add_image(texture)
    mine = viewer.add_shapes(shapes or None, ndim=2, shape_type=kind, name="mine")
    with pytest.raises(NotAnalysableError, match=words):
        region_of(picture, viewer, mine)


def test_shape_around_too_many_pixels_is_refused_before_a_mask_of_it_is_made(
    viewer, texture, monkeypatch
):
    monkeypatch.setattr(layers, "MAX_PIXELS", 1000)
    picture = viewer.add_image(texture)
    shapes = viewer.add_shapes([DIAMOND], shape_type="polygon")
    with pytest.raises(NotAnalysableError, match="Choose a region"):
        region_of(picture, viewer, shapes)


def test_without_a_window_no_field_is_visible(viewer, picture):
    with pytest.raises(NotAnalysableError, match="there is no window"):
        region_of(picture, viewer, "visible")


def test_results_of_a_part_lie_on_the_part_and_say_so(viewer, picture, texture, method):
    shapes = viewer.add_shapes([DIAMOND], shape_type="polygon", name="cells", **PLACED)
    part = part_of(viewer, picture, shapes)
    np.testing.assert_array_equal(part.read(), texture[10:51, 20:61])
    blur_map, confidence, mask = add_results(viewer, analysed(part))
    for layer in (blur_map, confidence, mask):
        assert layer.data.shape == (41, 41)
        for corner in np.ndindex(2, 2):
            np.testing.assert_allclose(
                layer.data_to_world(corner), picture.data_to_world(np.add(corner, (10, 20)))
            )
        told = layer.metadata[METADATA_KEY]["region"]
        assert told["of"] == "shapes “cells”"
        assert (told["rows"], told["columns"]) == ([10, 51], [20, 61])
        assert "confidence is 0" in told["outside"]


def test_outside_of_the_shapes_nothing_counts_but_the_map_goes_on(viewer, picture, method):
    shapes = viewer.add_shapes([DIAMOND], shape_type="polygon", **PLACED)
    part = part_of(viewer, picture, shapes)
    (blur_map, _, _), (confidence, _, _), (mask, _, _) = analysed(part)
    assert (blur_map == method.radius).all()
    assert mask.dtype == np.uint8
    assert (mask == part.inside).all()
    assert not confidence[~part.inside].any()
    assert (confidence[part.inside] > 0).all()
    assert 0.45 < part.inside.mean() < 0.55


def test_another_shape_of_the_same_size_estimates_again_the_same_shape_does_not(
    viewer, picture, method
):
    cache = JobCache()
    shapes = viewer.add_shapes([DIAMOND], shape_type="polygon", **PLACED)
    first = part_of(viewer, picture, shapes)
    assert part_of(viewer, picture, shapes) == first
    analysed(first, cache)
    analysed(part_of(viewer, picture, shapes), cache)
    assert len(method.estimations) == 1
    shapes.data = [np.add(DIAMOND, (5, 0))]
    moved = part_of(viewer, picture, shapes)
    assert moved != first
    analysed(moved, cache)
    assert len(method.estimations) == 2


def test_map_that_is_estimated_for_a_part_has_no_say_outside_of_the_shapes(viewer, picture, method):
    from napari_defocus.widgets.jobs.estimation import Picture

    shapes = viewer.add_shapes([DIAMOND], shape_type="polygon", **PLACED)
    part = part_of(viewer, picture, shapes)
    source = EstimatedSource(settings=MapSettings())
    found = source.read(Picture.of(part), JobCache(), lambda step, done: None)
    assert not found.confidence[~part.inside].any()
    assert found.confidence[part.inside].all()


def test_seeds_and_maps_of_the_whole_picture_serve_a_part_too(viewer, picture, texture):
    shapes = viewer.add_shapes([BOX], shape_type="polygon", **PLACED)
    seeds = add_seeds_layer(viewer, picture)
    seeds.data[15, 30] = 1
    blur_map = viewer.add_image(8 * texture, name="map", **PLACED)
    part = part_of(viewer, picture, shapes)
    found = shown_seeds(seeds, part, viewer.dims).values
    assert np.argwhere(found).tolist() == [[5, 10]]
    source = source_of_layer(blur_map, part, viewer, "disc")
    np.testing.assert_array_equal(source.plane.read(), 8 * texture[10:30, 20:60])


def test_map_of_a_part_serves_that_part_with_its_confidence_and_no_other(viewer, picture, method):
    shapes = viewer.add_shapes([BOX], shape_type="polygon", **PLACED)
    part = part_of(viewer, picture, shapes)
    blur_map, confidence, _ = add_results(viewer, analysed(part))
    source = source_of_layer(blur_map, part, viewer, "disc")
    np.testing.assert_array_equal(source.confidence.read(), confidence.data)
    shapes.data = [np.add(BOX, (3, 0))]
    with pytest.raises(ValueError, match="another part"):
        source_of_layer(blur_map, part_of(viewer, picture, shapes), viewer, "disc")


@pytest.mark.display
def test_visible_field_is_what_the_canvas_shows(window):
    data = np.random.default_rng(0).random((800, 1200)).astype(np.float32)
    levels = [data[:: 2**n, :: 2**n] for n in range(3)]
    placed = {"scale": (0.5, 0.5), "translate": (7, 0)}
    plain, pyramid = (window.add_image(given, **placed) for given in (data, levels))
    assert pyramid.multiscale
    window.scene.camera.zoom = 8
    window.scene.camera.center = (0, 7 + 150, 250)
    height, width = np.array(window.canvas.size) / 8 / 0.5
    rows, columns = (300 - height / 2, 300 + height / 2), (500 - width / 2, 500 + width / 2)
    expected = [*np.clip(rows, 0, 800), *np.clip(columns, 0, 1200)]
    for image in (plain, pyramid):
        region = region_of(image, window, "visible")
        np.testing.assert_allclose(bounds(region), expected, atol=1)
        part = part_of(window, image, "visible")
        np.testing.assert_array_equal(part.read(), data[region.rows, region.columns])


@pytest.mark.display
def test_visible_field_agrees_with_napari_and_follows_swapped_axes(make_napari_viewer_proxy):
    window = make_napari_viewer_proxy()
    image = window.add_image(np.zeros((5, 400, 700)), rotate=(0, 0, 30))
    for order in ((0, 1, 2), (0, 2, 1)):
        window.dims.order = order
        window.scene.camera.zoom = 5
        window.scene.camera.center = (0, *np.array([100, 230])[np.argsort(order[1:])])
        window.screenshot(flash=False)
        low, high = image.corner_pixels[:, 1:]
        found = bounds(region_of(image, window, "visible"))
        np.testing.assert_allclose(found, (low[0], high[0], low[1], high[1]), atol=2)


@pytest.mark.display
def test_field_that_shows_nothing_or_too_little_is_refused(window):
    image = window.add_image(np.zeros((100, 100)))
    for center, zoom, words in (
        ((0, 0, 900), 8, "lies beside the picture"),
        ((0, 50, 50), 2000, "too small"),
    ):
        window.scene.camera.zoom, window.scene.camera.center = zoom, center
        with pytest.raises(NotAnalysableError, match=f"the visible field .*{words}"):
            region_of(image, window, "visible")
