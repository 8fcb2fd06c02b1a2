"""The terminal command: what it prints, what it writes, and how it fails."""

import csv
import json
import os
import re
import subprocess
import sys
from dataclasses import fields
from importlib.resources import files
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
import typer
from command_line import assert_fails_in_one_line, full_disk, names_in, run
from PIL import Image
from scipy.ndimage import uniform_filter1d

import napari_defocus
from napari_defocus import Annulus, Disc, Gaussian, MeasuredPSF, Polygon, ShotNoise
from napari_defocus.cli.app import app
from napari_defocus.core.intensity import Intensities
from napari_defocus.io.encoders import settings_in_tiff
from napari_defocus.settings import COMPARED_PSFS, MapSettings, MaskSettings

SAMPLE = files("napari_defocus") / "samples" / "dandelion.jpg"


@pytest.fixture
def picture(tmp_path):
    """A folder with nothing but a small picture in it; returns the picture's path."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    with Image.open(str(SAMPLE)) as sample:
        sample.crop((140, 60, 236, 140)).save(folder / "seed.png")
    return folder / "seed.png"


@pytest.fixture
def instant(monkeypatch):
    """Stand-ins for the method, where a test is not about its results; keeps their arguments."""
    calls = {}

    def estimate_candidates(image, **options):
        calls["candidates"] = options
        noise = options["noise_variance"]
        return SimpleNamespace(
            psf_choice=None,
            doubt=None,
            image_shape=image.shape[:2],
            noise_variance=1e-4,
            noise_growth=1.5,
            psf=options["psf"],
            shot_noise=noise if isinstance(noise, napari_defocus.ShotNoise) else None,
            intensities=Intensities(0.0, 255.0, "number type"),
        )

    def label_blur_map(candidates, image, **options):
        calls["map"] = options
        return np.full(image.shape[:2], 2.5, np.float32)

    def segment_in_focus(candidates, image, **options):
        calls["mask"] = options
        return np.ones(image.shape[:2], np.uint8)

    def confidence_map(candidates, blur_map):
        return np.linspace(0, 1, blur_map.size, dtype=np.float32).reshape(blur_map.shape)

    def focus_threshold(candidates, image, **options):
        calls["threshold"] = options
        return 2.3

    def known_places(candidates, image, **options):
        return np.ones(image.shape[:2], bool)

    made = estimate_candidates, label_blur_map, segment_in_focus, confidence_map
    for function in (*made, focus_threshold, known_places):
        monkeypatch.setattr(napari_defocus, function.__name__, function)
    return calls


# --- what the commands do -------------------------------------------------------------------


def test_map_writes_radii_in_px_and_a_drawing(picture):
    result = run("map", picture)
    assert result.exit_code == 0, result.output
    assert names_in(picture.parent) == ["seed-blur.png", "seed-blur.tif", "seed.png"]
    radius = tifffile.imread(picture.with_name("seed-blur.tif"))
    assert radius.shape == (80, 96)
    assert radius.dtype == np.float32
    assert 0 <= radius.min() <= radius.max() <= 8
    assert "96 x 80 px" in result.stdout
    assert f"median {np.median(radius):.1f} px" in result.stdout
    assert "seed-blur.tif" in result.stdout


def test_map_says_in_the_file_what_made_it(picture):
    assert run("map", picture, "--smoothness", 5).exit_code == 0
    with tifffile.TiffFile(picture.with_name("seed-blur.tif")) as tiff:
        description = json.loads(tiff.pages[0].description)
    assert description["unit"] == "px"
    assert description["settings"]["smoothness"] == 5
    assert description["settings"]["max_radius"] == MapSettings.max_radius
    assert description["settings"]["noise_variance"] > 0, "the variance that was found"


def test_segment_writes_a_mask_and_an_overlay(picture):
    result = run("segment", picture)
    assert result.exit_code == 0, result.output
    assert names_in(picture.parent) == ["seed-mask.png", "seed-overlay.png", "seed.png"]
    mask = np.asarray(Image.open(picture.with_name("seed-mask.png")))
    overlay = np.asarray(Image.open(picture.with_name("seed-overlay.png")))
    assert mask.shape == (80, 96)
    assert set(np.unique(mask)) <= {0, 255}
    assert overlay.shape == (80, 96, 3)
    assert "careful      The blur is not known on 99 %" in result.stdout, "it is a plain piece"


def test_segment_leaves_what_is_not_known_and_judges_within_a_file_if_asked(picture):
    with Image.open(str(SAMPLE)) as sample:
        sample.crop((480, 140, 576, 220)).save(picture)
    tissue = np.zeros((80, 96), np.uint8)
    tissue[:, 48:] = 9
    Image.fromarray(tissue).save(picture.with_name("tissue.png"))
    asked = ["--unknown", "leave", "--within", picture.with_name("tissue.png"), "--json"]
    result = run("segment", picture, *asked)
    assert result.exit_code == 0, result.output
    mask = np.asarray(Image.open(picture.with_name("seed-mask.png")))
    assert (mask[:, :48] == 128).all()
    facts = json.loads(result.stdout)
    known = mask != 128
    assert facts["known_percent"] == pytest.approx(100 * known.mean())
    assert facts["in_focus_percent"] == pytest.approx(100 * (mask == 255).sum() / known.sum())
    assert facts["threshold_found"]
    assert 1 <= facts["threshold_px"] <= 3.5
    told = run("segment", picture, *asked[:-1], "--force").stdout
    assert f"% of what is known ({100 * known.mean():.1f} % of the picture); blur up to" in told
    assert "px, found from the picture" in told


@pytest.mark.parametrize("ending", [".png", ".tif"])
def test_segment_keeps_to_the_seeds_and_tells_of_them(picture, ending):
    seeds = np.zeros((80, 96), np.uint8)
    seeds[10:20, 10:30], seeds[60:70, 50:80] = 1, 2
    path = picture.with_name(f"known{ending}")
    tifffile.imwrite(path, seeds) if ending == ".tif" else Image.fromarray(seeds).save(path)
    result = run("segment", picture, "--seeds", path)
    assert result.exit_code == 0, result.output
    assert f"200 px in focus, 300 px blurred, from {path}" in result.stdout
    mask = np.asarray(Image.open(picture.with_name("seed-mask.png")))
    assert (mask[seeds == 1] == 255).all()
    assert (mask[seeds == 2] == 0).all()


def test_segment_writes_a_table_of_regions(picture):
    path = picture.with_name("regions.csv")
    result = run("segment", picture, "--regions", path)
    assert result.exit_code == 0, result.output
    assert names_in(picture.parent) == [
        "regions.csv",
        "seed-mask.png",
        "seed-overlay.png",
        "seed.png",
    ]
    with path.open(newline="") as file:
        blurred, *regions = csv.DictReader(file)
    assert f"{len(regions)} in focus" in result.stdout
    assert blurred["part"] == "blurred"
    assert {region["part"] for region in regions} <= {"in focus"}
    mask = np.asarray(Image.open(picture.with_name("seed-mask.png")))
    assert int(blurred["area_px"]) == (mask == 0).sum()
    assert int(regions[0]["area_px"]) > 16
    assert 0 < float(regions[0]["blur_median_px"]) <= 8
    assert 0 <= float(regions[0]["confidence_mean"]) <= 1


def test_json_of_segment_counts_the_regions_if_asked(picture, instant):
    assert "regions" not in json.loads(run("segment", picture, "--json", "--force").stdout)
    table = picture.with_name("regions.csv")
    result = run("segment", picture, "--regions", table, "--json", "--force")
    assert json.loads(result.stdout)["regions"] == 1
    assert str(table) in json.loads(result.stdout)["files"]


def test_table_of_regions_is_a_csv_and_not_written_over_another(picture, instant):
    saying = "its name must end in .csv"
    result = run("segment", picture, "--regions", picture.with_name("regions.txt"))
    assert_fails_in_one_line(result, saying=saying)
    picture.with_name("regions.csv").write_text("mine")
    result = run("segment", picture, "--regions", picture.with_name("regions.csv"))
    assert_fails_in_one_line(result, saying="it exists already (--force overwrites it)")
    assert not instant
    assert picture.with_name("regions.csv").read_text() == "mine"


def test_demo_measures_the_sample_and_can_be_run_again(tmp_path, instant):
    folder = tmp_path / "results"
    for _ in range(2):
        result = run("demo", folder)
        assert result.exit_code == 0, result.output
    assert names_in(folder) == [
        "dandelion-blur.png",
        "dandelion-blur.tif",
        "dandelion-confidence.png",
        "dandelion-mask.png",
        "dandelion-overlay.png",
    ]
    assert "1000 x 562 px" in result.stdout
    assert "2.5 px" in result.stdout
    assert "100.0 %" in result.stdout
    assert "sigma 2.55 of 255 grey levels" in result.stdout, "sqrt(1e-4) of 255"


def test_json_is_one_object_with_everything(picture):
    result = run("map", picture, "--json")
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout)
    radius = tifffile.imread(picture.with_name("seed-blur.tif"))
    assert (facts["width"], facts["height"]) == (96, 80)
    assert facts["blur_median_px"] == pytest.approx(np.median(radius))
    assert facts["blur_p5_px"] <= facts["blur_median_px"] <= facts["blur_p95_px"]
    variance = facts["noise_variance"]
    assert facts["noise_sigma_grey_levels"] == pytest.approx(255 * variance**0.5)
    assert facts["seconds"] >= 0
    assert facts["files"] == [str(picture.with_name(f"seed-blur.{end}")) for end in ("tif", "png")]


def test_json_of_segment_has_the_share_in_focus(picture, instant):
    assert json.loads(run("segment", picture, "--json").stdout)["in_focus_percent"] == 100.0


def careful_lines(result):
    """Return what is said of a mask; that the picture is small goes without saying."""
    lines = (line.split(maxsplit=1) for line in result.stdout.splitlines() if line)
    said = [words for name, words in lines if name == "careful"]
    return [words for words in said if "small" not in words]


def test_mask_that_is_mostly_filled_from_around_is_told(picture, instant, monkeypatch):
    def known_places(candidates, image, **options):
        return np.arange(image.shape[1]) * np.ones((len(image), 1)) < 24

    monkeypatch.setattr(napari_defocus, "known_places", known_places)
    told = careful_lines(run("segment", picture))
    assert told[0].startswith("The blur is not known on 75 % of the picture: the mask is filled")
    assert len(told) == 1
    assert not careful_lines(run("segment", picture, "--unknown", "leave", "--force"))
    within = np.zeros((80, 96), np.uint8)
    within[:, :30] = 1
    Image.fromarray(within).save(picture.with_name("cells.png"))
    limited = ("--within", picture.with_name("cells.png"), "--force")
    assert not careful_lines(run("segment", picture, *limited)), "most of the cells is known"


def test_picture_that_may_be_blurred_as_a_whole_is_told(picture, instant, monkeypatch):
    monkeypatch.setattr(napari_defocus, "focus_threshold", lambda *_, **__: 3.0)
    told = careful_lines(run("segment", picture))
    assert told[0].endswith("If all of it may be blurred, give a threshold in px.")
    assert not careful_lines(run("segment", picture, "--threshold", 3, "--force"))


def test_where_nothing_is_known_no_number_looks_measured(picture):
    Image.fromarray(np.full((60, 70), 90, np.uint8)).save(picture)
    told = run("map", picture).stdout
    assert "\nblur         not known anywhere; the map says: median " in told
    assert "The blur is not known anywhere, so the mask says nothing." in careful_lines(
        run("segment", picture)
    )


def test_several_pictures_are_a_batch(picture):
    result = run("segment", picture, picture)
    assert result.exit_code == 2
    assert "napari-defocus batch --mask PICTURES -o FOLDER" in result.stderr


def test_quiet_prints_nothing(picture, instant):
    result = run("map", picture, "--quiet")
    assert (result.exit_code, result.output) == (0, "")


def test_defaults_are_those_of_the_functions(picture, instant):
    assert run("map", picture).exit_code == 0
    assert run("segment", picture).exit_code == 0
    assert instant["candidates"]["psf"] == Disc(MapSettings.max_radius)
    assert instant["candidates"]["linearize"] is MapSettings.linearize
    assert instant["candidates"]["noise_variance"] is MapSettings.noise_variance
    assert instant["map"]["smoothness"] == MapSettings.smoothness
    assert instant["map"]["color_sigma"] == MapSettings.color_sigma
    assert instant["candidates"]["mode"] == MapSettings.mode
    assert instant["mask"]["threshold"] == 2.3, "it is found from the picture"
    assert instant["mask"]["smoothness"] == MaskSettings.smoothness
    assert instant["mask"]["color_sigma"] == MaskSettings.color_sigma
    assert instant["mask"]["seeds"] is None


def test_options_reach_the_functions(picture, instant):
    common = ["--noise-variance", 2e-4, "--max-radius", 5, "--color-sigma", 0.3]
    common += ["--smoothness", 7, "--intensity-range", 10, 200]
    assert run("map", picture, *common, "--mode", "paper").exit_code == 0
    assert instant["candidates"]["mode"] == "paper"
    instant.pop("candidates")
    assert run("segment", picture, *common, "--mode", "paper", "--threshold", 1.5).exit_code == 0
    assert instant["candidates"]["noise_variance"] == 2e-4
    assert instant["candidates"]["psf"].max_radius == 5
    for step in ("map", "mask"):
        assert instant[step]["color_sigma"] == 0.3
        assert instant[step]["smoothness"] == 7
        assert instant[step]["intensity_range"] == (10, 200)
    assert instant["candidates"]["mode"] == "paper"
    assert instant["mask"]["threshold"] == 1.5


@pytest.mark.parametrize("command", ["map", "segment", "demo"])
def test_lens_and_light_reach_the_function(picture, instant, command):
    where = picture.parent / "results" if command == "demo" else picture
    result = run(command, where, "--psf", "polygon:6:15", "--linearize", "srgb")
    assert result.exit_code == 0, result.output
    assert instant["candidates"]["psf"] == Polygon(6, 15.0)
    assert instant["candidates"]["linearize"] == "srgb"
    assert "polygon:6:15, scale: blur radius (px)" in result.stdout


@pytest.mark.parametrize("psf", ["annulus:0.5", "gaussian"])
def test_threshold_is_a_blur_radius_whatever_the_lens(picture, instant, psf):
    result = run("segment", picture, "--psf", psf, "--threshold", 1.7, "--force")
    assert result.exit_code == 0, result.output
    assert instant["mask"]["threshold"] == 1.7


def test_gaussian_is_looked_for_up_to_the_blur_radius(picture, instant):
    result = run("map", picture, "--psf", "gaussian", "--max-radius", 6)
    assert instant["candidates"]["psf"] == Gaussian(6.0)
    assert "gaussian, scale: blur radius (px)" in result.stdout
    with tifffile.TiffFile(picture.with_name("seed-blur.tif")) as tiff:
        description = json.loads(tiff.pages[0].description)
    assert description["quantity"] == "defocus blur radius"
    assert description["settings"]["psf"] == "gaussian"


@pytest.mark.parametrize(("max_radius", "largest"), [(8, 5), (3, 3)])
def test_measured_lens_is_looked_for_up_to_its_own_largest_scale(
    picture, instant, tmp_path, max_radius, largest
):
    lens = MeasuredPSF([1, 5], [np.pad(Disc().kernel(1), 4), Disc().kernel(5)])
    lens.save(tmp_path / "lens.npz")
    result = run("map", picture, "--psf", tmp_path / "lens.npz", "--max-radius", max_radius)
    assert result.exit_code == 0, result.output
    assert instant["candidates"]["psf"].max_scale == largest


def test_shot_noise_is_measured_and_told(picture, instant, monkeypatch):
    def estimate_shot_noise(image, **options):
        instant["noise"] = options
        return ShotNoise(1e-5, 2e-4)

    monkeypatch.setattr(napari_defocus, "estimate_shot_noise", estimate_shot_noise)
    common = ["--shot-noise", "--psf", "annulus:0.4", "--intensity-range", 0, 200]
    result = run("map", picture, *common)
    assert result.exit_code == 0, result.output
    assert instant["candidates"]["noise_variance"] == ShotNoise(1e-5, 2e-4)
    assert instant["noise"]["intensity_range"] == (0, 200)
    assert "variance 1e-05 + 0.0002 x intensity" in result.stdout
    facts = json.loads(run("segment", picture, *common, "--json").stdout)
    assert facts["shot_noise"] == {"read_variance": 1e-5, "gain": 2e-4, "offset": 0.0}


def test_noise_that_grows_towards_the_corners_is_told(picture, instant):
    assert "in the corners 2.5 times that of the centre" in run("map", picture).stdout
    assert json.loads(run("segment", picture, "--json").stdout)["noise_growth"] == 1.5


def test_shot_noise_and_a_given_variance_exclude_each_other(picture, instant):
    result = run("map", picture, "--shot-noise", "--noise-variance", 1e-4)
    assert_fails_in_one_line(result, saying="--shot-noise")
    assert not instant


def test_confidence_is_written_as_values_or_drawing_and_told(picture):
    folder = picture.parent
    result = run("map", picture, "--confidence", folder / "sure.tif", "--json")
    assert result.exit_code == 0, result.output
    confidence = tifffile.imread(folder / "sure.tif")
    assert (confidence.shape, confidence.dtype) == ((80, 96), np.float32)
    assert 0 <= confidence.min() <= confidence.max() <= 1
    facts = json.loads(result.stdout)
    assert facts["confidence_median"] == pytest.approx(np.median(confidence))
    assert facts["confident_percent"] == pytest.approx(100 * (confidence >= 0.5).mean())
    assert facts["psf"] == "disc"
    assert str(folder / "sure.tif") in facts["files"]


def test_confidence_drawing_is_grey(picture, instant):
    path = picture.with_name("sure.png")
    result = run("map", picture, "--confidence", path)
    assert "confidence   median 0.50" in result.stdout
    drawn = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert np.ptp(drawn, axis=2).max() == 0


def test_pixels_of_low_confidence_are_left_out_of_the_map(picture, instant):
    result = run("map", picture, "--min-confidence", 0.25)
    assert result.exit_code == 0, result.output
    values = tifffile.imread(picture.with_name("seed-blur.tif"))
    assert np.isnan(values).mean() == pytest.approx(0.25, abs=0.01)
    assert np.nanmax(values) == 2.5
    assert "left out     25.0 %" in result.stdout
    assert "median 2.5 px" in result.stdout


def test_only_the_outputs_that_are_named_are_written(picture, instant):
    folder = picture.parent
    assert run("map", picture, "-o", folder / "values.tiff").exit_code == 0
    assert run("map", picture, "-o", folder / "a.tif", "-o", folder / "b.png").exit_code == 0
    assert run("segment", picture, "-o", folder / "m.png").exit_code == 0
    assert run("segment", picture, "--overlay", folder / "o.png").exit_code == 0
    expected = ["a.tif", "b.png", "m.png", "o.png", "seed.png", "values.tiff"]
    assert names_in(folder) == expected


def lamps(radius, lens=Disc()):
    """A picture of two lamps through a lens, as 16-bit integers."""
    light = np.zeros((61, 121))
    light[30, [30, 90]] = 1.0
    kernel = lens.kernel(radius)
    reach = len(kernel) // 2
    for column in (30, 90):
        light[30 - reach : 31 + reach, column - reach : column + reach + 1] = kernel
    return np.rint(50_000 * light / light.max()).astype(np.uint16)


@pytest.fixture
def settings_of_a_lens(tmp_path):
    """Pictures of lamps through a mirror lens, out of focus by 1, 3 and 5 px."""
    paths = [tmp_path / f"lamps{radius}.tif" for radius in (1, 3, 5)]
    for path, radius in zip(paths, (1, 3, 5), strict=True):
        tifffile.imwrite(path, lamps(radius, Annulus(0.4)))
    return paths


def test_calibrate_writes_a_lens_that_map_takes(settings_of_a_lens, tmp_path, picture):
    path = tmp_path / "lens.npz"
    result = run("calibrate", *settings_of_a_lens, "-o", path, "--scales", "1,3,5")
    assert result.exit_code == 0, result.output
    lens = MeasuredPSF.load(path)
    np.testing.assert_array_equal(lens.scales, [1, 3, 5])
    ring = Annulus(0.4).kernel(5)
    assert np.abs(lens.kernels[2] - ring).sum() < 0.05
    assert lens.provenance["names"] == ["lamps1.tif", "lamps3.tif", "lamps5.tif"]
    assert "given        3.00 px in " in result.stdout
    assert "3 kernels of 11 x 11 px, scales up to 5.00 px" in result.stdout
    assert "log error of the spectra" in result.stdout
    assert f"wrote        {path}" in result.stdout
    result = run("map", picture, "--psf", path)
    assert result.exit_code == 0, result.output
    assert f"{path}, scale: scale (px)" in result.stdout


def test_calibrate_measures_the_scales_and_is_asked_before_it_overwrites(
    settings_of_a_lens, tmp_path
):
    path = tmp_path / "lens.npz"
    path.write_bytes(b"mine")
    arguments = ["calibrate", *settings_of_a_lens, "-o", path, "--json"]
    assert_fails_in_one_line(run(*arguments), saying="exists already")
    assert path.read_bytes() == b"mine"
    facts = json.loads(run(*arguments, "--force", "--max-scale", 4).stdout)
    np.testing.assert_allclose(facts["scales_px"][1:], [3, 5], rtol=0.03)
    assert facts["scales_were"] == "measured"
    assert facts["max_scale_px"] == MeasuredPSF.load(path).max_scale == 4
    assert facts["files"] == [str(path)]


@pytest.mark.parametrize("sharp", [1, 2])
def test_calibrate_from_a_sharp_picture_once_or_once_for_each(tmp_path, gravel, sharp):
    paths = [tmp_path / f"{radius}.tif" for radius in (0, 2, 4)]
    for path, radius in zip(paths, (0, 2, 4), strict=True):
        seen = napari_defocus.simulate_defocus(gravel, np.full(gravel.shape, float(radius)))
        tifffile.imwrite(path, seen.astype(np.float32))
    references = [argument for _ in range(sharp) for argument in ("--sharp", paths[0])]
    result = run("calibrate", *paths[1:], *references, "-o", tmp_path / "lens.npz")
    assert result.exit_code == 0, result.output
    scales = MeasuredPSF.load(tmp_path / "lens.npz").scales
    np.testing.assert_allclose(scales, [2, 4], rtol=0.05)


@pytest.mark.parametrize(
    ("options", "saying"),
    [
        (["-o", "lens.txt"], "must end in .npz"),
        (["-o", "none/lens.npz"], "there is no folder"),
        (["-o", "lens.npz", "--scales", "1,two,3"], "numbers with commas"),
        (["-o", "lens.npz", "--scales", "1,2"], "scales has 2 entries"),
        (["-o", "lens.npz", "--scales", "2,2,2"], "1 setting"),
        (["-o", "lens.npz", "--max-scale", "0.5"], "--max-scale is "),
        (["-o", "lens.npz", "--sharp", "none.tif"], "no such file"),
        (["-o", "lens.npz", "--intensity-range", "0", "100"], "lamps1.tif shows no usable"),
    ],
)
def test_calibrate_that_cannot_be_writes_nothing(
    settings_of_a_lens, tmp_path, monkeypatch, options, saying
):
    monkeypatch.chdir(tmp_path)
    before = names_in(tmp_path)
    assert_fails_in_one_line(run("calibrate", *settings_of_a_lens, *options), saying=saying)
    assert names_in(tmp_path) == before


def test_calibrate_on_a_full_disk_leaves_nothing_behind(settings_of_a_lens, tmp_path, monkeypatch):
    before = names_in(tmp_path)
    monkeypatch.setattr(os, "fsync", full_disk)
    result = run("calibrate", *settings_of_a_lens, "-o", tmp_path / "lens.npz")
    assert_fails_in_one_line(result, saying="No space left")
    assert names_in(tmp_path) == before


@pytest.fixture
def seen_through_a_mirror_lens(tmp_path, gravel):
    path = tmp_path / "gravel.tif"
    seen = napari_defocus.simulate_defocus(
        gravel, np.full(gravel.shape, 5.0), psf=Annulus(0.5), noise_variance=1e-6, rng=0
    )
    tifffile.imwrite(path, seen.astype(np.float32))
    return path


def test_compare_psf_puts_the_right_lens_first(seen_through_a_mirror_lens, tmp_path):
    lens = MeasuredPSF([2, 5], [np.pad(Disc().kernel(2), 3), Disc().kernel(5)])
    lens.save(tmp_path / "lens.npz")
    families = ["disc", "annulus:0.5", "gaussian", str(tmp_path / "lens.npz")]
    options = [argument for text in families for argument in ("--family", text)]
    result = run("compare-psf", seen_through_a_mirror_lens, *options)
    assert result.exit_code == 0, result.output
    table = result.stdout[result.stdout.index("log evidence") :].splitlines()[1:5]
    assert {line.split()[0] for line in table} == set(families)
    assert table[0].startswith("annulus:0.5")
    assert table[0].endswith("blur radius 5.0 px")
    facts = json.loads(run("compare-psf", seen_through_a_mirror_lens, *options, "--json").stdout)
    assert facts["best"] == facts["families"][0]["psf"] == "annulus:0.5"
    assert facts["families"][0]["median_px"] == pytest.approx(5, abs=0.2)
    assert sum(row["best_in_percent"] for row in facts["families"]) == pytest.approx(100)


def test_lens_may_be_found_from_the_picture_and_is_told(seen_through_a_mirror_lens):
    result = run("map", seen_through_a_mirror_lens, "--psf", "auto")
    assert result.exit_code == 0, result.output
    assert "lens         annulus:0.5 (found from the picture)" in result.stdout
    path = seen_through_a_mirror_lens.with_name(f"{seen_through_a_mirror_lens.stem}-blur.tif")
    assert settings_in_tiff(path)["psf"] == "annulus:0.5"
    assert float(np.median(tifffile.imread(path))) == pytest.approx(5, abs=0.3)
    facts = json.loads(run("segment", seen_through_a_mirror_lens, "--psf", "auto", "--json").stdout)
    assert facts["psf"] == "annulus:0.5"
    assert facts["psf_choice"]["found"]


@pytest.mark.parametrize("command", ["map", "segment"])
def test_picture_that_does_not_look_like_defocus_is_said_to(tmp_path, gravel, command):
    moving = uniform_filter1d(gravel, 13, axis=1, mode="mirror")
    path = tmp_path / "moving.png"
    Image.fromarray(np.rint(255 * moving).astype(np.uint8)).save(path)
    result = run(command, path)
    assert result.exit_code == 0, result.output
    assert "careful      This does not look like defocus" in result.stdout
    assert "motion" in json.loads(run(command, path, "--json", "--force").stdout)["doubt"]


@pytest.mark.parametrize(
    ("pixels", "said"),
    [
        (np.full((10, 10), 90, np.uint8), ["The picture is small", "the same value"]),
        (np.arange(100, dtype=np.uint8).reshape(10, 10), ["The picture is small"]),
        (np.full((90, 120, 3), 255, np.uint8), ["the same value"]),
    ],
)
def test_picture_that_can_tell_little_is_not_measured_without_a_word(
    tmp_path, instant, pixels, said
):
    path = tmp_path / "p.png"
    Image.fromarray(pixels).save(path)
    result = run("map", path)
    assert result.exit_code == 0, result.output
    careful = [line for line in result.stdout.splitlines() if line.startswith("careful ")]
    assert len(careful) == len(said)
    assert all(words in line for words, line in zip(said, careful, strict=True))


def test_what_counts_as_in_focus_is_said_with_the_share(picture, instant):
    result = run("segment", picture, "--threshold", 1.5)
    of_known = r"\d+\.\d % of what is known \(\d+\.\d % of the picture\)"
    saying = rf"^in focus     100\.0 % of the mask, {of_known}; blur up to 1\.5 px$"
    assert re.search(saying, result.stdout, re.M)


def test_compare_psf_has_a_list_of_its_own(seen_through_a_mirror_lens):
    facts = json.loads(run("compare-psf", seen_through_a_mirror_lens, "--json").stdout)
    assert {row["psf"] for row in facts["families"]} == set(COMPARED_PSFS)
    assert facts["best"] == "annulus:0.5"


@pytest.mark.parametrize(
    ("options", "saying"),
    [
        (["--family", "square"], "psf is 'square'"),
        (["--noise-variance", "-1"], "--noise-variance is "),
        (["--max-radius", "0.5"], "takes a number from 1"),
    ],
)
def test_compare_psf_with_a_bad_value(seen_through_a_mirror_lens, options, saying):
    result = run("compare-psf", seen_through_a_mirror_lens, *options)
    assert_fails_in_one_line(result, saying=saying)


def test_compare_psf_needs_texture(tmp_path):
    Image.new("L", (60, 60)).save(tmp_path / "black.png")
    assert_fails_in_one_line(run("compare-psf", tmp_path / "black.png"), saying="no texture")


def test_version_is_the_package_s():
    assert run("--version").stdout == f"napari-defocus {napari_defocus.__version__}\n"


# --- settings files -------------------------------------------------------------------------


def settings_file(picture, **parts):
    path = picture.with_name("settings.json")
    path.write_text(json.dumps(parts), encoding="utf-8")
    return path


def test_settings_file_says_what_options_do_not(picture, instant):
    estimation = {"psf": "annulus:0.5", "max_radius": 5, "window": 31, "stride": 6}
    file = settings_file(picture, map=estimation | {"smoothness": 7, "color_sigma": 0.3})
    given = ["--settings", file, "--max-radius", 6, "--color-sigma", MapSettings.color_sigma]
    result = run("map", picture, *given)
    assert result.exit_code == 0, result.output
    assert instant["candidates"]["psf"] == Annulus(0.5, max_radius=6.0), "6 was given"
    assert (instant["candidates"]["window"], instant["candidates"]["stride"]) == (31, 6)
    assert instant["candidates"]["mode"] == MapSettings.mode
    assert instant["map"]["smoothness"] == 7
    assert instant["map"]["color_sigma"] == MapSettings.color_sigma, "given, though it is usual"


def test_mask_has_its_own_smoothness_in_a_settings_file(picture, instant):
    mask = {"threshold": 1.2, "smoothness": 9}
    file = settings_file(picture, map={"smoothness": 7, "linearize": "srgb"}, mask=mask)
    assert run("segment", picture, "--settings", file).exit_code == 0
    assert instant["mask"]["smoothness"] == 9
    assert instant["mask"]["threshold"] == 1.2
    assert instant["mask"]["color_sigma"] == MaskSettings.color_sigma
    assert instant["candidates"]["linearize"] == "srgb"
    assert run("segment", picture, "--settings", file, "--threshold", 3, "--force").exit_code == 0
    assert instant["mask"]["threshold"] == 3


@pytest.mark.parametrize(
    ("said", "option", "noise"),
    [
        ({"shot_noise": True}, ["--noise-variance", 1e-4], 1e-4),
        ({"noise_variance": 1e-4}, ["--shot-noise"], ShotNoise),
        ({"shot_noise": True}, [], ShotNoise),
    ],
)
def test_noise_that_is_given_is_not_that_of_the_settings_file(
    picture, instant, said, option, noise
):
    result = run("map", picture, "--settings", settings_file(picture, map=said), *option)
    assert result.exit_code == 0, result.output
    found = instant["candidates"]["noise_variance"]
    assert isinstance(found, ShotNoise) if noise is ShotNoise else found == noise


def test_options_win_over_a_settings_file_that_is_named_after_them(picture, instant):
    file = settings_file(picture, map={"shot_noise": True, "window": 31, "stride": 6})
    result = run("map", picture, "--noise-variance", 1e-4, "--stride", 5, "--settings", file)
    assert result.exit_code == 0, result.output
    assert instant["candidates"]["noise_variance"] == 1e-4
    assert (instant["candidates"]["window"], instant["candidates"]["stride"]) == (31, 5)


@pytest.mark.parametrize("command", ["map", "segment"])
def test_settings_that_were_used_are_saved_and_used_again(picture, instant, command):
    saved, again = picture.with_name("saved.json"), picture.with_name("again.json")
    options = ["--psf", "polygon:6", "--window", 51, "--stride", 5, "--smoothness", 3.3]
    options += ["--noise-variance", 1e-4, "--linearize", "srgb", "--mode", "paper"]
    plain = run(command, picture, *options, "--json")
    with_file = run(command, picture, *options, "--json", "--force", "--save-settings", saved)
    assert with_file.exit_code == 0, with_file.output
    calls = dict(instant)
    instant.clear()
    repeated = ["--settings", saved, "--save-settings", again, "--force"]
    assert run(command, picture, *repeated).exit_code == 0
    for step in calls:
        for name in calls[step].keys() - {"progress"}:
            assert instant[step][name] == calls[step][name]
    assert saved.read_text() == again.read_text()
    used = napari_defocus.Settings.load(saved)
    assert used.map.psf == "polygon:6"
    assert (used.mask if command == "segment" else used.map).smoothness == 3.3
    report, usual = json.loads(with_file.stdout), json.loads(plain.stdout)
    timeless = {"seconds": 0, "seconds_compiling": 0}
    assert report | timeless == usual | timeless, "the report is as it was"


def test_saved_settings_say_nothing_of_what_was_not_used(picture, instant):
    saved = picture.with_name("saved.json")
    assert run("map", picture, "--psf", "gaussian", "--save-settings", saved).exit_code == 0
    assert json.loads(saved.read_text()).keys() == {"napari_defocus", "unit", "map"}
    assert run("segment", picture, "--settings", saved).exit_code == 0
    assert instant["mask"]["threshold"] == 2.3, "it is found from the picture"


@pytest.mark.parametrize(
    ("content", "saying"),
    [
        (None, "settings.json: there is no such file"),
        ("{", "it is not JSON"),
        ('{"map": {"radius": 3}}', 'key of "map" "radius"; it takes noise_variance, psf'),
        ('{"map": {"max_radius": "3"}}', '"max_radius" of "map" is "3"; it takes a number'),
    ],
)
@pytest.mark.parametrize("command", ["map", "segment", "restore", "refocus", "depth"])
def test_settings_file_that_cannot_be_used_is_refused(picture, instant, command, content, saying):
    path = picture.with_name("settings.json")
    if content is not None:
        path.write_text(content)
    before = names_in(picture.parent)
    result = run(command, picture, "--settings", path)
    assert_fails_in_one_line(result, saying=saying)
    assert not instant, "nothing was computed"
    assert names_in(picture.parent) == before


@pytest.mark.parametrize("command", ["map", "segment", "restore", "refocus", "depth", "explain"])
def test_every_setting_of_a_map_is_an_option_with_its_default(command):
    options = {each.name: each for each in typer.main.get_command(app).commands[command].params}
    for setting in fields(MapSettings):
        usual = setting.default
        if command == "segment":
            usual = getattr(MaskSettings, setting.name, usual)
        if command in {"restore", "refocus", "depth"} and setting.name == "psf":
            usual = None  # left to the map, if one is given
        assert options[setting.name].default == usual


def test_every_option_of_every_command_says_what_it_does():
    for name, command in typer.main.get_command(app).commands.items():
        assert command.help, name
        for each in command.params:
            assert each.help, (name, each.name)


def test_settings_that_exist_are_kept_unless_forced(picture, instant):
    saved = settings_file(picture)
    before = saved.read_bytes()
    assert_fails_in_one_line(run("map", picture, "--save-settings", saved), saying="exists already")
    assert not instant, "nothing was computed"
    assert saved.read_bytes() == before
    assert run("map", picture, "--save-settings", saved, "--force").exit_code == 0
    assert napari_defocus.Settings.load(saved) == napari_defocus.Settings()


# --- how they fail --------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["map", "segment"])
def test_existing_result_stops_before_any_work(picture, instant, command):
    assert run(command, picture).exit_code == 0
    results = [path for path in picture.parent.iterdir() if path != picture]
    for path in results:
        path.write_bytes(b"mine")
    instant.clear()
    assert_fails_in_one_line(run(command, picture), saying="exists already")
    assert not instant, "nothing was computed"
    assert {path.read_bytes() for path in results} == {b"mine"}
    assert run(command, picture, "--force").exit_code == 0
    assert b"mine" not in {path.read_bytes() for path in results}


def test_picture_is_never_overwritten(picture, instant):
    before = picture.read_bytes()
    result = run("segment", picture, "-o", picture, "--force")
    assert_fails_in_one_line(result, saying="is a file that is read")
    assert picture.read_bytes() == before


@pytest.mark.parametrize(
    ("seeds", "saying"),
    [
        (np.zeros((80, 95), np.uint8), "seeds has shape (80, 95)"),
        (np.zeros((80, 96, 3), np.uint8), "seeds has shape (80, 96, 3)"),
        (np.full((80, 96), 255, np.uint8), "seeds has the value 255"),
        (np.zeros((80, 96), np.float32), "seeds has dtype float32"),
        (None, "cannot read"),
    ],
)
def test_seeds_that_do_not_fit_stop_before_any_work(picture, tmp_path, instant, seeds, saying):
    if seeds is not None:
        tifffile.imwrite(tmp_path / "seeds.tif", seeds)
    assert_fails_in_one_line(
        run("segment", picture, "--seeds", tmp_path / "seeds.tif"), saying=saying
    )
    assert not instant, "nothing was computed"
    assert names_in(picture.parent) == ["seed.png"]


def test_seeds_are_never_overwritten(picture, instant):
    Image.fromarray(np.zeros((80, 96), np.uint8)).save(picture.with_name("mask.png"))
    before = picture.with_name("mask.png").read_bytes()
    mask = picture.with_name("mask.png")
    result = run("segment", picture, "--seeds", mask, "-o", mask, "--force")
    assert_fails_in_one_line(result, saying="is a file that is read")
    assert mask.read_bytes() == before


@pytest.mark.parametrize("command", ["map", "segment"])
@pytest.mark.parametrize("content", [None, b"", b"no picture"])
def test_unreadable_picture(tmp_path, command, content):
    path = tmp_path / "two\nlines.png"
    if content is not None:
        path.write_bytes(content)
    before = names_in(tmp_path)
    assert_fails_in_one_line(run(command, path), saying="cannot read")
    assert names_in(tmp_path) == before


@pytest.mark.parametrize("path", [".", "..", "/"])
def test_folder_instead_of_a_picture(path):
    assert_fails_in_one_line(run("map", path), saying="is a folder")


def test_picture_that_the_method_does_not_take(tmp_path):
    Image.new("L", (2, 40)).save(tmp_path / "thin.png")
    assert_fails_in_one_line(run("map", tmp_path / "thin.png"), saying="3 px")
    tifffile.imwrite(tmp_path / "infinite.tif", np.full((40, 40), np.inf, np.float32))
    assert_fails_in_one_line(run("map", tmp_path / "infinite.tif"), saying="infinite values")
    tifffile.imwrite(tmp_path / "complex.tif", np.ones((40, 40), np.complex64))
    assert_fails_in_one_line(run("map", tmp_path / "complex.tif"), saying="complex64")
    assert names_in(tmp_path) == ["complex.tif", "infinite.tif", "thin.png"]


@pytest.mark.parametrize(
    ("command", "option", "value", "saying"),
    [
        ("map", "--noise-variance", -1, "--noise-variance is "),
        ("map", "--noise-variance", "nan", "--noise-variance is "),
        ("map", "--max-radius", 0, "--max-radius is "),
        ("map", "--psf", "square", "psf is 'square'"),
        ("map", "--psf", "polygon:2", "blades"),
        ("map", "--psf", "none.npz", "no such file"),
        ("map", "--min-confidence", 1.5, "--min-confidence is "),
        ("map", "--min-confidence", "nan", "--min-confidence is "),
        ("map", "--confidence", "sure.jpg", "must end in"),
        ("map", "--smoothness", -1, "smoothness"),
        ("map", "--color-sigma", 0, "--color-sigma is "),
        ("segment", "--threshold", -1, "threshold"),
        ("segment", "--psf", "annulus:1", "obstruction"),
        ("segment", "--smoothness", "inf", "smoothness"),
        ("segment", "--color-sigma", -1, "--color-sigma is "),
    ],
)
def test_value_out_of_range(picture, command, option, value, saying):
    assert_fails_in_one_line(run(command, picture, option, value), saying=saying)
    assert names_in(picture.parent) == ["seed.png"]


def test_intensity_range_that_is_none(picture):
    result = run("map", picture, "--intensity-range", 5, 5)
    assert_fails_in_one_line(result, saying="--intensity-range is ")


@pytest.mark.parametrize(
    "arguments",
    [
        ["map"],
        ["nonsense"],
        ["map", "p.png", "--nonsense"],
        ["map", "p.png", "--mode", "other"],
        ["map", "p.png", "--linearize", "other"],
        ["calibrate", "p.png"],
        ["compare-psf"],
        ["restore"],
        ["refocus"],
        ["depth"],
        ["restore", "p.png", "--linearize", "linear"],
        ["refocus", "p.png", "--encoding", "other"],
        ["refocus", "p.png", "--side", "left"],
        ["depth", "p.png", "--side", "left"],
    ],
)
def test_wrong_usage_ends_with_code_2_and_a_hint(arguments):
    result = run(*arguments)
    assert result.exit_code == 2
    assert "Usage:" in result.stderr
    assert result.stdout == ""


@pytest.mark.parametrize(
    ("command", "output", "saying"),
    [
        ("map", "none/map.tif", "there is no folder"),
        ("map", "map.jpg", "must end in"),
        ("map", "folder.tif", "is a folder"),
        ("segment", "none/mask.png", "there is no folder"),
        ("segment", "mask.tif", "must end in"),
    ],
)
def test_output_that_cannot_be_is_refused_before_any_work(
    picture, instant, command, output, saying
):
    (picture.parent / "folder.tif").mkdir()
    result = run(command, picture, "-o", picture.parent / output, "--force")
    assert_fails_in_one_line(result, saying=saying)
    assert not instant, "nothing was computed"
    assert names_in(picture.parent) == ["folder.tif", "seed.png"]


def test_full_disk(picture, instant, monkeypatch):
    monkeypatch.setattr(os, "fsync", full_disk)
    assert_fails_in_one_line(run("map", picture), saying="No space left on device")
    assert names_in(picture.parent) == ["seed.png"]


@pytest.mark.parametrize(
    ("error", "saying", "code"),
    [
        (KeyboardInterrupt(), "interrupted", 130),
        (MemoryError(), "memory", 2),
        (TypeError("image has dtype object"), "dtype object", 2),
        (RuntimeError("first\nsecond"), "RuntimeError: first second", 2),
    ],
    ids=lambda value: type(value).__name__,
)
def test_whatever_happens_ends_in_one_line(picture, instant, monkeypatch, error, saying, code):
    def fail(*_args, **_kwargs):
        raise error

    monkeypatch.setattr(napari_defocus, "label_blur_map", fail)
    assert_fails_in_one_line(run("map", picture, "--json"), saying=saying, code=code)
    assert names_in(picture.parent) == ["seed.png"]


def test_failed_demo_leaves_no_folder_behind(tmp_path, instant, monkeypatch):
    monkeypatch.setattr(os, "fsync", full_disk)
    assert_fails_in_one_line(run("demo", tmp_path / "new"), saying="No space left")
    assert names_in(tmp_path) == []


def test_demo_into_what_is_no_folder(tmp_path, instant):
    (tmp_path / "file").touch()
    assert_fails_in_one_line(run("demo", tmp_path / "file"), saying="is not a folder")
    assert_fails_in_one_line(run("demo", tmp_path / "none" / "new"), saying="there is no folder")
    assert names_in(tmp_path) == ["file"]


# --- in a process of its own ----------------------------------------------------------------


def test_pipe_gets_the_result_and_nothing_else(picture):
    """No progress, no warning of a library, no import of napari or Qt."""
    code = (
        "import atexit, sys; from napari_defocus.cli.app import main; "
        "atexit.register(lambda: print(*{'napari', 'qtpy', 'PySide6'} & {*sys.modules}, end='')); "
        "main()"
    )
    command = [sys.executable, "-c", code, "map", str(picture), "--json"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")
    assert json.loads(result.stdout)["width"] == 96


def test_ctrl_c_leaves_nothing_behind(picture):
    code = (
        "import signal, napari_defocus; from napari_defocus.cli.app import main; "
        "signal.signal(signal.SIGINT, signal.default_int_handler); "
        "napari_defocus.label_blur_map = lambda *_, **__: signal.raise_signal(signal.SIGINT); "
        "main()"
    )
    command = [sys.executable, "-c", code, "map", str(picture)]
    result = subprocess.run(command, capture_output=True, text=True)
    assert (result.returncode, result.stdout) == (130, "")
    assert result.stderr == "napari-defocus: interrupted\n"
    assert names_in(picture.parent) == ["seed.png"]


def test_list_of_commands_cuts_no_sentence():
    assert "..." not in run("--help").stdout.partition("Commands:")[2]
