"""The terminal commands that make pictures: restore and refocus."""

import json
import math
import os
from types import SimpleNamespace

import imagecodecs
import numpy as np
import pytest
import tifffile
from command_line import assert_fails_in_one_line, full_disk, names_in, run
from PIL import Image

import napari_defocus
from napari_defocus import Annulus, Disc, Gaussian, ThinLens, blur_from_depth, simulate_defocus
from napari_defocus.core.intensity import Intensities
from napari_defocus.io.encoders import blur_map_tiff, description_in_tiff
from napari_defocus.io.pictures import read_picture
from napari_defocus.restoration.all_in_focus import RestorationFit
from napari_defocus.settings import MapSettings, RefocusSettings, RestorationSettings

HEIGHT, WIDTH = 48, 60
LENS = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=5)
LENS_OPTIONS = [
    *("--focal-length", 50, "--f-number", 2, "--focus-distance", 2, "--pixel-pitch", 5)
]  # fmt: skip


@pytest.fixture
def folder(tmp_path, astronaut):
    """A folder with a small picture in colour and its blur map, p.png and blur.tif."""
    levels = np.rint(255 * astronaut[20 : 20 + HEIGHT, 60 : 60 + WIDTH]).astype(np.uint8)
    Image.fromarray(levels).save(tmp_path / "p.png")
    save_map(tmp_path / "blur.tif", np.full((HEIGHT, WIDTH), 2.0))
    return tmp_path


def save_map(path, scales):
    tifffile.imwrite(path, np.asarray(scales, np.float32))


@pytest.fixture
def instant(monkeypatch):
    """Stand-ins for the method, which keep their arguments; what is made is the picture itself."""
    calls = {}

    def estimate_candidates(image, **options):
        calls["candidates"] = options
        return SimpleNamespace(
            psf_choice=None,
            doubt=None,
            image_shape=image.shape[:2],
            noise_variance=1e-4,
            psf=options["psf"],
            shot_noise=None,
            noise_growth=0.0,
            intensities=Intensities(0.0, 255.0, "number type"),
        )

    def label_blur_map(candidates, image, **options):
        calls["map"] = options
        return np.full(image.shape[:2], 2.5, np.float32)

    def confidence_map(candidates, blur_map):
        return np.full(blur_map.shape, 0.75, np.float32)

    def cautious_blur_map(candidates, blur_map, *, risk):
        calls["risk"] = risk
        return blur_map - np.float32(0.5)

    def estimate_noise_variance(image, **options):
        calls["noise"] = options
        return 3e-5

    def made(name):
        def make(image, blur_map, **options):
            calls[name] = {"blur_map": blur_map, **options}
            array = np.asarray(image)
            color = array if array.ndim == 2 else array[..., :3]
            full = np.iinfo(color.dtype).max if color.dtype.kind in "ui" else 1
            sharp = (color / full).astype(np.float32)
            if not options.get("return_fit"):
                return sharp
            weight = options["tv_weight"] or 0.002
            left = np.full(sharp.shape[:2], 0.25, np.float32)
            return sharp, RestorationFit(options["noise_variance"], weight, 7e-5, left)

        return make

    stand_ins = [estimate_candidates, label_blur_map, confidence_map, cautious_blur_map]
    stand_ins.append(estimate_noise_variance)
    for function in stand_ins:
        monkeypatch.setattr(napari_defocus, function.__name__, function)
    for name in ("restore_all_in_focus", "change_focus"):
        monkeypatch.setattr(napari_defocus, name, made(name))
    return calls


# --- what they make -------------------------------------------------------------------------


def test_restore_brings_back_details(tmp_path, gravel):
    sharp = gravel[:80, :80]
    blurred = simulate_defocus(sharp, np.full((80, 80), 3.0), noise_variance=1e-6, rng=0)
    tifffile.imwrite(tmp_path / "p.tif", blurred.astype(np.float32))
    result = run("restore", tmp_path / "p.tif")
    assert result.exit_code == 0, result.output
    assert names_in(tmp_path) == ["p-in-focus.png", "p.tif"]
    restored = read_picture(tmp_path / "p-in-focus.png") / 65535
    error, error_before = (np.abs(p - sharp)[8:-8, 8:-8].mean() for p in (restored, blurred))
    assert error < 0.6 * error_before
    assert "80 x 80 px" in result.stdout
    assert "blur         median 3." in result.stdout
    assert "smoothing    0." in result.stdout


