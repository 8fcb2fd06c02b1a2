"""A corpus of broken files: each is read as it should be, or refused in a line that says why."""

import io
import json
import shutil
import struct
import zipfile
import zlib

import numpy as np
import pytest
import tifffile
from command_line import assert_fails_in_one_line, run
from PIL import Image

from napari_defocus import MeasuredPSF
from napari_defocus.io.ome_zarr_writer import new_ome_zarr
from napari_defocus.io.open import open_source
from napari_defocus.io.pictures import read_picture
from napari_defocus.io.settings_file import Settings

GREY = np.random.default_rng(0).integers(0, 256, (40, 48), np.uint8)
STACK = np.stack([GREY, GREY[::-1], GREY // 2])


def bytes_of_tiff(values, **options):
    buffer = io.BytesIO()
    tifffile.imwrite(buffer, values, **options)
    return buffer.getvalue()


def tiff_with(tag, value, tmp_path):
    path = tmp_path / "tagged.tif"
    path.write_bytes(bytes_of_tiff(GREY))
    with tifffile.TiffFile(path, mode="r+") as tiff:
        tiff.pages[0].tags[tag].overwrite(value)
    return path


def png_of_size(width, height, depth, color):
    def chunk(kind, body):
        whole = kind + body
        return struct.pack(">I", len(body)) + whole + struct.pack(">I", zlib.crc32(whole))

    header = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    pixels = chunk(b"IDAT", zlib.compress(bytes(100)))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + pixels + chunk(b"IEND", b"")


def refused(read, path, saying):
    """Check that a file is refused in one line with its name, and return that."""
    with pytest.raises(ValueError, match="cannot read") as error:
        read(path)
    message = str(error.value)
    assert str(path) in message
    assert "\n" not in message
    assert saying in message
    return message


def first_plane(path):
    source = open_source(path)
    return source.plane(next(source.planes())).compute(scheduler="synchronous")


# --- more pixels than there are -------------------------------------------------------------


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("color", [0, 2, 6])
@pytest.mark.parametrize(
    "size", [(60_000, 60_000), (2**31 - 1, 2**31 - 1), (2**31 - 1, 1)], ids=str
)
def test_png_that_says_to_be_huge_is_refused_unread(tmp_path, size, depth, color):
    path = tmp_path / "huge.png"
    path.write_bytes(png_of_size(*size, depth, color))
    for read in (read_picture, open_source):
        refused(read, path, "pixels")


@pytest.mark.parametrize("tag", ["ImageLength", "ImageWidth"])
def test_tiff_that_says_to_be_huge_is_refused_unread(tmp_path, tag):
    path = tiff_with(tag, 2**31, tmp_path)
    refused(read_picture, path, "pixels")
    refused(open_source, path, "cut off")


# --- what decoders did not expect -----------------------------------------------------------


@pytest.mark.parametrize(
    ("tag", "value", "saying"),
    [
        ("PhotometricInterpretation", 999, "its colour model 999 is not read"),
        ("SamplesPerPixel", 60_000, ""),
        ("Compression", 34712, ""),
    ],
)
def test_tiff_of_odd_tags_is_refused_with_the_reason(tmp_path, tag, value, saying):
    path = tiff_with(tag, value, tmp_path)
    for read in (read_picture, first_plane):
        refused(read, path, saying)


@pytest.mark.parametrize("read", [read_picture, first_plane])
def test_description_of_imagej_that_is_none_is_damage(tmp_path, read):
    path = tmp_path / "stack.tif"
    whole = bytes_of_tiff(STACK, imagej=True, metadata={"axes": "ZYX"})
    path.write_bytes(whole.replace(b"images=3", b"images=x"))
    refused(read, path, "it is damaged (TypeError: ")


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        (b'SizeX="48"', b'SizeX="-1"'),
        (b'SizeX="48"', b'SizeX="99"'),
        (b"</OME>", b"</OMG>"),
        (b'<?xml version="1.0" encoding="UTF-8"?>', b'<!DOCTYPE a [<!ENTITY b "bb">]>'.ljust(38)),
    ],
    ids=["negative", "too wide", "no end", "entities"],
)
def test_stack_of_broken_ome_xml_is_the_pages_that_it_has(tmp_path, right, wrong):
    path = tmp_path / "stack.ome.tif"
    whole = bytes_of_tiff(STACK, ome=True, metadata={"axes": "ZYX"})
    assert right in whole
    path.write_bytes(whole.replace(right, wrong))
    source = open_source(path)
    assert source.plane_shape == (3,)
    np.testing.assert_array_equal(source.data.compute(), STACK)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_no_numbers_are_read_as_such(tmp_path, value):
    path = tmp_path / "float.tif"
    values = np.where(GREY > 100, value, GREY / 255).astype(np.float32)
    path.write_bytes(bytes_of_tiff(values))
    np.testing.assert_array_equal(read_picture(path), values)


