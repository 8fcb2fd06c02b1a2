from types import SimpleNamespace

import dask.array as da
import numpy as np
import pytest
from napari.components import ViewerModel
from napari.layers import Labels

import napari_defocus
from napari_defocus import Cancelled, simulate_defocus
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.map_source import source_of_layer
from napari_defocus.widgets.jobs.stack_analysis import StackAnalysis
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, shown_plane
from napari_defocus.widgets.layers.region import plane_in, region_of
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY, PLANES
from napari_defocus.widgets.layers.seeds import add_seeds_layer

PLACED = {"scale": (5, 0.5, 0.25), "translate": (10, 1, 2), "rotate": (0, 0, 20)}
CUBE = list(np.ndindex(2, 2, 2))


@pytest.fixture
def viewer():
    return ViewerModel()


@pytest.fixture
def stack():
    return np.random.default_rng(0).uniform(0.1, 0.9, (4, 32, 48)).astype(np.float32)


@pytest.fixture
def brightness(method, monkeypatch):
    """A method whose radius is ten times the picture's mean."""

    def estimate_candidates(image, **arguments):
        method.radius = 10 * float(np.mean(image))
        method.noise_variance = 1e-5 * (1 + len(method.estimations))
        return type(method).estimate_candidates(method, image, **arguments)

    monkeypatch.setitem(vars(napari_defocus), "estimate_candidates", estimate_candidates)
    return method


def wanted(plane, **more):
    settings = {"mask": MaskSettings(threshold=5.0), "estimation": MapSettings(), **more}
    return StackAnalysis(plane=plane, **settings)


def results_of(viewer, layer, cache=None, **more):
    return wanted(shown_plane(layer, viewer.dims), **more).run(cache or JobCache())


def test_every_plane_gets_its_own_result_and_all_lie_on_the_stack(viewer, stack, brightness):
    layer = viewer.add_image(stack, name="sweep", **PLACED)
    viewer.dims.set_current_step(0, 2)
    blur_map, confidence, mask = add_results(viewer, results_of(viewer, layer).layers)
    assert [found.name for found in (blur_map, confidence, mask)] == [
        "sweep blur (px)",
        "sweep confidence",
        "sweep in focus",
    ]
    radii = 10 * stack.mean(axis=(1, 2))
    np.testing.assert_allclose(blur_map.data, np.ones_like(stack) * radii[:, None, None], rtol=1e-5)
    np.testing.assert_array_equal(mask.data[:, 0, 0], radii <= 5)
    assert [found.data.dtype for found in (blur_map, confidence, mask)] == ["f4", "f4", "u1"]
    assert isinstance(mask, Labels)
    for found in (blur_map, confidence, mask):
        assert found.data.shape == stack.shape
        for corner in CUBE:
            np.testing.assert_allclose(found.data_to_world(corner), layer.data_to_world(corner))


def test_results_say_what_each_plane_had(viewer, stack, brightness):
    layer = viewer.add_image(stack, name="sweep")
    found = results_of(viewer, layer)
    made = found.layers[0][1]["metadata"][METADATA_KEY]
    assert made["noise_variance"] == pytest.approx(2.5e-5)
    assert made["planes"]["axes"] == [0]
    np.testing.assert_allclose(made["planes"]["noise_variances"], [1e-5, 2e-5, 3e-5, 4e-5])
    assert made["source"] == "sweep"
    assert found.summary.splitlines() == [
        "4 planes",
        "Noise variance 1.0e-05 to 4.0e-05 (found)",
        "Trusted on 50% (confidence 0.5 or more)",
    ]


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (1, 2, 0, 3)])
def test_planes_over_time_and_depth_are_all_analysed(viewer, brightness, order):
    movie = np.random.default_rng(0).random((3, 4, 5, 16, 3)).astype(np.float32)
    movie *= np.linspace(0.1, 1, 60).reshape(3, 4, 5, 1, 1)
    layer = viewer.add_image(movie[..., 0], contrast_limits=(0, 1))
    viewer.dims.order = order
    [(blur_map, _, _), *_] = results_of(viewer, layer).layers
    expected = 10 * movie[..., 0].mean(axis=tuple(sorted(order[2:])), keepdims=True)
    assert blur_map.shape == movie.shape[:4]
    np.testing.assert_allclose(blur_map, expected * np.ones((3, 4, 5, 16)), rtol=1e-4)


