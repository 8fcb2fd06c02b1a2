"""Blur maps saved and opened again: as layers of napari, and by the terminal command."""

import fnmatch
import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from napari.components import ViewerModel
from napari.errors import MultipleReaderError
from napari.layers import Image, Labels
from napari.plugins import _npe2
from napari.plugins.io import save_layers
from npe2 import PluginManifest
from PIL import Image as Picture
from typer.testing import CliRunner

import napari_defocus
from napari_defocus.cli.app import app
from napari_defocus.io.encoders import blur_map_tiff
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.display.add_results import add_results
from napari_defocus.widgets.export.map_files import (
    PATTERNS,
    NotAMapError,
    map_reader,
    open_map,
    read_map,
    save_map,
)
from napari_defocus.widgets.jobs.map_source import may_be_map_of, settings_of_map, source_of_layer
from napari_defocus.widgets.layers.image_layers import shown_plane
from napari_defocus.widgets.layers.result_layers import (
    blur_map_layer,
    confidence_layer,
    in_focus_layer,
)
from napari_defocus.widgets.layers.result_metadata import BLUR_MAP, METADATA_KEY, made_by_us

MANIFEST = PluginManifest.from_file(Path(napari_defocus.__file__).with_name("napari.yaml"))
SETTINGS = MapSettings(smoothness=5.0, max_radius=6.0)


@pytest.fixture
def plugins(npe2pm):
    """Ours first: napari does not say in which order it finds plugins."""
    npe2pm.register(MANIFEST)
    npe2pm.register(PluginManifest.from_distribution("napari"))
    return npe2pm


@pytest.fixture
def measured(viewer, texture):
    """A photograph in a viewer, 0.5 um a pixel, with its map, confidence and mask."""
    where = {"scale": (0.5, 0.25), "translate": (3.0, 4.0), "units": ("um", "um")}
    image = viewer.add_image(texture, name="photo", axis_labels=("y", "x"), **where)
    plane = shown_plane(image, viewer.dims)
    rng = np.random.default_rng(3)
    radius = rng.uniform(0, 6, texture.shape).astype(np.float32)
    radius[:9, :9] = np.nan
    mask = (radius < 2).astype(np.uint8)
    layers = add_results(
        viewer,
        [
            blur_map_layer(plane, radius, SETTINGS, 3e-5),
            confidence_layer(plane, radius / 6, SETTINGS, 3e-5),
            in_focus_layer(plane, mask, MaskSettings(), SETTINGS, 3e-5),
        ],
    )
    return image, *layers


def assert_same(again, layer):
    np.testing.assert_array_equal(again.data, layer.data)
    assert again.data.dtype == np.float32
    assert again.name == layer.name
    assert again.colormap.name == layer.colormap.name
    assert tuple(again.contrast_limits) == tuple(layer.contrast_limits)
    assert again.metadata == layer.metadata
    assert again.units == layer.units
    assert again.axis_labels == layer.axis_labels
    for name in ("scale", "translate", "rotate", "shear"):
        np.testing.assert_array_equal(getattr(again, name), getattr(layer, name))
    np.testing.assert_array_equal(again.affine.affine_matrix, layer.affine.affine_matrix)
    assert again.colorbar.visible


@pytest.mark.parametrize("which", [1, 2], ids=["map", "confidence"])
def test_saved_layer_opens_as_it_was(tmp_path, measured, which):
    layer = measured[which]
    path = save_map(layer, tmp_path / "photo-blur.tif")
    assert_same(open_map(ViewerModel(), path), layer)


@pytest.mark.parametrize("planes", [1, 3, 4])
def test_saved_stack_opens_as_it_was(tmp_path, viewer, planes):
    data = np.random.default_rng(0).uniform(0, 8, (planes, 40, 3)).astype(np.float32)
    metadata = {METADATA_KEY: {"result": BLUR_MAP, "source": "film"}}
    layer = viewer.add_image(data, name="film blur (px)", colormap="viridis", metadata=metadata)
    layer.contrast_limits = (0, 8)
    layer.scale = (2.0, 0.5, 0.5)
    layer.colorbar.visible = True
    again = read_map(save_map(layer, tmp_path / "film-blur.tif"))
    assert again.data.shape == (planes, 40, 3)
    np.testing.assert_array_equal(again.data, data)
    np.testing.assert_array_equal(again.scale, layer.scale)


