import math
from dataclasses import replace

import numpy as np
import pytest
from napari.layers import Surface

from napari_defocus import ThinLens, blur_from_depth, depth_from_blur
from napari_defocus.settings import MapSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.jobs.distances import Distances
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.map_source import EstimatedSource, source_of_layer
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY

LENS = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=50)
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


def ramp(shape, largest=5.0):
    return np.linspace(0, largest, math.prod(shape), dtype=np.float32).reshape(shape)


def distances(viewer, layer, blur_map=None, psf="disc", lens=LENS, **options):
    plane = shown_plane(layer, viewer.dims)
    if blur_map is None:
        source = EstimatedSource(settings=MapSettings())
    else:
        blur_map = np.asarray(blur_map)
        if blur_map.ndim < layer.ndim:
            blur_map = plane.expanded(blur_map)
        shown = viewer.add_image(blur_map, name="map", contrast_limits=(0, 8), **plane.placement)
        source = source_of_layer(shown, plane, viewer, psf)
    return Distances(plane=plane, source=source, lens=lens, **options)


def shown(viewer, wanted):
    results = wanted.run(JobCache())
    return add_results(viewer, results.layers), results.summary


@pytest.mark.parametrize("side", ["far", "near"])
def test_blur_becomes_distance(viewer, leaf, side):
    blur = ramp(leaf.data.shape)
    [depth], summary = shown(viewer, distances(viewer, leaf, blur, side=side))
    assert depth.name == "leaf depth (m)"
    assert depth.data.dtype == np.float32
    np.testing.assert_array_equal(depth.data, depth_from_blur(blur, LENS, side=side))
    for corner in np.ndindex(2, 2):
        np.testing.assert_allclose(depth.data_to_world(corner), leaf.data_to_world(corner))
    assert depth.units == leaf.units
    assert depth.colorbar.visible
    low, high = np.percentile(depth.data, [1, 99])
    assert tuple(depth.contrast_limits) == pytest.approx((low, high))
    assert f"{low:.3g} to {high:.3g} m" in summary
    made = depth.metadata[METADATA_KEY]
    assert made["settings"]["lens"]["pixel_pitch_um"] == 50
    assert made["settings"]["side"] == side
    assert made["blur_map"] == "map"


def test_distance_is_the_same_whatever_the_lens(viewer, leaf):
    blur = np.full(leaf.data.shape, 2.0)
    [depth], _ = shown(viewer, distances(viewer, leaf, blur, psf="gaussian"))
    np.testing.assert_allclose(blur_from_depth(depth.data, LENS), 2.0, rtol=1e-5)


def test_distance_is_not_known_where_the_confidence_is_low(viewer, leaf, method):
    layers, summary = shown(viewer, distances(viewer, leaf, min_confidence=0.25))
    assert [layer.name for layer in layers] == [
        "leaf blur (px)",
        "leaf confidence",
        "leaf depth (m)",
    ]
    confidence, depth = layers[1], layers[2]
    np.testing.assert_array_equal(np.isnan(depth.data), confidence.data < 0.25)
    assert "Not known on 25%" in summary
    assert "not known" in depth.metadata[METADATA_KEY]["nan"]
    assert depth.colormap.map(np.array([np.nan]))[0, 3] == 1, "no other layer shows through"
    [everywhere], _ = shown(viewer, distances(viewer, leaf, ramp(leaf.data.shape)))
    assert np.isfinite(everywhere.data).all(), "this map has no confidence"


def test_infinite_distances_stay_infinite_and_do_not_stretch_the_colours(viewer, leaf):
    blur = ramp(leaf.data.shape, largest=2 * LENS.largest_radius)
    [depth], summary = shown(viewer, distances(viewer, leaf, blur))
    assert np.isinf(depth.data).mean() == pytest.approx(0.5, abs=0.01)
    assert np.isfinite(depth.contrast_limits).all()
    assert "Infinite on 50%" in summary
    assert "more blurred" in depth.metadata[METADATA_KEY]["infinity"]


def test_gaps_of_a_map_are_gaps_of_the_distances(viewer, leaf):
    blur = ramp(leaf.data.shape)
    blur[5, 7] = np.nan
    [depth], summary = shown(viewer, distances(viewer, leaf, blur))
    assert np.argwhere(np.isnan(depth.data)).tolist() == [[5, 7]]
    assert "Not known on less than 1%" in summary


def test_one_distance_everywhere_has_contrast_limits(viewer, leaf):
    [depth], _ = shown(viewer, distances(viewer, leaf, np.ones(leaf.data.shape)))
    low, high = depth.contrast_limits
    assert low < depth.data[0, 0] < high


