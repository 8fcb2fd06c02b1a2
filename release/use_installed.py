"""Use the package where only its wheel is: `python use_installed.py none`, `napari` or `large`."""

import subprocess
import sys
from importlib.metadata import files, metadata
from importlib.util import find_spec
from pathlib import Path

import napari_defocus

OF_EXTRAS = "napari", "qtpy", "magicgui", "dask", "zarr"
LICENCES = "licenses/LICENSE", "licenses/src/napari_defocus/samples/ATTRIBUTION.md"


def use_public_names():
    """Load every public name: none brings napari, Qt or dask with it."""
    assert Path(sys.prefix) in Path(napari_defocus.__file__).parents, napari_defocus.__file__
    for name in napari_defocus.__all__:
        getattr(napari_defocus, name)
    assert not set(OF_EXTRAS) & set(sys.modules)


def read_metadata():
    about = metadata("napari-defocus")
    assert about["Version"] == napari_defocus.__version__
    assert about["License-Expression"] == "GPL-3.0-or-later"
    assert about["Requires-Python"] == ">=3.11"
    present = [str(path) for path in files("napari-defocus")]
    for licence in LICENCES:
        assert any(name.endswith(f".dist-info/{licence}") for name in present), licence


def use_without_extras():
    """Measure a picture with the terminal command."""
    assert not any(map(find_spec, OF_EXTRAS))
    read_metadata()
    command = Path(sys.executable).with_name("napari-defocus")
    subprocess.run([command, "--version"], check=True)
    subprocess.run([command, "sample", "brushes.jpg", "--name", "brushes"], check=True)
    subprocess.run([command, "map", "brushes.jpg", "--stride", "8"], check=True)
    written = {path.name for path in Path().iterdir()}
    assert {"brushes-blur.tif", "brushes-blur.png"} <= written, written


def use_in_napari():
    """Open a sample as napari does, through the manifest."""
    from napari.components import ViewerModel
    from npe2 import PluginManager

    PluginManager.instance().discover()
    assert "napari-defocus" in PluginManager.instance()
    [layer] = ViewerModel().open_sample("napari-defocus", "dandelion")
    print("sample opened through the manifest:", layer)


def use_with_dask():
    """Measure a dask array."""
    import dask.array
    import numpy as np

    picture = np.random.default_rng(0).uniform(size=(96, 96)).astype(np.float32)
    lazy = napari_defocus.estimate_blur_map(dask.array.from_array(picture, chunks=64))
    assert np.isfinite(lazy.compute(scheduler="sync")).all()
    print("map of a dask array:", lazy)


if __name__ == "__main__":
    use_public_names()
    {"none": use_without_extras, "napari": use_in_napari, "large": use_with_dask}[sys.argv[1]]()
