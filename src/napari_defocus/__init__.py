"""Defocus blur of a single picture: how wide, how sure, what is in focus.

Every public name is loaded when it is first used, so that importing the package costs
next to nothing and never imports napari or Qt.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from napari_defocus.candidates import BlurCandidates, estimate_candidates
    from napari_defocus.labeling import estimate_blur_map, label_blur_map
    from napari_defocus.noise import estimate_noise_variance
    from napari_defocus.progress import Cancelled
    from napari_defocus.psf import Disc, PSFFamily
    from napari_defocus.segmentation import segment_in_focus
    from napari_defocus.simulation import simulate_defocus

__version__ = "0.1.0"

_HOME_OF = {
    "BlurCandidates": "candidates",
    "Cancelled": "progress",
    "Disc": "psf",
    "PSFFamily": "psf",
    "estimate_blur_map": "labeling",
    "estimate_candidates": "candidates",
    "estimate_noise_variance": "noise",
    "label_blur_map": "labeling",
    "segment_in_focus": "segmentation",
    "simulate_defocus": "simulation",
}

__all__ = [
    "BlurCandidates",
    "Cancelled",
    "Disc",
    "PSFFamily",
    "estimate_blur_map",
    "estimate_candidates",
    "estimate_noise_variance",
    "label_blur_map",
    "segment_in_focus",
    "simulate_defocus",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