def test_nothing_known_is_said_in_plain_words(viewer, leaf):
    wanted = distances(viewer, leaf, np.ones(leaf.data.shape))
    unsure = viewer.add_image(np.zeros(leaf.data.shape), contrast_limits=(0, 1), **PLACED)
    confidence = shown_plane(unsure, viewer.dims)
    wanted = replace(wanted, source=replace(wanted.source, confidence=confidence))
    with pytest.raises(ValueError, match=r"no pixel has a confidence of 0\.5 or more"):
        wanted.run(JobCache())
    assert replace(wanted, min_confidence=0.0).run(JobCache())


def test_nothing_lies_behind_infinity(viewer, leaf, method):
    far = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=math.inf, pixel_pitch_um=50)
    with pytest.raises(ValueError, match="Nothing lies behind a focus at infinity"):
        distances(viewer, leaf, lens=far)
    [depth], _ = shown(
        viewer, distances(viewer, leaf, np.ones(leaf.data.shape), lens=far, side="near")
    )
    assert depth.data.max() == pytest.approx(12.5)


def test_surface_stands_on_the_picture_in_its_colours(viewer, leaf):
    blur = ramp(leaf.data.shape)
    layers, _ = shown(viewer, distances(viewer, leaf, blur, surface=True))
    depth, surface = layers
    assert isinstance(surface, Surface)
    assert surface.name == "leaf depth surface"
    used = np.unique(surface.faces)
    assert len(used) == leaf.data.size
    world = np.array([surface.data_to_world(corner) for corner in surface.vertices[used]])
    height, rows, columns = surface.vertices[used].T
    expected = [leaf.data_to_world(place) for place in zip(rows, columns, strict=True)]
    np.testing.assert_allclose(world[:, 1:], expected, atol=1e-4)
    pixel = math.sqrt(0.5 * 0.25)
    np.testing.assert_allclose(world[:, 0], height * pixel, rtol=1e-5)
    nearest = depth.data[rows.astype(int), columns.astype(int)].argmin()
    assert height.argmax() == nearest
    grey = leaf.data[rows.astype(int), columns.astype(int)]
    np.testing.assert_allclose(surface.vertex_colors[used], np.stack([grey] * 3, 1), atol=1e-6)
    assert [str(unit) for unit in surface.units] == ["micrometer"] * 3
    assert surface.axis_labels == ("height", "y", "x")


def test_surface_covers_nothing_in_2d_and_turns_nothing_in_the_viewer(viewer, leaf):
    _, surface = shown(viewer, distances(viewer, leaf, ramp(leaf.data.shape), surface=True))[0]
    assert viewer.dims.ndisplay == 2
    assert viewer.dims.point[0] == 0
    assert len(surface._view_faces) == 0
    viewer.dims.ndisplay = 3
    assert len(surface._view_faces) == len(surface.faces)


def test_another_surface_takes_the_place_of_the_surface(viewer, leaf):
    first, _ = shown(viewer, distances(viewer, leaf, ramp(leaf.data.shape), surface=True))
    blur = ramp(leaf.data.shape)
    blur[:10] = np.nan
    second, _ = shown(viewer, distances(viewer, leaf, blur, surface=True))
    assert second == first
    assert len(second[1].vertices) == len(second[1].vertex_colors) < leaf.data.size


def test_of_a_stack_the_surface_stands_on_the_plane_that_is_shown(viewer):
    stack = np.random.default_rng(0).random((4, 32, 48))
    layer = viewer.add_image(stack, scale=(5, 2, 2), translate=(100, 0, 0))
    viewer.dims.set_point(0, 110)
    depth, surface = shown(viewer, distances(viewer, layer, ramp((32, 48), 2.0), surface=True))[0]
    assert depth.data.shape == (1, 32, 48)
    used = surface.vertices[np.unique(surface.faces)]
    world = np.array([surface.data_to_world(corner) for corner in used])
    assert world[:, 0].min() == pytest.approx(112)
    assert world[:, 1].max() == pytest.approx(62)
    assert world[:, 2].max() == pytest.approx(94)


def test_surface_that_cannot_be_does_not_spoil_the_distances(viewer, leaf):
    checkered = 8.0 * (np.indices(leaf.data.shape).sum(axis=0) % 2)
    layers, summary = shown(viewer, distances(viewer, leaf, checkered, surface=True))
    assert [layer.name for layer in layers] == ["leaf depth (m)"]
    assert "No surface: distances jump" in summary
