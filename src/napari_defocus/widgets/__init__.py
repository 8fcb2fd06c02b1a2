"""The napari side: widgets, sample data, and layers in and out.

What the manifest names is loaded when it is first used: napari starts without it.
"""

from importlib import import_module
from typing import Any

_HOME_OF = {
    "AllInFocusWidget": "all_in_focus",
    "BlurMapWidget": "blur_map",
    "CalibrateWidget": "calibrate",
    "ChangeFocusWidget": "change_focus",
    "DefocusWidget": "defocus",
    "DepthWidget": "depth",
    "FocusCurveWidget": "focus_curve",
    "InFocusWidget": "in_focus",
    "MapAndMaskWidget": "map_and_mask",
    "ProbeWidget": "probe",
    "SharpestPlaneWidget": "sharpest_plane",
    "brushes": "samples",
    "dandelion": "samples",
    "map_reader": "map_files",
    "simulated_ramp": "samples",
    "write_maps": "map_files",
    "write_store": "kept_files",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
