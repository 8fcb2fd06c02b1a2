"""Defocus blur of a single picture: how wide, how sure, what is in focus.

Every public name is loaded when it is first used, so that importing the package costs
next to nothing and never imports napari or Qt.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from napari_defocus.batch import measure_batch
    from napari_defocus.calibration import calibrate_psf
    from napari_defocus.candidates import BlurCandidates, estimate_candidates
    from napari_defocus.comparison import PSFComparison, PSFEvidence, compare_psf
    from napari_defocus.confidence import cautious_blur_map, confidence_map
    from napari_defocus.depth import ThinLens, blur_from_depth, depth_from_blur
    from napari_defocus.explanation import PixelExplanation, draw_explanation, explain_pixel
    from napari_defocus.focus_of_planes import FocusCurve, focus_curve
    from napari_defocus.labeling import estimate_blur_map, label_blur_map, labeling_energy
    from napari_defocus.layered import simulate_layered_defocus
    from napari_defocus.measured_psf import MeasuredPSF
    from napari_defocus.noise import ShotNoise, estimate_noise_variance, estimate_shot_noise
    from napari_defocus.progress import Cancelled
    from napari_defocus.psf import (
        Annulus,
        Disc,
        Gaussian,
        GeneralizedGaussian,
        KernelFunction,
        Polygon,
        PSFFamily,
    )
    from napari_defocus.psf_text import psf_from_text
    from napari_defocus.refocusing import change_focus
    from napari_defocus.regions import RegionTable, measure_regions
    from napari_defocus.restoration import restore_all_in_focus
    from napari_defocus.segmentation import segment_in_focus
    from napari_defocus.settings_file import Settings
    from napari_defocus.sharpest import SharpestPlane, sharpest_plane
    from napari_defocus.simulation import simulate_defocus
    from napari_defocus.spectrum import FitReport, fit_report
    from napari_defocus.surface import DepthSurface, depth_surface

__version__ = "0.1.0"

_HOME_OF = {
    "Annulus": "psf",
    "BlurCandidates": "candidates",
    "Cancelled": "progress",
    "DepthSurface": "surface",
    "Disc": "psf",
    "FitReport": "spectrum",
    "FocusCurve": "focus_of_planes",
    "Gaussian": "psf",
    "GeneralizedGaussian": "psf",
    "KernelFunction": "psf",
    "MeasuredPSF": "measured_psf",
    "PSFComparison": "comparison",
    "PSFEvidence": "comparison",
    "PSFFamily": "psf",
    "PixelExplanation": "explanation",
    "Polygon": "psf",
    "RegionTable": "regions",
    "Settings": "settings_file",
    "SharpestPlane": "sharpest",
    "ShotNoise": "noise",
    "ThinLens": "depth",
    "blur_from_depth": "depth",
    "calibrate_psf": "calibration",
    "cautious_blur_map": "confidence",
    "change_focus": "refocusing",
    "compare_psf": "comparison",
    "confidence_map": "confidence",
    "depth_from_blur": "depth",
    "depth_surface": "surface",
    "draw_explanation": "explanation",
    "estimate_blur_map": "labeling",
    "estimate_candidates": "candidates",
    "estimate_noise_variance": "noise",
    "estimate_shot_noise": "noise",
    "explain_pixel": "explanation",
    "fit_report": "spectrum",
    "focus_curve": "focus_of_planes",
    "label_blur_map": "labeling",
    "labeling_energy": "labeling",
    "measure_batch": "batch",
    "measure_regions": "regions",
    "psf_from_text": "psf_text",
    "restore_all_in_focus": "restoration",
    "segment_in_focus": "segmentation",
    "sharpest_plane": "sharpest",
    "simulate_defocus": "simulation",
    "simulate_layered_defocus": "layered",
}

__all__ = [
    "Annulus",
    "BlurCandidates",
    "Cancelled",
    "DepthSurface",
    "Disc",
    "FitReport",
    "FocusCurve",
    "Gaussian",
    "GeneralizedGaussian",
    "KernelFunction",
    "MeasuredPSF",
    "PSFComparison",
    "PSFEvidence",
    "PSFFamily",
    "PixelExplanation",
    "Polygon",
    "RegionTable",
    "Settings",
    "SharpestPlane",
    "ShotNoise",
    "ThinLens",
    "blur_from_depth",
    "calibrate_psf",
    "cautious_blur_map",
    "change_focus",
    "compare_psf",
    "confidence_map",
    "depth_from_blur",
    "depth_surface",
    "draw_explanation",
    "estimate_blur_map",
    "estimate_candidates",
    "estimate_noise_variance",
    "estimate_shot_noise",
    "explain_pixel",
    "fit_report",
    "focus_curve",
    "label_blur_map",
    "labeling_energy",
    "measure_batch",
    "measure_regions",
    "psf_from_text",
    "restore_all_in_focus",
    "segment_in_focus",
    "sharpest_plane",
    "simulate_defocus",
    "simulate_layered_defocus",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
