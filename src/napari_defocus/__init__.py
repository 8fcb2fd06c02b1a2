"""Defocus blur of a single picture: how wide, how sure, what is in focus.

Every public name is loaded when it is first used, so that importing the package costs
next to nothing and never imports napari or Qt.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from napari_defocus.api.candidates import estimate_candidates
    from napari_defocus.api.maps import (
        cautious_blur_map,
        confidence_map,
        estimate_blur_map,
        label_blur_map,
    )
    from napari_defocus.api.masks import segment_in_focus
    from napari_defocus.api.restoration import restore_all_in_focus
    from napari_defocus.batch.batch import measure_batch
    from napari_defocus.core.progress import Cancelled
    from napari_defocus.forward.occlusion import simulate_layered_defocus
    from napari_defocus.forward.simulation import simulate_defocus
    from napari_defocus.io.settings_file import Settings
    from napari_defocus.labeling.blur_map import labeling_energy
    from napari_defocus.labeling.explanation import (
        PixelExplanation,
        draw_explanation,
        explain_pixel,
    )
    from napari_defocus.labeling.regions import RegionTable, measure_regions
    from napari_defocus.likelihood.candidates import BlurCandidates
    from napari_defocus.likelihood.fitted_spectra import FitReport, fit_report
    from napari_defocus.likelihood.noise import estimate_noise_variance
    from napari_defocus.likelihood.psf_comparison import PSFComparison, PSFEvidence, compare_psf
    from napari_defocus.likelihood.shot_noise import ShotNoise, estimate_shot_noise
    from napari_defocus.optics.mesh import DepthSurface, depth_surface
    from napari_defocus.optics.thin_lens import ThinLens, blur_from_depth, depth_from_blur
    from napari_defocus.psf.calibration import calibrate_psf
    from napari_defocus.psf.families import (
        Annulus,
        Disc,
        Gaussian,
        GeneralizedGaussian,
        KernelFunction,
        Polygon,
        PSFFamily,
    )
    from napari_defocus.psf.measured import MeasuredPSF
    from napari_defocus.psf.text import psf_from_text
    from napari_defocus.restoration.refocusing import change_focus
    from napari_defocus.stacks.focus_curve import FocusCurve, focus_curve
    from napari_defocus.stacks.focus_stacking import SharpestPlane, sharpest_plane

__version__ = "0.1.0"

_HOME_OF = {
    "Annulus": "psf.families",
    "BlurCandidates": "likelihood.candidates",
    "Cancelled": "core.progress",
    "DepthSurface": "optics.mesh",
    "Disc": "psf.families",
    "FitReport": "likelihood.fitted_spectra",
    "FocusCurve": "stacks.focus_curve",
    "Gaussian": "psf.families",
    "GeneralizedGaussian": "psf.families",
    "KernelFunction": "psf.families",
    "MeasuredPSF": "psf.measured",
    "PSFComparison": "likelihood.psf_comparison",
    "PSFEvidence": "likelihood.psf_comparison",
    "PSFFamily": "psf.families",
    "PixelExplanation": "labeling.explanation",
    "Polygon": "psf.families",
    "RegionTable": "labeling.regions",
    "Settings": "io.settings_file",
    "SharpestPlane": "stacks.focus_stacking",
    "ShotNoise": "likelihood.shot_noise",
    "ThinLens": "optics.thin_lens",
    "blur_from_depth": "optics.thin_lens",
    "calibrate_psf": "psf.calibration",
    "cautious_blur_map": "api.maps",
    "change_focus": "restoration.refocusing",
    "compare_psf": "likelihood.psf_comparison",
    "confidence_map": "api.maps",
    "depth_from_blur": "optics.thin_lens",
    "depth_surface": "optics.mesh",
    "draw_explanation": "labeling.explanation",
    "estimate_blur_map": "api.maps",
    "estimate_candidates": "api.candidates",
    "estimate_noise_variance": "likelihood.noise",
    "estimate_shot_noise": "likelihood.shot_noise",
    "explain_pixel": "labeling.explanation",
    "fit_report": "likelihood.fitted_spectra",
    "focus_curve": "stacks.focus_curve",
    "label_blur_map": "api.maps",
    "labeling_energy": "labeling.blur_map",
    "measure_batch": "batch.batch",
    "measure_regions": "labeling.regions",
    "psf_from_text": "psf.text",
    "restore_all_in_focus": "api.restoration",
    "segment_in_focus": "api.masks",
    "sharpest_plane": "stacks.focus_stacking",
    "simulate_defocus": "forward.simulation",
    "simulate_layered_defocus": "forward.occlusion",
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