def test_picture_that_does_not_fit_its_map_is_told(folder, instant):
    result = run("restore", folder / "p.png")
    assert "the lens or the map may not fit" in result.stdout


@pytest.mark.parametrize("command", [["restore"], ["refocus", "--focus", 1]])
def test_what_is_left_as_it_was_is_told_and_written(folder, instant, command):
    files = ["--left-as-it-was", folder / "left.tif", "-o", folder / "r.png"]
    result = run(*command, folder / "p.png", *files)
    assert result.exit_code == 0, result.output
    assert "not restored 25 % of the picture: it would get rings there" in result.stdout
    left = tifffile.imread(folder / "left.tif")
    np.testing.assert_array_equal(left, np.full((HEIGHT, WIDTH), 0.25))
    assert description_in_tiff(folder / "left.tif")["quantity"] == "share left as it was"
    result = run(*command, folder / "p.png", "--left-as-it-was", folder / "left.jpg")
    assert result.exit_code == 2
    assert "its name must end in .png or .tif or .tiff" in result.stderr


def test_restore_is_the_function_on_the_map_that_is_given(folder, ramp):
    scales = ramp[:HEIGHT, :WIDTH].astype(np.float32)
    sure = np.linspace(0, 1, WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH)
    save_map(folder / "blur.tif", scales)
    save_map(folder / "sure.tif", sure)
    given = ["--map", folder / "blur.tif", "--map-confidence", folder / "sure.tif"]
    given += ["--tv-weight", 0.03, "--noise-variance", 1e-4]
    result = run(
        "restore", folder / "p.png", *given, "-o", folder / "r.tif", "-o", folder / "r.png"
    )
    assert result.exit_code == 0, result.output
    expected = napari_defocus.restore_all_in_focus(
        read_picture(folder / "p.png"),
        scales,
        confidence=sure,
        noise_variance=1e-4,
        tv_weight=0.03,
    )
    np.testing.assert_allclose(tifffile.imread(folder / "r.tif"), expected, atol=1e-5)
    drawn = np.asarray(Image.open(folder / "r.png")).astype(int)
    assert np.abs(drawn - 255 * expected).max() <= 0.51


def test_refocus_is_the_function_on_the_map_that_is_given(folder):
    options = ["--map", folder / "blur.tif", "--focus", 1.5, "--aperture", 0.5]
    options += ["--tv-weight", 0.03, "--noise-variance", 1e-4, "-o", folder / "r.tif"]
    result = run("refocus", folder / "p.png", *options)
    assert result.exit_code == 0, result.output
    expected = napari_defocus.change_focus(
        read_picture(folder / "p.png"),
        np.full((HEIGHT, WIDTH), 2.0),
        focus=1.5,
        aperture=0.5,
        tv_weight=0.03,
        noise_variance=1e-4,
    )
    np.testing.assert_allclose(tifffile.imread(folder / "r.tif"), expected, atol=1e-5)


