"""The terminal command for stacks through focus."""

import json

import numpy as np
import pytest
import tifffile
from command_line import assert_fails_in_one_line, names_in, run

import napari_defocus
from napari_defocus.sources import open_source
from napari_defocus.tiff_stacks import made_by


@pytest.fixture(scope="module")
def planes(grass, defocused):
    tilt = np.linspace(0.5, 5.5, 120, dtype=np.float32)
    sharp = grass[:100, :120]
    blurred = [
        napari_defocus.simulate_defocus(sharp, np.broadcast_to(np.abs(z - tilt), sharp.shape))
        for z in range(7)
    ]
    return np.rint(60000 * np.clip(blurred, 0, 1)).astype(np.uint16)


@pytest.fixture
def stack(tmp_path, planes):
    path = tmp_path / "worm.tif"
    resolution = {"resolution": (4.0, 4.0), "metadata": {"axes": "ZYX", "unit": "um"}}
    tifffile.imwrite(path, planes, imagej=True, **resolution)
    return path


def test_composite_and_positions_are_those_of_the_function_and_keep_the_scale(stack, planes):
    folder = stack.parent
    position, sure = folder / "z.tif", folder / "sure.tif"
    result = run("sharpest", stack, "--position", position, "--confidence", sure)
    assert result.exit_code == 0, result.output
    assert "7 planes of 120 x 100 px" in result.stdout
    assert names_in(folder) == ["sure.tif", "worm-sharpest.tif", "worm.tif", "z.tif"]
    found = napari_defocus.sharpest_plane(planes, axes="zyx")
    np.testing.assert_array_equal(tifffile.imread(folder / "worm-sharpest.tif"), found.composite)
    np.testing.assert_array_equal(tifffile.imread(position), found.position)
    np.testing.assert_array_equal(tifffile.imread(sure), found.confidence)
    assert made_by(position)["quantity"] == "position of best focus"
    assert open_source(position).scale == pytest.approx({"y": 0.25, "x": 0.25})


def test_json_tells_the_planes_and_given_px_are_used(stack):
    output = stack.with_name("all.tif")
    result = run("sharpest", stack, "-o", output, "--px-per-plane", 1, "--json")
    facts = json.loads(result.stdout, parse_constant=pytest.fail)
    assert facts["px_per_plane"] == 1
    assert sum(facts["share_of_plane"]) == pytest.approx(1)
    assert facts["files"] == [str(output)]


@pytest.mark.parametrize(
    ("arguments", "saying"),
    [
        (["-o", "x.png"], "must end in .tif"),
        (["--px-per-plane", "0"], "px_per_plane is 0"),
        (["-o", "worm.tif", "--force"], "it is a file that is read"),
    ],
)
def test_what_cannot_be_done_is_said_first(stack, monkeypatch, arguments, saying):
    monkeypatch.chdir(stack.parent)
    assert_fails_in_one_line(run("sharpest", stack, *arguments), saying=saying)
    assert names_in(stack.parent) == ["worm.tif"]


def test_single_plane_and_two_axes_of_planes_are_refused(stack, planes):
    tifffile.imwrite(stack, planes[0])
    assert_fails_in_one_line(run("sharpest", stack), saying="has a single plane")
    tifffile.imwrite(stack, np.stack([planes, planes]), imagej=True, metadata={"axes": "TZYX"})
    assert_fails_in_one_line(run("sharpest", stack), saying="planes, 2 along t and 7 along z")