def test_infinite_values_are_refused_by_name(tmp_path):
    path = tmp_path / "float.tif"
    path.write_bytes(bytes_of_tiff(np.where(GREY > 100, np.inf, GREY / 255).astype(np.float32)))
    assert_fails_in_one_line(run("map", path), saying="image has infinite values")


@pytest.mark.parametrize("share", [0.01, 0.5, 0.9])
@pytest.mark.parametrize("kind", ["png", "jpeg", "webp", "tiff", "stack", "ome"])
def test_command_says_in_one_line_that_a_file_was_cut_off(tmp_path, kind, share):
    path = tmp_path / "p.png"
    if kind in ("stack", "ome"):
        options = {"ome": True} if kind == "ome" else {"imagej": True}
        whole = bytes_of_tiff(STACK, metadata={"axes": "ZYX"}, **options)
    else:
        buffer = io.BytesIO()
        Image.fromarray(np.dstack([GREY] * 3)).save(buffer, kind, quality=95)
        whole = buffer.getvalue()
    path.write_bytes(whole[: int(share * len(whole))])
    for command in ("map", "sharpest"):
        assert_fails_in_one_line(run(command, path), saying=str(path))
    assert [entry.name for entry in tmp_path.iterdir()] == ["p.png"]


@pytest.mark.parametrize("name", ["a" * 5000, "/dev/null"], ids=["long", "device"])
def test_names_of_no_file_are_refused(name):
    for read in (read_picture, open_source, Settings.load, MeasuredPSF.load):
        with pytest.raises((ValueError, OSError)):
            read(name)
    assert run("map", name).exit_code == 2


# --- OME-Zarr -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole_store(tmp_path_factory):
    path = tmp_path_factory.mktemp("stores") / "whole.zarr"
    writer = new_ome_zarr(path, shape=(40, 48), dtype="u1", axes="yx", attributes={}, tile=16)
    writer.write_region((slice(0, 40), slice(0, 48)), GREY)
    return writer.finish()


@pytest.fixture
def store(tmp_path, whole_store):
    return shutil.copytree(whole_store, tmp_path / "broken.zarr")


def change(file, **values):
    about = json.loads(file.read_text())
    about.update(values)
    file.write_text(json.dumps(about))


@pytest.mark.parametrize("content", [b"", b"no chunk", bytes(range(200))])
def test_damaged_chunk_is_an_error_that_names_the_store(store, content):
    (store / "0" / "c" / "0" / "0").write_bytes(content)
    refused(first_plane, store, "decompression")


def test_missing_chunk_is_what_the_store_fills_with(store):
    (store / "0" / "c" / "0" / "0").unlink()
    expected = GREY.copy()
    expected[:16, :16] = 0
    np.testing.assert_array_equal(first_plane(store), expected)


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"zarr_format": 3}', "\0"])
@pytest.mark.parametrize("file", ["zarr.json", "0/zarr.json"])
def test_store_of_broken_metadata_is_refused(store, file, content):
    (store / file).write_text(content)
    refused(open_source, store, "")