@pytest.mark.parametrize(("command", "ending"), [("restore", "in-focus"), ("refocus", "refocused")])
@pytest.mark.parametrize("channels", [(), (3,), (4,)])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_result_is_as_deep_as_the_picture_and_as_opaque(
    tmp_path, instant, command, ending, channels, dtype
):
    rng = np.random.default_rng(0)
    picture = rng.random((12, 10, *channels))
    if dtype != "float32":
        picture = (picture * np.iinfo(dtype).max).astype(dtype)
    picture = picture.astype(dtype)
    color = "rgb" if channels else "minisblack"
    tifffile.imwrite(tmp_path / "p.tif", picture, photometric=color)
    options = ["--aperture", 2] if command == "refocus" else []
    assert run(command, tmp_path / "p.tif", *options).exit_code == 0
    made = read_picture(tmp_path / f"p-{ending}.png")
    assert made.dtype == (np.uint8 if dtype == "uint8" else np.uint16)
    if dtype == "float32":
        np.testing.assert_allclose(made / 65535, picture, atol=1e-5)
    else:
        np.testing.assert_array_equal(made, picture)
    assert run(command, tmp_path / "p.tif", *options, "-o", tmp_path / "r.tif").exit_code == 0
    values = read_picture(tmp_path / "r.tif")
    assert values.dtype == np.float32
    np.testing.assert_allclose(values, made / np.iinfo(made.dtype).max, atol=1e-5)


def test_tiff_says_what_made_it(folder, instant):
    options = ["--map", folder / "blur.tif", "--sharp-at", 3, *LENS_OPTIONS]
    assert run("refocus", folder / "p.png", *options, "-o", folder / "r.tif").exit_code == 0
    with tifffile.TiffFile(folder / "r.tif") as tiff:
        assert tiff.pages[0].photometric.name == "RGB"
        description = json.loads(tiff.pages[0].description)
    assert description["quantity"] == "refocused picture"
    settings = description["settings"]
    assert settings["map"] == str(folder / "blur.tif")
    assert settings["thin_lens"]["pixel_pitch_um"] == 5
    assert settings["side"] == RefocusSettings.side
    assert "smoothness" not in settings, "it did nothing"
    assert run("restore", folder / "p.png", "-o", folder / "q.tif").exit_code == 0
    with tifffile.TiffFile(folder / "q.tif") as tiff:
        description = json.loads(tiff.pages[0].description)
    assert description["quantity"] == "all-in-focus picture"
    assert description["settings"]["smoothness"] == MapSettings.smoothness


# --- what reaches the functions -------------------------------------------------------------


def test_defaults_are_those_of_the_functions(folder, instant):
    assert run("restore", folder / "p.png").exit_code == 0
    assert run("refocus", folder / "p.png", "--aperture", 2).exit_code == 0
    assert instant["candidates"]["psf"] == Disc()
    assert instant["candidates"]["mode"] == MapSettings.mode
    assert instant["map"]["smoothness"] == MapSettings.smoothness
    assert instant["map"]["color_sigma"] == MapSettings.color_sigma
    assert instant["risk"] == RestorationSettings.risk
    restoring, changing = instant["restore_all_in_focus"], instant["change_focus"]
    assert restoring["tv_weight"] is None
    assert restoring["psf"] == changing["psf"] == Disc()
    np.testing.assert_array_equal(restoring["confidence"], np.float32(0.75))
    np.testing.assert_array_equal(restoring["blur_map"], np.float32(2.0))
    np.testing.assert_array_equal(changing["blur_map"], np.float32(2.5))
    assert changing["all_in_focus"] is not None
    assert run("restore", folder / "p.png", "--force").exit_code == 0
    assert instant["restore_all_in_focus"]["linearize"] is MapSettings.linearize
    assert instant["change_focus"]["linearize"] == RefocusSettings.linearize
    assert instant["change_focus"]["focus"] == RefocusSettings.focus
    assert instant["change_focus"]["side"] == RefocusSettings.side


