"""Surfaces of distances to look at."""

import math

import numpy as np
import pytest

from napari_defocus import depth_surface
from napari_defocus.optics.mesh import blur_surface


def consistent(surface):
    """Check what holds for every surface, and return it."""
    assert surface.vertices.dtype == np.float32
    assert surface.faces.dtype == np.int32
    assert np.isfinite(surface.vertices).all()
    # Every vertex is used, and no triangle degenerate.
    np.testing.assert_array_equal(np.unique(surface.faces), np.arange(len(surface.vertices)))
    _, y, x = np.moveaxis(surface.vertices[surface.faces], -1, 0)
    # Rows point down: counter-clockwise as it is seen is a negative area here.
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    assert (area < 0).all()
    return surface


def test_flat_map_is_a_whole_grid():
    surface = consistent(depth_surface(np.full((5, 7), 3.0)))
    assert len(surface.vertices) == 35
    assert len(surface.faces) == 2 * 4 * 6
    rows, columns = np.indices((5, 7)).reshape(2, -1)
    np.testing.assert_array_equal(surface.vertices, np.stack([0 * rows, rows, columns], axis=1))
    assert surface.colors is None


def test_no_triangle_spans_a_jump():
    depth = np.where(np.arange(20) < 8, 1.0, 1.06) * np.linspace(1, 1.5, 30)[:, None]
    surface = consistent(depth_surface(depth))
    left = surface.vertices[surface.faces][..., 2] < 8
    assert (left.all(axis=1) | (~left).all(axis=1)).all()
    assert len(surface.faces) == 2 * 29 * (7 + 11)
    assert len(consistent(depth_surface(depth, largest_jump=0.1)).faces) == 2 * 29 * 19


@pytest.mark.parametrize("step", [1, 2, 3])
def test_no_triangle_of_a_rough_map_spans_more_than_was_said(step):
    depth = np.exp(np.random.default_rng(0).normal(0, 0.05, (40, 50)))
    depth[10:20, 10:20] = np.nan
    depth[30:, 5:9] = np.inf
    surface = consistent(depth_surface(depth, step=step, largest_jump=0.05))
    _, row, column = surface.vertices.astype(int).T
    corners = depth[row, column][surface.faces]
    assert (corners.max(axis=1) <= 1.05 * corners.min(axis=1)).all()


@pytest.mark.parametrize("gap", [np.nan, np.inf])
def test_gap_is_a_hole_however_large_jumps_may_be(gap):
    depth = np.ones((6, 6))
    depth[2, 3] = gap
    surface = consistent(depth_surface(depth, largest_jump=math.inf))
    assert len(surface.vertices) == 35
    assert len(surface.faces) == 2 * 25 - 6


def test_nearer_is_towards_you_by_half_of_the_longer_side():
    depth = np.broadcast_to(np.linspace(4, 2, 201), (100, 201))
    z = consistent(depth_surface(depth)).vertices[:, 0].reshape(100, 201)
    assert (np.diff(z, axis=1) > 0).all()
    near, far = np.percentile(z, [99, 1])
    assert near - far == pytest.approx(201 / 2)
    assert far == pytest.approx(0, abs=1e-3)
    doubled = depth_surface(depth, relief=1.0).vertices[:, 0].reshape(100, 201)
    np.testing.assert_allclose(doubled, 2 * z, atol=1e-3)
    # The unit of the distance does not matter.
    np.testing.assert_allclose(
        depth_surface(1000 * depth).vertices, depth_surface(depth).vertices, atol=1e-3
    )


def test_napari_looks_at_a_surface_from_its_near_side():
    components = pytest.importorskip("napari.components")
    z, _, _ = components.ViewerModel(ndisplay=3).scene.camera.view_direction
    assert z < 0


def test_few_wild_distances_do_not_shrink_the_rest():
    depth = np.tile(np.linspace(2, 3, 100), (100, 1))
    depth[50, 50:53] = [1e-3, 1e6, 1e9]
    z = consistent(depth_surface(depth, largest_jump=math.inf)).vertices[:, 0]
    assert np.ptp(z) == pytest.approx(3 * 50, rel=1e-3)


def test_small_subject_stands_before_a_flat_wall():
    depth = np.full((100, 100), 3.0)
    depth[50:55, 50:55] = 2.0
    surface = consistent(depth_surface(depth))
    z, row, column = surface.vertices.T
    subject = (row >= 50) & (row < 55) & (column >= 50) & (column < 55)
    np.testing.assert_array_equal(z, np.where(subject, 50, 0))


@pytest.mark.parametrize("shape", [(600, 800), (501, 503), (100, 3000), (500, 500)])
def test_default_step_leaves_at_most_250000_vertices(shape):
    count = len(consistent(depth_surface(np.ones(shape))).vertices)
    assert 0.2 * 250_000 < count <= 250_000


def test_step_takes_every_nth_pixel_about_the_middle():
    surface = consistent(depth_surface(np.ones((10, 12)), step=4))
    np.testing.assert_array_equal(np.unique(surface.vertices[:, 1]), [0, 4, 8])
    np.testing.assert_array_equal(np.unique(surface.vertices[:, 2]), [1, 5, 9])


