"""Pictures are read at their full depth, upright; results appear whole or not at all."""

import errno
import io
import os
import pickle
import struct
import zlib
from contextlib import suppress
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from napari_defocus.core.image import prepare_image
from napari_defocus.core.writing import NeedsForce, UnwritableResult, check_results, write_results
from napari_defocus.io.pictures import UnreadablePicture, read_picture

ORIENTATION = 274


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def bytes_of(rng, *shape):
    return rng.integers(0, 256, shape, dtype=np.uint8)


def words_of(rng, *shape):
    return rng.integers(0, 65536, shape, dtype=np.uint16)


def as_rgba(grey_and_opacity):
    return grey_and_opacity[..., [0, 0, 0, 1]]


def rgb_with_palette(rng):
    picture = Image.fromarray(bytes_of(rng, 24, 20, 3)).quantize(16)
    return picture, np.asarray(picture.convert("RGB"))


# --- what is read ---------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_8_bit_png_is_read_exactly(tmp_path, rng, channels):
    picture = bytes_of(rng, 24, 20, *channels)
    Image.fromarray(picture).save(tmp_path / "p.png")
    read = read_picture(tmp_path / "p.png")
    assert read.dtype == np.uint8
    np.testing.assert_array_equal(read, picture)


@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_16_bit_png_keeps_its_low_bits(tmp_path, rng, channels):
    picture = words_of(rng, 24, 20, *channels)
    (tmp_path / "p.png").write_bytes(imagecodecs.png_encode(picture))
    read = read_picture(tmp_path / "p.png")
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, picture)


@pytest.mark.parametrize("values", [bytes_of, words_of])
def test_grey_png_with_opacity_becomes_rgba(tmp_path, rng, values):
    picture = values(rng, 24, 20, 2)
    (tmp_path / "p.png").write_bytes(imagecodecs.png_encode(picture))
    np.testing.assert_array_equal(read_picture(tmp_path / "p.png"), as_rgba(picture))


def test_1_bit_picture_is_read_as_bool(tmp_path, rng):
    picture = bytes_of(rng, 24, 20) > 128
    Image.fromarray(picture).save(tmp_path / "p.png")
    read = read_picture(tmp_path / "p.png")
    assert read.dtype == bool
    np.testing.assert_array_equal(read, picture)


def test_palette_becomes_rgb(tmp_path, rng):
    picture, colors = rgb_with_palette(rng)
    picture.save(tmp_path / "p.png")
    np.testing.assert_array_equal(read_picture(tmp_path / "p.png"), colors)


def test_transparent_palette_entry_becomes_opacity(tmp_path, rng):
    picture, colors = rgb_with_palette(rng)
    picture.save(tmp_path / "p.png", transparency=3)
    read = read_picture(tmp_path / "p.png")
    np.testing.assert_array_equal(read[..., 3] == 0, np.asarray(picture) == 3)
    np.testing.assert_array_equal(read[..., :3], colors)


@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
def test_jpeg_is_read_as_grey_or_rgb(tmp_path, mode):
    ramp = np.add.outer(np.arange(0, 160, 2), np.arange(0, 90, 2)).astype(np.uint8)
    picture = Image.fromarray(np.stack([ramp, ramp[::-1], ramp[:, ::-1]], axis=-1))
    picture.convert(mode).save(tmp_path / "p.jpg", quality=95)
    read = read_picture(tmp_path / "p.jpg").astype(int)
    expected = np.asarray(picture.convert("L" if mode == "L" else "RGB"))
    assert read.shape == expected.shape
    assert np.abs(read - expected).mean() < 3


