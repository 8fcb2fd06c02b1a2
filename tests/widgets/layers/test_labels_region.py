import numpy as np
import pytest

from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, shown_plane
from napari_defocus.widgets.layers.labels_region import region_of_labels
from napari_defocus.widgets.layers.region import plane_in


def part_of(viewer, image, labels):
    plane = shown_plane(image, viewer.dims)
    return plane_in(plane, region_of_labels(plane, labels, viewer.dims))


def test_only_what_has_a_label_is_judged(viewer, texture, method):
    image = viewer.add_image(texture, name="leaf", scale=(2, 3))
    cells = np.zeros(texture.shape, np.int32)
    cells[10:40, 20:60], cells[50:60, 70:90] = 1, 2
    part = part_of(viewer, image, viewer.add_labels(cells, name="cells", scale=(2, 3)))
    assert part.shape == texture.shape
    wanted = Analysis(plane=part, estimation=MapSettings(), mask=MaskSettings(threshold=3.0))
    blur_map, confidence, mask = (data for data, *_ in wanted.run(JobCache()))
    np.testing.assert_array_equal(mask, cells != 0)
    assert not confidence[cells == 0].any()
    assert (blur_map == method.radius).all()


def test_labels_of_planes_hold_for_a_stack(viewer, texture):
    image = viewer.add_image(np.stack([texture] * 3), name="stack")
    labels = viewer.add_labels((texture > 0.5).astype(np.uint8), name="bright")
    np.testing.assert_array_equal(part_of(viewer, image, labels).inside, texture > 0.5)


@pytest.mark.parametrize(
    ("labels", "where", "saying"),
    [
        (np.ones((20, 20), np.uint8), {}, "lie elsewhere"),
        (np.ones((96, 128), np.uint8), {"translate": (30, 0)}, "lie elsewhere"),
        (np.zeros((96, 128), np.uint8), {}, "mark nothing"),
    ],
)
def test_labels_that_do_not_fit_are_refused(viewer, texture, labels, where, saying):
    image = viewer.add_image(texture, name="leaf")
    layer = viewer.add_labels(labels, name="cells", **where)
    with pytest.raises(NotAnalysableError, match=saying):
        part_of(viewer, image, layer)