@pytest.mark.parametrize("command", ["restore", "refocus"])
def test_options_reach_the_functions(folder, instant, command):
    options = ["--psf", "polygon:6", "--max-radius", 5, "--smoothness", 7, "--color-sigma", 0.3]
    options += ["--mode", "paper", "--linearize", "srgb", "--intensity-range", 0, 200]
    options += ["--noise-variance", 1e-4, "--tv-weight", 0.01, "--risk", 0.3]
    if command == "refocus":
        options += ["--focus", -1.5, "--aperture", 3, "--side", "near"]
    result = run(command, folder / "p.png", *options, "--json")
    assert result.exit_code == 0, result.output
    assert instant["candidates"]["mode"] == "paper"
    assert instant["candidates"]["linearize"] == "srgb"
    assert instant["map"]["smoothness"] == 7
    assert instant["map"]["color_sigma"] == 0.3
    assert instant["risk"] == 0.3
    restoring = instant["restore_all_in_focus"]
    step = instant["change_focus"] if command == "refocus" else restoring
    for part in (restoring, step):
        assert part["psf"].blades == 6
        assert part["intensity_range"] == (0, 200)
        assert part["linearize"] == "srgb"
    assert restoring["tv_weight"] == 0.01
    assert restoring["noise_variance"] == 1e-4
    facts = json.loads(result.stdout)
    assert facts["tv_weight"] == 0.01
    assert facts["misfit"] == 7e-5
    assert facts["psf"] == "polygon:6"
    assert facts["blur_median_px"] == 2.5
    assert facts["confidence_median"] == 0.75
    if command == "refocus":
        assert (step["focus"], step["aperture"], step["side"]) == (-1.5, 3, "near")
        assert (facts["focus_px"], facts["aperture"], facts["side"]) == (-1.5, 3, "near")


def test_noise_is_found_again_where_the_light_is_another(folder, instant):
    change = ["refocus", folder / "p.png", "--aperture", 2, "--noise-variance", 1e-4, "--force"]
    assert run(*change).exit_code == 0
    assert instant["noise"]["linearize"] == "srgb"
    assert instant["restore_all_in_focus"]["noise_variance"] == 3e-5
    for same_light in (
        ["--encoding", "linear"],
        ["--linearize", "srgb"],
        ["--map", folder / "blur.tif"],
    ):
        assert run(*change, *same_light).exit_code == 0
        assert instant["restore_all_in_focus"]["noise_variance"] == 1e-4


def test_encoding_says_in_what_light_it_is_blurred_again(folder, instant):
    change = ["refocus", folder / "p.png", "--aperture", 2, "--encoding", "linear"]
    assert run(*change).exit_code == 0
    assert instant["change_focus"]["linearize"] is None


@pytest.mark.parametrize("side", ["far", "near"])
@pytest.mark.parametrize("distance", [1.5, 2.0, 3.0, math.inf])
def test_distance_that_shall_be_sharp_is_a_blur_on_its_side(folder, instant, side, distance):
    change = ["refocus", folder / "p.png", "--sharp-at", distance, *LENS_OPTIONS]
    result = run(*change, "--side", side, "--psf", "gaussian", "--json")
    assert result.exit_code == 0, result.output
    blur = float(blur_from_depth(distance, LENS))
    same_side = (distance > 2) == (side == "far")
    assert instant["change_focus"]["focus"] == pytest.approx(blur if same_side else -blur)
    facts = json.loads(result.stdout, parse_constant=pytest.fail)
    assert facts["focus_px"] == pytest.approx(blur if same_side else -blur)
    assert facts["sharp_at_m"] == ("inf" if math.isinf(distance) else distance)
    assert facts["thin_lens"]["focus_distance_m"] == 2
    assert facts["thin_lens"]["from_exif"] == []


def test_refocus_tells_what_it_did(folder, instant):
    result = run("refocus", folder / "p.png", "--sharp-at", 1.5, *LENS_OPTIONS)
    blur = float(blur_from_depth(1.5, LENS))
    assert "thin lens    50 mm, f/2, focused at 2 m, pixels of 5 um" in result.stdout
    assert "side         far: all blur is assumed to lie beyond the plane" in result.stdout
    sharp = f"sharp now    what is blurred by {blur:.1f} px on the other side, 1.5 m away"
    assert sharp in result.stdout
    assert "aperture     1 times as wide" in result.stdout


# --- settings files -------------------------------------------------------------------------


def settings_file(folder, **parts):
    path = folder / "settings.json"
    path.write_text(json.dumps(parts), encoding="utf-8")
    return path


