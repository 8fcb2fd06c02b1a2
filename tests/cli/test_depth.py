"""The terminal command that tells distances."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
from command_line import assert_fails_in_one_line, names_in, run
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

import napari_defocus
from napari_defocus import Settings, ThinLens, depth_from_blur
from napari_defocus.core.intensity import Intensities
from napari_defocus.settings import MapSettings

HEIGHT, WIDTH = 48, 60
NOTED = {
    "FocalLength": IFDRational(50, 1),
    "FNumber": IFDRational(2, 1),
    "FocalPlaneXResolution": IFDRational(1000, 1),
    "FocalPlaneResolutionUnit": 4,
}
"""50 mm, f/2, 1 um; no focus distance."""

GIVEN = ["--focal-length", 50, "--f-number", 2, "--focus-distance", 2, "--pixel-pitch", 20]
LENS = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=20)
"""Its largest radius beyond the focus is 16 px."""


@pytest.fixture
def folder(tmp_path):
    """A folder with a photograph that notes most of its lens, and one that notes nothing."""
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif).update({ExifTags.Base[tag]: NOTED[tag] for tag in NOTED})
    Image.new("L", (WIDTH, HEIGHT), 99).save(tmp_path / "noted.jpg", exif=exif.tobytes())
    Image.new("L", (WIDTH, HEIGHT), 99).save(tmp_path / "p.png")
    return tmp_path


@pytest.fixture
def scales(folder):
    """A map from 0 to 20 px, as a file."""
    ramp = np.tile(np.linspace(0, 20, WIDTH, dtype=np.float32), (HEIGHT, 1))
    tifffile.imwrite(folder / "blur.tif", ramp)
    return ramp


@pytest.fixture
def instant(monkeypatch):
    """Stand-ins for the estimation: a radius of 4 px everywhere, surer to the right."""
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
        return np.full(image.shape[:2], 4.0, np.float32)

    def confidence_map(candidates, blur_map):
        return np.tile(np.linspace(0, 1, WIDTH, dtype=np.float32), (HEIGHT, 1))

    for function in (estimate_candidates, label_blur_map, confidence_map):
        monkeypatch.setattr(napari_defocus, function.__name__, function)
    return calls


@pytest.mark.parametrize("side", ["far", "near"])
def test_distances_are_those_of_the_function(folder, scales, side):
    given = ["--map", folder / "blur.tif", *GIVEN, "--side", side]
    result = run("depth", folder / "p.png", *given, "--json")
    assert result.exit_code == 0, result.output
    expected = depth_from_blur(scales, LENS, side=side)
    values = tifffile.imread(folder / "p-depth.tif")
    assert values.dtype == np.float32
    np.testing.assert_array_equal(values, expected)
    assert np.isinf(values).any() == (side == "far")
    facts = json.loads(result.stdout)
    finite = expected[np.isfinite(expected)].astype(float)
    assert facts["depth_median_m"] == pytest.approx(np.median(finite))
    assert facts["depth_p5_m"] == pytest.approx(np.percentile(finite, 5))
    assert facts["depth_p95_m"] == pytest.approx(np.percentile(finite, 95))
    assert facts["infinite_percent"] == pytest.approx(100 * np.isinf(expected).mean())
    assert facts["side"] == side
    assert facts["files"] == [str(folder / "p-depth.tif"), str(folder / "p-depth.png")]


def test_settings_are_read_from_a_file_and_saved(folder, instant):
    said, saved = folder / "said.json", folder / "saved.json"
    said.write_text('{"map": {"window": 61, "stride": 6}}')
    given = [*GIVEN, "--settings", said, "--stride", 5, "--save-settings", saved]
    result = run("depth", folder / "p.png", *given)
    assert result.exit_code == 0, result.output
    assert (instant["candidates"]["window"], instant["candidates"]["stride"]) == (61, 5)
    assert Settings.load(saved).map == MapSettings(window=61, stride=5)


def test_file_says_what_made_it(folder, scales):
    assert run("depth", folder / "p.png", "--map", folder / "blur.tif", *GIVEN).exit_code == 0
    with tifffile.TiffFile(folder / "p-depth.tif") as tiff:
        description = json.loads(tiff.pages[0].description)
    assert (description["quantity"], description["unit"]) == ("distance from the lens", "m")
    assert description["settings"]["thin_lens"]["pixel_pitch_um"] == 20
    assert description["settings"]["side"] == "far"
    assert description["settings"]["map"] == str(folder / "blur.tif")


def test_lens_is_what_the_photograph_notes_and_what_is_given(folder, instant):
    options = ["--focus-distance", 3, "--f-number", 4]
    result = run("depth", folder / "noted.jpg", *options)
    assert result.exit_code == 0, result.output
    lens = "50 mm (EXIF), f/4, focused at 3 m, pixels of 1 um (EXIF: from the resolution of its"
    assert f"thin lens    {lens}" in result.stdout
    assert "side         far: all blur is assumed to lie beyond the plane in focus" in result.stdout
    used = ThinLens(focal_length_mm=50, f_number=4, focus_distance_m=3, pixel_pitch_um=1)
    distance = float(depth_from_blur(4.0, used))
    assert f"depth        median {distance:.4g} m" in result.stdout
    limit = float(depth_from_blur(64.0, used))
    assert f"limit        {limit:.4g} m has the largest blur that is looked for" in result.stdout
    np.testing.assert_allclose(tifffile.imread(folder / "noted-depth.tif"), distance)


def test_what_the_photograph_lacks_is_named_before_any_work(folder, instant):
    before = names_in(folder)
    result = run("depth", folder / "noted.jpg")
    assert_fails_in_one_line(result, saying="does not note --focus-distance; give what is missing")
    result = run("depth", folder / "p.png", "--focus-distance", 2)
    missing = "does not note --focal-length, --f-number and --pixel-pitch"
    assert_fails_in_one_line(result, saying=missing)
    assert not instant, "nothing was computed"
    assert names_in(folder) == before


def test_picture_without_exif_needs_none_if_the_lens_is_given(folder, instant):
    """Pillow does not open TIFFs of floats in colour."""
    tifffile.imwrite(folder / "f.tif", np.ones((HEIGHT, WIDTH, 3), np.float32), photometric="rgb")
    result = run("depth", folder / "f.tif", *GIVEN)
    assert result.exit_code == 0, result.output


def test_focus_at_infinity_is_told_and_is_json(folder, scales):
    options = ["--map", folder / "blur.tif", *GIVEN, "--focus-distance", "inf", "--side", "near"]
    result = run("depth", folder / "p.png", *options, "--json")
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout, parse_constant=pytest.fail)
    assert facts["thin_lens"]["focus_distance_m"] == "inf"
    assert facts["infinite_percent"] == pytest.approx(100 / WIDTH)
    result = run("depth", folder / "p.png", *options, "--force")
    assert "focused at infinity" in result.stdout
    assert "near: all blur is assumed to lie before the plane in focus" in result.stdout


def test_nothing_lies_beyond_infinity(folder, instant):
    result = run("depth", folder / "p.png", *GIVEN, "--focus-distance", "inf")
    assert_fails_in_one_line(result, saying="it takes 'near'")
    assert not instant, "nothing was computed"


def test_picture_without_a_finite_distance_has_no_range(folder):
    tifffile.imwrite(folder / "blur.tif", np.full((HEIGHT, WIDTH), 17, np.float32))
    options = ["depth", folder / "p.png", "--map", folder / "blur.tif", *GIVEN]
    facts = json.loads(run(*options, "--json").stdout, parse_constant=pytest.fail)
    assert facts["depth_median_m"] is None
    assert facts["infinite_percent"] == 100
    result = run(*options, "--force")
    assert result.exit_code == 0, result.output
    assert "infinite     100.0 % of the picture" in result.stdout


def test_pixels_of_low_confidence_have_no_distance(folder, instant):
    result = run("depth", folder / "p.png", *GIVEN, "--min-confidence", 0.25)
    assert result.exit_code == 0, result.output
    values = tifffile.imread(folder / "p-depth.tif")
    assert np.isnan(values[:, :15]).all()
    assert np.isfinite(values[:, 15:]).all()
    assert "left out     25.0 %" in result.stdout


def test_gaps_of_a_map_have_no_distance_and_confidence_may_be_given(folder, scales):
    scales[:, :10] = np.nan
    tifffile.imwrite(folder / "blur.tif", scales)
    sure = np.ones((HEIGHT, WIDTH), np.float32)
    sure[:8] = 0.1
    tifffile.imwrite(folder / "sure.tif", sure)
    options = ["depth", folder / "p.png", "--map", folder / "blur.tif", *GIVEN]
    result = run(*options, "--map-confidence", folder / "sure.tif", "--min-confidence", 0.5)
    assert result.exit_code == 0, result.output
    missing = np.isnan(tifffile.imread(folder / "p-depth.tif"))
    np.testing.assert_array_equal(missing, np.isnan(scales) | (sure < 0.5))
    result = run(*options, "--min-confidence", 0.5, "--force")
    assert_fails_in_one_line(result, saying="--map-confidence")


def test_distance_is_the_same_whatever_the_lens(folder, instant):
    result = run("depth", folder / "p.png", *GIVEN, "--psf", "gaussian")
    assert result.exit_code == 0, result.output
    values = tifffile.imread(folder / "p-depth.tif")
    np.testing.assert_allclose(values, depth_from_blur(4.0, LENS))


@pytest.mark.parametrize(
    ("options", "saying"),
    [
        (["--pixel-pitch", -5], "--pixel-pitch is -5"),
        (["--focus-distance", 0.01], "above the focal length"),
        (["--min-confidence", 2], "--min-confidence is "),
        (["-o", "p.jpg"], "must end in"),
        (["-o", "none/p.tif"], "there is no folder"),
        (["--psf", "square"], "psf is 'square'"),
        (["--max-radius", 0], "--max-radius is "),
    ],
)
def test_what_makes_no_sense_is_refused_before_any_work(folder, instant, options, saying):
    before = names_in(folder)
    result = run("depth", folder / "p.png", *GIVEN, *options)
    assert_fails_in_one_line(result, saying=saying)
    assert not instant, "nothing was computed"
    assert names_in(folder) == before


def test_existing_result_is_kept_unless_forced(folder, instant):
    (folder / "p-depth.png").write_bytes(b"mine")
    assert_fails_in_one_line(run("depth", folder / "p.png", *GIVEN), saying="exists already")
    assert not instant, "nothing was computed"
    assert run("depth", folder / "p.png", *GIVEN, "--force", "--quiet").output == ""
