"""Files of ours are known by what they say of themselves, whatever they are called."""

import io
import shutil

import numpy as np
import pytest
import tifffile
from command_line import names_in, run
from PIL import Image

from napari_defocus import measure_batch
from napari_defocus.io.encoders import picture_png
from napari_defocus.io.ome_zarr_writer import new_ome_zarr
from napari_defocus.io.picture_files import look_for_pictures, told_left_out
from napari_defocus.io.pictures import UnreadablePicture
from napari_defocus.io.provenance import is_picture, mark_of
from napari_defocus.io.settings_file import Settings
from napari_defocus.io.tiff_writer import write_pyramidal_tiff
from napari_defocus.settings import MapSettings

LENS = ("--focal-length", 50, "--f-number", 2, "--focus-distance", 2, "--pixel-pitch", 5)


@pytest.fixture(scope="module")
def everything(tmp_path_factory, grass):
    """A folder with a picture and what every command makes beside it, under other names."""
    folder = tmp_path_factory.mktemp("photos")
    photo = folder / "photo.png"
    Image.fromarray(np.rint(255 * grass[:64, :70]).astype(np.uint8)).save(photo)
    quick, known = ("--stride", 8), ("--map", folder / "photo-blur.tif")
    calls = {
        "map": ("--confidence", folder / "sure.png", *quick),
        "segment": quick,
        "restore": ("-o", folder / "photo-in-focus.png", "-o", folder / "sharp.tif", *known),
        "refocus": ("--focus", 2, *known),
        "depth": (*LENS, *known),
    }
    for command, options in calls.items():
        result = run(command, photo, *options)
        assert result.exit_code == 0, result.output
    assert run("explain", photo, 30, 30, "-o", folder / "curve.png", *quick).exit_code == 0
    for path in list(folder.iterdir()):
        if path != photo:
            path.rename(folder / f"renamed {len(path.name)} {path.name[::-2]}{path.suffix}")
    return folder


def test_folder_of_photos_is_the_photos_and_says_what_else_is_there(everything, tmp_path):
    results = [path for path in everything.iterdir() if path.name != "photo.png"]
    assert len(results) == 11
    assert all(mark_of(path)["software"] == "napari-defocus" for path in results)
    looked = look_for_pictures(everything)
    assert [path.name for path in looked.pictures] == ["photo.png"]
    assert looked.left_out == {"result": 11}
    again = look_for_pictures([f"{everything}/*.png", f"{everything}/*", everything])
    assert [path.name for path in again.pictures] == ["photo.png"]
    assert again.left_out == {"result": 11}


def test_batch_measures_the_photos_and_reports_what_else_is_there(everything, tmp_path):
    photos = tmp_path / "photos"
    shutil.copytree(everything, photos)
    for name in ("a.txt", "b.TXT", "scan.oib", "README", ".hidden.txt"):
        (photos / name).touch()
    (photos / "deeper").mkdir()
    left = {"result": 11, ".txt": 2, ".oib": 1, "folder": 1, "no ending": 1}
    settings = Settings(map=MapSettings(stride=8))
    for _ in range(2):
        report = measure_batch(photos, photos / "measured", settings=settings)
        assert (report.planes, report.failed, report.left_out) == (1, 0, left)
    assert names_in(photos / "measured" / "maps") == ["photo-blur.tif"]
    told = "11 results of napari-defocus, 2 .txt, 1 .oib, 1 folder, 1 without an ending"
    assert told_left_out(report.left_out) == told


def test_folder_with_nothing_but_results_says_so(everything, tmp_path):
    for path in everything.iterdir():
        if mark_of(path):
            shutil.copy(path, tmp_path)
    with pytest.raises(UnreadablePicture, match=r"has no pictures .*; left out: 11 results of nap"):
        look_for_pictures(tmp_path)


def test_named_results_are_measured_if_they_show_a_scene_and_refused_if_not(everything):
    pictures, others = [], []
    for path in sorted(everything.iterdir()):
        try:
            pictures += look_for_pictures(path).pictures
        except UnreadablePicture as refused:
            others.append(str(refused))
    quantities = sorted(mark_of(path).get("quantity", "a photo") for path in pictures)
    assert quantities == ["a photo", *["all-in-focus picture"] * 2, "refocused picture"]
    assert len(others) == 8
    assert all("it is not a picture but a result of napari-defocus (" in each for each in others)
    assert any("(in-focus mask); folders, and patterns in quotation" in each for each in others)


def test_stacks_and_stores_are_known(tmp_path):
    values, about = np.ones((2, 20, 30), np.float32), {"quantity": "defocus blur radius"}
    for name, axes in (("a.ome.tif", "zyx"), ("b.tif", "pyx")):
        write_pyramidal_tiff(tmp_path / name, values, axes=axes, description=about)
    writer = new_ome_zarr(
        tmp_path / "c.zarr", shape=values.shape, dtype="f4", axes="zyx", attributes=about
    )
    writer.write_region((slice(0, 2), slice(0, 20), slice(0, 30)), values)
    writer.finish()
    for name in ("a.ome.tif", "b.tif", "c.zarr"):
        assert mark_of(tmp_path / name)["quantity"] == "defocus blur radius"
        assert not is_picture(mark_of(tmp_path / name))


def test_other_files_have_no_mark(tmp_path):
    Image.new("L", (9, 9)).save(tmp_path / "a.png")
    tifffile.imwrite(tmp_path / "b.tif", np.zeros((9, 9)), software="napari-defocus")
    tifffile.imwrite(tmp_path / "c.tif", np.zeros((3, 9, 9), np.uint8), ome=True)
    (tmp_path / "d.png").write_bytes((tmp_path / "a.png").read_bytes()[:20])
    (tmp_path / "e.tif").write_bytes((tmp_path / "b.tif").read_bytes()[:20])
    (tmp_path / "f.zarr").mkdir()
    (tmp_path / "f.zarr" / "zarr.json").write_text("[]")
    (tmp_path / "g.png").write_bytes(b"\x89PNG\r\n\x1a\n" + 40 * b"\xff")
    assert [mark_of(path) for path in sorted(tmp_path.iterdir())] == [{}] * 7
    assert mark_of(tmp_path / "none") == {}


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_marked_png_is_an_ordinary_png(tmp_path, dtype):
    content = picture_png(np.eye(20, 30), np.zeros((20, 30), dtype))
    with Image.open(io.BytesIO(content)) as picture:
        picture.load()
        assert picture.info["Software"].startswith("napari-defocus ")
        assert picture.size == (30, 20)
    (tmp_path / "p").write_bytes(content)
    assert mark_of(tmp_path / "p")["quantity"] == "all-in-focus picture"
