"""Pictures too large for memory: measured part by part, shown from the disk."""

import gc
import pickle
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import dask.array as da
import numpy as np
import pytest
import zarr
from dask.callbacks import Callback
from skimage.data import camera

from napari_defocus import Cancelled, simulate_defocus
from napari_defocus.core.intensity import Intensities
from napari_defocus.io.lazy_arrays import Carried
from napari_defocus.io.ome_zarr import read_ome_zarr
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.display.cursor_text import text_under_cursor
from napari_defocus.widgets.display.probing import NothingKnownError, probed
from napari_defocus.widgets.display.region_table import add_regions
from napari_defocus.widgets.docks.defocus import DefocusWidget
from napari_defocus.widgets.export.map_files import save_map
from napari_defocus.widgets.export.stores import NotAMapError, write_store
from napari_defocus.widgets.jobs import large_analysis, stack_analysis
from napari_defocus.widgets.jobs import tiled_job as stored_parts
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.estimation import JobCache
from napari_defocus.widgets.jobs.large_analysis import LargeAnalysis, is_large
from napari_defocus.widgets.jobs.map_source import source_of_layer
from napari_defocus.widgets.jobs.stack_analysis import StackAnalysis
from napari_defocus.widgets.jobs.tiled_job import with_time_left
from napari_defocus.widgets.layers import image_layers as layers
from napari_defocus.widgets.layers import result_stores
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, shown_plane
from napari_defocus.widgets.layers.result_layers import not_trusted_layer
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY, STORE
from napari_defocus.widgets.layers.result_stores import Place

PLACED = {
    "scale": (0.5, 0.25),
    "translate": (3.0, -4.0),
    "units": ("um", "um"),
    "axis_labels": ("y", "x"),
}
SETTINGS = MapSettings(noise_variance=1e-5)


@pytest.fixture(scope="module")
def picture():
    sharp = np.hstack([camera()[100:250, :400], camera()[150:300, 100:330]]) / 255
    radius = np.broadcast_to(np.linspace(0.8, 6, sharp.shape[1]), sharp.shape)
    return (255 * simulate_defocus(sharp, radius, noise_variance=1e-5, rng=0)).astype(np.uint8)


@pytest.fixture(autouse=True)
def _small_parts(monkeypatch):
    """Parts of 256 px, and no other process: each would compile, and import, for itself."""
    monkeypatch.setattr(stored_parts, "BLOCK_SIZE", 256)

    def here(function, *arguments, progress, **keywords):
        return function(*arguments, progress=progress, **keywords)

    monkeypatch.setattr(large_analysis, "run_elsewhere", here)


def wanted(layer, viewer, **more):
    settings = {"estimation": SETTINGS, "mask": MaskSettings(), **more}
    return LargeAnalysis(plane=shown_plane(layer, viewer.dims), **settings)


def stores_in(folder):
    return sorted(path.name for path in Path(folder).iterdir())


@pytest.fixture(scope="module")
def in_memory(picture):
    from napari.components import ViewerModel

    viewer = ViewerModel()
    layer = viewer.add_image(picture)
    analysis = Analysis(
        plane=shown_plane(layer, viewer.dims), estimation=SETTINGS, mask=MaskSettings()
    )
    return [data for data, _, _ in analysis.run(JobCache())]


def test_lens_is_found_from_the_picture_and_told(viewer, picture, tmp_path):
    layer = viewer.add_image(da.from_array(picture, chunks=100), name="slide")
    auto = replace(SETTINGS, psf="auto")
    found = wanted(layer, viewer, place=Place(tmp_path), estimation=auto).run(JobCache())
    assert found.summary.startswith("Lens: disc")
    for _, keywords, _ in found.layers:
        assert keywords["metadata"][METADATA_KEY]["settings"]["psf"] == "disc"
    assert len(stores_in(tmp_path)) == 3