@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_colours_are_those_of_the_picture(channels):
    image = np.random.default_rng(0).integers(0, 256, (9, 11, *channels), dtype=np.uint8)
    depth = np.ones((9, 11))
    depth[4, 5] = np.nan
    surface = consistent(depth_surface(depth, image, step=2))
    _, row, column = surface.vertices.astype(int).T
    seen = image[row, column].reshape(len(row), -1)[:, :3] / 255
    assert surface.colors.dtype == np.float32
    np.testing.assert_allclose(surface.colors, np.broadcast_to(seen, (len(row), 3)), rtol=1e-6)


def test_colours_use_the_intensity_range_and_stay_within():
    image = np.arange(16, dtype=np.uint16).reshape(4, 4)
    colors = depth_surface(np.ones((4, 4)), image, intensity_range=(2, 12)).colors
    expected = np.clip((np.arange(16) - 2) / 10, 0, 1)
    np.testing.assert_allclose(colors, np.stack([expected] * 3, axis=1), rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"depth": np.ones(5)}, ValueError, r"depth has shape \(5,\); it takes \(H, W\)"),
        ({"depth": np.ones((1, 5))}, ValueError, r"depth has shape \(1, 5\)"),
        ({"depth": [["far"]]}, TypeError, "depth has dtype .*; it takes real numbers"),
        ({"depth": np.zeros((4, 5))}, ValueError, "depth has values down to 0; it takes ones abo"),
        ({"depth": np.full((4, 5), np.nan)}, ValueError, "depth leaves no triangle"),
        ({"depth": np.geomspace(1, 9, 20).reshape(4, 5)}, ValueError, "largest_jump = 0.05"),
        ({"image": np.ones((5, 4))}, ValueError, r"image has height and width \(5, 4\); it takes"),
        ({"image": "picture"}, TypeError, "image has dtype"),
        ({"step": 0}, ValueError, "step is 0; it takes a whole number from 1 to below .* 4 px"),
        ({"step": 4}, ValueError, "step is 4; it takes a whole number from 1 to below .* 4 px"),
        ({"step": 1.5}, TypeError, "step is 1.5; it takes a whole number"),
        ({"largest_jump": 0}, ValueError, "largest_jump is 0; it takes a number above 0"),
        ({"largest_jump": math.nan}, ValueError, "largest_jump is nan"),
        ({"largest_jump": "5 %"}, TypeError, "largest_jump is '5 %'"),
        ({"relief": -1}, ValueError, "relief is -1; it takes a finite number above 0"),
        ({"relief": math.inf}, ValueError, "relief is inf"),
        ({"relief": None}, TypeError, "relief is None"),
    ],
)
def test_impossible_surface_is_an_error(arguments, error, words):
    with pytest.raises(error, match=words):
        depth_surface(**{"depth": np.ones((4, 5)), **arguments})


def test_what_is_in_focus_stands_out_and_a_px_of_blur_is_always_as_high():
    slope = np.broadcast_to(np.linspace(1, 3, 201), (100, 201))
    z = consistent(blur_surface(slope, max_scale=8.0)).vertices[:, 0]
    np.testing.assert_allclose(z.reshape(100, 201), 0.5 * 201 * (1 - slope / 8), rtol=1e-5)
    flat = blur_surface(np.full((100, 201), 3.0), max_scale=8.0).vertices[:, 0]
    assert (flat == z.min()).all()


def test_blur_that_jumps_or_is_not_known_tears_the_surface():
    blur = np.where(np.arange(20) < 8, 1.0, 1.6) * np.ones((30, 1))
    assert len(consistent(blur_surface(blur, max_scale=8.0)).faces) == 2 * 29 * (7 + 11)
    assert len(blur_surface(blur, max_scale=8.0, largest_jump=0.7).faces) == 2 * 29 * 19
    blur[10, 3] = np.nan
    assert len(consistent(blur_surface(blur, max_scale=8.0)).faces) == 2 * 29 * (7 + 11) - 6


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"blur_map": np.ones(5)}, ValueError, r"blur_map has shape \(5,\); it takes \(H, W\)"),
        ({"blur_map": [["much"]]}, TypeError, "blur_map has dtype .*; it takes real numbers"),
        ({"blur_map": -np.ones((4, 5))}, ValueError, "blur_map has values that are infinite or"),
        ({"blur_map": np.full((4, 5), np.nan)}, ValueError, "blur_map leaves no triangle"),
        ({"max_scale": 0}, ValueError, "max_scale is 0; it takes a finite number above 0"),
        ({"largest_jump": 0}, ValueError, "largest_jump is 0; it takes a number above 0"),
        ({"relief": math.inf}, ValueError, "relief is inf; it takes a finite number above 0"),
        ({"step": 4}, ValueError, "step is 4; it takes a whole number from 1"),
    ],
)
def test_surface_of_blur_says_what_it_takes(arguments, error, words):
    with pytest.raises(error, match=words):
        blur_surface(**({"blur_map": np.ones((4, 5)), "max_scale": 8.0} | arguments))