@pytest.mark.parametrize(
    "ome",
    [
        7,
        {"multiscales": []},
        {"multiscales": None},
        {"multiscales": [{"axes": ["y", "x"], "datasets": []}]},
        {"multiscales": [{"axes": 5, "datasets": [{"path": "0"}]}]},
        {"multiscales": [{"axes": [None, 3], "datasets": [{"path": "0"}]}]},
        {"multiscales": [{"axes": ["y", "x"], "datasets": [{"path": "../../etc"}]}]},
        {"plate": 7},
    ],
    ids=str,
)
def test_store_that_says_nonsense_of_its_picture_is_refused(store, ome):
    change(store / "zarr.json", attributes={"ome": ome})
    refused(open_source, store, "")


def test_scales_that_are_none_are_left_out(store):
    about = json.loads((store / "zarr.json").read_text())
    level = about["attributes"]["ome"]["multiscales"][0]["datasets"][0]
    level["coordinateTransformations"] = [{"type": "scale", "scale": [0, -1]}]
    (store / "zarr.json").write_text(json.dumps(about))
    assert open_source(store).pixel_size == {}


def test_store_that_says_to_be_huge_is_opened_and_not_read(store):
    change(store / "0" / "zarr.json", shape=[10**6, 10**6])
    assert open_source(store).data.shape == (10**6, 10**6)


# --- measured lenses, settings --------------------------------------------------------------


@pytest.fixture
def lens(tmp_path):
    path = tmp_path / "lens.npz"
    MeasuredPSF([1.0, 2.0], np.ones((2, 3, 3))).save(path)
    return path


class _Program:
    def __reduce__(self):
        raise AssertionError("never made")


@pytest.mark.parametrize("key", ["format", "scales", "kernels", "max_scale", "provenance"])
def test_lens_that_holds_objects_is_refused_and_none_is_made(lens, key):
    with np.load(lens) as file:
        parts = dict(file)
    with zipfile.ZipFile(lens, "w") as file:
        for name, values in parts.items():
            buffer = io.BytesIO()
            np.save(buffer, values)
            content = buffer.getvalue()
            if name == key:
                content = content.replace(values.dtype.str.encode(), b"|O".ljust(3)[:2], 1)
            file.writestr(f"{name}.npy", content)
    refused(MeasuredPSF.load, lens, "damaged")


def test_lens_that_unpacks_to_gigabytes_is_refused_unread(lens, monkeypatch):
    monkeypatch.setattr("napari_defocus.psf.measured._LARGEST_FILE", 1_000_000)
    MeasuredPSF.load(lens)
    with zipfile.ZipFile(lens, "a", zipfile.ZIP_DEFLATED) as file:
        file.writestr("more.npy", bytes(2_000_000))
    refused(MeasuredPSF.load, lens, "unpacks to")


@pytest.mark.parametrize(
    "content",
    ['{"map":' * 100_000, "[" * 100_000, '{"map": {"window": ' + "9" * 5000 + "}}", "\0"],
    ids=["deep", "deep list", "long number", "nul"],
)
def test_settings_that_parsers_choke_on_are_refused(tmp_path, content):
    path = tmp_path / "settings.json"
    path.write_text(content)
    refused(Settings.load, path, "")


def test_corpus_is_refused_by_the_command_without_a_traceback(tmp_path, store, lens):
    (store / "0" / "c" / "0" / "0").write_bytes(b"")
    lens.write_bytes(lens.read_bytes()[:300])
    Image.fromarray(GREY).save(tmp_path / "p.png")
    for arguments in (
        ["map", store],
        ["sharpest", store],
        ["map", tmp_path / "p.png", "--psf", lens],
        ["map", tmp_path / "p.png", "--map", lens],
        ["map", tmp_path / "p.png", "--settings", lens],
    ):
        result = run(*arguments)
        assert (result.exit_code, "Traceback" in result.output) == (2, False), result.output
