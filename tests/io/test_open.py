"""Photographs, stacks and slides are opened without reading them, and read only where asked."""

import pickle
import subprocess
import sys

import dask.array as da
import imagecodecs
import numpy as np
import pytest
import tifffile
import zarr
from PIL import Image

from napari_defocus.io.ome_zarr_writer import new_ome_zarr
from napari_defocus.io.open import find_sources, open_source, open_stack
from napari_defocus.io.pictures import UnreadablePicture, read_picture

MICRON, SECOND = "micrometer", "second"


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def words_of(rng, *shape):
    return rng.integers(0, 65536, shape, dtype=np.uint16)


def bytes_of(rng, *shape):
    return rng.integers(0, 256, shape, dtype=np.uint8)


def read(source):
    return source.data.compute(scheduler="synchronous")


# --- photographs ----------------------------------------------------------------------------


def photographs(rng, folder):
    """Write a photograph of every kind; their names."""
    color = Image.fromarray(bytes_of(rng, 24, 20, 3))
    palette = color.quantize(16)
    turned = Image.Exif()
    turned[274] = 6
    color.save(folder / "color.jpg", exif=turned)
    color.save(folder / "cmyk.webp")
    color.convert("CMYK").save(folder / "cmyk.jpg")
    color.convert("L").save(folder / "grey.bmp")
    color.convert("1").save(folder / "bits.png")
    color.convert("LA").save(folder / "opacity.png")
    palette.save(folder / "palette.png")
    palette.save(folder / "clear.png", transparency=3)
    (folder / "deep.png").write_bytes(imagecodecs.png_encode(words_of(rng, 24, 20, 3)))
    Image.fromarray(words_of(rng, 24, 20)).save(folder / "deep-grey.png")
    return sorted(path.name for path in folder.iterdir())


def test_photographs_are_what_read_picture_gives(tmp_path, rng):
    names = photographs(rng, tmp_path)
    assert len(names) == 10
    for name in names:
        source, picture = open_source(tmp_path / name), read_picture(tmp_path / name)
        assert (source.data.shape, source.data.dtype) == (picture.shape, picture.dtype), name
        np.testing.assert_array_equal(read(source), picture, err_msg=name)
        assert source.axes == "yxs"[: picture.ndim]
        assert list(source.planes()) == [()]
        assert (source.plane_axes, source.plane_shape, source.label_of(())) == ("", (), "")


def test_photograph_is_decoded_when_it_is_computed(tmp_path, rng):
    Image.fromarray(bytes_of(rng, 90, 80)).save(tmp_path / "p.jpg")
    content = (tmp_path / "p.jpg").read_bytes()
    (tmp_path / "p.jpg").write_bytes(content[:1000])
    source = open_source(tmp_path / "p.jpg")
    assert source.data.shape == (90, 80)
    with pytest.raises(UnreadablePicture, match=r"p\.jpg"):
        read(source)


# --- TIFF -----------------------------------------------------------------------------------


TIFFS = {
    "plain": {},
    "deflated": {"compression": "zlib", "predictor": True},
    "strips": {"rowsperstrip": 7, "compression": "zlib"},
    "tiled": {"tile": (32, 48)},
    "tiled and packed": {"tile": (16, 16), "compression": "lzw"},
    "big-endian": {"byteorder": ">"},
}


@pytest.mark.parametrize("kind", TIFFS)
@pytest.mark.parametrize("shape", [(70, 90), (70, 90, 3), (70, 90, 4)])
def test_single_tiff_is_what_read_picture_gives(tmp_path, rng, kind, shape):
    photometric = "rgb" if len(shape) == 3 else "minisblack"
    tifffile.imwrite(
        tmp_path / "p.tif", words_of(rng, *shape), photometric=photometric, **TIFFS[kind]
    )
    source, picture = open_source(tmp_path / "p.tif"), read_picture(tmp_path / "p.tif")
    np.testing.assert_array_equal(read(source), picture)
    assert (source.axes, source.data.dtype) == ("yxs"[: len(shape)], picture.dtype)
    region = np.s_[13:50, 40:77]
    np.testing.assert_array_equal(source.plane()[region], picture[region])


