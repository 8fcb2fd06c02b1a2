"""The old place of `napari_defocus.io.ome_zarr_writer`, for two minor versions."""

import sys
from warnings import warn

import napari_defocus.io.ome_zarr_writer as now

warn(
    "napari_defocus.ome_zarr_writer is napari_defocus.io.ome_zarr_writer now",
    FutureWarning,
    stacklevel=2,
)
sys.modules[__name__] = now
