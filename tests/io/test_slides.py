"""Of a slide, the largest level is the picture; labels, thumbnails and overviews are not."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
from command_line import assert_fails_in_one_line, run
from microscope_files import SLIDES, write_lsm, write_slide, write_stk

from napari_defocus.io.open import find_sources, open_source
from napari_defocus.io.pictures import UnreadablePicture, read_picture, told_choice_in
from napari_defocus.io.tiff_series import picture_number


@pytest.fixture(scope="module")
def picture(astronaut):
    """(128, 160, 3), sharp."""
    return np.rint(255 * np.tile(astronaut[:128, :80], (1, 2, 1))).astype(np.uint8)


@pytest.mark.parametrize("ending", SLIDES)
def test_largest_level_is_read_and_the_rest_is_told(tmp_path, picture, ending):
    path = write_slide(tmp_path / f"slide{ending}", picture)
    np.testing.assert_array_equal(read_picture(path), picture)
    source = open_source(path)
    assert source.axes == "yxs"
    np.testing.assert_array_equal(source.data.compute(scheduler="synchronous"), picture)
    told = told_choice_in(path)
    assert ("left out" in told) == (ending != ".btf")
    assert "the largest of 2 levels" in told


def series(kind, name, height, width, levels=1):
    """What tifffile gives for a picture in a file."""
    return SimpleNamespace(
        kind=kind, name=name, shape=(height, width, 3), axes="YXS", levels=[None] * levels
    )


@pytest.mark.parametrize(
    ("pictures", "number"),
    [
        # NDPI of a small piece: the overview of the glass has more pixels.
        ([("ndpi", "Baseline", 900, 900, 3), ("ndpi", "Macro", 1000, 3000)], 0),
        (
            [
                ("ndpi", "slide 7", 900, 900, 3),
                ("ndpi", "Macro", 1000, 3000),
                ("ndpi", "Map", 9, 9),
            ],
            0,
        ),
        ([("bif", "Label", 500, 500), ("bif", "Baseline", 900, 900, 3)], 1),
        ([("philips", "Baseline", 900, 900), ("philips", "Macro", 800, 900)], 0),
        ([("ome", "label image", 900, 900), ("ome", "a.svs", 700, 700)], 1),
        ([("lsm", "stack", 128, 128), ("lsm", "stack", 128, 128)], 0),
        ([("generic", "", 20, 30), ("generic", "", 300, 200)], 1),
        ([("generic", "", 300, 290), ("generic", "", 300, 200)], None),
        ([("scn", "image 1", 900, 900), ("scn", "image 2", 900, 800), ("scn", "m", 9, 9)], None),
    ],
)
def test_picture_is_the_one_that_makers_call_so_or_that_is_much_larger(pictures, number):
    tiff = SimpleNamespace(series=[series(*picture) for picture in pictures])
    if number is None:
        with pytest.raises(ValueError, match=r"it holds \d pictures \(.* x .* px, "):
            picture_number(tiff)
    else:
        assert picture_number(tiff) == number


def test_folder_of_slides_and_stacks_of_all_makers_is_all_found(tmp_path, picture):
    for ending in SLIDES:
        write_slide(tmp_path / f"a{ending}", picture)
    planes = picture[None, ..., 0].repeat(3, 0)
    write_lsm(tmp_path / "b.LSM", planes, "zyx")
    write_stk(tmp_path / "c.stk", planes, "zyx")
    names = [path.name for path in find_sources([tmp_path])]
    assert names == ["a.btf", "a.qptiff", "a.scn", "a.svs", "b.LSM", "c.stk"]


def test_commands_for_one_picture_say_which_they_took(tmp_path, picture):
    path = write_slide(tmp_path / "a.svs", picture)
    output = tmp_path / "map.tif"
    told = run("map", path, "-o", output, "--stride", 8).stdout
    assert "a.svs, 160 x 128 px\n" in told
    assert (
        "taken        the largest of 2 levels; left out: thumbnail of 80 x 64 px, "
        "label of 64 x 60 px" in told
    )
    facts = json.loads(run("compare-psf", path, "--family", "disc", "--json").stdout)
    assert (facts["width"], facts["taken"].split(";")[0]) == (160, "the largest of 2 levels")
    assert tifffile.imread(output).shape == (128, 160)


def test_ordinary_pictures_tell_nothing(tmp_path, picture):
    tifffile.imwrite(tmp_path / "p.tif", picture)
    (tmp_path / "p.png").write_bytes(b"nothing")
    assert [told_choice_in(tmp_path / name) for name in ("p.tif", "p.png", "none")] == [""] * 3


def test_file_in_which_no_picture_is_clearly_the_one_lists_them(tmp_path, picture):
    """Two regions of one glass, and its label."""
    path = tmp_path / "two.ome.tif"
    with tifffile.TiffWriter(path, ome=True) as tiff:
        for part, name in ((picture, "one"), (picture[:100], "two"), (picture[:64], "label image")):
            tiff.write(part, photometric="rgb", metadata={"axes": "YXS", "Name": name})
    saying = "it holds 2 pictures (160 x 128 px, 160 x 100 px); one picture"
    for read in (read_picture, open_source):
        with pytest.raises(UnreadablePicture) as refused:
            read(path)
        assert saying in str(refused.value)
    assert_fails_in_one_line(run("map", path), saying=saying)


def test_slide_that_is_too_large_at_once_is_for_the_batch(tmp_path, picture, monkeypatch):
    monkeypatch.setattr("PIL.Image.MAX_IMAGE_PIXELS", 1000)
    path = write_slide(tmp_path / "a.svs", picture)
    with pytest.raises(UnreadablePicture, match=r"20480 pixels; up to 2000 .*napari-defocus batch"):
        read_picture(path)
    assert open_source(path).data.shape == picture.shape


@pytest.mark.parametrize("axes", ["zyx", "zcyx"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_stack_of_a_confocal_microscope_keeps_planes_channels_and_scale(
    tmp_path, monkeypatch, axes, compression
):
    values = np.random.default_rng(0).integers(0, 255, (4, 3, 40, 50), np.uint8)
    values = values if axes == "zcyx" else values[:, 0]
    write = tifffile.TiffWriter.write
    monkeypatch.setattr(
        tifffile.TiffWriter,
        "write",
        lambda *given, **options: write(*given, compression=compression, **options),
    )
    source = open_source(write_lsm(tmp_path / "a.lsm", values, axes))
    assert source.axes == axes
    assert source.pixel_size == pytest.approx({"z": 0.5, "y": 0.1, "x": 0.1})
    assert source.units["z"] == "micrometer"
    np.testing.assert_array_equal(source.data.compute(scheduler="synchronous"), values)
    part = source.data[1:3, ..., 7:20, 30:]
    np.testing.assert_array_equal(
        part.compute(scheduler="synchronous"), values[1:3, ..., 7:20, 30:]
    )


@pytest.mark.parametrize("axes", ["zyx", "tyx"])
def test_stack_of_metamorph_keeps_its_planes(tmp_path, axes):
    values = np.random.default_rng(0).integers(0, 65535, (4, 40, 50), np.uint16)
    source = open_source(write_stk(tmp_path / "a.stk", values, axes))
    assert source.axes == axes
    np.testing.assert_array_equal(source.data.compute(scheduler="synchronous"), values)
