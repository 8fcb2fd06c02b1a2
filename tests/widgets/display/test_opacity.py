"""The opacity of what is in focus as a layer."""

import numpy as np

import napari_defocus
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display import opacity
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.display.opacity import wanted_opacity
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import in_focus_layer


def test_opacity_of_the_mask_lies_on_the_picture(viewer, texture, monkeypatch):
    image = viewer.add_image(texture, name="leaf", scale=(0.5, 0.25))
    plane = shown_plane(image, viewer.dims)
    mask = (np.indices(plane.shape)[1] > 40).astype(np.uint8)
    add_results(viewer, [in_focus_layer(plane, mask, MaskSettings(), MapSettings(), 3e-5)])
    monkeypatch.setattr(opacity, "need_matting_extra", lambda: None)
    stand_in = vars(napari_defocus), "matte_in_focus", lambda _, mask, progress: 0.25 + mask / 2
    monkeypatch.setitem(*stand_in)
    wanted = wanted_opacity(viewer, image)
    layer = wanted.add(viewer, wanted.made())
    assert layer.name == "leaf opacity in focus"
    np.testing.assert_allclose(layer.data, 0.25 + mask / 2)
    assert tuple(layer.scale) == (0.5, 0.25)


def test_without_a_mask_or_the_package_it_says_so(viewer, texture, monkeypatch, messages):
    image = viewer.add_image(texture, name="leaf")
    monkeypatch.setattr(opacity, "need_matting_extra", lambda: None)
    assert wanted_opacity(viewer, image) is None

    def missing():
        raise ImportError("a soft mask needs pymatting: pip install 'napari-defocus[matting]'")

    monkeypatch.setattr(opacity, "need_matting_extra", missing)
    assert wanted_opacity(viewer, image) is None
    first, second = messages()
    assert "has no in-focus mask" in first
    assert "pip install" in second
