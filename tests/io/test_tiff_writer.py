"""Stacks and large maps as TIFF: tiled, with smaller levels, in little memory, whole or not."""

import tracemalloc

import dask.array as da
import numpy as np
import pytest
import tifffile

from napari_defocus.core.writing import UnwritableResult
from napari_defocus.io.encoders import description_in_tiff, values_in_tiff
from napari_defocus.io.multiscale import halved
from napari_defocus.io.open import open_source
from napari_defocus.io.pictures import read_picture
from napari_defocus.io.tiff_writer import made_by, write_pyramidal_tiff

ABOUT = {"quantity": "defocus blur radius", "unit": "px", "settings": {"window": 41}}


@pytest.fixture
def rng():
    return np.random.default_rng(4)


def written(path, data, axes, description=ABOUT, **more):
    return write_pyramidal_tiff(path, data, axes=axes, description=description, **more)


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_map_keeps_its_values_and_says_what_made_it(tmp_path, rng):
    blur = rng.uniform(0, 8, (1100, 700)).astype(np.float32)
    blur[:9] = np.nan
    path = written(tmp_path / "map.tif", blur, "yx")
    np.testing.assert_array_equal(read_picture(path), blur)
    np.testing.assert_array_equal(values_in_tiff(path), blur)
    assert ABOUT.items() <= description_in_tiff(path).items()
    assert made_by(path) == description_in_tiff(path)
    assert names_in(tmp_path) == ["map.tif"]


def test_levels_are_halves_of_each_other(tmp_path, rng):
    blur = rng.uniform(0, 8, (1100, 700)).astype(np.float32)
    with tifffile.TiffFile(written(tmp_path / "map.tif", blur, "yx")) as tiff:
        levels = [level.asarray() for level in tiff.series[0].levels]
        assert all(level.keyframe.is_tiled for level in tiff.series[0].levels)
    assert [level.shape for level in levels] == [(1100, 700), (550, 350), (275, 175)]
    np.testing.assert_array_equal(levels[1], halved(blur))
    np.testing.assert_array_equal(levels[2], halved(levels[1]))


@pytest.mark.parametrize("axes", ["zyx", "tzyx", "tzyxs", "ctyx", "yxs", "qyx"])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_stack_is_read_again_with_scale_and_units(tmp_path, rng, axes, dtype, caplog):
    shape = tuple({"y": 60, "x": 700, "s": 3, "z": 3}.get(a, 2) for a in axes)
    values = rng.integers(0, 250, shape).astype(dtype)
    known = {"z": (1.5, "micrometer"), "t": (3.0, "second"), "y": (0.5, "micrometer")}
    known["x"] = (250.0, "nanometer")
    scale = {a: known[a][0] for a in axes if a in known}
    units = {a: known[a][1] for a in axes if a in known}
    path = written(tmp_path / "s.ome.tif", values, axes, pixel_size=scale, units=units)
    source = open_source(path)
    assert caplog.text == "", "nothing that tifffile complains about"
    np.testing.assert_array_equal(source.data, values)
    assert made_by(path)["axes"] == axes.upper()
    assert ABOUT.items() <= made_by(path).items()
    if set(axes) & set("tcz"):
        assert (source.axes, source.pixel_size, source.units) == (axes, scale, units)
    else:
        assert source.axes == axes
        assert source.pixel_size == pytest.approx({"y": 0.5, "x": 0.25})


def test_masks_keep_what_is_thin(tmp_path):
    mask = np.zeros((600, 40), bool)
    mask[100] = True
    with tifffile.TiffFile(written(tmp_path / "m.tif", mask, "yx")) as tiff:
        levels = [level.asarray() for level in tiff.series[0].levels]
    assert levels[0].dtype == np.uint8
    np.testing.assert_array_equal(levels[0], mask)
    assert levels[1][50].all()


@pytest.mark.parametrize("rows", [100, 512, 700, (1, 1000, 99)])
def test_each_block_is_computed_once(tmp_path, rng, rows):
    blur = rng.uniform(0, 8, (2, 1100, 600)).astype(np.float32)
    computed = []

    def counted(block, block_info=None):
        computed.append(block_info[0]["chunk-location"])
        return block

    lazy = da.from_array(blur, chunks=(1, rows, 300)).map_blocks(counted, dtype=np.float32)
    computed.clear()
    path = written(tmp_path / "s.ome.tif", lazy, "zyx")
    assert len(computed) == len(set(computed)) == lazy.npartitions
    np.testing.assert_array_equal(tifffile.imread(path), blur)


def test_large_map_is_written_in_little_memory(tmp_path):
    row = np.tile(np.float32([[1, 3], [5, 7]]), (256, 512))
    data = da.tile(da.from_array(row, chunks=512), (16, 1))
    written(tmp_path / "first.tif", row, "yx")
    tracemalloc.start()
    path = written(tmp_path / "map.tif", data, "yx")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < data.nbytes / 2
    with tifffile.TiffFile(path) as tiff:
        assert (tiff.series[0].levels[2].asarray() == 4).all()


def test_same_values_are_the_same_bytes(tmp_path, rng):
    blur = rng.uniform(0, 8, (3, 600, 700)).astype(np.float32)
    files = [written(tmp_path / name, blur, "qyx") for name in ("a.tif", "b.tif")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_interrupted_writing_leaves_everything_as_it_was(tmp_path):
    (tmp_path / "map.tif").write_bytes(b"old")

    def fail(block):
        raise KeyboardInterrupt

    lazy = da.zeros((2048, 600), chunks=512).map_blocks(fail, dtype=float, meta=np.empty((0, 0)))
    with pytest.raises(KeyboardInterrupt):
        written(tmp_path / "map.tif", lazy, "yx", force=True)
    assert (tmp_path / "map.tif").read_bytes() == b"old"
    assert names_in(tmp_path) == ["map.tif"]


def test_existing_file_is_kept_unless_forced(tmp_path):
    (tmp_path / "map.tif").write_bytes(b"old")
    with pytest.raises(UnwritableResult, match="exists already"):
        written(tmp_path / "map.tif", np.ones((9, 9)), "yx")
    written(tmp_path / "map.tif", np.ones((9, 9)), "yx", force=True)
    assert (read_picture(tmp_path / "map.tif") == 1).all()


@pytest.mark.parametrize(
    ("shape", "axes", "complaint"),
    [
        ((9, 9), "xy", "axes is 'xy'"),
        ((3, 9, 9), "syx", "axes is 'syx'"),
        ((9, 9), "zyx", "take 3 sizes"),
        ((9, 9, 2), "yxs", "data have 2 colours"),
    ],
)
def test_bad_arguments_are_named(tmp_path, shape, axes, complaint):
    with pytest.raises(ValueError, match=complaint):
        written(tmp_path / "map.tif", np.ones(shape), axes)
    with pytest.raises(TypeError, match="data are complex64"):
        written(tmp_path / "map.tif", np.ones((9, 9), np.complex64), "yx")
    with pytest.raises(TypeError, match="description takes what JSON can hold"):
        written(tmp_path / "map.tif", np.ones((9, 9)), "yx", {"made": object()})
    assert names_in(tmp_path) == []


def test_other_tiffs_say_nothing_of_themselves(tmp_path, rng):
    tifffile.imwrite(tmp_path / "o.ome.tif", np.ones((2, 9, 9), np.uint8), ome=True)
    (tmp_path / "text.tif").write_text("no picture")
    assert [made_by(tmp_path / name) for name in ("o.ome.tif", "text.tif", "none")] == [{}] * 3
