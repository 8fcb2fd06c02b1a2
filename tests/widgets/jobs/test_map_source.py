import numpy as np
import pytest

from napari_defocus import Disc, Gaussian, Polygon
from napari_defocus.core.progress import silent
from napari_defocus.settings import MapSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.jobs.estimation import JobCache, Picture
from napari_defocus.widgets.jobs.map_source import (
    EstimatedSource,
    LayerSource,
    may_be_map_of,
    source_of_layer,
)
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import blur_map_layer, confidence_layer


@pytest.fixture
def leaf(viewer, texture):
    return viewer.add_image(texture, name="leaf")


def plane_of(layer, viewer):
    return shown_plane(layer, viewer.dims)


def results_on(layer, viewer, radius=2.0, confidence=0.7, **settings):
    plane, made = plane_of(layer, viewer), MapSettings(**settings)
    values = np.full(plane.shape, radius, np.float32)
    sure = np.full(plane.shape, confidence, np.float32)
    return add_results(
        viewer,
        [blur_map_layer(plane, values, made, 3e-5), confidence_layer(plane, sure, made, 3e-5)],
    )


def read(source, layer, viewer):
    return source.read(Picture.of(plane_of(layer, viewer)), JobCache(), silent)


def source(map_layer, layer, viewer, psf="disc"):
    return source_of_layer(map_layer, plane_of(layer, viewer), viewer, psf)


def test_estimated_map_comes_with_its_confidence_and_their_layers_are_hidden(viewer, leaf, method):
    found = read(EstimatedSource(settings=MapSettings(psf="polygon:6")), leaf, viewer)
    assert (found.values == method.radius).all()
    assert found.psf == Polygon(6)
    assert found.confidence.shape == leaf.data.shape
    names = [keywords["name"] for _, keywords, _ in found.layers]
    assert names == ["leaf blur (px)", "leaf confidence"]
    assert not any(keywords["visible"] for _, keywords, _ in found.layers)


def test_map_is_labelled_once_for_the_same_settings(viewer, leaf, method):
    cache, picture = JobCache(), Picture.of(plane_of(leaf, viewer))
    for smoothness in (20.0, 20.0, 30.0):
        EstimatedSource(settings=MapSettings(smoothness=smoothness)).read(picture, cache, silent)
    assert len(method.estimations) == 1
    assert len(method.labelings) == 2


def test_painting_on_the_shown_map_does_not_change_what_is_kept(viewer, leaf, method):
    cache, picture = JobCache(), Picture.of(plane_of(leaf, viewer))
    estimate = EstimatedSource(settings=MapSettings())
    for layer in add_results(viewer, estimate.read(picture, cache, silent).layers):
        layer.data[:] = 0
    again = estimate.read(picture, cache, silent)
    assert again.values.min() == method.radius
    assert again.confidence.max() == 1


def test_map_of_ours_says_its_lens_itself(viewer, leaf):
    blur_map, _ = results_on(leaf, viewer, psf="gaussian", max_radius=6.0)
    found = read(source(blur_map, leaf, viewer, psf="polygon:5"), leaf, viewer)
    assert found.psf == Gaussian(6.0)
    assert found.name == "leaf blur (px)"
    assert not found.layers


def test_lens_of_a_map_of_somebody_else_is_what_the_form_says(viewer, leaf):
    theirs = viewer.add_image(np.full(leaf.data.shape, 2.0), name="theirs")
    found = read(source(theirs, leaf, viewer, psf="polygon:5"), leaf, viewer)
    assert found.psf == Polygon(5)
    assert found.values.dtype == np.float32


def test_domain_of_the_lens_reaches_as_far_as_the_map(viewer, leaf):
    theirs = viewer.add_image(np.full(leaf.data.shape, 11.0), name="theirs")
    assert read(source(theirs, leaf, viewer), leaf, viewer).psf == Disc(64.0)
    theirs.data = np.full(leaf.data.shape, 70.0)
    assert read(source(theirs, leaf, viewer), leaf, viewer).psf == Disc(70.0)
    ours, _ = results_on(leaf, viewer, radius=11.0, max_radius=8.0)
    assert read(source(ours, leaf, viewer), leaf, viewer).psf == Disc(11.0)


def test_confidence_of_the_same_estimation_is_found(viewer, leaf):
    blur_map, _ = results_on(leaf, viewer, confidence=0.7)
    found = read(source(blur_map, leaf, viewer), leaf, viewer)
    assert found.confidence.max() == np.float32(0.7)


def test_confidence_of_another_estimation_is_not_taken(viewer, leaf):
    blur_map, confidence = results_on(leaf, viewer)
    confidence.metadata["napari_defocus"]["noise_variance"] = 1e-3
    assert read(source(blur_map, leaf, viewer), leaf, viewer).confidence is None
    theirs = viewer.add_image(np.ones(leaf.data.shape), name="theirs")
    assert read(source(theirs, leaf, viewer), leaf, viewer).confidence is None


