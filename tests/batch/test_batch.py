"""Many pictures and stacks: what is measured, how it goes on, and what stops nothing else."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import PIL.Image
import psutil
import pytest
import tifffile
from command_line import names_in

import napari_defocus
from napari_defocus import Settings, measure_batch
from napari_defocus.batch import batch
from napari_defocus.batch import planes as batch_planes
from napari_defocus.batch import sources as batch_sources
from napari_defocus.batch import tiled_planes as batch_parts
from napari_defocus.core.writing import UnwritableResult
from napari_defocus.io.encoders import holds, settings_in_tiff, values_in_tiff
from napari_defocus.io.ome_zarr import read_ome_zarr
from napari_defocus.io.open import open_source
from napari_defocus.io.pictures import UnreadablePicture
from napari_defocus.io.tiff_writer import made_by
from napari_defocus.settings import MapSettings, MaskSettings

QUICK = Settings(map=MapSettings(stride=8))


def save(path, picture):
    path.parent.mkdir(exist_ok=True)
    PIL.Image.fromarray(np.rint(255 * picture).astype(np.uint8)).save(path)
    return path


@pytest.fixture
def photographs(tmp_path, grass, ramp_picture):
    folder = tmp_path / "photographs"
    save(folder / "grass.png", grass[:96, :112])
    save(folder / "ramp.png", ramp_picture[:100, :96].clip(0, 1))
    return folder


@pytest.fixture
def stack(tmp_path, grass):
    planes = np.rint(60000 * np.stack([grass[z : z + 96, :100] for z in (0, 20, 40)]))
    path = tmp_path / "worm.tif"
    scale = {"resolution": (4.0, 4.0), "metadata": {"axes": "ZYX", "unit": "um", "spacing": 2.0}}
    tifffile.imwrite(path, planes.astype(np.uint16), imagej=True, **scale)
    return path


def rows_of(report):
    return [
        json.loads(line) for line in report.table.with_suffix(".jsonl").read_text().splitlines()
    ]


def contents(folder):
    """Return all bytes but those of the hidden notes."""
    files = {path.relative_to(folder): path for path in folder.rglob("*") if path.is_file()}
    return {name: f.read_bytes() for name, f in files.items() if name.parts[0] != ".batch"}


@pytest.fixture
def measured(monkeypatch):
    """The pictures that are measured, as they are."""
    seen, measure = [], batch_planes.measure_map

    def note(picture, *rest):
        seen.append(picture.shape)
        return measure(picture, *rest)

    monkeypatch.setattr(batch_planes, "measure_map", note)
    return seen


def test_row_of_a_picture_that_tells_little_says_why(tmp_path):
    PIL.Image.fromarray(np.full((48, 60), 90, np.uint8)).save(tmp_path / "flat.png")
    report = measure_batch(tmp_path / "flat.png", tmp_path / "out", settings=QUICK)
    assert report.doubtful == 1
    assert "All pixels have the same value" in rows_of(report)[0]["careful"]


def test_maps_are_those_of_the_functions_and_rows_tell_of_them(photographs, tmp_path):
    wanted = {"confidence": True, "mask": True, "restore": True}
    report = measure_batch(photographs, tmp_path / "out", settings=QUICK, **wanted)
    assert (report.planes, report.failed) == (2, 0)
    assert names_in(tmp_path / "out" / "maps")[:4] == [
        *("grass-blur.tif", "grass-confidence.tif", "grass-in-focus.png", "grass-mask.png"),
    ]
    row = rows_of(report)[1]
    picture = np.asarray(PIL.Image.open(photographs / "ramp.png"))
    candidates = napari_defocus.estimate_candidates(picture, stride=8)
    blur_map = napari_defocus.label_blur_map(candidates, picture)
    sure = napari_defocus.confidence_map(candidates, blur_map)
    np.testing.assert_array_equal(values_in_tiff(tmp_path / "out" / row["map"]), blur_map)
    np.testing.assert_array_equal(values_in_tiff(tmp_path / "out" / row["confidence"]), sure)
    mask = np.asarray(PIL.Image.open(tmp_path / "out" / row["mask"])) > 0
    np.testing.assert_array_equal(mask, napari_defocus.segment_in_focus(candidates, picture))
    with PIL.Image.open(tmp_path / "out" / row["in_focus"]) as restored:
        assert restored.size == (96, 100)
    assert settings_in_tiff(tmp_path / "out" / row["map"])["stride"] == 8
    for percent, name in ((5, "p5"), (50, "median"), (95, "p95")):
        assert row[f"{name}_radius_px"] == pytest.approx(np.percentile(blur_map, percent), abs=0.01)
    assert row["median_confidence"] == pytest.approx(np.median(sure), abs=0.001)
    assert row["share_sure"] == pytest.approx((sure >= 0.5).mean(), rel=1e-5)
    threshold = napari_defocus.focus_threshold(candidates, picture)
    assert row["threshold_px"] == threshold
    known = sure >= 0.5
    assert row["share_in_focus"] == pytest.approx((blur_map[known] <= threshold).mean(), rel=1e-5)
    assert row["share_in_mask"] == pytest.approx(mask.mean(), rel=1e-5)
    safe = napari_defocus.cautious_blur_map(candidates, blur_map)
    noise = candidates.noise_variance
    _, fit = napari_defocus.restore_all_in_focus(
        picture, safe, confidence=sure, noise_variance=noise, return_fit=True
    )
    assert row["share_left_as_it_was"] == pytest.approx(fit.unrestored, rel=1e-5)
    assert row["noise_variance"] == pytest.approx(candidates.noise_variance, rel=1e-5)
    assert row["source"] == str(photographs / "ramp.png")


def test_stack_is_one_store_with_its_scale_and_a_row_a_plane(stack, tmp_path):
    report = measure_batch(stack, tmp_path / "out", settings=QUICK, mask=True)
    rows = rows_of(report)
    assert [row["plane"] for row in rows] == ["z=0", "z=1", "z=2"]
    assert {row["map"] for row in rows} == {"maps/worm-blur.ome.zarr"}
    assert {row["pixel_width_um"] for row in rows} == {0.25}
    assert names_in(tmp_path / "out" / "maps") == ["worm-blur.ome.zarr", "worm-mask.ome.zarr"]
    held = read_ome_zarr(tmp_path / "out" / rows[0]["map"])
    assert (held.axes, held.levels[0].shape) == ("zyx", (3, 96, 100))
    assert held.pixel_size == pytest.approx({"z": 2.0, "y": 0.25, "x": 0.25})
    assert holds(held.attributes) == "blur map"
    assert held.attributes["settings"]["stride"] == 8
    second = napari_defocus.estimate_blur_map(tifffile.imread(stack)[1], stride=8)
    np.testing.assert_array_equal(held.levels[0][1].compute(), second)
    planes = tifffile.imread(stack)
    candidates = napari_defocus.estimate_candidates(planes, stride=8, axes="zyx")
    threshold = napari_defocus.focus_threshold(candidates, planes)
    assert [row["threshold_px"] for row in rows] == [threshold] * 3, "one holds for all planes"
    masks = read_ome_zarr(tmp_path / "out" / rows[0]["mask"]).levels[0]
    expected = napari_defocus.segment_in_focus(candidates, planes, threshold=threshold)
    np.testing.assert_array_equal(masks.compute(), expected)


def test_planes_of_a_stack_share_the_lens_that_they_show(tmp_path, grass):
    sharp, radii = grass[:120, :120], np.full((120, 120), 4.0)
    ring = napari_defocus.simulate_defocus(
        sharp, radii, psf=napari_defocus.Annulus(0.5), noise_variance=1e-6, rng=0
    )
    planes = np.rint(60000 * np.stack([ring, sharp, ring[::-1]]).clip(0, 1)).astype(np.uint16)
    path = tmp_path / "worm.tif"
    tifffile.imwrite(path, planes, imagej=True, metadata={"axes": "ZYX"})
    settings = replace(QUICK, map=replace(QUICK.map, psf="auto"))
    report = measure_batch(path, tmp_path / "out", settings=settings, file_format="tiff")
    assert report.failed == 0
    found = tifffile.imread(tmp_path / "out" / rows_of(report)[0]["map"])
    lens = napari_defocus.Annulus(0.5)
    for plane, blur_map in zip(planes, found, strict=True):
        expected = napari_defocus.estimate_blur_map(plane, psf=lens, stride=8)
        np.testing.assert_array_equal(blur_map, expected)


def test_stack_can_be_a_tiff(stack, tmp_path):
    report = measure_batch(stack, tmp_path / "out", settings=QUICK, file_format="tiff")
    path = tmp_path / "out" / "maps" / "worm-blur.ome.tif"
    assert contents(tmp_path / "out").keys() >= {path.relative_to(tmp_path / "out")}
    assert made_by(path)["quantity"] == "defocus blur radius"
    assert open_source(path).data.shape == (3, 96, 100)
    assert not list((tmp_path / "out" / ".batch").rglob("*.ome.zarr"))
    assert rows_of(report)[2]["map"] == "maps/worm-blur.ome.tif"


def test_finished_pictures_are_not_measured_again(photographs, stack, tmp_path, measured):
    inputs, out = [photographs, stack], tmp_path / "out"
    report = measure_batch(inputs, out, settings=QUICK)
    before, count = contents(out), len(measured)
    assert (count, report.planes) == (5, 5)
    assert measure_batch(inputs, out, settings=QUICK) == report
    assert len(measured) == count
    save(photographs / "third.png", np.tile([0.2, 0.8], (64, 40)))
    measure_batch(inputs, out, settings=QUICK)
    assert measured[count:] == [(64, 80)]
    changed = {name.name for name, _ in before.items() - contents(out).items()}
    assert changed == {"table.csv", "table.jsonl", "report.html"}


def test_bad_picture_is_a_row_and_tried_again(photographs, tmp_path, measured):
    bad = photographs / "bad.png"
    bad.write_bytes((photographs / "ramp.png").read_bytes()[:900])
    report = measure_batch(photographs, tmp_path / "out", settings=QUICK)
    assert (report.planes, report.failed) == (3, 1)
    row = rows_of(report)[0]
    assert (row["source"], row["status"], row["map"]) == (str(bad), "failed", None)
    assert "cannot read" in row["error"]
    bad.write_bytes((photographs / "ramp.png").read_bytes())
    report = measure_batch(photographs, tmp_path / "out", settings=QUICK, force=True)
    assert (report.failed, len(measured)) == (0, 3)


def test_plane_that_fails_is_nan_until_it_is_measured(stack, tmp_path, monkeypatch, measured):
    calm = measure_batch(stack, tmp_path / "calm", settings=QUICK, mask=True)
    measure = batch_planes.measure_map

    def failing(picture, *rest):
        if (picture == tifffile.imread(stack)[1]).all():
            raise MemoryError
        return measure(picture, *rest)

    monkeypatch.setattr(batch_planes, "measure_map", failing)
    report = measure_batch(stack, tmp_path / "out", settings=QUICK, mask=True)
    assert [row["status"] for row in rows_of(report)] == ["done", "failed", "done"]
    assert rows_of(report)[1]["error"] == "there is not enough memory for this picture"
    held = read_ome_zarr(tmp_path / "out" / "maps" / "worm-blur.ome.zarr").levels[0].compute()
    assert np.isnan(held[1]).all()
    assert np.isfinite(held[[0, 2]]).all()
    monkeypatch.setattr(batch_planes, "measure_map", measure)
    count = len(measured)
    measure_batch(stack, tmp_path / "out", settings=QUICK, mask=True)
    assert len(measured) == count + 1
    assert contents(tmp_path / "out") == contents(calm.table.parent)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"inputs": 5}, "inputs is int"),
        ({"inputs": [5]}, "inputs holds a int"),
        ({"output": 5}, "output is int"),
        ({"confidence": "yes"}, "confidence is 'yes'"),
        ({"restore": np.eye(3)}, "restore is array"),
    ],
)
def test_what_is_of_another_type_is_refused(tmp_path, photographs, given, message):
    with pytest.raises(TypeError, match=message):
        measure_batch(**{"inputs": photographs, "output": tmp_path / "out"} | given)
    assert not (tmp_path / "out").exists()


def test_two_batches_at_once_do_not_meet_in_one_folder(tmp_path, photographs):
    refused = []

    def begin_another(step, done):
        with pytest.raises(UnwritableResult, match="another batch is at work there"):
            measure_batch(photographs, tmp_path / "out", settings=QUICK)
        refused.append(step)

    measure_batch(photographs, tmp_path / "out", settings=QUICK, progress=begin_another)
    assert refused
    assert measure_batch(photographs, tmp_path / "out", settings=QUICK).failed == 0


def test_changed_pictures_and_other_settings_are_measured_again_only_by_force(
    photographs, tmp_path, measured
):
    out = tmp_path / "out"
    measure_batch(photographs, out, settings=QUICK)
    before = contents(out)
    os.utime(photographs / "ramp.png", ns=(1, 1))
    with pytest.raises(UnwritableResult, match=r"of .*ramp.png, time of change was .* and is 1970"):
        measure_batch(photographs, out, settings=QUICK)
    measure_batch(photographs, out, settings=QUICK, force=True)
    assert (contents(out), len(measured)) == (before, 3)
    other = Settings(map=QUICK.map, mask=MaskSettings(threshold=3.0))
    with pytest.raises(UnwritableResult, match=r"threshold was auto and is 3.0"):
        measure_batch(photographs, out, settings=other)
    report = measure_batch(photographs, out, settings=other, force=True)
    assert len(measured) == 5
    assert rows_of(report)[1]["share_in_focus"] > 0.1


def test_names_that_are_alike_are_told_apart(tmp_path, grass):
    first, second = (save(tmp_path / name / "a.png", grass[:64, :64]) for name in "xy")
    third = save(tmp_path / "x" / "A.bmp", grass[:64, :64])
    report = measure_batch([first, second, third], tmp_path / "out", settings=QUICK)
    found = [row["map"] for row in rows_of(report)]
    assert found == ["maps/a-blur.tif", "maps/a-png-blur.tif", "maps/A-bmp-blur.tif"]


def test_what_is_there_is_not_overwritten_and_results_are_no_inputs(photographs, tmp_path):
    out = photographs
    (out / "maps").mkdir()
    (out / "maps" / "mine.tif").touch()
    with pytest.raises(UnwritableResult, match="maps exists, and no batch made it"):
        measure_batch(photographs, out, settings=QUICK)
    (out / "maps" / "mine.tif").unlink()
    pattern = photographs / "**" / "*"
    first = measure_batch(pattern, out, settings=QUICK)
    assert measure_batch(pattern, out, settings=QUICK) == first
    for results in (out / "maps", out / "maps" / "grass-blur.tif"):
        with pytest.raises(UnwritableResult, match="it is a result and an input"):
            measure_batch(results, out, settings=QUICK)
    with pytest.raises(UnwritableResult, match="there is no folder above it"):
        measure_batch(photographs, tmp_path / "no" / "out")
    with pytest.raises(UnreadablePicture, match="there is no such file"):
        measure_batch(tmp_path / "no.png", tmp_path / "other")
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("arguments", "saying"),
    [
        ({"min_confidence": 2}, "min_confidence is 2"),
        ({"file_format": "png"}, "file_format is 'png'"),
        ({"block_size": 10}, "block_size is 10"),
        ({"settings": Settings(mask=MaskSettings(threshold=65))}, "threshold is 65"),
    ],
)
def test_impossible_settings_are_said_first(photographs, tmp_path, arguments, saying):
    with pytest.raises(ValueError, match=saying):
        measure_batch(photographs, tmp_path / "out", **arguments)
    assert not (tmp_path / "out").exists()


def test_worker_that_cannot_take_part_is_told(tmp_path):
    plan = tmp_path / ".batch" / "plan.json"
    version = napari_defocus.__version__
    assert "it does not see" in batch._objection(str(plan), version)
    assert "and 9.9 is at work" in batch._objection(str(plan), "9.9")
    plan.parent.mkdir()
    plan.touch()
    assert batch._objection(str(plan), version) is None


def test_progress_counts_planes_and_says_how_long_it_will_take(photographs, stack, tmp_path):
    told = []
    measure_batch(
        [photographs, stack],
        tmp_path / "out",
        settings=QUICK,
        progress=lambda step, done: told.append((step, done)),
    )
    shares = [done for step, done in told if "planes" in step]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert told[-1][0] == "5 of 5 planes"
    assert any(step.startswith("2 of 5 planes, ") and step.endswith(" left") for step, _ in told)


def test_large_plane_is_measured_in_parts_and_goes_on(tmp_path, grass, monkeypatch):
    picture = np.tile(np.pad(grass, ((0, 160), (0, 160)), mode="symmetric"), (1, 2))[:200, :600]
    path = save(tmp_path / "wide.png", picture)
    wanted = {"settings": QUICK, "restore": True, "min_confidence": 0.2, "block_size": 512}
    whole = measure_batch(path, tmp_path / "whole", **wanted)
    monkeypatch.setattr(batch_sources, "LARGEST_AT_ONCE", 100_000)
    write = batch_parts.write_note

    def only_one(path, note):
        write(path, note)
        raise OSError("the disk is full")

    monkeypatch.setattr(batch_parts, "write_note", only_one)
    report = measure_batch(path, tmp_path / "out", **wanted)
    assert rows_of(report)[0]["error"] == "the disk is full"
    assert names_in(tmp_path / "out" / "maps") == []
    monkeypatch.setattr(batch_parts, "write_note", write)
    monkeypatch.setattr(batch_parts.napari_defocus, "estimate_candidates", pytest.fail)
    report = measure_batch(path, tmp_path / "out", **wanted)
    (row,), (as_one,) = rows_of(report), rows_of(whole)
    assert row["map"] == "maps/wide-blur.tif"
    assert row["in_focus"] == "maps/wide-in-focus.tif"
    for name in ("median_radius_px", "share_sure", "p95_radius_px", "share_left_as_it_was"):
        assert row[name] == pytest.approx(as_one[name], abs=0.03)
    assert row["threshold_px"] == as_one["threshold_px"]
    for ending, apart in ((".jpg", 4), ("-blur.png", 4), ("-detail.jpg", 60)):
        found, expected = (
            np.asarray(PIL.Image.open(folder / "thumbnails" / f"wide{ending}"), float)
            for folder in (tmp_path / "out", tmp_path / "whole")
        )
        assert np.abs(found - expected).mean() < apart, ending
    assert not list((tmp_path / "out" / ".batch").rglob("*.npz"))
    found, expected = (
        open_source(folder / "maps" / "wide-blur.tif").data.compute()
        for folder in (tmp_path / "out", tmp_path / "whole")
    )
    assert np.nanmean(np.abs(found - expected)) < 0.03


def start(inputs, output, workers):
    # Where tests run in the background, SIGINT is ignored, also by what they start.
    heeding = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code = heeding + "from napari_defocus.cli.app import main; main()"
    command = [sys.executable, "-c", code, "batch"]
    command += [str(inputs), "-o", str(output), "--workers", str(workers), "--stride", "8"]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)


def wait_for(condition, process):
    # Workers may compile every kernel first, on a machine that does other things, too.
    while not condition():
        assert process.poll() is None
        time.sleep(0.005)


def test_killed_ended_and_short_of_a_worker_the_bytes_are_the_same(
    photographs, stack, tmp_path, grass
):
    for number in range(18):  # so many that none of the runs is over too early
        save(photographs / f"more{number}.png", np.roll(grass, 3 * number)[:112, :112])
    (photographs / "cut.tif").write_bytes(stack.read_bytes()[:300])  # of which tifffile complains
    stack.rename(photographs / stack.name)
    calm, out = tmp_path / "calm", tmp_path / "out"
    measure_batch(photographs, calm, settings=QUICK)

    def finished():
        return len(list(out.glob(".batch/sources/*/plane*.json")))

    process = start(photographs, out, workers=2)
    wait_for(lambda: finished() >= 1, process)
    children = psutil.Process(process.pid).children()
    workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
    assert len(workers) == 2
    workers[0].kill()
    count = finished()
    wait_for(lambda: finished() > count, process)
    process.kill()
    process.communicate()
    assert not psutil.wait_procs(workers, timeout=300)[1]
    count = finished()
    assert 2 <= count < 23

    process = start(photographs, out, workers=1)
    wait_for(lambda: finished() > count, process)
    # As a terminal does: the workers get it, too.
    os.killpg(process.pid, signal.SIGINT)
    told = process.communicate()[1].splitlines()
    assert process.returncode == 130
    assert told[0] == "napari-defocus: interrupted"
    assert told[1].endswith("the same command goes on from there")
    assert len(told) == 2
    # Rows follow the order of the sources: how many there are yet, depends on which were quick.
    with (out / "table.csv").open(newline="") as table:
        rows = list(csv.reader(table))
    assert {len(row) for row in rows} == {len(rows[0])}

    measure_batch(photographs, out, settings=QUICK)
    assert contents(out) == contents(calm)
    assert not list(out.rglob("*.part"))