def test_results_are_lazy_lie_on_the_picture_and_are_those_of_the_whole(
    viewer, picture, in_memory, tmp_path
):
    layer = viewer.add_image(da.from_array(picture, chunks=100), name="slide", **PLACED)
    found = wanted(layer, viewer, place=Place(tmp_path)).run(JobCache())
    results = add_results(viewer, found.layers)
    assert [result.name for result in results] == [
        "slide blur (px)",
        "slide confidence",
        "slide in focus",
    ]
    for result, expected, far in zip(results, in_memory, (0.05, 0.02, 0.02), strict=True):
        assert result.multiscale
        assert isinstance(result.data[0], da.Array)
        assert tuple(result.scale) == PLACED["scale"]
        assert tuple(result.translate) == PLACED["translate"]
        assert [str(unit) for unit in result.units] == ["micrometer"] * 2
        assert result.axis_labels == ("y", "x")
        values = np.asarray(result.data[0])
        assert values.dtype == expected.dtype
        assert np.abs(values.astype(float) - expected).mean() < far
    assert results[0].colorbar.visible
    assert stores_in(tmp_path) == [
        "slide blur (px).ome.zarr",
        "slide confidence.ome.zarr",
        "slide in focus.ome.zarr",
    ]
    stored = read_ome_zarr(tmp_path / "slide blur (px).ome.zarr")
    assert stored.units == {"y": "micrometer", "x": "micrometer"}
    assert stored.pixel_size == {"y": 0.5, "x": 0.25}
    assert stored.attributes["settings"]["noise_variance"] == 1e-5
    assert f"Kept in {tmp_path}" in found.summary


@pytest.fixture
def quick(method, monkeypatch):
    """Results at once: what is written into the stores."""

    def measure_into(work, writers, *, progress):
        image = stored_parts.as_dask(work.image.array, work.axes)
        np.asarray(image)
        shape = next(iter(writers.values())).shape
        progress("Measuring part by part", 0.5)
        for name, writer in writers.items():
            for index in np.ndindex(shape[:-2]):
                writer[(*index, slice(None), slice(None))] = np.ones(shape[-2:])
            writer.finish()
            assert name in ("blur_map", "confidence", "mask")
        noise = np.full(shape[:-2], 1e-5)
        return noise, [Intensities(0.0, 255.0, "number type")] * noise.size, 2.3

    monkeypatch.setattr(large_analysis, "measure_into", measure_into)
    return measure_into


def test_new_results_take_the_place_of_the_old_ones_whose_files_go(viewer, quick):
    layer = viewer.add_image(np.zeros((40, 50), np.uint8), name="slide")
    first = add_results(viewer, wanted(layer, viewer).run(JobCache()).layers)
    before = [Path(result.metadata[METADATA_KEY][STORE]["path"]) for result in first]
    assert all(path.is_dir() for path in before)
    again = add_results(viewer, wanted(layer, viewer).run(JobCache()).layers)
    assert again == first
    after = [Path(result.metadata[METADATA_KEY][STORE]["path"]) for result in again]
    gc.collect()
    assert not any(path.exists() for path in before)
    assert all(path.is_dir() for path in after)
    np.testing.assert_array_equal(np.asarray(again[0].data[0]), 1)


def test_nothing_in_a_folder_of_the_user_is_replaced_or_removed(viewer, quick, tmp_path):
    layer = viewer.add_image(np.zeros((40, 50), np.uint8), name="a/b")
    for _ in range(2):
        found = wanted(layer, viewer, mask=None, confidence=False, place=Place(tmp_path))
        add_results(viewer, found.run(JobCache()).layers)
    gc.collect()
    assert stores_in(tmp_path) == ["a-b blur (px) 2.ome.zarr", "a-b blur (px).ome.zarr"]


