"""Public modules and arguments of io and batch keep their old names for two minor versions."""

import subprocess
import sys

import numpy as np
import pytest

from napari_defocus.io.ome_zarr_writer import new_ome_zarr
from napari_defocus.io.open import open_source
from napari_defocus.io.tiff_writer import write_pyramidal_tiff

PLACES = {
    "cluster": "batch.cluster",
    "sources": "io.open",
    "tiff_stacks": "io.tiff_writer",
    "ome_zarr_writer": "io.ome_zarr_writer",
}


@pytest.mark.parametrize(("old", "new"), PLACES.items())
def test_module_is_found_at_its_old_place_which_warns(old, new):
    code = (
        "import warnings\n"
        "with warnings.catch_warnings(record=True) as told:\n"
        "    warnings.simplefilter('always')\n"
        f"    import napari_defocus.{old}\n"
        f"from napari_defocus import {old}\n"
        f"import napari_defocus.{new} as now\n"
        f"assert {old} is now\n"
        "print(*(each.message for each in told if each.category is FutureWarning))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"napari_defocus.{old} is napari_defocus.{new} now"


def test_pixel_size_may_be_called_scale(tmp_path):
    picture, size = np.zeros((600, 700), np.float32), {"y": 0.5, "x": 0.5}
    with pytest.warns(FutureWarning, match="scale is called pixel_size now"):
        path = write_pyramidal_tiff(
            tmp_path / "a.tif", picture, axes="yx", scale=size, units={}, description={}
        )
    source = open_source(path)
    with pytest.warns(FutureWarning, match="scale is called pixel_size now"):
        assert source.scale == source.pixel_size
    with pytest.warns(FutureWarning, match="scale is called pixel_size now"):
        writer = new_ome_zarr(
            tmp_path / "a.ome.zarr",
            **{"shape": (64, 64), "dtype": "uint8", "axes": "yx", "scale": size, "attributes": {}},
        )
    assert writer.pixel_size == {"y": 0.5, "x": 0.5}
