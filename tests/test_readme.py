"""What README.md and the manual print works as printed, in that order, for whoever copies it."""

import re
import shlex
import tomllib
from importlib.metadata import entry_points
from pathlib import Path

import dask.array
import numpy as np
import pytest
import tifffile
from command_line import names_in, run
from microscope_files import write_ome_tiff_of_objective
from PIL import Image

import napari_defocus
from napari_defocus import RestorationFit, Settings, simulate_defocus
from napari_defocus.batch import cluster
from napari_defocus.cli import sample as sample_commands
from napari_defocus.cli.app import app
from napari_defocus.io.ome_zarr_writer import new_ome_zarr

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    path.name: path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs" / "manual").glob("*.md")))
}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

PART = 300, 40, 644, 164
"""Of the bundled photograph: left, top, right, bottom; row 120 and column 340 are still in it."""

PLACE = "120, 340", "120, 100"
"""Row and column on the pages, and in half of the part."""

NOT_HERE = {".", "python3", "pip", "napari"}
"""Programs that are not started here: they install, or open a window."""


def blocks(page, language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGES[page], re.M | re.S)


def lines_of_shell(page):
    """Return every command for a shell."""
    whole = "\n".join(blocks(page, "sh"))
    return [line for line in whole.splitlines() if line.strip()]


def commands_of(page):
    return [line for line in lines_of_shell(page) if line.startswith("napari-defocus ")]


LINES = [line for page in PAGES for line in lines_of_shell(page)]


def words_of(line, folder):
    """Return the words that a shell in a folder makes of a line; absolute paths lead into it."""
    words = []
    for word in shlex.split(line, comments=True):
        if word.startswith("/"):
            words.append(f"{folder}{word}")
        elif "*" in word and f"'{word}'" not in line:
            words += sorted(path.name for path in folder.glob(word))
        else:
            words.append(word)
    return words


@pytest.fixture
def small_sample(tmp_path, monkeypatch):
    """Let the bundled photograph be a part of itself; returns the part."""
    with Image.open(sample_commands.sample_path("dandelion")) as whole:
        part = whole.crop(PART)
    part.save(tmp_path / "sample.jpg", quality=95)
    monkeypatch.setattr(sample_commands, "sample_path", lambda _: tmp_path / "sample.jpg")
    return part


def lamps():
    """Return pictures of a point of light, blurred by 1 to 8 px."""
    point = np.zeros((64, 64), np.float32)
    point[32, 32] = 0.9
    return [simulate_defocus(point, np.full(point.shape, radius)) for radius in range(1, 9)]


def save_as_bytes(picture, path):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.rint(230 * picture / picture.max()).astype(np.uint8)).save(path)


def save_store(path, planes, axes):
    writer = new_ome_zarr(path, shape=planes.shape, dtype="u1", axes=axes, attributes={})
    writer.write_region((slice(None),) * planes.ndim, planes)
    writer.finish()


