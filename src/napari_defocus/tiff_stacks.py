"""The old place of `napari_defocus.io.tiff_writer`, for two minor versions."""

import sys
from warnings import warn

import napari_defocus.io.tiff_writer as now

warn("napari_defocus.tiff_stacks is napari_defocus.io.tiff_writer now", FutureWarning, stacklevel=2)
sys.modules[__name__] = now