def test_placed_by_rotation_and_affine_it_lies_there_again(tmp_path, measured):
    layer = measured[1]
    layer.rotate = 30
    layer.affine = [[1, 0.5, 7], [0, 2, 1], [0, 0, 1]]
    assert_same(read_map(save_map(layer, tmp_path / "photo-blur.tif")), layer)


def test_opened_map_is_known_as_the_map_of_the_picture(tmp_path, measured, texture):
    path = save_map(measured[1], tmp_path / "photo-blur.tif")
    save_map(measured[2], tmp_path / "photo-confidence.tif")
    viewer = ViewerModel()
    image = viewer.add_image(texture, name="photo")
    layer = open_map(viewer, path)
    open_map(viewer, tmp_path / "photo-confidence.tif")
    assert may_be_map_of(layer, image)
    assert settings_of_map(layer) == SETTINGS
    source = source_of_layer(layer, shown_plane(image, viewer.dims), viewer, "gaussian")
    assert source.psf == "disc"
    assert source.confidence is not None, "saved with it, found with it"


def test_other_programs_read_the_size_of_a_pixel_and_what_made_the_map(tmp_path, measured):
    with tifffile.TiffFile(save_map(measured[1], tmp_path / "photo-blur.tif")) as tiff:
        tags = tiff.pages.first.tags
        described = json.loads(tiff.pages.first.description)
        np.testing.assert_array_equal(tiff.asarray(), measured[1].data)
    per_cm = [tags[name].value[0] / tags[name].value[1] for name in ("XResolution", "YResolution")]
    assert per_cm == pytest.approx([1e4 / 0.25, 1e4 / 0.5])
    assert tags["ResolutionUnit"].value == 3, "cm"
    assert described["unit"] == "px"
    assert described["source"] == "photo"
    assert described["noise_variance"] == 3e-5
    assert described["settings"]["smoothness"] == 5.0
    assert described["scale"] == "blur radius (px)"
    assert described["version"] == napari_defocus.__version__


def test_pixels_without_a_size_get_none(tmp_path, viewer):
    metadata = {METADATA_KEY: {"result": BLUR_MAP}}
    layer = viewer.add_image(np.ones((9, 9), np.float32), name="a", metadata=metadata)
    with tifffile.TiffFile(save_map(layer, tmp_path / "a-blur.tif")) as tiff:
        assert tiff.pages.first.tags["ResolutionUnit"].value == 1


def test_map_that_does_not_say_what_made_it_stays_so(tmp_path, viewer):
    metadata = {METADATA_KEY: {"result": BLUR_MAP, "noise_variance": 1e-6}}
    layer = viewer.add_image(np.ones((9, 9), np.float32), name="true", metadata=metadata)
    again = read_map(save_map(layer, tmp_path / "true-blur.tif"))
    assert again.metadata == metadata
    assert settings_of_map(again) is None


def test_lens_file_that_has_gone_does_not_stop_opening(tmp_path, measured):
    layer = measured[1]
    layer.metadata[METADATA_KEY]["settings"]["psf"] = str(tmp_path / "gone.npz")
    again = read_map(save_map(layer, tmp_path / "photo-blur.tif"))
    assert tuple(again.contrast_limits) == tuple(layer.contrast_limits) == (0, 8)
    np.testing.assert_array_equal(again.data, layer.data)


@pytest.mark.parametrize(
    ("given", "written"),
    [
        ("photo", "photo-blur.tif"),
        ("photo blur (px)", "photo blur (px).tif"),
        ("any.tif", "any.tif"),
        ("any.TIFF", "any.TIFF"),
    ],
)
def test_names_get_an_ending_by_which_they_are_known(tmp_path, measured, given, written):
    assert save_map(measured[1], tmp_path / given) == tmp_path / written
    assert [path.name for path in tmp_path.iterdir()] == [written]


def test_nothing_is_overwritten_unasked(tmp_path, measured):
    path = tmp_path / "photo-blur.tif"
    path.write_text("mine")
    with pytest.raises(OSError, match="it exists already"):
        save_map(measured[1], path)
    assert path.read_text() == "mine"
    save_map(measured[1], path, force=True)
    assert_same(read_map(path), measured[1])