def test_cancelled_work_leaves_nothing(viewer, picture, tmp_path):
    layer = viewer.add_image(picture)

    def stop(step, done):
        if done > 0.3:
            raise Cancelled

    with pytest.raises(Cancelled):
        wanted(layer, viewer, place=Place(tmp_path)).run(JobCache(), stop)
    assert not list(tmp_path.iterdir())


def test_shapes_and_seeds_of_a_large_picture_count(viewer, picture):
    layer = viewer.add_image(picture, name="slide")
    seeds = np.zeros(picture.shape, np.uint8)
    seeds[60:70, 500:510] = 1
    inside = np.zeros(picture.shape, bool)
    inside[:, 300:] = True
    plane = shown_plane(layer, viewer.dims).part(
        slice(0, 150), slice(0, 630), inside=inside, region="shapes"
    )
    found = LargeAnalysis(
        plane=plane, estimation=SETTINGS, mask=MaskSettings(), seeds=viewer.add_labels(seeds)
    ).run(JobCache())
    blur_map, confidence, mask = (np.asarray(data[0]) for data, _, _ in found.layers)
    assert mask[60:70, 500:510].all()
    assert not mask[~inside].any()
    assert not confidence[~inside].any()
    assert blur_map[~inside].all()


def test_all_planes_of_a_stack_lie_on_it_whatever_the_order_of_its_axes(viewer, quick, tmp_path):
    layer = viewer.add_image(
        np.zeros((40, 3, 50, 2), np.uint8), scale=(1, 5, 2, 3), axis_labels=("y", "t", "x", "z")
    )
    viewer.dims.order = (1, 3, 0, 2)
    found = wanted(layer, viewer, all_planes=True, place=Place(tmp_path)).run(JobCache())
    for result in add_results(viewer, found.layers):
        assert result.data.shape == (40, 3, 50, 2)
        assert tuple(result.scale) == (1, 5, 2, 3)
        assert result.metadata[METADATA_KEY]["planes"]["axes"] == [1, 3]
    stored = read_ome_zarr(tmp_path / f"{layer.name} blur (px).ome.zarr")
    assert stored.axes == "tzyx"
    assert stored.levels[0].shape == (3, 2, 40, 50)
    assert found.summary.startswith("6 planes\n")


def test_results_of_a_stack_that_do_not_fit_into_memory_are_kept_on_the_disk(
    viewer, method, monkeypatch, tmp_path
):
    monkeypatch.setattr(stack_analysis, "MOST_IN_MEMORY", 10_000)
    sweep = np.random.default_rng(0).random((4, 32, 48)).astype(np.float32)
    sweep[3, 3, 3] = np.inf
    layer = viewer.add_image(sweep, name="sweep", scale=(5, 1, 2))
    analysis = StackAnalysis(
        plane=shown_plane(layer, viewer.dims),
        estimation=MapSettings(),
        mask=MaskSettings(),
        place=Place(tmp_path),
    )
    found = analysis.run(JobCache())
    blur_map, confidence, mask = add_results(viewer, found.layers)
    assert isinstance(blur_map.data, da.Array)
    assert tuple(blur_map.scale) == (5, 1, 2)
    values = np.asarray(blur_map.data)
    assert np.isnan(values[3]).all()
    np.testing.assert_array_equal(values[:3], 2.5)
    assert not np.asarray(confidence.data[3]).any()
    assert mask.data.dtype == np.uint8
    assert "Trusted on 50% (confidence 0.5 or more)" in found.summary
    assert "Not analysed: plane 3" in found.summary
    one = Analysis(plane=analysis.plane, estimation=MapSettings()).run(JobCache())
    assert [each.name for each in add_results(viewer, one)] == [
        "sweep blur (px) 2",
        "sweep confidence 2",
    ]
    np.testing.assert_array_equal(np.asarray(blur_map.data), values)


