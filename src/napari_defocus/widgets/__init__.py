"""The napari side: widgets, sample data, and layers in and out.

What the manifest names is loaded when it is first used: napari starts without it.
"""

from importlib import import_module
from typing import Any

_HOME_OF = {
    "CalibrateWidget": "docks.calibrate",
    "ChangeFocusWidget": "docks.change_focus",
    "DefocusWidget": "docks.defocus",
    "FocusCurveWidget": "docks.focus_curve",
    "ProbeWidget": "docks.probe",
    "SharpestPlaneWidget": "docks.sharpest_plane",
    "brushes": "layers.samples",
    "dandelion": "layers.samples",
    "heic_reader": "layers.photographs",
    "map_reader": "export.map_files",
    "simulated_ramp": "layers.samples",
    "write_maps": "export.map_files",
    "write_store": "export.stores",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
