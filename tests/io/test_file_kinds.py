"""Whatever a file is: it is read, or the message says what it is and what to do with it."""

import io

import numpy as np
import pytest
import tifffile
from PIL import Image

from napari_defocus.core import extras
from napari_defocus.io.file_kinds import is_raw
from napari_defocus.io.open import open_source
from napari_defocus.io.pictures import UnreadablePicture, read_picture

HEIC = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(200)
AVIF = b"\0\0\0\x1cftypmif1\0\0\0\0mif1avifmiaf" + bytes(200)
CANON_3 = b"\0\0\0\x18ftypcrx \0\0\0\1crx isom" + bytes(200)
VIDEO = b"\0\0\0\x18ftypisom\0\0\2\0isomiso2" + bytes(200)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def ramp():
    """A smooth picture in colour, which compression hardly changes."""
    steps = np.add.outer(np.arange(96), np.arange(128)).astype(np.uint8)
    return np.stack([steps, steps[::-1], steps[:, ::-1]], axis=-1)


@pytest.fixture
def neither_installed(monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(extras, "import_module", missing)


def refusal_of(path):
    with pytest.raises(UnreadablePicture) as error:
        read_picture(path)
    assert str(error.value).startswith(f"cannot read {path}: it")
    assert "\n" not in str(error.value)
    return str(error.value)


# --- what is refused, in words that help ----------------------------------------------------


@pytest.mark.parametrize(
    ("start", "said"),
    [
        (b"%PDF-1.7", "a PDF document"),
        (b"8BPS\0\1", "a Photoshop document"),
        (AVIF, "an AVIF picture"),
        (VIDEO, "a video"),
        (b"RIFF\0\0\0\0AVI LIST", "a video"),
        (b"\x89HDF\r\n", "OME-TIFF or OME-Zarr with Fiji or bioformats2raw first"),
        (bytes(128) + b"DICM", "a DICOM file"),
        (b'<?xml version="1.0"?><svg/>', "an XML or SVG file"),
        ("Grüße\n".encode() * 400, "a text file; PNG, JPEG, TIFF, WebP, BMP and GIF"),
        (b"\x07\x01\x02\x03" * 9, "not known; PNG, JPEG, TIFF, WebP, BMP and GIF"),
        (b"", "it is empty"),
        (b"\x89PNG\r\n\x1a\n", "cut off or damaged"),
    ],
    ids=str,
)
def test_a_file_that_is_not_read_is_called_what_it_is(tmp_path, start, said):
    path = tmp_path / "p.png"
    path.write_bytes(start)
    assert said in refusal_of(path)


@pytest.mark.usefixtures("neither_installed")
@pytest.mark.parametrize(
    ("start", "extra"),
    [
        (HEIC, "heic"),
        (CANON_3, "raw"),
        (b"FUJIFILMCCD-RAW 0201", "raw"),
        (b"II*\0\x10\0\0\0CR\2\0", "raw"),
    ],
    ids=["HEIC", "CR3", "RAF", "CR2"],
)
def test_pictures_of_phones_and_cameras_say_what_to_install(tmp_path, start, extra):
    path = tmp_path / "p"
    path.write_bytes(start + bytes(99))
    assert f"pip install 'napari-defocus[{extra}]'; or " in refusal_of(path)


def test_damaged_heic_is_refused_in_one_line(tmp_path):
    path = tmp_path / "p.heic"
    path.write_bytes(HEIC)
    refusal_of(path)


# --- what is read ---------------------------------------------------------------------------


def test_heic_is_read_as_it_looks(tmp_path, ramp):
    pillow_heif = pytest.importorskip("pillow_heif")
    path = tmp_path / "p.jpg"  # the content decides
    pillow_heif.from_pillow(Image.fromarray(ramp)).save(path, format="HEIF", quality=95)
    read = read_picture(path)
    assert np.abs(read.astype(int) - ramp).mean() < 2
    np.testing.assert_array_equal(open_source(path).data, read)


def small_dng(path, mosaic):
    """Write a raw file as small as one can be: a mosaic of red, green and blue, 12 bits."""
    identity = [part for row in np.eye(3, dtype=int) for one in row for part in (int(one), 1)]
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True),  # the version of DNG
        (50708, "s", 0, "A camera", True),
        (33421, "H", 2, (2, 2), True),  # the mosaic's period, and its colours
        (33422, "B", 4, (0, 1, 1, 2), True),
        (50717, "I", 1, 4095, True),  # white
        (50721, "2i", 9, identity, True),  # the colours of the sensor
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),  # what is neutral
        (50778, "H", 1, 21, True),  # daylight
    ]
    tifffile.imwrite(path, mosaic, photometric="cfa", extratags=tags, metadata=None)


def test_raw_file_is_developed_in_linear_light(tmp_path):
    pytest.importorskip("rawpy")
    path = tmp_path / "p.dng"
    mosaic = np.full((120, 160), 500, np.uint16)
    mosaic[:, 80:] = 2000
    small_dng(path, mosaic)
    read = read_picture(path)
    assert read.shape == (120, 160, 3)
    assert read.dtype == np.uint16
    dark, bright = (read[40:80, columns, 1].mean() for columns in (slice(30, 50), slice(110, 130)))
    assert bright / dark == pytest.approx(4, rel=0.02)
    assert open_source(path).axes == "yxs"


def test_ordinary_tiff_is_not_taken_for_a_raw_file(tmp_path, rng):
    path = tmp_path / "p.tif"
    tifffile.imwrite(path, rng.integers(0, 256, (24, 20, 3), np.uint8), photometric="rgb")
    assert not is_raw(path)


# --- GIF and other animations ---------------------------------------------------------------


def palette_pictures(rng, count):
    return [
        Image.fromarray(rng.integers(0, 256, (24, 20, 3), np.uint8)).quantize(16)
        for _ in range(count)
    ]


def test_gif_is_read_as_the_same_palette_in_png(tmp_path, rng):
    [picture] = palette_pictures(rng, 1)
    for kind in ("gif", "png"):
        picture.save(tmp_path / f"p.{kind}")
    read = read_picture(tmp_path / "p.gif")
    np.testing.assert_array_equal(read, picture.convert("RGB"))
    np.testing.assert_array_equal(read, read_picture(tmp_path / "p.png"))


@pytest.mark.parametrize("kind", ["gif", "webp", "png"])
def test_each_frame_of_an_animation_is_a_plane(tmp_path, rng, kind):
    pictures = [each.convert("RGB") for each in palette_pictures(rng, 3)]
    buffer = io.BytesIO()
    shown = pictures if kind != "gif" else [each.quantize(16) for each in pictures]
    options = {"lossless": True} if kind == "webp" else {}
    shown[0].save(buffer, kind, save_all=True, append_images=shown[1:], **options)
    path = tmp_path / f"p.{kind}"
    path.write_bytes(buffer.getvalue())
    source = open_source(path)
    assert source.axes == "tyxs"
    frames = np.asarray(source.data)[..., :3]
    for frame, picture in zip(frames, shown, strict=True):
        np.testing.assert_array_equal(frame, picture.convert("RGB"))
    assert "an animation of 3 frames; napari-defocus batch measures" in refusal_of(path)