@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_colour_models_and_orientation_are_those_of_single_pictures(tmp_path, rng, orientation):
    turned = {"extratags": [(274, "H", 1, orientation, True)]}
    grey, color = bytes_of(rng, 40, 50), bytes_of(rng, 3, 40, 50)
    table = words_of(rng, 3, 256)
    for name, values, more in [
        ("white", grey, {"photometric": "miniswhite"}),
        ("palette", grey, {"photometric": "palette", "colormap": table}),
        ("planar", color, {"photometric": "rgb", "planarconfig": "separate", "tile": (16, 32)}),
        ("cmyk", bytes_of(rng, 40, 50, 4), {"photometric": "separated"}),
        ("bits", grey > 99, {}),
        ("opacity", bytes_of(rng, 40, 50, 2), {"photometric": "minisblack", "extrasamples": [2]}),
    ]:
        tifffile.imwrite(tmp_path / f"{name}.tif", values, **more, **turned)
        picture = read_picture(tmp_path / f"{name}.tif")
        np.testing.assert_array_equal(read(open_source(tmp_path / f"{name}.tif")), picture, name)


def stack_of(path, values, kind):
    if kind == "imagej":
        resolution, about = (4, 2), {"axes": "TZYX", "unit": "um", "spacing": 1.5, "finterval": 3}
        tifffile.imwrite(path, values, imagej=True, resolution=resolution, metadata=about)
    elif kind == "ome":
        about = {
            "axes": "TZYX",
            **{"PhysicalSizeX": 250, "PhysicalSizeXUnit": "nm", "PhysicalSizeY": 0.5},
            **{"PhysicalSizeZ": 1.5, "TimeIncrement": 3, "TimeIncrementUnit": "min"},
        }
        options = {"tile": (32, 32), "compression": "zlib"}
        tifffile.imwrite(path, values, ome=True, metadata=about, **options)
    else:
        with tifffile.TiffWriter(path) as tiff:
            for plane in values.reshape(-1, *values.shape[2:]):
                tiff.write(plane, metadata=None, compression="zlib", contiguous=False)


SCALES = {
    "imagej": (
        {"t": 3, "z": 1.5, "y": 0.5, "x": 0.25},
        {"t": SECOND, "z": MICRON, "y": MICRON, "x": MICRON},
    ),
    "ome": (
        {"t": 3, "z": 1.5, "y": 0.5, "x": 250},
        {"t": "minute", "z": MICRON, "y": MICRON, "x": "nanometer"},
    ),
    "pages": ({}, {}),
}


@pytest.mark.parametrize("kind", SCALES)
def test_stack_has_its_planes_scale_and_units(tmp_path, rng, kind):
    values = words_of(rng, 2, 3, 70, 90)
    path = tmp_path / ("s.ome.tif" if kind == "ome" else "s.tif")
    stack_of(path, values, kind)
    source = open_source(path)
    if kind == "pages":
        values = values.reshape(6, 70, 90)
    else:
        assert source.axes == "tzyx"
    assert (source.pixel_size, source.units) == SCALES[kind]
    assert source.plane_shape == values.shape[:-2]
    for index in source.planes():
        np.testing.assert_array_equal(source.plane(index), values[index])
    np.testing.assert_array_equal(read(source), values)


def test_planes_are_named_and_counted(tmp_path, rng):
    stack_of(tmp_path / "s.tif", words_of(rng, 2, 3, 30, 40), "imagej")
    source = open_source(tmp_path / "s.tif")
    assert [source.label_of(index) for index in source.planes()][3:5] == ["t=1 z=0", "t=1 z=1"]
    for wrong in [(2, 0), (0,), (0, -1)]:
        with pytest.raises(IndexError, match="t 0 to 1, z 0 to 2"):
            source.plane(wrong)


