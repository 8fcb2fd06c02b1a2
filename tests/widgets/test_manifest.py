import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from napari.components import ViewerModel
from npe2 import PluginManifest
from npe2.manifest.utils import import_python_name
from PIL import Image

import napari_defocus
from napari_defocus.widgets.layers.samples import ramp

MANIFEST = PluginManifest.from_file(Path(napari_defocus.__file__).with_name("napari.yaml"))
CONTRIBUTIONS = MANIFEST.contributions
WIDGETS = Path(napari_defocus.__file__).with_name("widgets")
WITHOUT_QT = sorted(
    f"napari_defocus.widgets.{room}.{file.stem}"
    for room in ("layers", "jobs", "display", "export")
    for file in (WIDGETS / room).glob("[!_]*.py")
)


@pytest.fixture
def viewer(npe2pm):
    npe2pm.register(MANIFEST)
    return ViewerModel()


def test_manifest_is_the_one_napari_finds():
    assert PluginManifest.from_distribution("napari-defocus").name == MANIFEST.name
    MANIFEST.validate_imports()


@pytest.mark.parametrize("command", CONTRIBUTIONS.commands, ids=lambda command: command.id)
def test_every_command_can_be_imported(command):
    assert callable(import_python_name(command.python_name))


def test_menus_name_one_way_in_first_and_the_single_steps_once_in_one_order():
    widgets = [widget.command for widget in CONTRIBUTIONS.widgets]
    assert CONTRIBUTIONS.widgets[0].display_name == "Measure defocus"
    [submenu] = CONTRIBUTIONS.submenus
    assert [item.command for item in CONTRIBUTIONS.menus[submenu.id]] == widgets[1:]
    first, second = CONTRIBUTIONS.menus["napari/layers/measure"]
    assert (first.command, second.submenu) == (widgets[0], submenu.id)
    [alone] = CONTRIBUTIONS.menus["napari/layers/segment"]
    assert alone.command == widgets[0]


def test_commands_and_widgets_have_the_same_names():
    title_of = {command.id: command.title for command in CONTRIBUTIONS.commands}
    for widget in CONTRIBUTIONS.widgets:
        assert title_of[widget.command] == widget.display_name


def test_napari_s_own_writer_stays_the_first_for_images(npe2pm):
    npe2pm.register(MANIFEST)
    npe2pm.register(PluginManifest.from_distribution("napari"))
    commands = [writer.command for writer in npe2pm.iter_compatible_writers(["image"])]
    assert commands[0] == "napari.write_image"
    assert "napari-defocus.write_maps" in commands


@pytest.mark.parametrize(
    ("sample", "shape"), [("dandelion", (562, 1000, 3)), ("brushes", (708, 900, 3))]
)
def test_photographs_open(viewer, sample, shape):
    [layer] = viewer.open_sample("napari-defocus", sample)
    assert layer.name == sample
    assert layer.rgb
    assert layer.data.shape == shape
    assert layer.data.dtype == np.uint8


def test_simulated_ramp_opens_with_its_true_map(viewer):
    true_map, picture = viewer.open_sample("napari-defocus", "ramp")
    assert picture.data.shape == true_map.data.shape == (300, 300)
    assert true_map.data[0, 0] == pytest.approx(0.92)
    assert true_map.data[299, 299] == pytest.approx(0.92 + 299 * 0.014)
    assert tuple(true_map.contrast_limits) == (0.0, 8.0)
    detail = np.abs(np.diff(picture.data, axis=1)).mean(axis=1)
    assert detail[:30].mean() > 2 * detail[-30:].mean()


def test_simulated_ramp_is_the_same_every_time(viewer):
    _, first = viewer.open_sample("napari-defocus", "ramp")
    _, second = viewer.open_sample("napari-defocus", "ramp")
    np.testing.assert_array_equal(first.data, second.data)


def test_ramp_rises_by_3_and_11_thousandths_of_a_pixel():
    rows, columns = np.gradient(ramp().astype(float))
    np.testing.assert_allclose(columns, 0.003, atol=1e-5)
    np.testing.assert_allclose(rows, 0.011, atol=1e-5)


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("napari_defocus", ("napari", "qtpy", "magicgui", "numba", "maxflow", "skimage")),
        (", ".join(WITHOUT_QT), ("qtpy.QtWidgets", "PySide6", "maxflow")),
    ],
)
def test_import_stays_light(module, unwanted):
    code = f"import sys, {module}; print(*(m for m in {unwanted} if m in sys.modules))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


def test_what_the_manifest_names_is_loaded_when_it_is_used():
    modules = sorted({command.python_name.split(":")[0] for command in CONTRIBUTIONS.commands})
    heavy = ("napari.components", "napari.layers", "magicgui", "qtpy", "numba", "maxflow")
    code = f"import sys, {', '.join(modules)}; print(*(m for m in {heavy} if m in sys.modules))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.split() == []


@pytest.mark.parametrize("name", ["phone.heic", "IMG_0001.HEIC"])
def test_photograph_of_a_phone_opens_and_a_damaged_one_says_so(viewer, tmp_path, name):
    heif = pytest.importorskip("pillow_heif")
    path = tmp_path / name
    heif.from_pillow(Image.effect_noise((80, 60), 50).convert("RGB")).save(path)
    [layer] = viewer.open(path, plugin="napari-defocus")
    assert (layer.name, layer.data.shape, layer.rgb) == (path.stem, (60, 80, 3), True)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(ValueError, match="a HEIC picture, which could not be decoded"):
        viewer.open(path, plugin="napari-defocus")
