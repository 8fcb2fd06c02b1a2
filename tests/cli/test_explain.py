"""The terminal command that explains one pixel."""

import json

import numpy as np
import pytest
from command_line import assert_fails_in_one_line, names_in, run
from PIL import Image

import napari_defocus

RADIUS = 4.0


@pytest.fixture(scope="module")
def pixels(gravel, defocused):
    blurred = defocused(gravel[:80, :96], RADIUS, noise_variance=0)
    return np.rint(255 * np.clip(blurred, 0, 1)).astype(np.uint8)


@pytest.fixture
def picture(tmp_path, pixels):
    Image.fromarray(pixels).save(tmp_path / "p.png")
    return tmp_path / "p.png"


@pytest.fixture
def no_work(monkeypatch):
    def estimate_candidates(*_, **__):
        pytest.fail("it was measured before the arguments were checked")

    monkeypatch.setattr(napari_defocus, "estimate_candidates", estimate_candidates)


def test_plain_lines_tell_the_value_the_candidates_and_the_window(picture):
    result = run("explain", picture, 40, 44)
    assert result.exit_code == 0, result.output
    assert "pixel        row 40, column 44" in result.stdout
    assert "window       rows 2" in result.stdout
    assert "blur         The blur is 4.0 px, with a confidence of 0." in result.stdout
    assert names_in(picture.parent) == ["p.png"], "nothing is written unasked"


def test_settings_file_says_what_options_do_not(picture):
    said = picture.with_name("said.json")
    said.write_text('{"map": {"window": 31}}')
    result = run("explain", picture, 40, 44, "--settings", said, "--stride", 5, "--json")
    top, left, bottom, right = json.loads(result.stdout)["window"]
    assert (bottom - top, right - left) == (31, 31)


def test_json_has_what_the_function_returns_and_the_drawing_is_a_picture(picture, pixels):
    drawing = picture.with_name("curve.png")
    result = run("explain", picture, 40, 44, "-o", drawing, "--json")
    facts = json.loads(result.stdout, parse_constant=pytest.fail)
    candidates = napari_defocus.estimate_candidates(pixels)
    blur_map = napari_defocus.label_blur_map(candidates, pixels)
    told = napari_defocus.explain_pixel(candidates, 40, 44, blur_map=blur_map, image=pixels)
    assert facts["blur_px"] == pytest.approx(told.blur)
    assert facts["candidates_px"] == pytest.approx(told.radii)
    assert facts["log_likelihood"] == pytest.approx(told.log_likelihood)
    assert facts["window"] == list(told.window)
    assert facts["files"] == [str(drawing)]
    with Image.open(drawing) as shown:
        assert shown.format == "PNG"
        assert np.ptp(np.asarray(shown)) > 100


@pytest.mark.parametrize(
    ("arguments", "saying"),
    [
        ((80, 3), "(row, column) is (80, 3)"),
        ((3, 96), "80 x 96 px"),
        ((3, 3, "-o", "curve.tif"), "must end in .png"),
        ((3, 3, "--psf", "square"), "psf is 'square'"),
    ],
)
def test_what_makes_no_sense_is_refused_before_any_work(picture, no_work, arguments, saying):
    assert_fails_in_one_line(run("explain", picture, *arguments), saying=saying)


def test_drawing_that_exists_is_kept_unless_forced(picture):
    (picture.parent / "curve.png").write_bytes(b"mine")
    arguments = ["explain", picture, 40, 44, "-o", picture.parent / "curve.png"]
    assert_fails_in_one_line(run(*arguments), saying="exists already")
    assert run(*arguments, "--force", "--quiet").output == ""
    assert (picture.parent / "curve.png").read_bytes() != b"mine"