def test_colour_stack_and_single_picture_work_alike(viewer, method, texture):
    colours = viewer.add_image(np.random.default_rng(0).integers(0, 255, (3, 32, 48, 3), np.uint8))
    assert results_of(viewer, colours).layers[0][0].shape == (3, 32, 48)
    viewer.layers.clear()
    picture = viewer.add_image(texture)
    found = results_of(viewer, picture)
    assert found.layers[0][0].shape == texture.shape
    assert found.summary.startswith("1 plane\n")


def test_region_is_cut_out_of_every_plane(viewer, stack, brightness):
    layer = viewer.add_image(stack, **PLACED)
    diamond = np.array([[0, 2, 20], [0, 12, 30], [0, 22, 20], [0, 12, 10]])
    shapes = viewer.add_shapes([diamond], shape_type="polygon", **PLACED)
    viewer.dims.set_point(0, 10)
    plane = plane_in(shown_plane(layer, viewer.dims), region_of(layer, viewer, shapes))
    blur_map, confidence, mask = add_results(viewer, wanted(plane).run(JobCache()).layers)
    radii = 10 * stack[:, 2:23, 10:31].mean(axis=(1, 2))
    np.testing.assert_allclose(
        blur_map.data, np.ones((4, 21, 21)) * radii[:, None, None], rtol=1e-4
    )
    assert not confidence.data[:, 0, 0].any()
    assert not mask.data[:, ~plane.inside].any()
    assert confidence.metadata[METADATA_KEY]["region"]["rows"] == [2, 23]
    for corner in CUBE:
        expected = layer.data_to_world(np.add(corner, (0, 2, 10)))
        np.testing.assert_allclose(blur_map.data_to_world(corner), expected)


def test_progress_names_the_plane_and_never_falls(viewer, stack, method):
    seen = []
    plane = shown_plane(viewer.add_image(stack), viewer.dims)
    wanted(plane).run(JobCache(), lambda step, done: seen.append((step, done)))
    assert ("Plane 3 of 4: Estimating blur") in [step for step, _ in seen]
    shares = [done for _, done in seen]
    assert shares == sorted(shares)
    assert 0 <= shares[0] <= shares[-1] <= 1


def test_cancel_ends_the_run_between_and_within_planes(viewer, stack, method):
    plane = shown_plane(viewer.add_image(stack), viewer.dims)
    for stop in ("Plane 3 of 4: Reading the picture", "Plane 3 of 4: Estimating blur"):
        method.estimations.clear()

        def cancel(step, done, stop=stop):
            if step == stop:
                raise Cancelled

        with pytest.raises(Cancelled):
            wanted(plane).run(JobCache(), cancel)
        assert 2 <= len(method.estimations) <= 3


def test_plane_that_cannot_be_analysed_is_unknown_and_the_rest_goes_on(viewer, stack, method):
    stack[1, 3, 4] = np.inf
    stack[2] = 0.5
    found = results_of(viewer, viewer.add_image(stack))
    (blur_map, keywords, _), (confidence, _, _), (mask, _, _) = found.layers
    assert np.isnan(blur_map[1]).all()
    assert not confidence[1].any()
    assert not mask[1].any()
    assert np.isfinite(blur_map[[0, 2, 3]]).all()
    assert "3 planes" in found.summary
    assert "Not analysed: plane 1 (from 0): it has infinite pixels" in found.summary
    told = keywords["metadata"][METADATA_KEY]["planes"]
    assert told["noise_variances"][1] is None
    assert "infinite pixels" in told["not analysed"]["1"]
    assert "on 50%" in found.summary, "of what was analysed"


def test_stack_of_which_no_plane_can_be_analysed_is_refused(viewer, stack, method):
    with pytest.raises(NotAnalysableError, match="infinite pixels"):
        results_of(viewer, viewer.add_image(stack * np.inf))


def test_what_does_not_fit_into_memory_goes_to_the_disk_if_there_is_room(viewer, monkeypatch):
    layer = viewer.add_image(da.zeros((1000, 1500, 2000), dtype=np.uint8), contrast_limits=(0, 1))
    plane = shown_plane(layer, viewer.dims)
    room = SimpleNamespace(free=13e9)
    monkeypatch.setattr("shutil.disk_usage", lambda _: room)
    with pytest.raises(NotAnalysableError, match=r"results take up to 27\.0 GB, and"):
        wanted(plane)
    assert wanted(plane, mask=None, confidence=False).is_large
    assert not wanted(plane.at((0, slice(0, 9), slice(0, 9)))).is_large


