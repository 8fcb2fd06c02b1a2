"""Slides of several files, read by OpenSlide; a tiny one of Hamamatsu is written here."""

import json

import numpy as np
import pytest
import tifffile
from command_line import run
from microscope_files import write_slide
from PIL import Image

from napari_defocus.core import extras
from napari_defocus.io import slides
from napari_defocus.io.file_kinds import slide_format
from napari_defocus.io.open import find_sources, open_source
from napari_defocus.io.pictures import UnreadablePicture, read_picture, told_choice_in

HEIGHT, WIDTH = 128, 192


@pytest.fixture(scope="module")
def shown():
    """Squares of 16 px, which JPEG keeps."""
    colors = np.random.default_rng(0).integers(0, 255, (HEIGHT // 16, WIDTH // 16, 3))
    return np.kron(colors, np.ones((16, 16, 1))).astype(np.uint8)


@pytest.fixture
def vms(tmp_path, shown):
    """A slide of 0.5 um a pixel: an index, the picture, a map of it and a picture of the glass."""
    whole = {"quality": 98, "subsampling": 0, "restart_marker_blocks": 6}
    for name, picture in (("picture", shown), ("map", shown[::4, ::4]), ("glass", shown[::8, ::8])):
        Image.fromarray(picture).save(tmp_path / f"{name}.jpg", **whole)
    path = tmp_path / "slide.vms"
    path.write_text(
        "[Virtual Microscope Specimen]\nNoLayers=1\nNoJpegColumns=1\nNoJpegRows=1\n"
        "ImageFile=picture.jpg\nMapFile=map.jpg\nMacroImage=glass.jpg\n"
        f"PhysicalWidth={WIDTH * 500}\nPhysicalHeight={HEIGHT * 500}\n"
    )
    return path


def test_largest_level_is_read_and_the_rest_is_told(vms, shown):
    pytest.importorskip("openslide")
    source = open_source(vms)
    assert source.axes == "yxs"
    assert source.pixel_size == {"y": 0.5, "x": 0.5}
    assert source.units == {"y": "micrometer", "x": "micrometer"}
    assert np.abs(read_picture(vms).astype(int) - shown).max() <= 2
    part = source.data[30:60, 100:150].compute(scheduler="synchronous")
    assert np.abs(part.astype(int) - shown[30:60, 100:150]).max() <= 2
    told = told_choice_in(vms)
    assert told.startswith("the largest of ")
    assert told.endswith("; left out: macro")


def test_slide_works_in_a_terminal(vms, tmp_path):
    pytest.importorskip("openslide")
    output = tmp_path / "map.tif"
    facts = json.loads(run("map", vms, "-o", output, "--stride", 8, "--json").stdout)
    assert (facts["width"], facts["height"]) == (WIDTH, HEIGHT)
    assert "left out: macro" in facts["taken"]
    assert tifffile.imread(output).shape == (HEIGHT, WIDTH)


def test_glass_that_was_not_scanned_is_white():
    pixels = np.array([[[10, 20, 30, 255], [0, 0, 0, 0]]], np.uint8)
    assert slides._on_white(pixels).tolist() == [[[10, 20, 30], [255, 255, 255]]]


def test_slide_that_lacks_a_part_is_refused_in_one_line(vms):
    pytest.importorskip("openslide")
    (vms.parent / "picture.jpg").unlink()
    with pytest.raises(UnreadablePicture, match="a slide of Hamamatsu, which OpenSlide could not"):
        read_picture(vms)


def test_without_the_extra_the_message_names_it(vms, monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(extras, "import_module", missing)
    for read in (read_picture, open_source):
        with pytest.raises(UnreadablePicture) as refused:
            read(vms)
        assert "which needs pip install 'napari-defocus[slides]'; or save it as" in str(
            refused.value
        )


def test_the_parts_of_a_slide_tell_what_it_is_not_its_ending_alone(tmp_path, shown):
    """MIRAX is a file and a folder of the same name; BIF is a TIFF of Ventana's."""
    Image.fromarray(shown).save(tmp_path / "photo.jpg")
    photograph = (tmp_path / "photo.jpg").rename(tmp_path / "photo.mrxs")
    assert slide_format(photograph) is None
    assert read_picture(photograph).shape == (HEIGHT, WIDTH, 3)
    (tmp_path / "photo").mkdir()
    (tmp_path / "photo" / "Slidedat.ini").touch()
    assert slide_format(photograph).vendor == "mirax"


@pytest.mark.parametrize("installed", [True, False])
def test_tiff_of_others_with_the_ending_of_ventana_is_read_as_a_tiff(
    tmp_path, shown, monkeypatch, installed
):
    if installed:
        pytest.importorskip("openslide")
    else:
        monkeypatch.setattr(slides, "is_there", lambda package: False)
    path = write_slide(tmp_path / "slide.svs", shown).rename(tmp_path / "slide.bif")
    np.testing.assert_array_equal(read_picture(path), shown)
    assert find_sources([tmp_path]) == [path]