@pytest.mark.parametrize("command", ["restore", "refocus"])
def test_settings_that_were_used_are_saved_and_used_again(folder, instant, command):
    saved, again = folder / "saved.json", folder / "again.json"
    options = ["--psf", "polygon:6", "--max-radius", 5, "--smoothness", 7, "--color-sigma", 0.3]
    options += ["--noise-variance", 1e-4, "--tv-weight", 0.01, "--risk", 0.3]
    if command == "refocus":
        options += ["--focus", -1.5, "--aperture", 3, "--side", "near", "--encoding", "linear"]
    result = run(command, folder / "p.png", *options, "--save-settings", saved)
    assert result.exit_code == 0, result.output
    calls = dict(instant)
    instant.clear()
    repeated = ["--settings", saved, "--save-settings", again, "--force"]
    assert run(command, folder / "p.png", *repeated).exit_code == 0
    last = "change_focus" if command == "refocus" else "restore_all_in_focus"
    for step in ("candidates", "map", "restore_all_in_focus", last):
        for name in calls[step].keys() - {"progress"}:
            np.testing.assert_array_equal(instant[step][name], calls[step][name])
    assert instant["risk"] == 0.3
    assert saved.read_text() == again.read_text()
    used = napari_defocus.Settings.load(saved)
    assert used.restoration == RestorationSettings(noise_variance=1e-4, tv_weight=0.01, risk=0.3)
    view = RefocusSettings(focus=-1.5, aperture=3, side="near", linearize=None)
    assert used.refocus == (view if command == "refocus" else RefocusSettings())


def test_options_win_over_a_settings_file(folder, instant):
    view = {"focus": 1.5, "aperture": 2, "linearize": None}
    file = settings_file(folder, refocus=view, restoration={"risk": 0.3, "tv_weight": 0.01})
    given = ["--settings", file, "--aperture", 3, "--encoding", "srgb", "--risk", 0.2]
    result = run("refocus", folder / "p.png", *given)
    assert result.exit_code == 0, result.output
    assert instant["change_focus"]["focus"] == 1.5
    assert instant["change_focus"]["aperture"] == 3
    assert instant["change_focus"]["linearize"] == "srgb"
    assert instant["risk"] == 0.2
    assert instant["restore_all_in_focus"]["tv_weight"] == 0.01


def test_distance_that_is_given_wins_over_the_focus_of_a_settings_file(folder, instant):
    file = settings_file(folder, refocus={"focus": 1.5})
    change = ["refocus", folder / "p.png", "--sharp-at", 3, *LENS_OPTIONS, "--settings", file]
    result = run(*change)
    assert result.exit_code == 0, result.output
    blur = float(blur_from_depth(3, LENS))
    assert instant["change_focus"]["focus"] == pytest.approx(blur)


@pytest.mark.parametrize(("said", "psf"), [("gaussian", Gaussian), (None, Annulus)])
def test_lens_of_a_map_wins_over_that_of_a_settings_file(folder, instant, said, psf):
    values = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    content = blur_map_tiff(values, {"psf": said} if said else {}, "blur radius (px)")
    (folder / "blur.tif").write_bytes(content)
    file = settings_file(folder, map={"psf": "annulus:0.5"})
    given = ["--map", folder / "blur.tif", "--settings", file]
    assert run("restore", folder / "p.png", *given).exit_code == 0
    assert isinstance(instant["restore_all_in_focus"]["psf"], psf)


def test_two_noises_cannot_be_said_by_one_option(folder, instant):
    file = settings_file(folder, map={}, restoration={"noise_variance": 1e-5})
    given = ["restore", folder / "p.png", "--settings", file]
    assert_fails_in_one_line(run(*given), saying='of "restoration" is 1e-05 and that of "map" None')
    assert not instant, "nothing was computed"
    assert run(*given, "--noise-variance", 1e-4).exit_code == 0
    assert instant["restore_all_in_focus"]["noise_variance"] == 1e-4


# --- maps that are given --------------------------------------------------------------------


