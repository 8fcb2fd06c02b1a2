"""The terminal command for stacks through focus."""

import json
import re

import imagecodecs
import numpy as np
import pytest
import tifffile
from command_line import assert_fails_in_one_line, names_in, run
from microscope_files import (
    write_imagej,
    write_lsm,
    write_ome_tiff,
    write_ome_zarr,
    write_pages,
    write_stk,
)
from PIL import Image

import napari_defocus
from napari_defocus.io.open import open_source, open_stack
from napari_defocus.io.tiff_writer import made_by, write_pyramidal_tiff


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
    best, second = np.argsort(found.share_of_plane)[:-3:-1]
    shares = f"{found.share_of_plane[best]:.0%}", f"{found.share_of_plane[second]:.0%}"
    assert f"plane {best} ({shares[0]}); then {second} ({shares[1]})" in result.stdout
    np.testing.assert_array_equal(tifffile.imread(folder / "worm-sharpest.tif"), found.composite)
    np.testing.assert_array_equal(tifffile.imread(position), found.position)
    np.testing.assert_array_equal(tifffile.imread(sure), found.confidence)
    assert made_by(position)["quantity"] == "position of best focus"
    assert open_source(position).pixel_size == pytest.approx({"y": 0.25, "x": 0.25})


def test_json_tells_the_planes_and_given_px_are_used(stack):
    output = stack.with_name("all.png")
    result = run("sharpest", stack, "-o", output, "--px-per-plane", 1, "--json")
    facts = json.loads(result.stdout, parse_constant=pytest.fail)
    assert facts["px_per_plane"] == 1
    assert sum(facts["share_of_plane"]) == pytest.approx(1)
    assert facts["files"] == [str(output)]
    same = napari_defocus.sharpest_plane(tifffile.imread(stack), axes="zyx", px_per_plane=1)
    with Image.open(output) as png:
        np.testing.assert_array_equal(np.asarray(png), same.composite)
    assert_fails_in_one_line(run("sharpest", stack, "-o", output), saying="--force overwrites it")


@pytest.mark.parametrize("order", ["<", ">"])
def test_png_holds_numbers_of_either_byte_order(tmp_path, planes, order):
    path = tmp_path / "worm.tif"
    tifffile.imwrite(path, planes[:, :50, :60], byteorder=order, metadata={"axes": "ZYX"})
    found = run("sharpest", path, "--px-per-plane", 1, "-o", tmp_path / "worm.png")
    assert found.exit_code == 0, found.output
    expected = napari_defocus.sharpest_plane(planes[:, :50, :60], axes="zyx", px_per_plane=1)
    with Image.open(tmp_path / "worm.png") as png:
        np.testing.assert_array_equal(np.asarray(png), expected.composite)


def test_png_does_not_take_numbers_that_it_cannot_hold(tmp_path, planes):
    path = tmp_path / "worm.tif"
    tifffile.imwrite(path, planes[:, :50, :60].astype(np.float32), metadata={"axes": "ZYX"})
    result = run("sharpest", path, "-o", tmp_path / "worm.png")
    assert_fails_in_one_line(result, saying="holds float32; PNG takes 8 or 16 bit, .tif any")


def test_alignment_is_saved_used_and_told(tmp_path, planes):
    path, kept = tmp_path / "worm.tif", tmp_path / "lain.json"
    moved = np.stack([np.roll(plane, 2 * number, axis=1) for number, plane in enumerate(planes)])
    tifffile.imwrite(path, moved[:, :, 16:], metadata={"axes": "ZYX"})
    result = run("sharpest", path, "--save-alignment", kept)
    assert result.exit_code == 0, result.output
    assert "Planes were aligned: shifts up to 6" in result.stdout
    shift = napari_defocus.StackAlignment.load(kept).shift
    np.testing.assert_allclose(shift[:, 1], 2 * (np.arange(7) - 3), atol=0.2)
    again = run(
        "sharpest", path, "--use-alignment", kept, "--force", "--json", "--composite", "pixels"
    )
    assert json.loads(again.stdout)["largest_motion_px"] == pytest.approx(6, abs=0.3)
    never = run("sharpest", path, "--align", "no", "--match-brightness", "no", "--force", "--json")
    assert json.loads(never.stdout)["notes"] == []
    both = run("sharpest", path, "--align", "no", "--use-alignment", kept, "--force")
    assert_fails_in_one_line(both, saying="are both given; it takes one")


def test_all_channels_are_put_together_at_the_positions_of_one(tmp_path, small):
    path = written(tmp_path, "ome-tiff", small, "zCyx")
    every = tmp_path / "all.tif"
    picture, _ = sharpest_of(path, "--channel", 1, "--composite", "pixels", "--all-channels", every)
    found = tifffile.imread(every)
    assert found.shape == (2, 50, 60)
    np.testing.assert_array_equal(found[1], picture)
    flat = tmp_path / "flat.tif"
    tifffile.imwrite(flat, small, metadata={"axes": "ZYX"})
    result = run("sharpest", flat, "--all-channels", every, "--force")
    assert_fails_in_one_line(result, saying="has no channels")


