"""Regions in focus as a layer with a table."""

import numpy as np
import pytest

from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.display.region_table import add_regions
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import (
    blur_map_layer,
    confidence_layer,
    in_focus_layer,
)


def squares(shape):
    mask = np.zeros(shape, np.uint8)
    mask[5:25, 5:25] = 1
    mask[40:70, 60:90] = 1
    return mask


def add_mask_and_maps(viewer, image, *, with_map=True, with_confidence=True):
    plane = shown_plane(image, viewer.dims)
    mask = squares(plane.shape)
    radius = np.where(mask, 1.0, 5.0).astype(np.float32)
    made_with = MapSettings(), 3e-5
    results = [in_focus_layer(plane, mask, MaskSettings(), *made_with)]
    if with_map:
        results.append(blur_map_layer(plane, radius, *made_with))
    if with_confidence:
        results.append(confidence_layer(plane, radius / 10, *made_with))
    return add_results(viewer, results)


@pytest.fixture
def image(viewer, texture):
    where = {"scale": (0.5, 0.25), "translate": (3, 4), "units": ("um", "um")}
    return viewer.add_image(texture, name="photo", **where)


def test_regions_lie_on_the_picture_with_their_numbers(viewer, image, messages):
    add_mask_and_maps(viewer, image)
    layer = add_regions(viewer, image)
    assert layer.name == "photo regions"
    assert layer.data[50, 70] == 1
    assert layer.data[10, 10] == 2
    assert layer.data[0, 0] == 0
    np.testing.assert_array_equal(layer.scale, image.scale)
    np.testing.assert_array_equal(layer.translate, image.translate)
    assert layer.units == image.units
    assert layer.features["area_px"].tolist() == [96 * 128 - 1300, 900, 400]
    assert "index" not in layer.features, "napari numbers the rows"
    assert layer.features["area_um2"].tolist()[1:] == [900 / 8, 400 / 8]
    assert layer.features["blur_median_px"].tolist() == [5.0, 1.0, 1.0]
    assert layer.features["confidence_mean"].tolist() == pytest.approx([0.5, 0.1, 0.1])
    [told] = messages()
    assert "2 regions are in focus" in told
    assert "Features table" in told


def test_row_of_a_region_is_shown_under_the_cursor(viewer, image):
    add_mask_and_maps(viewer, image)
    layer = add_regions(viewer, image)
    position = layer.data_to_world((10, 10))
    told = layer.get_status(position, world=True)["value"]
    assert "area_px: 400" in told
    assert "blur_median_px: 1" in told
    blurred = layer.get_status(layer.data_to_world((90, 10)), world=True)["value"]
    assert "part: blurred" in blurred


def test_mask_gets_a_row_for_blurred_and_one_for_in_focus(viewer, image):
    mask, *_ = add_mask_and_maps(viewer, image)
    add_regions(viewer, image)
    assert mask.features["part"].tolist() == ["blurred", "in focus"]
    assert mask.features["area_px"].tolist() == [96 * 128 - 1300, 1300]
    assert mask.features["blur_median_px"].tolist() == [5.0, 1.0]


def test_second_run_updates_the_layer_and_its_table(viewer, image):
    mask, *_ = add_mask_and_maps(viewer, image)
    layer = add_regions(viewer, image)
    mask.data = np.where(np.arange(128) < 30, mask.data, 0)
    assert add_regions(viewer, image) is layer
    assert layer.data.max() == 1
    assert layer.features["area_px"].tolist() == [96 * 128 - 400, 400]


def test_without_a_mask_the_message_says_what_to_run(viewer, image, messages):
    assert add_regions(viewer, image) is None
    [told] = messages()
    assert "“photo” has no in-focus mask" in told
    assert "Press “Measure”" in told
    assert len(viewer.layers) == 1


def test_without_a_map_there_are_areas_and_a_word_about_it(viewer, image, messages):
    add_mask_and_maps(viewer, image, with_map=False, with_confidence=False)
    layer = add_regions(viewer, image)
    assert layer.features["area_px"].tolist()[1:] == [900, 400]
    assert "blur_median_px" not in layer.features
    assert "measure “photo” first" in messages()[0]


def test_without_a_confidence_there_are_radii_and_a_word_about_it(viewer, image, messages):
    add_mask_and_maps(viewer, image, with_confidence=False)
    assert "blur_median_px" in add_regions(viewer, image).features
    assert "no confidence layer" in messages()[0]


def test_nothing_in_focus_is_one_row(viewer, image, messages):
    mask, *_ = add_mask_and_maps(viewer, image)
    mask.data = np.zeros_like(mask.data)
    layer = add_regions(viewer, image)
    assert layer.features["part"].tolist() == ["blurred"]
    assert "Nothing is in focus" in messages()[0]


def test_plane_of_a_stack_is_measured_where_it_was_analysed(viewer, texture, messages):
    stack = viewer.add_image(np.stack([texture] * 3), name="film", scale=(2, 1, 1))
    viewer.dims.set_current_step(0, 1)
    add_mask_and_maps(viewer, stack)
    layer = add_regions(viewer, stack)
    assert layer.data.shape == (1, 96, 128)
    assert layer.translate[0] == 2.0
    assert layer.features["blur_median_px"].tolist() == [5.0, 1.0, 1.0]
    assert "area_um2" not in layer.features
    viewer.dims.set_current_step(0, 2)
    assert add_regions(viewer, stack) is None
    assert "no in-focus mask here" in messages()[-1]


@pytest.mark.display
def test_napari_shows_the_table(window, texture, qtbot):
    image = window.add_image(texture, name="photo")
    add_mask_and_maps(window, image)
    window.layers.selection.active = add_regions(window, image)
    _, table = window.window.add_plugin_dock_widget("napari", "Features table widget")
    model = table.table.model()
    assert model.rowCount() == 3


@pytest.mark.parametrize("again", [False, True])
def test_map_of_a_part_has_the_colours_of_the_whole_on_which_it_lies(viewer, image, again):
    whole = shown_plane(image, viewer.dims)
    part = whole.part(slice(10, 50), slice(20, 80), region="shapes")
    far = np.full(whole.shape, 20, np.float32)
    made_with = MapSettings(), 3e-5
    [of_whole] = add_results(viewer, [blur_map_layer(whole, far, *made_with)])
    for _ in range(1 + again):
        near = np.full(part.shape, 3, np.float32)
        [of_part] = add_results(viewer, [blur_map_layer(part, near, *made_with)])
    assert of_part.contrast_limits == of_whole.contrast_limits
    assert of_part.contrast_limits[1] >= 20