def test_stack_in_colour(tmp_path, rng):
    values = bytes_of(rng, 3, 40, 50, 3)
    tifffile.imwrite(tmp_path / "s.tif", values, imagej=True, metadata={"axes": "ZYXS"})
    source = open_source(tmp_path / "s.tif")
    assert source.axes == "zyxs"
    np.testing.assert_array_equal(source.plane((1,)), values[1])


def test_stack_in_several_files_is_one(tmp_path, rng):
    """An OME-TIFF says in which file each plane is."""
    values = words_of(rng, 3, 40, 50)
    names = ["a.ome.tif", "b.ome.tif", "c.ome.tif"]
    planes = "".join(
        f'<TiffData FirstZ="{z}" IFD="0" PlaneCount="1">'
        f'<UUID FileName="{name}">urn:uuid:{name}</UUID></TiffData>'
        for z, name in enumerate(names)
    )
    for name, plane in zip(names, values, strict=True):
        xml = (
            '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:'
            f'{name}"><Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" SizeX="50" '
            'SizeY="40" SizeZ="3" SizeC="1" SizeT="1" Type="uint16" PhysicalSizeX="0.5">'
            f"{planes}</Pixels></Image></OME>"
        )
        options = {"compression": "zlib", "metadata": None, "description": xml}
        tifffile.imwrite(tmp_path / name, plane, **options)
    source = open_source(tmp_path / "a.ome.tif")
    assert (source.axes, source.pixel_size) == ("zyx", {"x": 0.5})
    np.testing.assert_array_equal(read(source), values)
    (tmp_path / "b.ome.tif").unlink()
    np.testing.assert_array_equal(read(open_source(tmp_path / "a.ome.tif"))[1], 0)


def test_axes_of_unknown_meaning_have_letters_of_their_own(tmp_path, rng):
    tifffile.imwrite(tmp_path / "s.tif", bytes_of(rng, 2, 3, 20, 30), photometric="minisblack")
    axes = open_source(tmp_path / "s.tif").axes
    assert axes.endswith("yx")
    assert len(set(axes)) == 4


def test_lookup_table_of_imagej_is_no_colour(tmp_path, rng):
    values, table = bytes_of(rng, 3, 20, 30), words_of(rng, 3, 256)
    options = {"photometric": "palette", "colormap": table, "metadata": {"axes": "ZYX"}}
    tifffile.imwrite(tmp_path / "s.tif", values, imagej=True, **options)
    np.testing.assert_array_equal(read(open_source(tmp_path / "s.tif")), values)


def test_resolution_counts_in_centimetres_not_in_dots_an_inch(tmp_path, rng):
    for name, unit, scale in [("s", "CENTIMETER", {"y": 0.5, "x": 0.25}), ("p", "INCH", {})]:
        options = {"resolution": (40000, 20000), "resolutionunit": unit}
        tifffile.imwrite(tmp_path / name, bytes_of(rng, 20, 30), metadata=None, **options)
        source = open_source(tmp_path / name)
        assert source.pixel_size == pytest.approx(scale)
        assert source.units == dict.fromkeys(scale, MICRON)


def pyramid_of(path, values, *, subifds):
    with tifffile.TiffWriter(path) as tiff:
        options = {"tile": (64, 64), "photometric": "rgb", "compression": "jpeg", "metadata": None}
        tiff.write(values, subifds=2 if subifds else 0, **options)
        for step in (2, 4):
            tiff.write(values[::step, ::step], subfiletype=1, **options)


@pytest.mark.parametrize("subifds", [True, False])
def test_largest_level_of_a_pyramid_is_read(tmp_path, rng, subifds):
    smooth = np.repeat(np.repeat(bytes_of(rng, 20, 30, 3), 16, 0), 16, 1)
    pyramid_of(tmp_path / "s.tif", smooth, subifds=subifds)
    source = open_source(tmp_path / "s.tif")
    assert source.data.shape == smooth.shape
    np.testing.assert_array_equal(source.data, tifffile.imread(tmp_path / "s.tif", key=0))


