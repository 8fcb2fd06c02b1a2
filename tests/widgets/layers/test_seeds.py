import dask.array as da
import numpy as np
import pytest
from matplotlib import colormaps
from napari.components import ViewerModel
from skimage.color import deltaE_ciede2000, rgb2lab

from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import COLOR_MAP, MASK_COLOR
from napari_defocus.widgets.layers.result_metadata import made_by_us
from napari_defocus.widgets.layers.seeds import BLURRED_COLOR, SEEDS, add_seeds_layer, shown_seeds

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


SEEN_AS = {
    "all colours": np.eye(3),
    "no red": [
        (0.152286, 1.052583, -0.204868),
        (0.114503, 0.786281, 0.099216),
        (-0.003882, -0.048116, 1.051998),
    ],
    "no green": [
        (0.367322, 0.860646, -0.227968),
        (0.280085, 0.672501, 0.047413),
        (-0.011820, 0.042940, 0.968881),
    ],
    "no blue": [
        (1.255528, -0.076749, -0.178779),
        (-0.078411, 0.930809, 0.147602),
        (0.004733, 0.691367, 0.303900),
    ],
}
"""Linear light as it is seen: Machado, Oliveira and Fernandes 2009."""


def difference(first, second, seen_as):
    """Return CIEDE2000 between two sRGB colours; 2 is just seen, 10 at a glance."""

    def lab(color):
        color = np.asarray(color[:3], float)
        linear = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
        linear = np.clip(np.asarray(seen_as) @ linear, 0, 1)
        encoded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
        return rgb2lab(encoded[None, None])

    return float(deltaE_ciede2000(lab(first), lab(second))[0, 0])


@pytest.mark.parametrize("seen_as", SEEN_AS.values(), ids=SEEN_AS)
def test_in_focus_and_blurred_are_told_apart_on_the_map_whatever_colours_one_sees(seen_as):
    assert difference(MASK_COLOR, BLURRED_COLOR, seen_as) > 20
    for place in np.linspace(0, 1, 9):
        shown = colormaps[COLOR_MAP](place)
        assert difference(BLURRED_COLOR, shown, seen_as) > 20
        assert difference(MASK_COLOR, shown, seen_as) > 10