@pytest.mark.parametrize("command", [["restore"], ["refocus", "--aperture", 2]])
def test_map_that_is_given_is_not_measured(folder, instant, command):
    result = run(*command, folder / "p.png", "--map", folder / "blur.tif", "--json")
    assert result.exit_code == 0, result.output
    assert "candidates" not in instant
    step = instant["restore_all_in_focus"]
    if command[0] == "restore":
        assert step["confidence"] is None
    else:
        assert (step["confidence"] == 1).all()
    np.testing.assert_array_equal(step["blur_map"], np.float32(2))
    facts = json.loads(result.stdout)
    assert facts["map"] == str(folder / "blur.tif")
    assert facts["map_confidence"] is None
    assert facts["blur_median_px"] == 2
    assert "confidence_median" not in facts


@pytest.mark.parametrize("with_confidence", [False, True])
def test_gaps_of_a_map_get_the_nearest_scale_and_no_confidence(folder, instant, with_confidence):
    scales = np.tile(np.linspace(1, 3, WIDTH, dtype=np.float32), (HEIGHT, 1))
    scales[:, 20:30] = np.nan
    save_map(folder / "blur.tif", scales)
    save_map(folder / "sure.tif", np.full((HEIGHT, WIDTH), 0.6))
    given = ["--map", folder / "blur.tif"]
    given += ["--map-confidence", folder / "sure.tif"] if with_confidence else []
    result = run("restore", folder / "p.png", *given)
    assert result.exit_code == 0, result.output
    step = instant["restore_all_in_focus"]
    np.testing.assert_array_equal(step["blur_map"][:, 20:25], scales[:, [19] * 5])
    np.testing.assert_array_equal(step["blur_map"][:, 26:30], scales[:, [30] * 4])
    known = ~np.isnan(scales)
    np.testing.assert_array_equal(step["blur_map"][known], scales[known])
    sure = np.float32(0.6 if with_confidence else 1)
    np.testing.assert_array_equal(step["confidence"], np.where(known, sure, 0))
    assert f"left out     {100 * 10 / WIDTH:.1f} %" in result.stdout
    assert ("confidence" in result.stdout) == with_confidence


def test_map_brings_its_lens_unless_another_is_given(folder, instant):
    mapped = run("map", folder / "p.png", "--psf", "gaussian", "-o", folder / "m.tif")
    assert mapped.exit_code == 0, mapped.output
    given = ["restore", folder / "p.png", "--map", folder / "m.tif", "--force"]
    assert run(*given).exit_code == 0
    assert isinstance(instant["restore_all_in_focus"]["psf"], Gaussian)
    assert run(*given, "--psf", "annulus:0.4").exit_code == 0
    assert instant["restore_all_in_focus"]["psf"].obstruction == 0.4


@pytest.mark.parametrize(("psf", "max_scale"), [("disc", 80.0), ("gaussian", 80.0)])
def test_map_may_go_beyond_the_largest_radius(folder, instant, psf, max_scale):
    save_map(folder / "blur.tif", np.full((HEIGHT, WIDTH), 80.0))
    given = ["--map", folder / "blur.tif", "--psf", psf]
    assert run("restore", folder / "p.png", *given).exit_code == 0
    assert instant["restore_all_in_focus"]["psf"].max_scale == max_scale


def test_lens_of_a_map_that_is_given_is_not_found_from_the_picture(folder, instant):
    save_map(folder / "blur.tif", np.full((HEIGHT, WIDTH), 2.0))
    given = ["--map", folder / "blur.tif", "--psf", "auto"]
    assert_fails_in_one_line(run("restore", folder / "p.png", *given), saying="psf is 'auto'")


@pytest.mark.parametrize(
    "unit", ["standard deviation (px)", "outer radius (px)", "equal-area radius (px)"]
)
def test_map_in_an_early_unit_of_its_lens_is_not_read_as_radii(folder, instant, unit):
    values = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    (folder / "blur.tif").write_bytes(blur_map_tiff(values, {"psf": "gaussian"}, unit))
    result = run("restore", folder / "p.png", "--map", folder / "blur.tif")
    assert_fails_in_one_line(result, saying="it takes the blur radius")