def test_only_the_tiles_asked_for_are_read(tmp_path, rng, monkeypatch):
    monkeypatch.setattr("napari_defocus.io.lazy_arrays.LEAST_SIDE", 32)
    values = bytes_of(rng, 3, 128, 128)
    options = {"tile": (32, 32), "compression": "zlib", "metadata": {"axes": "ZYX"}}
    path = tmp_path / "s.ome.tif"
    tifffile.imwrite(path, values, ome=True, **options)
    with tifffile.TiffFile(path) as tiff:
        pages = [zip(page.dataoffsets, page.databytecounts, strict=True) for page in tiff.pages]
        tiles = [tile for page in pages for tile in page]
    content = bytearray(path.read_bytes())
    for number, (offset, length) in enumerate(tiles):
        if number not in (16 + 4, 16 + 5):
            content[offset : offset + length] = bytes(length)
    path.write_bytes(content)
    source = open_source(path)
    np.testing.assert_array_equal(source.plane((1,))[40:60, 20:50], values[1, 40:60, 20:50])
    with pytest.raises(UnreadablePicture, match=r"cannot read .*s\.ome\.tif"):
        source.plane((1,))[40:60, 20:70].compute()


def test_large_tiff_is_cut_into_blocks_of_whole_tiles(tmp_path):
    options = {"tile": (256, 256), "photometric": "minisblack"}
    tifffile.imwrite(tmp_path / "s.tif", shape=(3000, 2500), dtype=np.uint8, **options)
    assert open_source(tmp_path / "s.tif").data.chunks == ((1024, 1024, 952), (1024, 1024, 452))
    tifffile.imwrite(tmp_path / "t.tif", shape=(3000, 2500), dtype=np.uint8)
    assert open_source(tmp_path / "t.tif").data.numblocks == (3, 1)


def test_data_go_to_another_process(tmp_path, rng, monkeypatch):
    values = bytes_of(rng, 2, 2, 40, 50)
    stack_of(tmp_path / "s.tif", values, "imagej")
    stack_of(tmp_path / "s.ome.tif", values, "ome")
    zarr_of(tmp_path / "s.zarr", values, "tzyx")
    Image.fromarray(values[0, 0]).save(tmp_path / "s.png")
    monkeypatch.chdir(tmp_path)
    names = ["s.tif", "s.ome.tif", "s.zarr", "s.png"]
    (tmp_path / "data").write_bytes(pickle.dumps([open_source(name).data for name in names]))
    code = (
        "import pickle, sys\n"
        "for data in pickle.load(open(sys.argv[1], 'rb')):\n"
        "    print(data[..., 5:, :7].sum(dtype=int).compute(scheduler='synchronous'))"
    )
    told = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "data")],
        cwd=tmp_path.parent, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    expected = [values[..., 5:, :7].sum(dtype=int)] * 3 + [values[0, 0, 5:, :7].sum(dtype=int)]
    assert [int(line) for line in told.split()] == expected


# --- OME-Zarr -------------------------------------------------------------------------------


def zarr_of(path, values, axes, **more):
    form = {"shape": values.shape, "dtype": values.dtype, "axes": axes, "attributes": {}}
    writer = new_ome_zarr(path, **form, **more)
    writer.write_region(tuple(slice(0, size) for size in values.shape), values)
    return writer.finish()


def test_store_is_a_stack_with_scale_and_units(tmp_path, rng):
    values = words_of(rng, 2, 3, 40, 50)
    scale, units = {"z": 1.5, "y": 0.25, "x": 0.25}, dict.fromkeys("zyx", MICRON)
    source = open_source(
        zarr_of(tmp_path / "s.zarr", values, "czyx", pixel_size=scale, units=units)
    )
    assert (source.axes, source.plane_shape) == ("czyx", (2, 3))
    assert (source.pixel_size, source.units) == (scale, units)
    np.testing.assert_array_equal(source.plane((1, 2)), values[1, 2])


