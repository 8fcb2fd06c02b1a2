"""The old place of `napari_defocus.batch.cluster`, for two minor versions."""

import sys
from warnings import warn

import napari_defocus.batch.cluster as now

warn("napari_defocus.cluster is napari_defocus.batch.cluster now", FutureWarning, stacklevel=2)
sys.modules[__name__] = now