def test_cancelled_stack_leaves_nothing(viewer, method, monkeypatch, tmp_path):
    monkeypatch.setattr(stack_analysis, "MOST_IN_MEMORY", 10_000)
    layer = viewer.add_image(np.ones((4, 32, 48), np.float32))

    def stop(step, done):
        if done > 0.4:
            raise Cancelled

    analysis = StackAnalysis(
        plane=shown_plane(layer, viewer.dims), estimation=MapSettings(), place=Place(tmp_path)
    )
    with pytest.raises(Cancelled):
        analysis.run(JobCache(), stop)
    assert not list(tmp_path.iterdir())


def test_results_without_room_are_refused_before_any_work(viewer, monkeypatch, tmp_path):
    layer = viewer.add_image(da.zeros((500, 400), chunks=500, dtype=np.uint8))
    monkeypatch.setattr(result_stores.shutil, "disk_usage", lambda _: SimpleNamespace(free=1e6))
    with pytest.raises(NotAnalysableError, match=r"has 0.0 GB left\. Choose another"):
        wanted(layer, viewer, place=Place(tmp_path))
    with pytest.raises(NotAnalysableError, match=r"there is no folder .*nowhere"):
        wanted(layer, viewer, place=Place(tmp_path / "nowhere"))


def test_time_left_is_told_in_words():
    seen, now = [], iter([0.0, 1.0, 60.0, 600.0])
    report = with_time_left(lambda *told: seen.append(told), lambda: next(now))
    report("Measuring", 0.01)
    report("Measuring", 0.1)
    report("Measuring", 0.95)
    assert seen == [
        ("Measuring", 0.01),
        ("Measuring, 9 min left", 0.1),
        ("Measuring, 32 s left", 0.95),
    ]


@pytest.fixture
def large(viewer, quick):
    """Results of a picture, whose map is kept on the disk."""
    layer = viewer.add_image(np.zeros((600, 700), np.uint8), name="slide", scale=(0.5, 0.5))
    found = wanted(layer, viewer).run(JobCache())
    return layer, *add_results(viewer, found.layers)


def test_text_under_the_cursor_reads_no_more_than_a_chunk(viewer, large):
    viewer.cursor.position = (100, 200)
    viewer.layers.selection = {large[1]}
    text_under_cursor(viewer)
    read = []
    with Callback(posttask=lambda key, values, *_: read.append(np.size(values))):
        assert text_under_cursor(viewer) == "1.0 px, confidence 1.00, in focus"
    assert read
    assert max(read) <= 256**2


def test_veil_follows_the_confidence_without_reading_it(viewer, large):
    _, _, confidence, _ = large
    for least, share in ((0.5, 0), (1.5, 1)):
        cover = not_trusted_layer(confidence.as_layer_data_tuple(), least)
        [veil] = add_results(viewer, [cover])
        assert isinstance(veil.data[0], da.Array)
        assert np.asarray(veil.data[0]).mean() == share
    assert STORE not in veil.metadata[METADATA_KEY]


def test_probe_says_that_nothing_was_kept(viewer, large):
    with pytest.raises(NothingKnownError, match="measured part by part"):
        probed(viewer, large[0], (10, 10), JobCache())


def test_table_of_regions_is_measured_or_refused_in_words(viewer, large, monkeypatch, messages):
    regions = add_regions(viewer, large[0])
    assert regions.data.shape == (600, 700)
    assert regions.features["area_px"].iloc[1] == 600 * 700
    monkeypatch.setattr(layers, "MAX_PIXELS", 100_000)
    assert add_regions(viewer, large[0]) is None
    assert "Choose a region" in messages()[-1]


def test_map_of_a_region_serves_what_is_made_of_the_picture(viewer, large, monkeypatch):
    layer, blur_map, *_ = large
    monkeypatch.setattr(layers, "MAX_PIXELS", 10_000)
    part = shown_plane(layer, viewer.dims).part(slice(20, 90), slice(40, 120), region="shapes")
    source = source_of_layer(blur_map, part, viewer, "disc")
    assert source.plane.shape == (70, 80)
    assert source.confidence.shape == (70, 80)
    np.testing.assert_array_equal(source.plane.values(), 1)
    whole = source_of_layer(blur_map, shown_plane(layer, viewer.dims), viewer, "disc")
    with pytest.raises(NotAnalysableError, match="Choose a region"):
        whole.plane.values()