def test_channels_are_colours_only_if_the_store_says_so(tmp_path, rng):
    values = bytes_of(rng, 2, 40, 50, 3)
    path = zarr_of(tmp_path / "s.zarr", values, "zyxs")
    assert open_source(path).axes == "zyxs"
    np.testing.assert_array_equal(open_source(path).plane((1,)), values[1])
    group = zarr.open_group(path, mode="r+")
    about = group.attrs["ome"]
    about["omero"]["channels"][0]["color"] = "00FFFF"
    group.attrs["ome"] = about
    assert (open_source(path).axes, open_source(path).plane_shape) == ("czyx", (3, 2))
    del about["omero"]
    group.attrs["ome"] = about
    assert open_source(path).axes == "czyx"


# --- bad files ------------------------------------------------------------------------------


def refusal_of(path):
    with pytest.raises(UnreadablePicture) as refused:
        open_source(path)
    message = str(refused.value)
    assert message.startswith(f"cannot read {path}: ")
    assert "\n" not in message
    return message


def test_chain_of_pages_that_breaks_off_is_refused(tmp_path, rng):
    """Programs that describe a page after its pixels leave whole pages when they are cut off."""
    frames = [Image.fromarray(bytes_of(rng, 40, 50)) for _ in range(4)]
    path = tmp_path / "s.tif"
    frames[0].save(path, save_all=True, append_images=frames[1:])
    assert open_source(path).plane_shape == (4,)
    with tifffile.TiffFile(path) as tiff:
        third = tiff.pages[2].offset
    path.write_bytes(path.read_bytes()[:third])
    assert "cut off" in refusal_of(path)


@pytest.mark.parametrize("kind", ["imagej", "ome", "pages"])
@pytest.mark.parametrize("kept", [0.98, 0.5, 0.01])
def test_stack_that_is_cut_off_is_refused(tmp_path, rng, kind, kept):
    path = tmp_path / ("s.ome.tif" if kind == "ome" else "s.tif")
    stack_of(path, words_of(rng, 2, 3, 70, 90), kind)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    refusal_of(path)