def test_impossible_settings_and_seeds_are_refused_before_any_work(viewer, stack, method):
    layer = viewer.add_image(stack)
    plane = shown_plane(layer, viewer.dims)
    with pytest.raises(ValueError, match="below 8 px"):
        wanted(plane, mask=MaskSettings(threshold=9.0), estimation=MapSettings(max_radius=8.0))
    with pytest.raises(ValueError, match="below 8 px"):  # as far as planes tell
        wanted(plane, mask=MaskSettings(threshold=63.0))
    short = viewer.add_labels(np.zeros((30, 40), int), name="mine")
    with pytest.raises(ValueError, match="“mine” cannot be the seeds"):
        wanted(plane, seeds=short)
    assert not method.estimations


def test_each_plane_keeps_to_its_own_seeds(viewer, stack, method):
    layer = viewer.add_image(stack, **PLACED)
    seeds = add_seeds_layer(viewer, layer)
    seeds.data[2, 5, 6] = 2
    results_of(viewer, layer, seeds=seeds)
    counts = [np.count_nonzero(call["seeds"]) for call in method.segmentations]
    assert counts == [0, 0, 1, 0]


def test_seeds_of_one_picture_hold_for_all_planes_and_those_of_a_shifted_stack_are_moved(
    viewer, stack, method
):
    layer = viewer.add_image(stack)
    flat = np.zeros((32, 48), np.uint8)
    flat[3, 4] = 1
    results_of(viewer, layer, seeds=viewer.add_labels(flat))
    assert all(np.count_nonzero(call["seeds"]) == 1 for call in method.segmentations)
    method.segmentations.clear()
    longer = np.zeros((6, 32, 48), np.uint8)
    longer[3, 3, 4] = 1
    results_of(viewer, layer, seeds=viewer.add_labels(longer, translate=(-1, 0, 0)))
    counts = [np.count_nonzero(call["seeds"]) for call in method.segmentations]
    assert counts == [0, 0, 1, 0]


def test_only_the_shown_plane_is_kept(viewer, stack, method):
    cache = JobCache()
    layer = viewer.add_image(stack)
    viewer.dims.set_current_step(0, 1)
    plane = shown_plane(layer, viewer.dims)
    wanted(plane).run(cache)
    assert len(cache.analysed) == len(cache.maps) == 1
    Analysis(plane=plane, estimation=MapSettings(), mask=MaskSettings(threshold=3.0)).run(cache)
    assert len(method.estimations) == 4


@pytest.mark.parametrize("scales", [1, 2])
def test_of_a_dask_stack_one_plane_at_a_time_is_computed(viewer, method, scales):
    computed = []

    def plane(block_info):
        computed.append(block_info[None]["chunk-location"][0])
        return np.full((1, 32, 48), 0.1 * computed[-1], np.float32)

    stack = da.map_blocks(plane, chunks=((1,) * 5, (32,), (48,)), dtype=np.float32)
    data = [stack, stack[:, ::2, ::2]] if scales > 1 else stack
    layer = viewer.add_image(data, multiscale=scales > 1, contrast_limits=(0, 1))
    analysis = wanted(shown_plane(layer, viewer.dims))
    computed.clear()
    seen = []
    analysis.run(
        JobCache(), lambda step, done: seen.append(set(computed)) if "Estimating" in step else None
    )
    assert seen == [set(range(n + 1)) for n in range(5)]


def test_map_of_a_stack_serves_the_plane_that_is_shown(viewer, stack, brightness):
    layer = viewer.add_image(stack, **PLACED)
    blur_map, confidence, _ = add_results(viewer, results_of(viewer, layer).layers)
    viewer.dims.set_current_step(0, 3)
    source = source_of_layer(blur_map, shown_plane(layer, viewer.dims), viewer, "disc")
    np.testing.assert_array_equal(source.plane.read(), blur_map.data[3])
    np.testing.assert_array_equal(source.confidence.read(), confidence.data[3])


def test_focal_sweep_has_its_radii_plane_by_plane(viewer, gravel):
    sharp = gravel[:96, :96]
    radii = [4.0, 1.0, 3.0]
    sweep = [
        simulate_defocus(sharp, np.full(sharp.shape, radius), noise_variance=1e-6, rng=0)
        for radius in radii
    ]
    layer = viewer.add_image(np.array(sweep), contrast_limits=(0, 1))
    found = results_of(viewer, layer, mask=MaskSettings(threshold=2.0))
    (blur_map, _, _), (confidence, _, _), (mask, _, _) = found.layers
    np.testing.assert_allclose(np.median(blur_map, axis=(1, 2)), radii, atol=0.4)
    assert (mask.mean(axis=(1, 2)) > 0.5).tolist() == [False, True, False]
    assert np.median(confidence) > 0.5
    assert PLANES in found.layers[0][1]["metadata"][METADATA_KEY]