def test_map_may_not_go_beyond_what_was_calibrated(folder, instant):
    lens = napari_defocus.MeasuredPSF([1, 5], [np.pad(Disc().kernel(1), 4), Disc().kernel(5)])
    lens.save(folder / "lens.npz")
    save_map(folder / "blur.tif", np.full((HEIGHT, WIDTH), 6.0))
    given = ["--map", folder / "blur.tif", "--psf", folder / "lens.npz"]
    result = run("restore", folder / "p.png", *given)
    assert_fails_in_one_line(result, saying="goes up to 5 px")


# --- how they fail --------------------------------------------------------------------------

NO_MAPS = {
    "size.tif": (np.ones((HEIGHT, WIDTH - 1), np.float32), "59 x 48 px"),
    "levels.tif": (np.ones((HEIGHT, WIDTH), np.uint8), "holds no blur map"),
    "color.tif": (np.ones((HEIGHT, WIDTH, 3), np.float32), "holds no blur map"),
    "nan.tif": (np.full((HEIGHT, WIDTH), np.nan, np.float32), "has only NaN"),
    "infinite.tif": (np.full((HEIGHT, WIDTH), np.inf, np.float32), "finite ones from 0 px"),
    "negative.tif": (np.full((HEIGHT, WIDTH), -1, np.float32), "finite ones from 0 px"),
    "none.tif": (None, "no such file"),
}


@pytest.mark.parametrize("command", ["restore", "refocus", "depth"])
@pytest.mark.parametrize("name", NO_MAPS)
def test_what_is_no_map_of_the_picture_is_refused(folder, instant, command, name):
    values, saying = NO_MAPS[name]
    if values is not None:
        tifffile.imwrite(folder / name, values, photometric="rgb" if values.ndim == 3 else None)
    before = names_in(folder)
    options = {"restore": [], "refocus": ["--focus", 1], "depth": LENS_OPTIONS}[command]
    result = run(command, folder / "p.png", "--map", folder / name, *options)
    assert_fails_in_one_line(result, saying=saying)
    assert not instant, "nothing was computed"
    assert names_in(folder) == before


@pytest.mark.parametrize(
    ("values", "saying"),
    [
        (np.full((HEIGHT, WIDTH), 1.5), "not from 0 to 1"),
        (np.full((HEIGHT, WIDTH), np.nan), "not from 0 to 1"),
        (np.ones((2, 2)), "2 x 2 px"),
    ],
)
def test_what_is_no_confidence_of_the_map_is_refused(folder, instant, values, saying):
    save_map(folder / "sure.tif", values)
    given = ["--map", folder / "blur.tif", "--map-confidence", folder / "sure.tif"]
    assert_fails_in_one_line(run("restore", folder / "p.png", *given), saying=saying)
    assert not instant, "nothing was computed"


@pytest.mark.parametrize("command", ["restore", "refocus", "depth"])
def test_confidence_without_its_map_is_refused(folder, instant, command):
    save_map(folder / "sure.tif", np.ones((HEIGHT, WIDTH)))
    options = {"restore": [], "refocus": ["--focus", 1], "depth": LENS_OPTIONS}[command]
    result = run(command, folder / "p.png", "--map-confidence", folder / "sure.tif", *options)
    assert_fails_in_one_line(result, saying="--map-confidence")
    assert not instant, "nothing was computed"


@pytest.mark.parametrize("command", ["restore", "refocus", "depth"])
@pytest.mark.parametrize("name", ["p.png", "blur.tif", "sure.tif"])
def test_what_is_read_is_never_overwritten(folder, instant, command, name):
    save_map(folder / "sure.tif", np.ones((HEIGHT, WIDTH)))
    before = (folder / name).read_bytes()
    given = ["--map", folder / "blur.tif", "--map-confidence", folder / "sure.tif"]
    options = {"restore": [], "refocus": ["--focus", 1], "depth": LENS_OPTIONS}[command]
    result = run(command, folder / "p.png", *given, *options, "-o", folder / name, "--force")
    assert_fails_in_one_line(result, saying="is a file that is read")
    assert (folder / name).read_bytes() == before
    assert not instant, "nothing was computed"