def test_what_is_no_map_is_told_and_not_written(tmp_path, measured):
    with pytest.raises(NotAMapError, match="“photo” is no blur map"):
        save_map(measured[0], tmp_path / "photo-blur.tif")
    tifffile.imwrite(tmp_path / "other.tif", np.zeros((5, 5)))
    with pytest.raises(NotAMapError, match=r"“other\.tif” is no blur map"):
        read_map(tmp_path / "other.tif")
    assert [path.name for path in tmp_path.iterdir()] == ["other.tif"]


def test_file_that_is_cut_off_is_told(tmp_path, measured):
    path = save_map(measured[1], tmp_path / "photo-blur.tif")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match="cut off or damaged"):
        read_map(path)


# In napari.


def test_manifest_takes_the_names_that_we_give():
    assert tuple(MANIFEST.contributions.readers[0].filename_patterns) == PATTERNS


def test_map_opens_with_the_plugin(tmp_path, plugins, measured):
    path = save_map(measured[1], tmp_path / "photo-blur.tif")
    [layer] = ViewerModel().open(path, plugin="napari-defocus")
    assert_same(layer, measured[1])


@pytest.mark.parametrize(
    "name", ["photo.tif", "blur.tif", "gaussian_blur.tiff", "deblurred.tif", "photo.ome.tif"]
)
def test_other_tiffs_open_as_ever_without_a_question(tmp_path, plugins, name):
    values = np.arange(20, dtype=np.uint16).reshape(4, 5)
    tifffile.imwrite(tmp_path / name, values)
    assert list(_npe2.get_readers(tmp_path / name)) == ["napari"]
    [layer] = ViewerModel().open(tmp_path / name, plugin=None)
    np.testing.assert_array_equal(layer.data, values)
    assert not any(fnmatch.fnmatch(name, pattern) for pattern in PATTERNS)


def test_plugin_that_is_remembered_opens_maps_unasked_and_leaves_other_tiffs_to_napari(
    tmp_path, plugins, measured, monkeypatch
):
    path = save_map(measured[1], tmp_path / "photo-blur.tif")
    with pytest.raises(MultipleReaderError):
        ViewerModel().open(path, plugin=None)
    chosen = "napari.components.viewer_model.get_preferred_reader"
    monkeypatch.setattr(chosen, lambda _: "napari-defocus")
    [layer] = ViewerModel().open(path, plugin=None)
    assert_same(layer, measured[1])
    tifffile.imwrite(tmp_path / "other.tif", np.zeros((4, 5), np.uint8))
    with pytest.warns(RuntimeWarning, match="Can't find napari-defocus"):
        [layer] = ViewerModel().open(tmp_path / "other.tif", plugin=None)
    assert layer.source.reader_plugin == "napari"


def test_reader_refuses_what_only_has_the_name_of_a_map(tmp_path):
    tifffile.imwrite(tmp_path / "my-blur.tif", np.zeros((4, 5), np.float32))
    (tmp_path / "text-blur.tif").write_text("no picture")
    for name in ("my-blur.tif", "text-blur.tif", "none-blur.tif"):
        assert map_reader(str(tmp_path / name)) is None
    (tmp_path / "our-blur.tif").write_bytes(blur_map_tiff(np.zeros((4, 5)), {}))
    assert map_reader(str(tmp_path / "our-blur.tif")) is not None
    both = [str(tmp_path / name) for name in ("our-blur.tif", "my-blur.tif")]
    assert map_reader(both) is None


@pytest.mark.parametrize("name", ["photo.tif", "photo"])
def test_other_layers_are_saved_by_napari_as_ever(tmp_path, plugins, measured, name):
    image, _, _, mask = measured
    assert image.save(str(tmp_path / name)) == [str(tmp_path / "photo.tif")]
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "photo.tif"), image.data)
    assert mask.save(str(tmp_path / "mask.tif")) == [str(tmp_path / "mask.tif")]


def test_map_is_saved_by_the_plugin_where_it_is_chosen(tmp_path, plugins, viewer, measured):
    layer = measured[1]
    path = tmp_path / "photo-blur.tif"
    path.write_text("what the dialog has asked about")
    assert layer.save(str(path), plugin="napari-defocus") == [str(path)]
    assert_same(read_map(path), layer)
    offered, _ = _npe2.file_extensions_string_for_layers([layer])
    assert "Defocus Blur map (px) as TIFF (*.tif *.tiff)" in offered.split(";;")


