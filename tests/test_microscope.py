"""From a micrograph to um: what a microscopist gets, from Python, the terminal and napari."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile
from command_line import assert_fails_in_one_line, names_in, run
from napari.components import ViewerModel
from scipy.fft import irfft2, rfft2

from napari_defocus import (
    Microscope,
    Settings,
    confidence_map,
    estimate_candidates,
    label_blur_map,
    measure_batch,
)
from napari_defocus.batch.picture_signs import signs_of_picture
from napari_defocus.cli.microscope import remarks_on_pixels
from napari_defocus.settings import MapSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.display.cursor_text import text_under_cursor
from napari_defocus.widgets.display.summaries import summary_of
from napari_defocus.widgets.jobs.analysis import Analysis
from napari_defocus.widgets.jobs.estimation import JobCache, Picture
from napari_defocus.widgets.layers.image_layers import shown_plane

LENS = Microscope(0.8, 0.52, 0.1625)
TYPED = ["--numerical-aperture", 0.8, "--wavelength", 0.52, "--immersion", "air"]
DEFOCUS_UM = 0.9
SIDE = 200


def blurred(light, defocus):
    """Return the counts of a camera of 20 000 photons, for a specimen at a defocus in um."""
    rng = np.random.default_rng(1)
    kernel = rfft2(LENS.kernel(LENS.blur_radius(defocus)), light.shape)
    seen = irfft2(rfft2(light) * kernel, light.shape)
    return (rng.poisson(np.maximum(seen, 0)) + rng.normal(100, 2, seen.shape)).astype(np.uint16)


@pytest.fixture(scope="module")
def tissue(grass):
    return blurred(20_000 * grass[:SIDE, :SIDE], DEFOCUS_UM)


@pytest.fixture(scope="module")
def beads():
    rng = np.random.default_rng(0)
    light = np.full((SIDE, SIDE), 10.0)
    light[tuple(rng.integers(0, SIDE, (2, 130)))] += 20_000
    return blurred(light, DEFOCUS_UM)


@pytest.mark.parametrize("kind", ["tissue", "beads"])
def test_defocus_is_found_in_um_and_so_is_what_the_specimen_shows(kind, request):
    picture = request.getfixturevalue(kind)
    candidates = estimate_candidates(picture, psf=LENS)
    blur_map = label_blur_map(candidates, picture)
    assert np.median(LENS.defocus_um(blur_map)) == pytest.approx(DEFOCUS_UM, rel=0.1)
    assert np.median(confidence_map(candidates, blur_map)) > 0.5
    choice = candidates.psf_choice
    assert choice.psf.specimen == {"tissue": "texture", "beads": "points"}[kind]
    assert choice.found


@pytest.fixture
def micrograph(tmp_path, tissue):
    path = tmp_path / "tissue.tif"
    about = {"axes": "YX", "unit": "um"}
    tifffile.imwrite(path, tissue, imagej=True, resolution=(1 / 0.1625,) * 2, metadata=about)
    return path


def test_terminal_tells_um_and_writes_them(micrograph):
    told = run("map", micrograph, *TYPED)
    assert "defocus      median 0." in told.output
    assert "one picture cannot tell" in told.output
    folder = micrograph.parent
    um, px = (tifffile.imread(folder / f"tissue-{name}.tif") for name in ("defocus", "blur"))
    np.testing.assert_allclose(um, LENS.defocus_um(px), rtol=1e-5)
    assert np.median(um) == pytest.approx(DEFOCUS_UM, rel=0.1)
    refused = run("restore", micrograph, "--map", folder / "tissue-defocus.tif")
    assert_fails_in_one_line(refused, saying="in um; it takes a blur map in px")


def test_terminal_asks_for_what_neither_file_nor_options_say(tmp_path, tissue):
    plain = tmp_path / "plain.tif"
    tifffile.imwrite(plain, tissue)
    assert_fails_in_one_line(run("map", plain, *TYPED), saying="the pixel size")
    both = run("map", plain, "--psf", "gaussian", "--wavelength", 0.5)
    assert_fails_in_one_line(both, saying="it takes microscope")
    known = run("map", plain, "--defocus", tmp_path / "um.tif")
    assert_fails_in_one_line(known, saying="um take psf microscope")
    assert names_in(tmp_path) == ["plain.tif"]


@pytest.mark.parametrize(
    ("option", "value", "saying"),
    [
        ("--wavelength", 520, "--wavelength is 520.0; it takes a number of um from 0.1 to 20"),
        ("--immersion", 9, "--immersion is 9.0; it takes a number from 1 to 2"),
    ],
)
def test_terminal_asks_for_nothing_else_if_a_number_is_impossible(
    micrograph, option, value, saying
):
    result = run("map", micrograph, *TYPED, option, value)
    assert_fails_in_one_line(result, saying=saying)
    assert "(--" not in result.stderr


def test_table_of_a_batch_has_um_beside_px(micrograph, tmp_path):
    lens = MapSettings(psf="microscope:0.8:0.52:0.1625:1:texture")
    assert measure_batch([micrograph], tmp_path / "out", settings=Settings(map=lens)).failed == 0
    [row] = csv.DictReader((tmp_path / "out" / "table.csv").open())
    um, px = (float(row[name]) for name in ("median_defocus_um", "median_radius_px"))
    assert um == pytest.approx(LENS.defocus_um(px), rel=1e-4)
    assert row["p95_defocus_um"]


def test_settings_file_repeats_the_microscope(micrograph, tmp_path):
    saved = tmp_path / "settings.json"
    run("map", micrograph, *TYPED, "--save-settings", saved)
    assert json.loads(saved.read_text())["map"]["psf"].startswith("microscope:0.8:0.52:0.1625:1")


def test_napari_shows_um(tissue):
    viewer = ViewerModel()
    layer = viewer.add_image(tissue, name="tissue")
    plane = shown_plane(layer, viewer.dims)
    asked = MapSettings(psf="microscope:0.8:0.52:0.1625:1:texture")
    results = Analysis(plane=plane, estimation=asked).run(JobCache())
    add_results(viewer, results)
    um = viewer.layers["tissue defocus (µm)"]
    assert np.median(um.data) == pytest.approx(DEFOCUS_UM, rel=0.1)
    assert um.colorbar.visible
    assert um.contrast_limits[1] == pytest.approx(LENS.defocus_um(8.0), rel=1e-3)
    viewer.cursor.position = SIDE // 2, SIDE // 2
    assert " px = 0." in text_under_cursor(viewer)
    assert "µm" in text_under_cursor(viewer)
    assert "Defocus 0." in summary_of(results, None, Picture.of(plane))


def test_another_pixel_size_than_the_file_notes_is_told(micrograph):
    output = ["-o", micrograph.with_name("m.tif")]
    told = run("map", micrograph, *TYPED, "--pixel-size", 0.325, *output)
    assert "careful      The picture notes pixels of 0.1625 um" in told.output


WIDE = Microscope(0.8, 0.52, 6.5)
"""The pixels are those of a camera, not of the specimen."""


def damaged(path):
    about = {"axes": "YX", "PhysicalSizeX": "wide", "PhysicalSizeY": "high"}
    tifffile.imwrite(path, np.zeros((8, 8)), metadata=about)
    return path


def not_square(path):
    about = {"axes": "YX", "PhysicalSizeX": 0.1, "PhysicalSizeY": 0.3}
    tifffile.imwrite(path, np.zeros((8, 8)), metadata=about)
    return path


def nothing(path):
    tifffile.imwrite(path, np.zeros((8, 8)))
    return path


@pytest.mark.parametrize("noting", [damaged, not_square, nothing])
def test_terminal_tells_wide_pixels_whatever_the_file_notes_of_them(tmp_path, noting):
    path = noting(tmp_path / "cells.ome.tif")
    [told] = remarks_on_pixels(path, SimpleNamespace(psf=WIDE))
    assert "A pixel of 6.5 um is 16 times as wide as the Airy disc" in told
    assert remarks_on_pixels(path, SimpleNamespace(psf=LENS)) == []


def test_batch_tells_wide_pixels_and_other_pixels_than_the_file_notes():
    picture = np.random.default_rng(0).integers(0, 255, (120, 120), dtype=np.uint8)
    candidates = SimpleNamespace(window=41, strength=None, direction=None)

    def careful(lens, noted):
        found = SimpleNamespace(candidates=candidates, doubt=None, psf=lens)
        return signs_of_picture(picture, found, None, {"pixel_width_um": noted})["careful"]

    assert careful(LENS, None) is None
    assert "16 times as wide as the Airy disc" in careful(WIDE, None)
    assert "The picture notes pixels of 0.1 um" in careful(LENS, 0.1)