@pytest.mark.parametrize("compression", [None, "zlib", "lzw"])
def test_file_that_is_cut_off_after_it_was_opened_is_told(tmp_path, rng, compression):
    path = tmp_path / "s.tif"
    values = rng.integers(0, 255, (3, 200, 300), np.uint8)
    tifffile.imwrite(path, values, compression=compression, photometric="minisblack")
    source = open_source(path)
    with path.open("rb+") as file:
        file.truncate(path.stat().st_size // 2)
    with pytest.raises(UnreadablePicture, match=r"cannot read .*s\.tif: ") as error:
        source.data.compute()
    assert "\n" not in str(error.value)


def test_what_is_no_source_is_refused_with_the_reason(tmp_path, rng):
    assert "there is no such file" in refusal_of(tmp_path / "none.tif")
    assert "not an OME-Zarr store" in refusal_of(tmp_path)
    (tmp_path / "text.png").write_text("no picture")
    assert "it is a text file; PNG, JPEG, TIFF" in refusal_of(tmp_path / "text.png")
    tifffile.imwrite(tmp_path / "c.tif", np.zeros((9, 9), np.complex64))
    assert "complex64; real numbers are read" in refusal_of(tmp_path / "c.tif")
    with tifffile.TiffWriter(tmp_path / "two.tif") as tiff:
        tiff.write(bytes_of(rng, 24, 20), metadata=None)
        tiff.write(bytes_of(rng, 12, 50), metadata=None)
    assert "2 pictures" in refusal_of(tmp_path / "two.tif")
    tifffile.imwrite(tmp_path / "lab.tif", bytes_of(rng, 9, 9, 3), photometric="cielab")
    assert "CIELAB" in refusal_of(tmp_path / "lab.tif")


# --- which files ----------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path):
    for name in (
        "img10.PNG", "img9.png", "img1.tif", "notes.txt", ".hidden.png",
        "deep/a.jpg", "deep/deeper/b.jpg", "deep/slide.zarr/0/c.png",
    ):  # fmt: skip
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    return tmp_path


def found(folder, *inputs):
    given = [folder / one for one in inputs]
    return [path.relative_to(folder).as_posix() for path in find_sources(given)]


def test_folder_is_its_pictures_in_natural_order(folder):
    assert found(folder, ".") == ["img1.tif", "img9.png", "img10.PNG"]
    assert found(folder, "deep") == ["deep/a.jpg", "deep/slide.zarr"]


@pytest.mark.parametrize(
    ("names", "order"),
    [
        (["z+0.0um", "z+0.1um", "z+0.7um", "z-0.1um", "z-0.7um"], [4, 3, 0, 1, 2]),
        (["plane-1", "plane-10", "plane-2"], [0, 2, 1]),
    ],
)
def test_signs_order_the_planes_of_a_stack_if_some_are_plus(tmp_path, names, order):
    for value, name in enumerate(names):
        picture = np.full((12, 16), value, np.uint8)
        Image.fromarray(picture).save(tmp_path / f"{name}.png")
    planes = open_stack(tmp_path).data[:, 0, 0].compute()
    assert planes.tolist() == order


def test_patterns_are_expanded_here(folder):
    assert found(folder, "*.png") == ["img9.png"]
    assert found(folder, "img?.*") == ["img1.tif", "img9.png"]
    assert found(folder, "**/*.jpg") == ["deep/a.jpg", "deep/deeper/b.jpg"]
    assert found(folder, "*/*.zarr") == ["deep/slide.zarr"]
    assert len(found(folder, "**")) == 6


def test_pattern_may_be_the_name_of_a_file_or_folder(folder):
    (folder / "day [1]").mkdir()
    (folder / "day [1]" / "a*.png").touch()
    assert found(folder, "day [1]/a*.png") == ["day [1]/a*.png"]
    assert found(folder, "day [1]/*.png") == ["day [1]/a*.png"]


def test_each_source_comes_once_in_the_order_given(folder):
    inputs = ["img9.png", "deep/../img9.png", "notes.txt", ".", "deep/slide.zarr"]
    expected = ["img9.png", "notes.txt", "img1.tif", "img10.PNG", "deep/slide.zarr"]
    assert found(folder, *inputs) == expected


def test_relative_patterns_start_here(folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert [str(path) for path in find_sources(["img*.png"])] == ["img9.png"]


@pytest.mark.parametrize(
    ("given", "complaint"),
    [("none.png", "no such file"), ("*.gif", "no picture matches"), ("void", "has no pictures")],
)
def test_input_that_names_nothing_is_an_error(folder, given, complaint):
    (folder / "void").mkdir()
    with pytest.raises(UnreadablePicture, match=complaint) as refused:
        find_sources([folder / "img9.png", folder / given])
    assert str(folder / given) in str(refused.value)


def test_opening_imports_nothing_that_the_package_does_not_need():
    code = (
        "import sys, napari_defocus.io.open, napari_defocus.io.ome_zarr_writer; print(*sys.modules)"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"dask", "zarr", "ome_zarr_models", "tifffile"} & set(told.stdout.split())


def test_missing_extra_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr("napari_defocus.core.extras.find_spec", lambda name: name == "dask" or None)
    with pytest.raises(
        ImportError, match=r"zarr, ome_zarr_models: pip install 'napari-defocus\[large\]'"
    ):
        open_source(tmp_path / "p.png")


def test_data_are_lazy_dask_arrays(tmp_path, rng):
    Image.fromarray(bytes_of(rng, 9, 9)).save(tmp_path / "p.png")
    assert isinstance(open_source(tmp_path / "p.png").data, da.Array)