def test_saving_copies_the_store(viewer, large, tmp_path):
    _, blur_map, _, mask = large
    saved = save_map(blur_map, tmp_path / "mine")
    assert saved.name == "mine.ome.zarr"
    np.testing.assert_array_equal(np.asarray(read_ome_zarr(saved).levels[0]), 1)
    with pytest.raises(OSError, match="exists already"):
        save_map(blur_map, saved)
    assert save_map(blur_map, saved, force=True) == saved
    with pytest.raises(NotAMapError, match=r"too large for \.tif.*Save it as map\.ome\.zarr"):
        save_map(blur_map, tmp_path / "map.tif")
    assert write_store(str(tmp_path / "mask.zarr"), [mask.as_layer_data_tuple()])
    with pytest.raises(NotAMapError, match="no large result"):
        write_store(str(tmp_path / "no.zarr"), [large[0].as_layer_data_tuple()])
    assert stores_in(tmp_path) == ["mask.zarr", "mine.ome.zarr"]


def test_work_can_be_sent_to_another_process_whatever_reads_the_picture(viewer, picture):
    lazy = da.from_array(picture, chunks=100).map_blocks(lambda block: block)
    layer = viewer.add_image(lazy)
    arrived = pickle.loads(pickle.dumps(wanted(layer, viewer)._work(), protocol=5))
    np.testing.assert_array_equal(arrived.image.array.compute(), picture)
    assert arrived.mask == MaskSettings()


def test_layer_of_results_can_be_analysed_itself_elsewhere(viewer, large):
    level = large[1].data[0]
    arrived = pickle.loads(pickle.dumps(Carried(level), protocol=5)).array
    np.testing.assert_array_equal(np.asarray(arrived[:5, :5]), 1)
    del arrived
    gc.collect()
    np.testing.assert_array_equal(np.asarray(level[:5, :5]), 1)


@pytest.mark.display
def test_form_asks_where_to_keep_only_what_is_large(
    viewer, opened, finish, quick, tmp_path, monkeypatch
):
    monkeypatch.setattr(large_analysis, "LARGEST_IN_MEMORY", 100_000)
    monkeypatch.setattr(stack_analysis, "MOST_IN_MEMORY", 100_000)
    viewer.add_image(np.zeros((20, 30, 40), np.uint8), name="stack")
    viewer.add_image(np.zeros((600, 700), np.uint8), name="slide", scale=(2, 3))
    widget = opened(DefocusWidget)
    widget.show()
    assert widget.keep_in.visible
    widget.image.value = viewer.layers["stack"]
    assert not widget.keep_in.visible
    widget.planes.value = "all"
    assert widget.keep_in.visible
    widget.planes.value = "shown"
    widget.image.value = viewer.layers["slide"]
    finish(widget)
    assert "gone when napari is closed" in widget.status.value
    assert viewer.layers["slide blur (px)"].multiscale
    assert viewer.layers.selection.active.name == "slide blur (px)"
    assert viewer.layers["slide not trusted"].multiscale
    widget.keep_in.value = tmp_path
    finish(widget)
    assert f"Kept in {tmp_path}" in widget.status.value
    assert len(stores_in(tmp_path)) == 3
    assert [layer.name for layer in viewer.layers][2:] == [
        "slide blur (px)",
        "slide confidence",
        "slide in focus",
        "slide not trusted",
    ]
    before = widget.status.value
    widget.settings.threshold.value = 3
    assert widget.status.value != before  # it does not follow by itself, and says so
    widget.keep_in.value = tmp_path / "nowhere"
    assert widget.run() is None


