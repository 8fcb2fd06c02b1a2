import numpy as np
import pytest

from napari_defocus import settings
from napari_defocus.widgets.display.summaries import summary_of
from napari_defocus.widgets.jobs.estimation import Picture
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import blur_map_layer, in_focus_layer
from napari_defocus.widgets.layers.result_metadata import say_noise_growth

SHAPE = 100, 120


@pytest.fixture
def plane(viewer):
    picture = np.random.default_rng(0).random(SHAPE)
    return shown_plane(viewer.add_image(picture, name="leaf"), viewer.dims)


def said_of(plane, mask, *, known=120):
    """Return what is said of a map of 1 px on the left and 9 px on the right half."""
    blur = np.where(np.arange(SHAPE[1]) < 60, 1.0, 9.0) * np.ones(SHAPE)
    made = settings.MapSettings(), 1e-5
    layers = [
        blur_map_layer(plane, blur.astype(np.float32), *made),
        in_focus_layer(plane, mask, settings.MaskSettings(threshold=2.5), *made),
    ]
    confidence = plane.counted((np.arange(SHAPE[1]) < known) * np.ones(SHAPE, np.float32))
    return summary_of(layers, confidence, Picture.of(plane)).splitlines()


def test_the_first_lines_say_how_blurred_it_is_and_how_much_is_in_focus(plane):
    mask = np.zeros(SHAPE, np.uint8)
    mask[:, :30] = 1
    assert said_of(plane, mask) == [
        "Blur: median 5.0 px (5 to 95 %: 1.0 to 9.0 px)",
        "In focus: 25% of the picture (blur up to 2.5 px)",
        "Trusted on 100% (confidence 0.5 or more)",
        "Noise variance 1.0e-05 (found)",
    ]
    mask[:, 60:] = settings.UNKNOWN
    assert said_of(plane, mask)[1] == "In focus: 50% of what is known (blur up to 2.5 px)"


def test_what_is_filled_from_around_is_told(plane):
    said = said_of(plane, np.ones(SHAPE, np.uint8), known=30)
    assert said[1] == "In focus: 100% of the picture (blur up to 2.5 px)"
    assert said[2].startswith("The blur is not known on 75 % of the picture: the mask is filled")


def test_of_a_stack_what_is_filled_from_around_is_told_too(viewer):
    stack = np.random.default_rng(0).random((3, *SHAPE))
    plane = shown_plane(viewer.add_image(stack, name="worm"), viewer.dims)
    blur = blur_map_layer(plane, np.ones(SHAPE, np.float32), settings.MapSettings(), 1e-5)
    mask = in_focus_layer(
        *(plane, np.ones(SHAPE, np.uint8), settings.MaskSettings(threshold=2.5)),
        *(settings.MapSettings(), 1e-5),
    )
    confidence = (np.arange(SHAPE[1]) < 30) * np.ones((1, *SHAPE), np.float32)
    said = summary_of([blur, mask], confidence, Picture.of(plane)).splitlines()
    assert any(line.startswith("The blur is not known on 75 % of the picture") for line in said)


def test_noise_that_grows_towards_the_corners_is_told(plane):
    layer = blur_map_layer(plane, np.ones(SHAPE, np.float32), settings.MapSettings(), 3e-5)
    (layer,) = say_noise_growth([layer], 1.3)
    said = summary_of([layer], None, Picture.of(plane)).splitlines()
    assert said[-1] == "Noise variance 3.0e-05 (found), 2.3 times that in the corners"


def test_what_lies_outside_of_a_shape_does_not_count(plane):
    inside = np.zeros(SHAPE, bool)
    inside[:, :60] = True
    part = plane.part(slice(0, 100), slice(0, 120), inside=inside, region="shapes")
    said = said_of(part, part.counted(np.ones(SHAPE, np.uint8)))
    assert said[1:4] == [
        "Blur: median 1.0 px (5 to 95 %: 1.0 to 1.0 px)",
        "In focus: 100% of the part (blur up to 2.5 px)",
        "Trusted on 100% (confidence 0.5 or more)",
    ]