def test_name_that_gets_an_ending_in_the_dialog_overwrites_nothing(tmp_path, plugins, measured):
    writer = MANIFEST.contributions.writers[0]
    (tmp_path / "photo-blur.tif").write_text("mine")
    with pytest.raises(OSError, match="it exists already"):
        save_layers(str(tmp_path / "photo"), [measured[1]], _writer=writer)
    assert (tmp_path / "photo-blur.tif").read_text() == "mine"


def test_picture_with_labels_is_not_offered_as_a_map(plugins, measured):
    offered, _ = _npe2.file_extensions_string_for_layers([measured[0], measured[3]])
    assert "Defocus" not in offered


# The terminal.


@pytest.fixture
def photograph(tmp_path, texture):
    path = tmp_path / "photo.png"
    Picture.fromarray(np.rint(255 * texture).astype(np.uint8)).save(path)
    return path


def terminal(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result


@pytest.mark.parametrize("option", [[], ["--psf", "gaussian"], ["--shot-noise"]])
def test_map_of_the_terminal_opens_as_one_of_ours(tmp_path, plugins, photograph, option):
    sure = tmp_path / "photo-confidence.tif"
    terminal("map", photograph, "--confidence", sure, "--smoothness", 7, *option)
    viewer = ViewerModel()
    [image] = viewer.open(photograph)
    [layer] = viewer.open(tmp_path / "photo-blur.tif", plugin="napari-defocus")
    viewer.open(sure, plugin="napari-defocus")
    assert layer.name == "photo blur (px)"
    np.testing.assert_array_equal(layer.data, tifffile.imread(tmp_path / "photo-blur.tif"))
    assert made_by_us(layer) == BLUR_MAP
    assert settings_of_map(layer).smoothness == 7
    assert settings_of_map(layer).max_radius == 64
    assert tuple(layer.contrast_limits) == (0, 8), "not as far as the settings: as the map"
    assert layer.metadata[METADATA_KEY]["noise_variance"] > 0
    assert may_be_map_of(layer, image)
    source = source_of_layer(layer, shown_plane(image, viewer.dims), viewer, "disc")
    assert source.confidence is not None


def test_map_in_an_early_unit_of_its_lens_is_not_opened_as_radii(tmp_path):
    path = tmp_path / "photo-blur.tif"
    early = blur_map_tiff(np.ones((9, 9)), {"psf": "gaussian"}, "standard deviation (px)")
    path.write_bytes(early)
    with pytest.raises(ValueError, match=r"standard deviation .* it takes the blur radius"):
        open_map(ViewerModel(), path)


def test_terminal_takes_the_map_that_napari_saved(tmp_path, photograph, measured):
    path = save_map(measured[1], tmp_path / "from-napari-blur.tif")
    lens = ["--focal-length", 50, "--f-number", 2, "--focus-distance", 2, "--pixel-pitch", 8]
    out = tmp_path / "depth.tif"
    result = terminal("depth", photograph, "--map", path, *lens, "-o", out)
    assert str(path) in result.stdout
    depth, radius = tifffile.imread(out), measured[1].data
    assert depth.shape == radius.shape
    np.testing.assert_array_equal(np.isnan(depth), np.isnan(radius))


def test_layers_of_other_kinds_are_none_of_ours():
    for layer in (Image(np.zeros((4, 4))), Image(np.zeros((4, 4)), metadata={METADATA_KEY: 3})):
        with pytest.raises(NotAMapError):
            save_map(layer, "nowhere.tif")
    with pytest.raises(NotAMapError):
        save_map(Labels(np.zeros((4, 4), int)), "nowhere.tif")


@pytest.mark.display
def test_layers_that_napari_lends_to_plugins_are_saved_and_opened(tmp_path, window):
    metadata = {METADATA_KEY: {"result": BLUR_MAP, "noise_variance": 1e-6}}
    layer = window.add_image(np.eye(9, dtype=np.float32), name="photo blur", metadata=metadata)
    again = open_map(window, save_map(layer, tmp_path / "photo-blur.tif"))
    np.testing.assert_array_equal(again.data, np.eye(9))
    assert again.metadata == metadata
    assert again.colorbar.visible