@pytest.mark.parametrize("kind", ["png", "png16", "jpeg", "tiff"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_noted_orientation_is_applied(tmp_path, orientation, kind):
    steps = np.add.outer(np.arange(0, 96, 4), np.arange(0, 160, 4))
    path = tmp_path / "p"
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    upright = ImageOps.exif_transpose(with_exif(Image.fromarray(steps.astype(np.uint8)), exif))
    if kind == "png16":
        path.write_bytes(png_with_exif(steps.astype(np.uint16), exif))
    elif kind == "tiff":
        tag = (ORIENTATION, "H", 1, orientation, True)
        tifffile.imwrite(path, steps.astype(np.uint8), extratags=[tag])
    else:
        Image.fromarray(steps.astype(np.uint8)).save(path, kind, exif=exif, quality=100)
    read = read_picture(path).astype(int)
    assert read.shape == (upright.height, upright.width)
    assert np.abs(read - np.asarray(upright)).max() <= 2


def with_exif(picture, exif):
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", exif=exif)
    return Image.open(buffer)


def png_with_exif(pixels, exif):
    """Put an eXIf chunk right behind the header of a PNG."""
    encoded = imagecodecs.png_encode(pixels)
    body = b"eXIf" + exif.tobytes().removeprefix(b"Exif\0\0")
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return encoded[:33] + chunk + encoded[33:]


@pytest.mark.parametrize("channels", [(), (3,), (4,)])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32", "float64"])
@pytest.mark.parametrize("compression", [None, "zlib", "lzw"])
def test_tiff_is_read_exactly(tmp_path, rng, channels, dtype, compression):
    picture = (rng.random((24, 20, *channels)) * 200).astype(dtype)
    color = "rgb" if channels else "minisblack"
    tifffile.imwrite(tmp_path / "p.tif", picture, photometric=color, compression=compression)
    read = read_picture(tmp_path / "p.tif")
    assert read.dtype == picture.dtype
    np.testing.assert_array_equal(read, picture)


def test_tiff_that_stores_planes_of_colour_is_read_channel_last(tmp_path, rng):
    planes = bytes_of(rng, 3, 24, 20)
    tifffile.imwrite(tmp_path / "p.tif", planes, photometric="rgb", planarconfig="separate")
    np.testing.assert_array_equal(read_picture(tmp_path / "p.tif"), np.moveaxis(planes, 0, -1))


def test_tiff_of_grey_with_opacity_becomes_rgba(tmp_path, rng):
    picture = bytes_of(rng, 24, 20, 2)
    color = {"photometric": "minisblack", "planarconfig": "contig"}
    tifffile.imwrite(tmp_path / "p.tif", picture, extrasamples=["unassalpha"], **color)
    np.testing.assert_array_equal(read_picture(tmp_path / "p.tif"), as_rgba(picture))


def test_tiff_palette_becomes_rgb(tmp_path, rng):
    index, colors = bytes_of(rng, 24, 20), words_of(rng, 3, 256)
    tifffile.imwrite(tmp_path / "p.tif", index, photometric="palette", colormap=colors)
    np.testing.assert_array_equal(read_picture(tmp_path / "p.tif"), colors.T[index])


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_tiff_cmyk_becomes_rgb(tmp_path, rng, dtype):
    inks = bytes_of(rng, 24, 20, 4)
    expected = np.asarray(Image.fromarray(inks, mode="CMYK").convert("RGB")) / 255
    stored = (inks.astype(dtype) * (np.iinfo(dtype).max // 255)).astype(dtype)
    tifffile.imwrite(tmp_path / "p.tif", stored, photometric="separated")
    read = read_picture(tmp_path / "p.tif")
    assert read.dtype == dtype
    np.testing.assert_allclose(read / np.iinfo(dtype).max, expected, atol=1 / 255)


def test_tiff_that_counts_from_white_is_turned_round(tmp_path, rng):
    stored = bytes_of(rng, 24, 20)
    tifffile.imwrite(tmp_path / "p.tif", stored, photometric="miniswhite")
    np.testing.assert_array_equal(read_picture(tmp_path / "p.tif"), 255 - stored)


def test_jpeg_in_a_tiff_is_rgb(tmp_path):
    steps = np.arange(64, dtype=np.uint8)
    picture = np.stack(np.broadcast_arrays(steps[:, None], steps * 3, np.uint8(90)), axis=-1)
    tifffile.imwrite(tmp_path / "p.tif", picture, compression="jpeg", photometric="rgb")
    read = read_picture(tmp_path / "p.tif").astype(int)
    assert np.abs(read - picture).mean() < 3


def test_tiff_with_a_thumbnail_is_one_picture(tmp_path, rng):
    picture = bytes_of(rng, 64, 60, 3)
    with tifffile.TiffWriter(tmp_path / "p.tif") as tiff:
        tiff.write(picture, metadata=None)
        tiff.write(picture[::4, ::4], subfiletype=1, metadata=None)
    np.testing.assert_array_equal(read_picture(tmp_path / "p.tif"), picture)


def test_content_decides_not_the_name(tmp_path, rng):
    picture = bytes_of(rng, 24, 20)
    Image.fromarray(picture).save(tmp_path / "p.tif", "PNG")
    tifffile.imwrite(tmp_path / "tiff.png", picture)
    np.testing.assert_array_equal(read_picture(tmp_path / "p.tif"), picture)
    np.testing.assert_array_equal(read_picture(str(tmp_path / "tiff.png")), picture)


@pytest.mark.parametrize("kind", ["png", "jpeg", "tiff", "webp", "bmp"])
def test_what_is_read_is_what_the_method_takes(tmp_path, rng, kind):
    Image.fromarray(bytes_of(rng, 24, 20, 3)).save(tmp_path / "p", kind)
    assert prepare_image(read_picture(tmp_path / "p")).shape == (24, 20)


# --- what is refused ------------------------------------------------------------------------


def refusal_of(path):
    with pytest.raises(UnreadablePicture) as error:
        read_picture(path)
    message = str(error.value)
    assert str(path) in message
    assert "\n" not in message
    return message


def test_missing_file_is_named(tmp_path):
    assert "no such file" in refusal_of(tmp_path / "none.png")


def test_folder_is_no_picture(tmp_path):
    assert "is a folder" in refusal_of(tmp_path)


@pytest.mark.parametrize(
    "content", [b"", b"just text", b"\x89PNG\r\n\x1a\n", b"II*\0", b"\xff\xd8"]
)
def test_what_is_no_picture_is_refused(tmp_path, content):
    path = tmp_path / "p.png"
    path.write_bytes(content)
    refusal_of(path)


@pytest.mark.parametrize(
    "encoding",
    [
        {"format": "PNG"},
        {"format": "JPEG"},
        {"format": "WEBP", "lossless": True},
        {"format": "BMP"},
        {"format": "TIFF"},
        {"format": "TIFF", "compression": "jpeg"},
        {"format": "TIFF", "compression": "tiff_lzw"},
    ],
    ids=str,
)
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_file_that_was_cut_off_is_refused(tmp_path, rng, encoding, share):
    buffer = io.BytesIO()
    Image.fromarray(bytes_of(rng, 64, 60, 3)).save(buffer, **encoding)
    path = tmp_path / "p"
    path.write_bytes(buffer.getvalue()[: int(share * buffer.tell())])
    refusal_of(path)


@pytest.mark.parametrize("kind", ["png", "jpeg", "webp", "bmp", "tiff"])
def test_damaged_file_is_read_or_refused_and_raises_nothing_else(tmp_path, rng, kind):
    buffer = io.BytesIO()
    Image.fromarray(bytes_of(rng, 40, 50, 3)).save(buffer, kind)
    path = tmp_path / "p"
    for _ in range(40):
        content = np.frombuffer(buffer.getvalue(), np.uint8).copy()
        content[rng.integers(0, 300, 4)] = bytes_of(rng, 4)
        path.write_bytes(content.tobytes())
        with suppress(UnreadablePicture):
            assert read_picture(path).ndim in (2, 3)


@pytest.mark.parametrize("compression", [None, "zlib", "jpeg"])
def test_tiff_with_its_end_cut_off_is_refused(tmp_path, rng, compression):
    """Its directory is whole and at the start; only pixels are missing."""
    path = tmp_path / "p.tif"
    tifffile.imwrite(path, bytes_of(rng, 64, 60, 3), photometric="rgb", compression=compression)
    path.write_bytes(path.read_bytes()[:-500])
    assert "cut off" in refusal_of(path)


def test_16_bit_png_that_was_cut_off_is_refused(tmp_path, rng):
    path = tmp_path / "p.png"
    path.write_bytes(imagecodecs.png_encode(words_of(rng, 64, 60, 3))[:-3000])
    refusal_of(path)


def test_stack_is_refused_with_its_shape(tmp_path, rng):
    path = tmp_path / "p.tif"
    tifffile.imwrite(path, bytes_of(rng, 5, 24, 20), imagej=True, metadata={"axes": "ZYX"})
    message = refusal_of(path)
    assert "5 x 24 x 20" in message
    assert "napari-defocus batch reads stacks" in message
    assert "sharpest makes one sharp picture" in message


def test_tiff_of_several_pictures_is_refused(tmp_path, rng):
    path = tmp_path / "p.tif"
    with tifffile.TiffWriter(path) as tiff:
        tiff.write(bytes_of(rng, 24, 20), metadata=None)
        tiff.write(bytes_of(rng, 12, 50), metadata=None)
    assert "2 pictures" in refusal_of(path)


def test_stack_of_one_plane_is_that_plane(tmp_path, rng):
    plane = bytes_of(rng, 1, 24, 20)
    tifffile.imwrite(tmp_path / "p.tif", plane, imagej=True)
    np.testing.assert_array_equal(read_picture(tmp_path / "p.tif"), plane[0])


def test_unknown_colour_model_is_refused(tmp_path, rng):
    tifffile.imwrite(tmp_path / "p.tif", bytes_of(rng, 24, 20, 3), photometric="cielab")
    assert "CIELAB" in refusal_of(tmp_path / "p.tif")


@pytest.mark.parametrize("kind", ["png", "tiff"])
def test_decompression_bomb_is_refused(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    Image.fromarray(np.zeros((50, 60), np.uint8)).save(tmp_path / "p", kind)
    assert "pixels" in refusal_of(tmp_path / "p")


# --- whole or not at all --------------------------------------------------------------------


def everything_in(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_results_are_ordinary_files_and_nothing_else_is_left(tmp_path):
    results = {tmp_path / "a": b"1", tmp_path / "b": b"2"}
    write_results(results)
    assert everything_in(tmp_path) == {"a": b"1", "b": b"2"}
    (tmp_path / "ordinary").touch()
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "ordinary").stat().st_mode


def test_existing_result_is_kept_unless_forced(tmp_path):
    (tmp_path / "b").write_bytes(b"old")
    results = {tmp_path / "a": b"1", tmp_path / "b": b"2"}
    with pytest.raises(UnwritableResult, match="exists already"):
        write_results(results)
    assert everything_in(tmp_path) == {"b": b"old"}
    write_results(results, force=True)
    assert everything_in(tmp_path) == {"a": b"1", "b": b"2"}


@pytest.mark.parametrize("failing_call", [1, 2])
def test_full_disk_leaves_everything_as_it_was(tmp_path, monkeypatch, failing_call):
    (tmp_path / "b").write_bytes(b"old")
    calls = iter(range(1, 9))

    def fsync(_descriptor):
        if next(calls) == failing_call:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(UnwritableResult, match="No space left on device"):
        write_results({tmp_path / "a": b"1", tmp_path / "b": b"2"}, force=True)
    assert everything_in(tmp_path) == {"b": b"old"}


def test_interrupted_writing_leaves_everything_as_it_was(tmp_path, monkeypatch):
    def interrupt(_descriptor):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_results({tmp_path / "a": b"1"})
    assert everything_in(tmp_path) == {}


def fail_at(number, error):
    """Return a `Path.replace` that fails the so-many-th time."""
    calls, replace = iter(range(1, 99)), Path.replace

    def failing(path, target):
        if next(calls) == number:
            raise error
        return replace(path, target)

    return failing


def no_second_names(_source, _target):
    raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))


@pytest.mark.parametrize("second_names", [True, False])
@pytest.mark.parametrize("failing_call", [1, 2, 3])
@pytest.mark.parametrize("error", [OSError(errno.EIO, "I/O error"), KeyboardInterrupt()])
def test_renaming_that_fails_leaves_everything_as_it_was(
    tmp_path, monkeypatch, error, failing_call, second_names
):
    before = {"a": b"old a", "c": b"old c"}
    for name, content in before.items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.setattr(Path, "replace", fail_at(failing_call, error))
    if not second_names:
        monkeypatch.setattr(os, "link", no_second_names)
    results = {tmp_path / name: b"new" for name in "abc"}
    refusal = KeyboardInterrupt if error.args == () else UnwritableResult
    with pytest.raises(refusal) as refused:
        write_results(results, force=True)
    if refusal is UnwritableResult:
        assert f"cannot write {tmp_path / 'abc'[failing_call - 1]}: I/O error" in str(refused.value)
    assert everything_in(tmp_path) == before


def test_interruption_right_after_a_renaming_counts(tmp_path, monkeypatch):
    (tmp_path / "a").write_bytes(b"old")
    replace = Path.replace

    def interrupted(path, target):
        replace(path, target)
        if target.read_bytes() == b"new":
            raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_results({tmp_path / "a": b"new", tmp_path / "b": b"new"}, force=True)
    assert everything_in(tmp_path) == {"a": b"old"}


def test_what_cannot_be_put_back_is_kept_and_told(tmp_path, monkeypatch):
    for name in "ab":
        (tmp_path / name).write_bytes(f"old {name}".encode())
    calls, replace = iter(range(1, 99)), Path.replace

    def fails_from_the_second_time_on(path, target):
        if next(calls) > 1:
            raise OSError(errno.EIO, "I/O error")
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", fails_from_the_second_time_on)
    with pytest.raises(UnwritableResult, match=f"I/O error; {tmp_path / 'a'} was ") as refused:
        write_results({tmp_path / "a": b"new", tmp_path / "b": b"new"}, force=True)
    kept = Path(str(refused.value).rpartition(" was ")[2])
    assert kept.read_bytes() == b"old a"
    assert everything_in(tmp_path) == {"a": b"new", "b": b"old b", kept.name: b"old a"}


def test_refusal_says_how_the_caller_may_overwrite(tmp_path):
    (tmp_path / "{a}").touch()
    with pytest.raises(NeedsForce, match=r"\(force=True overwrites it\)$") as refused:
        check_results([tmp_path / "{a}"])
    same = pickle.loads(pickle.dumps(refused.value))
    assert same.told("--force").endswith("{a}: it exists already (--force overwrites it)")


def test_link_is_followed_not_replaced(tmp_path):
    (tmp_path / "real").write_bytes(b"old")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write_results({tmp_path / "link": b"new"}, force=True)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_bytes() == b"new"


def test_missing_folder_is_refused_and_not_made(tmp_path):
    with pytest.raises(UnwritableResult, match="there is no folder"):
        check_results([tmp_path / "none" / "a"])
    assert everything_in(tmp_path) == {}


def test_folder_that_takes_no_files_is_refused(tmp_path, monkeypatch):
    def refuse(*_args, **_kwargs):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr("pathlib.Path.touch", refuse)
    with pytest.raises(UnwritableResult, match="Permission denied"):
        check_results([tmp_path / "a"])


@pytest.mark.skipif(not os.path.exists("/dev/null"), reason="no such device here")  # noqa: PTH110
def test_device_is_never_replaced():
    with pytest.raises(UnwritableResult, match="not a regular file"):
        check_results([Path("/dev/null")], force=True)


def test_folder_source_and_twin_are_refused_even_when_forced(tmp_path):
    source = tmp_path / "picture.png"
    source.touch()
    for paths, reason in [
        ([tmp_path], "is a folder"),
        ([source], "a file that is read"),
        ([tmp_path / "a", tmp_path / "." / "a"], "given twice"),
    ]:
        with pytest.raises(UnwritableResult, match=reason):
            check_results(paths, force=True, source=source)


def test_channels_are_not_called_planes_of_a_stack(tmp_path):
    path = tmp_path / "cells.ome.tif"
    tifffile.imwrite(path, np.zeros((3, 8, 9), np.uint16), metadata={"axes": "CYX"})
    with pytest.raises(UnreadablePicture, match="a picture of 3 channels; napari-defocus batch"):
        read_picture(path)


def test_photograph_that_is_cut_off_says_so(tmp_path):
    whole, path = io.BytesIO(), tmp_path / "photo.jpg"
    Image.effect_noise((80, 60), 50).save(whole, "JPEG")
    path.write_bytes(whole.getvalue()[:-400])
    assert refusal_of(path).endswith("the file is cut off")