@pytest.fixture
def own_files(tmp_path, small_sample, gravel, defocused):
    """The files that the pages say are the reader's own."""
    width, height = small_sample.size
    marks = np.zeros((height, width), np.uint8)
    marks[60:70, 40:50], marks[5:15, 5:15] = 1, 2
    Image.fromarray(marks).save(tmp_path / "marks.png")
    for number, lamp in enumerate(lamps(), 1):
        save_as_bytes(lamp, tmp_path / f"lamp-{number}.png")
    for name in ("photos/one.png", "day1/plate/a.tif", "day2/b.tif", "slides/c.png"):
        save_as_bytes(gravel[:64, :80], tmp_path / name)
    planes = [defocused(gravel[:64, :80], abs(plane - 1.5)) for plane in range(4)]
    stack = np.clip(255 * np.stack(planes), 0, 255).astype(np.uint8)
    tifffile.imwrite(tmp_path / "worm.tif", stack, photometric="minisblack")
    step = {"axes": "ZYX", "PhysicalSizeZ": 0.5, "PhysicalSizeZUnit": "µm"}
    tifffile.imwrite(tmp_path / "worm.ome.tif", stack, photometric="minisblack", metadata=step)
    cells = np.rint(200 * gravel[:64, :80]).astype(np.uint8)
    tifffile.imwrite(tmp_path / "cells.tif", cells)
    for name in ("cells.ome.tif", "plate/B03.ome.tif"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        write_ome_tiff_of_objective(tmp_path / name, cells)
    for number, plane in enumerate(planes, 8):
        save_as_bytes(plane, tmp_path / f"slices/slice{number}.png")
    save_store(tmp_path / "worm.ome.zarr", stack, "zyx")
    save_store(tmp_path / "embryo.ome.zarr", np.tile(stack, (21, 2, 1, 1, 1)), "tczyx")
    (tmp_path / "shared").mkdir()


@pytest.fixture
def quick(monkeypatch):
    """Leave out what takes long and is tested elsewhere: restoring, and starting processes."""

    def unchanged(image, *_, return_fit=False, **__):
        same = np.asarray(image, np.float32) / 255
        return (
            (same, RestorationFit(1e-5, 1e-3, 0.0, np.zeros(image.shape[:2], np.float32)))
            if return_fit
            else same
        )

    for name in ("restore_all_in_focus", "change_focus"):
        monkeypatch.setattr(napari_defocus, name, unchanged)
    here = cluster.in_this_process
    monkeypatch.setattr(cluster, "dask_client", lambda _address=None, **_: here())


@pytest.mark.usefixtures("own_files", "quick")
@pytest.mark.parametrize("page", [page for page in PAGES if commands_of(page)])
def test_the_commands_do_what_they_say_one_after_the_other(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if page == "lenses.md":
        run("sample", "photo.jpg")
    for line in commands_of(page):
        done = run(*words_of(line, tmp_path)[1:])
        assert done.exit_code == 0, f"{line}\n{done.output}"
    said = " ".join(lines_of_shell(page))
    promised = set(re.findall(r"photo-[\w-]+\.\w+|(?<=-o )\w+\.\w+|regions\.csv", said))
    assert promised <= set(names_in(tmp_path))
    for folder in re.findall(r"batch .*-o (\w+)", said):
        assert (tmp_path / folder / "table.csv").is_file()


def test_readme_is_short():
    assert PAGES["README.md"].count("\n") <= 150


def test_the_manual_shows_most_commands():
    shown = {line.split()[1] for page in PAGES for line in commands_of(page)}
    assert shown >= {each.name for each in app.registered_commands} - {"demo"}


def test_programs_that_are_named_are_those_that_an_installation_has():
    programs = {shlex.split(line, comments=True)[0] for line in LINES}
    assert programs - NOT_HERE == {"napari-defocus"}
    scripts = {each.name for each in entry_points(group="console_scripts")}
    assert "napari-defocus" in scripts
    for page in ("README.md", "commands.md"):
        lines = lines_of_shell(page)
        first = lines.index(commands_of(page)[0])
        assert lines.index(". .venv/bin/activate") < first, "or it is not found"
    assert {line.split()[2] for line in LINES if line.startswith("python3 tasks.py")} == {
        "demo",
        "test",
    }


def test_pip_installs_this_clone_and_extras_that_there_are():
    installs = [line for line in LINES if line.startswith("pip ")]
    assert len(installs) >= 2
    for line in installs:
        [extra] = re.fullmatch(r'pip install -e "\.\[(\w+)\]"( +#.*)?', line).groups()[:1]
        assert extra in PROJECT["optional-dependencies"]


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")])
def test_the_scripts_run_one_after_the_other(page, tmp_path, small_sample, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Settings().save("defocus.json")
    image = np.asarray(small_sample)[:, 150:300]
    Image.fromarray(image).save("photo.jpg")
    write_ome_tiff_of_objective("cells.ome.tif", np.ascontiguousarray(image[..., 1]))
    texture = np.random.default_rng(0).uniform(0.1, 0.9, (96, 128)).astype(np.float32)
    names = {
        "__name__": "page",
        "image": image,
        "seeds": np.zeros(image.shape[:2], np.uint8),
        "blur_maps": np.full((3, 48, 64), 2.0, np.float32),
        "confidences": np.ones((3, 48, 64), np.float32),
        "pictures_of_a_point_source": lamps(),
        "stack": texture[None, None, :64, :80].repeat(2, axis=0),
        "z_stack": texture[None, :64, :80].repeat(3, axis=0),
        "slide": dask.array.from_array(texture, chunks=64),
    }
    names["seeds"][60:70, 40:50] = 1
    for block in blocks(page, "python"):
        exec(compile(block.replace(*PLACE), page, "exec"), names)
    if page == "scripts.md":
        assert names["depth"].shape == names["sharp"].shape[:2] == image.shape[:2]
    if page == "batches.md":
        assert names["blur_maps"].shape == names["confidence"].shape == names["stack"].shape
    if page == "lenses.md":
        assert "lens.npz" in names_in(tmp_path)
