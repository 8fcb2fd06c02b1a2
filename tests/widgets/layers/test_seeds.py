import dask.array as da
import numpy as np
import pytest
from napari.components import ViewerModel

from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import MASK_COLOR
from napari_defocus.widgets.layers.result_metadata import made_by_us
from napari_defocus.widgets.layers.seeds import SEEDS, add_seeds_layer, shown_seeds

PLACED = {
    "scale": (0.5, 0.25),
    "translate": (3.0, -4.0),
    "rotate": 20.0,
    "affine": [[1.1, 0.2, 5.0], [0.0, 0.9, -2.0], [0.0, 0.0, 1.0]],
    "units": ("um", "um"),
    "axis_labels": ("y", "x"),
}


@pytest.fixture
def viewer():
    return ViewerModel()


def seeds_of(viewer, labels, image):
    return shown_seeds(labels, shown_plane(image, viewer.dims), viewer.dims)


@pytest.mark.parametrize(
    ("data", "options"),
    [
        (np.zeros((30, 40)), PLACED),
        (np.zeros((30, 40, 3), np.uint8), {"rgb": True}),
        (np.zeros((30, 40, 4), np.uint8), {"rgb": True, "scale": (2, 2)}),
        ([np.zeros((30, 40)), np.zeros((15, 20))], {"multiscale": True, "scale": (0.1, 0.1)}),
        (da.zeros((30, 40)), {}),
        (np.zeros((1, 1, 30, 40)), {"translate": (7, 5, 3, 1)}),
    ],
)
def test_new_layer_fits_and_what_is_painted_on_it_is_found(viewer, data, options):
    image = viewer.add_image(data, name="leaf", **options)
    labels = add_seeds_layer(viewer, image)
    assert labels.name == "leaf seeds"
    assert made_by_us(labels) == SEEDS
    assert (labels.mode, labels.selected_label) == ("paint", 1)
    assert viewer.layers.selection.active is labels
    assert labels.units == image.units
    labels.data[..., 3, 5], labels.data[..., 20, 30] = 1, 2
    seeds = seeds_of(viewer, labels, image)
    assert seeds.name == "leaf seeds"
    expected = np.zeros((30, 40))
    expected[3, 5], expected[20, 30] = 1, 2
    np.testing.assert_array_equal(seeds.values, expected)


def test_labels_have_the_colours_of_their_meaning(viewer):
    labels = add_seeds_layer(viewer, viewer.add_image(np.zeros((30, 40))))
    free, focused, blurred = (labels.get_color(label) for label in (0, 1, 2))
    assert free is None or free[3] == 0
    np.testing.assert_allclose(focused, MASK_COLOR, atol=0.01, err_msg="that of the mask")
    assert np.abs(focused - blurred).max() > 0.5


def test_each_plane_of_a_stack_has_its_own(viewer):
    image = viewer.add_image(np.zeros((4, 3, 30, 40)), scale=(2, 1, 0.5, 0.5))
    labels = add_seeds_layer(viewer, image)
    labels.data[3, 1, 8, 9] = 2
    for point, count in [((0, 0), 0), ((6, 1), 1)]:
        viewer.dims.set_point((0, 1), point)
        assert np.count_nonzero(seeds_of(viewer, labels, image).values) == count


def test_painting_goes_on_while_they_are_used(viewer):
    image = viewer.add_image(np.zeros((30, 40)))
    labels = add_seeds_layer(viewer, image)
    seeds = seeds_of(viewer, labels, image)
    labels.data[:] = 1
    assert not seeds.values.any()


def test_labels_of_the_plane_alone_are_taken_too(viewer):
    image = viewer.add_image(np.zeros((4, 30, 40)), scale=(2, 0.5, 0.5))
    flat = np.ones((30, 40), np.int64)
    for labels in (
        viewer.add_labels(flat, scale=(0.5, 0.5)),
        viewer.add_labels(flat[None], scale=(2, 0.5, 0.5), translate=(4, 0, 0)),
    ):
        viewer.dims.set_point(0, 4)
        np.testing.assert_array_equal(seeds_of(viewer, labels, image).values, flat)


@pytest.mark.parametrize(
    ("data", "options", "words"),
    [
        (np.zeros((30, 41), int), {}, r"shape \(30, 41\).*\(30, 40\)"),
        (np.full((30, 40), 3), {}, "the value 3"),
        (np.zeros((30, 40), int), {"scale": (0.5, 0.5)}, "has another scale"),
        (np.zeros((30, 40), int), {"translate": (0, 1)}, "lies elsewhere"),
    ],
)
def test_layer_that_does_not_fit_is_said_in_plain_words(viewer, data, options, words):
    image = viewer.add_image(np.zeros((30, 40)), name="leaf")
    labels = viewer.add_labels(data, name="mine", **options)
    with pytest.raises(ValueError, match=rf"^“mine” cannot be the seeds of “leaf”: .*{words}.*"):
        seeds_of(viewer, labels, image)


def test_seeds_of_another_plane_are_said_in_plain_words(viewer):
    image = viewer.add_image(np.zeros((4, 30, 40)))
    labels = viewer.add_labels(np.zeros((1, 30, 40), int), translate=(2, 0, 0))
    viewer.dims.set_point(0, 2)
    assert seeds_of(viewer, labels, image).values.shape == (30, 40)
    viewer.dims.set_point(0, 1)
    with pytest.raises(ValueError, match="the viewer shows no plane of it"):
        seeds_of(viewer, labels, image)
