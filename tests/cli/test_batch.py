"""The terminal command for many pictures: real workers of a scheduler, and what it tells."""

import json
import re

import numpy as np
import PIL.Image
import pytest
from command_line import assert_fails_in_one_line, names_in, run

from napari_defocus import Settings, measure_batch
from napari_defocus.batch.batch import BatchReport
from napari_defocus.batch.cluster import dask_client
from napari_defocus.cli import batch as batch_commands
from napari_defocus.settings import MapSettings, MaskSettings


@pytest.fixture(scope="module")
def address():
    """A scheduler with two workers, processes of their own."""
    with dask_client(workers=2) as client:
        yield client.scheduler.address


@pytest.fixture
def pictures(tmp_path, grass, monkeypatch):
    folder = tmp_path / "pictures"
    folder.mkdir()
    for name, column in (("left", 0), ("right", 60)):
        part = np.rint(255 * grass[:90, column : column + 96]).astype(np.uint8)
        PIL.Image.fromarray(part).save(folder / f"{name}.png")
    monkeypatch.chdir(tmp_path)
    return folder


def run_batch(address, *arguments):
    return run("batch", "pictures", "-o", "out", "--stride", 8, "--scheduler", address, *arguments)


def test_workers_of_a_scheduler_write_what_this_process_does(pictures, address):
    for name in ("notes.txt", "more.txt", "scan.oib"):
        (pictures / name).touch()
    result = run_batch(address, "--confidence", "--mask")
    assert result.exit_code == 0, result.output
    assert "pictures     2 of 2 measured\nleft out     2 .txt, 1 .oib\n" in result.stdout
    assert "careful" not in result.stdout
    assert result.stderr == ""
    wanted = {"confidence": True, "mask": True}
    settings = Settings(map=MapSettings(stride=8))
    measure_batch("pictures", "here", settings=settings, **wanted)
    there, here = pictures.parent / "out", pictures.parent / "here"
    assert names_in(there / "maps") == names_in(here / "maps")
    for path in (there / "maps").iterdir():
        assert path.read_bytes() == (here / "maps" / path.name).read_bytes()
    assert (there / "table.csv").read_bytes() == (here / "table.csv").read_bytes()


def test_map_command_writes_the_same_file(pictures, address):
    assert run_batch(address, "--quiet").stdout == ""
    assert run("map", "pictures/left.png", "-o", "left.tif", "--stride", 8).exit_code == 0
    alone = pictures.with_name("left.tif").read_bytes()
    assert (pictures.parent / "out" / "maps" / "left-blur.tif").read_bytes() == alone


def test_what_failed_is_counted_in_one_line_and_by_the_exit_code(pictures, address):
    (pictures / "bad.png").write_bytes(b"nothing")
    result = run_batch(address, "--json")
    assert result.exit_code == batch_commands.SOME_FAILED
    facts = json.loads(result.stdout)
    assert (facts["planes"], facts["failed"], facts["left_out"]) == (3, 1, {})
    named, counted = result.stderr.splitlines()
    assert named.startswith("napari-defocus: cannot read pictures/")
    assert counted == "napari-defocus: 1 could not be measured; the table says why"
    rows = (pictures.parent / "out" / "table.csv").read_text().splitlines()
    assert rows[1].startswith('pictures/bad.png,,failed,"cannot read pictures/bad.png: it')


@pytest.fixture
def asked(monkeypatch):
    """What a batch is asked for, instead of doing it."""
    seen = {}

    def note(inputs, output, **given):
        seen.update(given, inputs=inputs, output=output)
        return BatchReport(output / "table.csv", 0, 0)

    monkeypatch.setattr(batch_commands.napari_defocus, "measure_batch", note)
    return seen


def test_options_win_over_the_settings_file(pictures, address, asked):
    mask = MaskSettings(threshold=1.5, smoothness=300.0)
    Settings(map=MapSettings(window=31, smoothness=9.0), mask=mask).save("settings.json")
    given = ("--settings", "settings.json", "--window", 35, "--risk", 0.4, "--format", "tiff")
    result = run_batch(address, *given, "--block-size", 512, "--intensity-range", 0, 4095)
    assert result.exit_code == 0, result.output
    settings = asked["settings"]
    assert settings.map == MapSettings(window=35, smoothness=9.0, stride=8)
    assert settings.mask == mask
    assert settings.restoration.risk == 0.4
    assert (asked["file_format"], asked["block_size"]) == ("tiff", 512)
    assert asked["intensity_range"] == (0, 4095)
    result = run_batch(address, "--settings", "settings.json", "--threshold", 3)
    assert asked["settings"].mask == MaskSettings(threshold=3.0, smoothness=300.0)


@pytest.mark.parametrize(
    ("arguments", "saying"),
    [
        (["--scheduler", "nowhere"], "scheduler is 'nowhere'"),
        (["--workers", "0"], "workers is 0"),
        (["--risk", "3", "--workers", "1"], "risk is 3"),
        (["--psf", "square", "--workers", "1"], "square"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(pictures, arguments, saying):
    result = run("batch", "pictures", "-o", "out", *arguments)
    assert_fails_in_one_line(result, saying=saying)
    assert names_in(pictures.parent) == ["pictures"]


def test_other_results_than_before_are_all_that_is_said(pictures, address):
    assert run_batch(address).exit_code == 0
    saying = "what is made was map and is map, mask (give"
    assert_fails_in_one_line(run_batch(address, "--mask"), saying=saying)


def test_other_settings_than_before_are_said_in_one_line(pictures, address):
    assert run_batch(address).exit_code == 0
    result = run_batch(address, "--window", 31)
    saying = "window was 41 and is 31 (give another folder, or --force to measure all of it again)"
    assert_fails_in_one_line(result, saying=saying)


def test_what_is_out_of_focus_names_the_limit_and_its_option(pictures, address):
    result = run_batch(address, "--in-focus-up-to", 0.1)
    saying = r"flagged      2 of 2: 2 out of focus \(median above 0\.1 px, see --in-focus-up-to\)\n"
    assert re.search(saying, result.stdout), result.stdout