@pytest.mark.parametrize(
    ("arguments", "saying"),
    [
        (["-o", "x.jpg"], "must end in .tif"),
        (["--px-per-plane", "0"], "--px-per-plane is 0"),
        (["-o", "worm.tif", "--force"], "it is a file that is read"),
    ],
)
def test_what_cannot_be_done_is_said_first(stack, monkeypatch, arguments, saying):
    monkeypatch.chdir(stack.parent)
    assert_fails_in_one_line(run("sharpest", stack, *arguments), saying=saying)
    assert names_in(stack.parent) == ["worm.tif"]


def test_single_plane_is_refused(stack, planes):
    tifffile.imwrite(stack, planes[0])
    assert_fails_in_one_line(run("sharpest", stack), saying="has a single plane")


def test_stack_of_blur_maps_is_no_stack_through_focus(tmp_path, planes):
    path = tmp_path / "worm-blur.ome.tif"
    about = {"quantity": "defocus blur radius"}
    write_pyramidal_tiff(path, planes.astype(np.float32), axes="zyx", description=about)
    assert_fails_in_one_line(run("sharpest", path), saying="a result of napari-defocus (defocus b")


# --- which axis is that of the focus --------------------------------------------------------

WRITERS = {
    "ome-zarr": (write_ome_zarr, ".zarr"),
    "ome-tiff": (write_ome_tiff, ".ome.tif"),
    "imagej": (write_imagej, ".tif"),
    "pages": (write_pages, ".tif"),
    "lsm": (write_lsm, ".lsm"),
    "stk": (write_stk, ".stk"),
}


@pytest.fixture(scope="module")
def small(planes):
    """A stack that takes little time: (7, 50, 60)."""
    return np.ascontiguousarray(planes[:, :50, :60])


@pytest.fixture(scope="module")
def expected(small):
    return napari_defocus.sharpest_plane(small, px_per_plane=1.0).composite


def written(folder, kind, small, axes):
    """Write a stack with two channels, or times, where `axes` has them in capitals.

    Of two, the second is the stack; the first is turned upside down.
    """
    values, order = small, "zyx"
    for axis in axes:
        if axis.lower() not in order:
            values = np.stack([values[:, ::-1], values]) if axis.isupper() else values[None]
            values, order = np.moveaxis(values, 0, -1), order + axis.lower()
    values = values.transpose([order.index(axis) for axis in axes.lower()])
    write, ending = WRITERS[kind]
    return write(folder / f"stack{ending}", np.ascontiguousarray(values), axes.lower())


def sharpest_of(path, *options):
    """Return the picture of the sharpest pixels of a stack, and what is told."""
    output = path.with_name("out.tif")
    result = run("sharpest", path, "-o", output, "--px-per-plane", 1, *options)
    assert result.exit_code == 0, result.output
    return tifffile.imread(output), result.stdout


@pytest.mark.parametrize(
    ("kind", "axes", "options"),
    [
        ("ome-zarr", "tczyx", ()),
        ("ome-zarr", "czyx", ()),
        ("ome-zarr", "zyx", ()),
        ("ome-zarr", "tCzyx", ("--channel", 1)),
        ("ome-zarr", "TCzyx", ("--channel", 1, "--time", 1)),
        ("ome-zarr", "zCtyx", ("--channel", 1)),
        ("ome-tiff", "zCyx", ("--channel", 1)),
        ("ome-tiff", "TCzyx", ("--channel", 1, "--time", 1)),
        ("ome-tiff", "tczyx", ()),
        ("imagej", "zCyx", ("--channel", 1)),
        ("imagej", "TzCyx", ("--channel", 1, "--time", 1)),
        ("lsm", "zyx", ()),
        ("stk", "zyx", ()),
    ],
)
def test_stacks_of_all_kinds_are_the_stack_that_is_chosen(
    tmp_path, small, expected, kind, axes, options
):
    composite, told = sharpest_of(written(tmp_path, kind, small, axes), *options)
    np.testing.assert_array_equal(composite, expected)
    assert "7 planes of 60 x 50 px" in told
    assert "focus  " not in told
    assert ("channel      1 (from 0)" in told) == ("--channel" in options)


