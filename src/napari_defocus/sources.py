"""The old place of `napari_defocus.io.open`, for two minor versions."""

import sys
from warnings import warn

import napari_defocus.io.open as now

warn("napari_defocus.sources is napari_defocus.io.open now", FutureWarning, stacklevel=2)
sys.modules[__name__] = now