@pytest.mark.parametrize(
    ("arguments", "saying"),
    [
        (["restore", "--tv-weight", 0], "--tv-weight is 0"),
        (["restore", "--tv-weight", "nan"], "--tv-weight is nan"),
        (["restore", "--noise-variance", -1], "--noise-variance is -1"),
        (["restore", "--psf", "square"], "psf is 'square'"),
        (["restore", "-o", "p.jpg"], "must end in"),
        (["restore", "-o", "none/p.png"], "there is no folder"),
        (["refocus"], "nothing would change"),
        (["refocus", "--focus", 0, "--aperture", 1], "nothing would change"),
        (["refocus", "--focus", "inf"], "focus is inf"),
        (["refocus", "--aperture", -1], "aperture is -1"),
        (["refocus", "--aperture", "nan"], "aperture is nan"),
        (["refocus", "--focus", 1, "--sharp-at", 2], "one of them is enough"),
        (["refocus", "--focus", 1, "--f-number", 2], "--f-number is 2.0, but only --sharp-at"),
        (["refocus", "--sharp-at", 0, *LENS_OPTIONS], "--sharp-at is 0.0"),
        (["refocus", "--sharp-at", "nan", *LENS_OPTIONS], "--sharp-at is nan"),
        (["refocus", "--sharp-at", 1e-320, *LENS_OPTIONS], "--sharp-at is 1e-320"),
        (["refocus", "--sharp-at", 2, "--f-number", 2], "does not note --focal-length, --focus-"),
        (["refocus", "--sharp-at", 2, *LENS_OPTIONS, "--focus-distance", "inf"], "'near'"),
        (["refocus", "--sharp-at", 2, *LENS_OPTIONS, "--f-number", 0], "--f-number is 0"),
        (["refocus", "--focus", 1, "--tv-weight", -1], "--tv-weight is -1"),
        (["refocus", "--focus", 1, "--psf", "square"], "psf is 'square'"),
        (["refocus", "--focus", 1, "-o", "p.gif"], "must end in"),
    ],
)
def test_what_makes_no_sense_is_refused_before_any_work(
    folder, instant, monkeypatch, arguments, saying
):
    monkeypatch.chdir(folder)
    command, *options = arguments
    assert_fails_in_one_line(run(command, "p.png", *options), saying=saying)
    assert not instant, "nothing was computed"
    assert names_in(folder) == ["blur.tif", "p.png"]


def test_existing_result_is_kept_unless_forced(folder, instant):
    (folder / "p-in-focus.png").write_bytes(b"mine")
    assert_fails_in_one_line(run("restore", folder / "p.png"), saying="exists already")
    assert not instant, "nothing was computed"
    assert (folder / "p-in-focus.png").read_bytes() == b"mine"
    assert run("restore", folder / "p.png", "--force").exit_code == 0
    assert (folder / "p-in-focus.png").read_bytes() != b"mine"


def test_full_disk_leaves_nothing_behind(folder, instant, monkeypatch):
    monkeypatch.setattr(os, "fsync", full_disk)
    outputs = ["-o", folder / "r.png", "-o", folder / "r.tif"]
    result = run("restore", folder / "p.png", *outputs)
    assert_fails_in_one_line(result, saying="No space left on device")
    assert names_in(folder) == ["blur.tif", "p.png"]


def test_quiet_prints_nothing(folder, instant):
    result = run("refocus", folder / "p.png", "--focus", 1, "--quiet")
    assert (result.exit_code, result.output) == (0, "")


def test_16_bit_png_with_opacity_stays_that(tmp_path, instant):
    picture = np.random.default_rng(1).integers(0, 65536, (12, 10, 4), dtype=np.uint16)
    (tmp_path / "p.png").write_bytes(imagecodecs.png_encode(picture))
    assert run("restore", tmp_path / "p.png").exit_code == 0
    np.testing.assert_array_equal(read_picture(tmp_path / "p-in-focus.png"), picture)