def test_channels_of_a_confocal_microscope_are_chosen(tmp_path, small, expected):
    values = np.stack([small[:, ::-1], small, small // 2], axis=1)
    path = write_lsm(tmp_path / "a.lsm", values, "zcyx")
    composite, _ = sharpest_of(path, "--channel", 1)
    np.testing.assert_array_equal(composite, expected)


@pytest.mark.parametrize(
    ("kind", "axes", "note"),
    [
        ("imagej", "tyx", "t was taken for focus; it is the only axis with more than one plane"),
        ("ome-tiff", "tyx", "t was taken for focus"),
        ("ome-zarr", "tyx", "t was taken for focus"),
        ("stk", "tyx", "t was taken for focus"),
        ("pages", "zyx", "pages were taken for planes through focus; the file does not say"),
    ],
)
def test_planes_that_are_not_called_so_are_taken_with_a_word(
    tmp_path, small, expected, kind, axes, note
):
    write, ending = WRITERS[kind]
    composite, told = sharpest_of(write(tmp_path / f"s{ending}", small, axes))
    np.testing.assert_array_equal(composite, expected)
    assert f"focus        {note}" in told


def test_stack_in_colour_is_no_stack_of_colours(tmp_path, small):
    colors = (np.stack([small, small // 2, small // 3], axis=-1) >> 8).astype(np.uint8)
    path = write_imagej(tmp_path / "s.tif", colors, "zyxs")
    composite, told = sharpest_of(path)
    assert composite.shape == (50, 60, 3)
    assert "7 planes" in told


@pytest.mark.parametrize(
    ("kind", "axes", "saying"),
    [
        ("imagej", "cyx", "stack.tif has 7 along c, and channels are not planes through focus"),
        ("ome-tiff", "cyx", "channels are not planes through focus"),
        ("ome-zarr", "cyx", "channels are not planes through focus"),
        ("ome-zarr", "tczyx", "has a single plane; it takes two or more along an axis such as z"),
        ("ome-tiff", "zCyx", "has 7 along z and 2 along c; --channel chooses one"),
        ("ome-zarr", "tCzyx", "has 2 along c and 7 along z; --channel chooses one"),
        ("imagej", "Tzyx", "has 2 along t and 7 along z; --time chooses one"),
        ("ome-zarr", "TCzyx", "; --time and --channel choose one of each"),
    ],
)
def test_what_does_not_say_which_planes_are_meant_is_told_how_to(
    tmp_path, small, kind, axes, saying
):
    if axes == "cyx":
        write, ending = WRITERS[kind]
        path = write(tmp_path / f"stack{ending}", small, axes)
    else:
        given = small[:1] if axes == "tczyx" else small
        path = written(tmp_path, kind, given, axes)
    assert_fails_in_one_line(run("sharpest", path), saying=saying)
    assert names_in(tmp_path) == [path.name]


def test_channel_of_a_store_is_known_by_its_type(tmp_path, small):
    path = write_ome_zarr(tmp_path / "s.zarr", small, "wyx", {"w": "channel"})
    assert_fails_in_one_line(run("sharpest", path), saying="channels are not planes")


@pytest.mark.parametrize(
    ("options", "saying"),
    [
        (("--channel", 2), "--channel is 2; {} has 2 along c, counted from 0"),
        (("--time", 0), "--time is 0; {} has no axis t to choose from"),
    ],
)
def test_channel_that_is_not_there_is_refused(tmp_path, small, options, saying):
    path = written(tmp_path, "ome-zarr", small, "Czyx")
    assert_fails_in_one_line(run("sharpest", path, *options), saying=saying.format(path))


# --- pictures that are planes ---------------------------------------------------------------


def pictures_of(folder, small, ending):
    folder.mkdir()
    paths = [folder / f"slice{number}{ending}" for number in range(5, 12)]
    for path, plane in zip(paths, small, strict=True):
        if ending == ".png":
            path.write_bytes(imagecodecs.png_encode(plane))
        elif ending == ".tif":
            tifffile.imwrite(path, plane[None, None], imagej=True)
        else:
            write_ome_zarr(path, plane[None, None, None], "tczyx")
    return paths


@pytest.mark.parametrize("ending", [".png", ".tif", ".zarr"])
def test_folder_of_pictures_is_a_stack_in_natural_order(
    tmp_path, small, expected, monkeypatch, ending
):
    paths = pictures_of(tmp_path / "slices", small, ending)
    (tmp_path / "slices" / "notes.txt").touch()
    monkeypatch.chdir(tmp_path)
    result = run("sharpest", "slices", "--px-per-plane", 1)
    assert result.exit_code == 0, result.output
    assert "slices, 7 planes of 60 x 50 px\n" in result.stdout
    assert f"pictures     from slice5{ending} to slice11{ending}\n" in result.stdout
    number, slice_number = re.search(r"plane (\d) \(\d+%\), slice(\d+)", result.stdout).groups()
    assert int(slice_number) == int(number) + 5
    np.testing.assert_array_equal(tifffile.imread("slices-sharpest.tif"), expected)
    shuffled = sorted(paths, key=lambda path: path.name)
    result = run("sharpest", *shuffled, "--px-per-plane", 1, "--json")
    facts = json.loads(result.stdout)
    assert facts["pictures"] == [path.name for path in paths]
    assert facts["files"] == [str(tmp_path / "slices" / "slice5-sharpest.tif")]
    np.testing.assert_array_equal(tifffile.imread(facts["files"][0]), expected)
    again = run("sharpest", "slices", "--px-per-plane", 1, "--force", "--json")
    assert json.loads(again.stdout)["planes"] == 7
    named = run("sharpest", *paths, facts["files"][0], "-o", "x.tif")
    assert_fails_in_one_line(named, saying="it was made of the sharpest pixels of a stack")


def test_pictures_may_have_channels_of_which_one_is_chosen(tmp_path, small, expected):
    for number, plane in enumerate(small):
        path = tmp_path / f"z{number}.ome.tif"
        write_ome_tiff(path, np.stack([plane[::-1], plane]), "cyx")
    opened = open_stack(tmp_path)
    assert (opened.axes, opened.data.shape) == ("zcyx", (7, 2, 50, 60))
    result = run("sharpest", tmp_path, "--channel", 1, "--px-per-plane", 1, "-o", tmp_path / "o")
    assert_fails_in_one_line(result, saying="must end in .tif")
    output = tmp_path / "out.tif"
    result = run("sharpest", tmp_path, "--channel", 1, "--px-per-plane", 1, "-o", output)
    assert result.exit_code == 0, result.output
    np.testing.assert_array_equal(tifffile.imread(output), expected)
    assert_fails_in_one_line(run("sharpest", tmp_path), saying="--channel chooses one")


@pytest.mark.parametrize(
    ("odd", "saying"),
    [
        (lambda plane: plane[:-1], "it is 60 x 49 px, uint16, and others are 60 x 50 px, uint16"),
        (lambda plane: (plane >> 8).astype(np.uint8), "it is 60 x 50 px, uint8, and others"),
        (lambda plane: np.stack([plane] * 3, axis=-1), "it is 60 x 50 px of 3 colours, uint16"),
    ],
)
@pytest.mark.parametrize("at", [0, 3])
def test_picture_that_does_not_fit_is_named(tmp_path, small, odd, saying, at):
    path = pictures_of(tmp_path / "slices", small, ".png")[at]
    path.write_bytes(imagecodecs.png_encode(odd(small[at])))
    result = run("sharpest", tmp_path / "slices")
    assert_fails_in_one_line(result, saying=f"cannot read {path} as a plane of a stack: {saying}")


def test_stack_among_pictures_and_a_single_picture_are_refused(tmp_path, small):
    folder = tmp_path / "slices"
    paths = pictures_of(folder, small, ".png")
    write_imagej(folder / "all.tif", small, "zyx")
    assert_fails_in_one_line(
        run("sharpest", folder), saying="all.tif as a plane of a stack: it has"
    )
    for path in paths:
        path.unlink()
    assert_fails_in_one_line(run("sharpest", folder), saying="it is one picture, all.tif; give two")
    (folder / "all.tif").unlink()
    (folder / "a.txt").touch()
    assert_fails_in_one_line(run("sharpest", folder), saying="has no pictures")


def test_no_picture_of_a_stack_is_overwritten(tmp_path, small):
    paths = pictures_of(tmp_path / "slices", small, ".tif")
    result = run("sharpest", *paths, "-o", paths[3], "--force")
    assert_fails_in_one_line(result, saying="it is a file that is read")


def test_heights_are_in_um_with_the_z_step_of_the_file_or_a_typed_one(stack, tmp_path, planes):
    assert_fails_in_one_line(
        run("sharpest", stack, "--height", tmp_path / "h.tif"), saying="--z-step"
    )
    outputs = ["-o", tmp_path / "a.tif", "--position", tmp_path / "p.tif"]
    typed = run("sharpest", stack, "--height", tmp_path / "h.tif", "--z-step", 1.5, *outputs)
    assert "planes 1.5 um apart" in typed.output
    height, position = (tifffile.imread(tmp_path / name) for name in ("h.tif", "p.tif"))
    np.testing.assert_allclose(height, 1.5 * position, rtol=1e-6)
    assert made_by(tmp_path / "h.tif")["unit"] == "um"
    noted = tmp_path / "noted.tif"
    about = {"axes": "ZYX", "unit": "um", "spacing": 0.5}
    tifffile.imwrite(noted, planes, imagej=True, resolution=(4, 4), metadata=about)
    told = json.loads(run("sharpest", noted, "-o", tmp_path / "b.tif", "--json").output)
    assert told["z_step_um"] == 0.5
    assert told["height_p95_um"] == pytest.approx(0.5 * np.percentile(position, 95), rel=1e-3)