@pytest.mark.display
def test_in_memory_and_large_results_take_each_others_place(
    viewer, opened, finish, quick, texture, monkeypatch
):
    layer = viewer.add_image(texture, name="slide")
    widget = opened(DefocusWidget)
    finish(widget)
    assert not viewer.layers["slide blur (px)"].multiscale
    monkeypatch.setattr(large_analysis, "LARGEST_IN_MEMORY", 1000)
    finish(widget)
    assert isinstance(viewer.layers["slide blur (px)"].data, da.Array)
    monkeypatch.undo()
    assert layer in viewer.layers
    assert len(viewer.layers) == 5


@pytest.mark.display
def test_map_that_is_kept_is_used_and_not_measured_again(
    viewer, opened, finish, quick, method, qtbot, monkeypatch
):
    monkeypatch.setattr(large_analysis, "LARGEST_IN_MEMORY", 100_000)
    viewer.add_image(np.zeros((400, 500), np.uint8), name="slide")
    widget = opened(DefocusWidget)
    finish(widget)
    blur_map = viewer.layers["slide blur (px)"].data
    with qtbot.waitSignal(widget.restore().finished):
        pass
    assert "slide all in focus" in viewer.layers
    np.testing.assert_array_equal(method.restorations[0]["blur_map"], 1)
    assert not method.estimations
    assert viewer.layers["slide blur (px)"].data is blur_map


class Counted:
    """An array that notes what is read of it: of numpy, but for that."""

    def __init__(self, values):
        self.values, self.shape, self.dtype, self.ndim = values, values.shape, values.dtype, 3
        self.read = []

    def __getitem__(self, key):
        self.read.append(key)
        return self.values[key]


@pytest.mark.parametrize("kind", ["dask", "zarr", "multiscale"])
def test_lazy_layers_are_read_at_the_plane_and_the_part_that_are_analysed(viewer, method, kind):
    values = np.random.default_rng(0).integers(0, 255, (5, 64, 96), np.uint8)
    counted = Counted(values)
    lazy = da.from_array(counted, chunks=(1, 32, 48), meta=np.empty((0,) * 3, np.uint8))
    smaller = da.zeros((5, 32, 48), dtype=np.uint8)
    if kind == "zarr":
        lazy = zarr.array(values, chunks=(1, 32, 48))
    data = [lazy, smaller] if kind == "multiscale" else lazy
    layer = viewer.add_image(data, multiscale=kind == "multiscale", contrast_limits=(0, 255))
    viewer.dims.set_current_step(0, 3)
    plane = shown_plane(layer, viewer.dims)
    counted.read.clear()
    Analysis(plane=plane.part(slice(0, 30), slice(50, 90)), estimation=SETTINGS).run(JobCache())
    np.testing.assert_array_equal(method.estimations[0]["image"], values[3, :30, 50:90])
    if kind != "zarr":
        assert len(counted.read) == 1
    found = StackAnalysis(plane=plane, estimation=SETTINGS).run(JobCache())
    assert found.layers[0][0].shape == (5, 64, 96)
    np.testing.assert_array_equal(method.estimations[-1]["image"], values[4])
    assert len(counted.read) in (0, 1 + 5 * 4)


def test_large_lazy_picture_is_not_read_before_it_is_measured(viewer, monkeypatch):
    monkeypatch.setattr(large_analysis, "LARGEST_IN_MEMORY", 1000)
    counted = Counted(np.zeros((2, 64, 96), np.uint8))
    lazy = da.from_array(counted, chunks=(1, 32, 48), meta=np.empty((0,) * 3, np.uint8))
    layer = viewer.add_image([lazy, lazy[:, ::2, ::2]], contrast_limits=(0, 255))
    counted.read.clear()
    plane = shown_plane(layer, viewer.dims)
    assert is_large(plane)
    wanted(layer, viewer)._work()
    assert not counted.read