def test_only_maps_that_fit_are_offered(viewer, leaf):
    blur_map, confidence = results_on(leaf, viewer)
    theirs = viewer.add_image(np.zeros(leaf.data.shape, np.float32))
    bytes_ = viewer.add_image(np.zeros(leaf.data.shape, np.uint8))
    smaller = viewer.add_image(np.zeros((20, 30), np.float32))
    color = viewer.add_image(np.zeros((*leaf.data.shape, 3), np.float32))
    labels = viewer.add_labels(np.zeros(leaf.data.shape, int))
    offered = [layer for layer in viewer.layers if may_be_map_of(layer, leaf)]
    assert offered == [blur_map, theirs]
    for layer in (leaf, confidence, bytes_, smaller, color, labels):
        assert layer not in offered


def test_map_of_one_plane_of_a_stack_is_offered_and_read_where_it_is_shown(viewer):
    stack = viewer.add_image(np.random.default_rng(0).random((5, 32, 48)), name="stack")
    viewer.dims.order = (1, 0, 2)
    viewer.dims.set_current_step(1, 3)
    blur_map, _ = results_on(stack, viewer)
    assert may_be_map_of(blur_map, stack)
    assert read(source(blur_map, stack, viewer), stack, viewer).values.shape == (5, 48)
    viewer.dims.set_current_step(1, 4)
    with pytest.raises(ValueError, match="cannot be the blur map of “stack”: the viewer shows no"):
        source(blur_map, stack, viewer)


def test_map_of_another_size_is_refused_in_plain_words(viewer, leaf):
    smaller = viewer.add_image(np.zeros((20, 30), np.float32), name="small")
    with pytest.raises(ValueError, match=r"“small” cannot be .* it has 20 x 30 px, the picture 96"):
        source(smaller, leaf, viewer)


@pytest.mark.parametrize("wrong", [-1.0, np.inf])
def test_picture_that_is_no_map_is_refused_in_plain_words(viewer, leaf, wrong):
    values = np.ones(leaf.data.shape, np.float32)
    values[3, 4] = wrong
    theirs = viewer.add_image(values, name="theirs", contrast_limits=(0, 1))
    with pytest.raises(ValueError, match="“theirs” is no blur map"):
        read(source(theirs, leaf, viewer), leaf, viewer)


def test_gaps_are_no_harm_until_something_is_restored(viewer, leaf):
    values = np.ones(leaf.data.shape, np.float32)
    values[3, 4] = np.nan
    found = read(source(viewer.add_image(values, name="theirs"), leaf, viewer), leaf, viewer)
    assert np.isnan(found.values[3, 4])
    with pytest.raises(ValueError, match="“theirs” has pixels without a value"):
        found.checked_for_restoration()


@pytest.mark.parametrize("psf", ["disc", "gaussian"])
def test_map_beyond_what_is_restored_is_refused(viewer, leaf, psf):
    theirs = viewer.add_image(np.full(leaf.data.shape, 128.0), name="theirs")
    found = read(source(theirs, leaf, viewer, psf), leaf, viewer)
    assert found.checked_for_restoration().max() == 128
    theirs.data = np.full(leaf.data.shape, 129.0)
    found = read(source(theirs, leaf, viewer, psf), leaf, viewer)
    with pytest.raises(ValueError, match="a radius of 129 px; up to 128 px"):
        found.checked_for_restoration()


def test_lens_that_cannot_be_is_refused_before_any_work(viewer, leaf):
    with pytest.raises(ValueError, match="no such file"):
        LayerSource(plane=plane_of(leaf, viewer), psf="none.npz")
    with pytest.raises(ValueError, match="no such file"):
        EstimatedSource(settings=MapSettings(psf="none.npz"))
    with pytest.raises(ValueError, match="“leaf” does not say with which lens"):
        LayerSource(plane=plane_of(leaf, viewer), psf="auto")


def test_each_of_several_maps_has_its_own_confidence(viewer, leaf):
    first, _ = results_on(leaf, viewer, confidence=0.7, smoothness=20.0)
    plane, made = plane_of(leaf, viewer), MapSettings(smoothness=30.0)
    values = np.full(plane.shape, 0.4, np.float32)
    second, _ = add_results(
        viewer,
        [blur_map_layer(plane, values, made, 3e-5), confidence_layer(plane, values, made, 3e-5)],
        keep_earlier=True,
    )
    for layer, sure in ((first, 0.7), (second, 0.4)):
        assert read(source(layer, leaf, viewer), leaf, viewer).confidence[0, 0] == np.float32(sure)
