"""OME-Zarr is written region by region, whole or not at all, and says what it is."""

import shutil
import tracemalloc
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import zarr
from ome_zarr_models.v05.image import Image

from napari_defocus.core.writing import UnwritableResult
from napari_defocus.io.ome_zarr import read_ome_zarr
from napari_defocus.io.ome_zarr_writer import new_ome_zarr

MICRONS = {"y": "micrometer", "x": "micrometer"}


@pytest.fixture
def blur():
    values = np.random.default_rng(2).uniform(0, 8, (1100, 700)).astype(np.float32)
    values[:300, :300] = np.nan
    return values


def begun(path, shape=(1100, 700), dtype="float32", axes="yx", attributes=None, **more):
    about = {"quantity": "defocus blur"} if attributes is None else attributes
    return new_ome_zarr(path, shape=shape, dtype=dtype, axes=axes, attributes=about, **more)


def everything(writer):
    return tuple(slice(0, size) for size in writer.shape)


def finished(path, values, axes="yx", **more):
    writer = begun(path, values.shape, values.dtype, axes, **more)
    writer.write_region(everything(writer), values)
    return writer.finish()


def files_in(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


# --- what is written ------------------------------------------------------------------------


def test_store_holds_the_values_and_says_what_they_are(tmp_path, blur):
    about = {"quantity": "defocus blur", "unit": "px", "settings": {"window": 41}}
    path = finished(
        tmp_path / "a.ome.zarr",
        blur,
        pixel_size={"y": 0.25, "x": 0.5},
        units=MICRONS,
        attributes=about,
    )
    Image.from_zarr(zarr.open_group(path, mode="r"))
    picture = read_ome_zarr(path)
    np.testing.assert_array_equal(picture.levels[0], blur)
    assert (picture.axes, picture.units) == ("yx", MICRONS)
    assert picture.pixel_size == {"y": 0.25, "x": 0.5}
    assert picture.attributes == about
    assert names_in(tmp_path) == ["a.ome.zarr"]


def test_pyramid_lies_on_the_picture(tmp_path, blur):
    path = finished(tmp_path / "a.zarr", blur, pixel_size={"y": 0.25, "x": 0.5})
    levels = read_ome_zarr(path).levels
    assert [level.shape for level in levels] == [(1100, 700), (550, 350), (275, 175)]
    coarse = levels[1].compute()
    assert np.isnan(coarse[:150, :150]).all()
    assert not np.isnan(coarse[150:]).any()
    quarter = blur[400:402, 500:502].mean()
    np.testing.assert_allclose(coarse[200, 250], quarter, rtol=1e-6)
    datasets = zarr.open_group(path, mode="r").attrs["ome"]["multiscales"][0]["datasets"]
    scale, shift = datasets[2]["coordinateTransformations"]
    assert scale["scale"] == [1.0, 2.0]
    assert shift["translation"] == [0.375, 0.75], "middles of pixels, not their corners"


@pytest.mark.parametrize("axes", ["zyxs", "ztyx", "ytx", "tqzyx"])
def test_axes_are_stored_as_ome_zarr_orders_them(tmp_path, axes):
    sizes = {"t": 2, "z": 3, "q": 2, "y": 40, "x": 30, "s": 3}
    shape = tuple(sizes[a] for a in axes)
    values = np.random.default_rng(0).integers(0, 255, shape, dtype=np.uint8)
    path = finished(
        tmp_path / "a.zarr", values, axes, pixel_size=dict.fromkeys(set(axes) - {"s"}, 2.0)
    )
    Image.from_zarr(zarr.open_group(path, mode="r"))
    picture = read_ome_zarr(path)
    order = [axes.index(letter.replace("c", "s")) for letter in picture.axes]
    np.testing.assert_array_equal(picture.levels[0], values.transpose(order))
    assert picture.channel_colors == (("FF0000", "00FF00", "0000FF") if "s" in axes else ())


def test_masks_are_told_from_pictures(tmp_path):
    mask = np.zeros((600, 40), np.uint8)
    mask[100] = 1
    path = finished(tmp_path / "m.zarr", mask, labels=True)
    assert "image-label" in zarr.open_group(path, mode="r").attrs["ome"]
    assert read_ome_zarr(path).levels[1][50].compute().all()


def test_same_values_are_the_same_bytes(tmp_path, blur):
    one, other = (finished(tmp_path / name / "a.zarr", blur) for name in made(tmp_path, "p", "q"))
    assert files_in(one) == files_in(other)


def made(folder, *names):
    for name in names:
        (folder / name).mkdir()
    return names


def test_pyramid_of_a_large_map_is_made_in_little_memory(tmp_path):
    writer = begun(tmp_path / "a.zarr", (4096, 1024), tile=128)
    tile_row = np.tile(np.float32([[1, 3], [5, 7]]), (64, 512))
    for row in range(0, 4096, 128):
        writer.write_region((slice(row, row + 128), slice(0, 1024)), tile_row)
    tracemalloc.start()
    writer.finish()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * tile_row.nbytes, "of 32 such rows"
    assert (read_ome_zarr(tmp_path / "a.zarr").levels[1][-1].compute() == 4).all()


# --- regions --------------------------------------------------------------------------------


def write_rows(writer, start, stop, values):
    writer.write_region((slice(start, stop), slice(0, 700)), values)


def test_other_processes_write_their_regions(tmp_path, blur):
    writer = begun(tmp_path / "a.zarr")
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        bounds = [(0, 512), (512, 1024), (1024, 1100)]
        tasks = [pool.submit(write_rows, writer, a, b, blur[a:b]) for a, b in bounds]
        assert [task.result() for task in tasks] == [None] * 3
    np.testing.assert_array_equal(read_ome_zarr(writer.finish()).levels[0], blur)


def test_dask_stores_into_it(tmp_path, blur):
    import dask.array as da

    writer = begun(tmp_path / "a.zarr")
    da.store(da.from_array(blur, chunks=512), writer, lock=False)
    np.testing.assert_array_equal(read_ome_zarr(writer.finish()).levels[0], blur)


def test_planes_are_written_by_number(tmp_path, blur):
    writer = begun(tmp_path / "a.zarr", (2, 1100, 700), axes="zyx")
    for plane in range(2):
        writer.write_region((plane, slice(0, 1100), slice(0, 700)), blur + plane)
    np.testing.assert_array_equal(read_ome_zarr(writer.finish()).levels[0][1], blur + 1)


def test_region_that_ends_with_dots_has_all_of_the_other_axes(tmp_path, blur):
    colors = np.stack([blur, blur + 1, blur + 2], axis=-1)
    writer = begun(tmp_path / "a.zarr", (2, 1100, 700, 3), axes="zyxs")
    for plane in range(2):
        assert not writer.has_region((plane, ...))
        writer.write_region((plane, slice(0, 512), ...), colors[:512])
        writer.write_region((plane, slice(512, 1100), slice(0, 512), ...), colors[512:, :512])
    left = writer.missing()
    assert [tuple(part.start for part in tile) for tile in left] == [
        (plane, row, 512, color) for plane in range(2) for row in (512, 1024) for color in range(3)
    ]
    for tile in left:
        plane, *inside = tile
        writer.write_region(tile, colors[tuple(inside)][None])
    assert writer.has_region((...,))
    stored = read_ome_zarr(writer.finish()).levels[0]
    np.testing.assert_array_equal(stored, np.moveaxis([colors] * 2, -1, 0))


@pytest.mark.parametrize(
    ("region", "shape", "complaint"),
    [
        (np.s_[0:100, 0:512], (100, 512), "whole tiles of 512"),
        (np.s_[512:1024, 0:512], (512, 500), r"values have the shape \(512, 500\)"),
        (np.s_[0:512], (512,), "region has 1 axes; the store has 2"),
        (np.s_[0:512, 0:700, 0:3, ...], (512, 700, 3), "region has 3 axes; the store has 2"),
        (np.s_[2048:2560, 0:512], (512, 512), "takes a part of 0 to 1100"),
    ],
)
def test_wrong_regions_are_refused(tmp_path, region, shape, complaint):
    region = region if isinstance(region, tuple) else (region,)
    with pytest.raises(ValueError, match=complaint):
        begun(tmp_path / "a.zarr").write_region(region, np.zeros(shape))


# --- whole or not at all --------------------------------------------------------------------


def test_unfinished_store_is_no_picture_and_has_no_name(tmp_path, blur):
    writer = begun(tmp_path / "a.zarr")
    write_rows(writer, 0, 512, blur[:512])
    assert names_in(tmp_path) == [".a.zarr.part"]
    with pytest.raises(ValueError, match="4 of 6 tiles"):
        writer.finish()
    assert names_in(tmp_path) == [".a.zarr.part"]


def test_interrupted_store_goes_on_where_it_was(tmp_path, blur):
    first = np.s_[0:512, 0:700]
    begun(tmp_path / "a.zarr").write_region(first, np.zeros((512, 700)))
    writer = begun(tmp_path / "a.zarr", resume=True)
    assert writer.has_region(first)
    assert not writer.has_region(everything(writer))
    write_rows(writer, 512, 1100, blur[512:])
    assert (read_ome_zarr(writer.finish()).levels[0][:512].compute() == 0).all()


@pytest.mark.parametrize(
    "other",
    [
        {"attributes": {"quantity": "another"}},
        {"shape": (1101, 700)},
        {"dtype": "float64"},
        {"tile": 256},
        {"resume": False},
    ],
)
def test_interrupted_store_of_something_else_is_thrown_away(tmp_path, other):
    first = np.s_[0:512, 0:700]
    begun(tmp_path / "a.zarr").write_region(first, np.zeros((512, 700)))
    assert not begun(tmp_path / "a.zarr", **{"resume": True, **other}).has_region(first)


def test_damaged_part_is_thrown_away(tmp_path):
    begun(tmp_path / "a.zarr")
    (tmp_path / ".a.zarr.part" / "0" / "zarr.json").write_text("{")
    assert not begun(tmp_path / "a.zarr", resume=True).has_region(np.s_[0:512, 0:512])


def test_killed_while_the_pyramid_is_made_the_run_finishes_later(tmp_path, blur, monkeypatch):
    writer = begun(tmp_path / "a.zarr")
    writer.write_region(everything(writer), blur)
    killed_at(monkeypatch, "napari_defocus.io.ome_zarr_writer._say_what_it_is", 1)
    with pytest.raises(KeyboardInterrupt):
        writer.finish()
    monkeypatch.undo()
    (writer.part / "0" / "c" / "0" / "0.1234.partial").write_bytes(b"half a chunk")
    resumed = begun(tmp_path / "a.zarr", resume=True)
    assert resumed.has_region(everything(resumed))
    finished(tmp_path / "b.zarr", blur)
    assert files_in(resumed.finish()).keys() == files_in(tmp_path / "b.zarr").keys()


def killed_at(monkeypatch, name, call):
    """Let the n-th call of a function be where the run is killed."""
    module, _, function = name.rpartition(".")
    where = Path if module == "Path" else __import__(module, fromlist=["_"])
    original, calls = getattr(where, function), iter(range(1, 99))

    def kill(*args, **kwargs):
        if next(calls) == call:
            raise KeyboardInterrupt
        return original(*args, **kwargs)

    monkeypatch.setattr(where, function, kill)


def test_existing_store_is_kept_unless_forced(tmp_path, blur):
    finished(tmp_path / "a.zarr", blur)
    with pytest.raises(UnwritableResult, match="exists already"):
        begun(tmp_path / "a.zarr")
    finished(tmp_path / "a.zarr", blur + 1, force=True)
    np.testing.assert_array_equal(read_ome_zarr(tmp_path / "a.zarr").levels[0], blur + 1)
    assert names_in(tmp_path) == ["a.zarr"]


@pytest.mark.parametrize("call", [1, 2])
def test_killed_between_renames_the_old_store_comes_back(tmp_path, blur, monkeypatch, call):
    finished(tmp_path / "a.zarr", blur)
    killed_at(monkeypatch, "Path.rename", call)
    with pytest.raises(KeyboardInterrupt):
        finished(tmp_path / "a.zarr", blur + 1, force=True)
    monkeypatch.undo()
    begun(tmp_path / "a.zarr", resume=True, force=True)
    np.testing.assert_array_equal(read_ome_zarr(tmp_path / "a.zarr").levels[0], blur)
    assert ".a.zarr.old" not in names_in(tmp_path)


def test_killed_while_the_old_store_is_removed_the_new_one_stays(tmp_path, blur):
    finished(tmp_path / "a.zarr", blur)
    shutil.copytree(tmp_path / "a.zarr" / "1", tmp_path / ".a.zarr.old" / "1")
    with pytest.raises(UnwritableResult, match="exists already"):
        begun(tmp_path / "a.zarr")
    assert names_in(tmp_path) == ["a.zarr"]
    np.testing.assert_array_equal(read_ome_zarr(tmp_path / "a.zarr").levels[0], blur)


def test_folder_of_something_else_is_never_replaced(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_bytes(b"mine")
    with pytest.raises(UnwritableResult, match="not a Zarr store"):
        begun(tmp_path / "photos", force=True)
    with pytest.raises(UnwritableResult, match="there is no folder"):
        begun(tmp_path / "none" / "a.zarr")


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"axes": "yy"}, "axes is 'yy'"),
        ({"axes": "zy"}, "y and x among them"),
        ({"axes": "zyx"}, "shape is"),
        ({"axes": "cyxs", "shape": (2, 9, 9, 3)}, "not both"),
        ({"axes": "qpyx", "shape": (2, 2, 9, 9)}, "one at most besides"),
        ({"shape": (0, 9)}, "sizes above 0"),
        ({"tile": 1}, "tile is 1; it takes 16"),
        ({"pixel_size": {"z": 1.0}}, "pixel_size has the axes z; axes is 'yx'"),
        ({"dtype": "complex64"}, "dtype is complex64"),
        ({"attributes": {"a": object()}}, "attributes takes what JSON can hold"),
    ],
)
def test_bad_arguments_are_named_before_anything_is_written(tmp_path, change, complaint):
    with pytest.raises((ValueError, TypeError), match=complaint):
        begun(tmp_path / "a.zarr", **change)
    assert names_in(tmp_path) == []
