from .api.candidates import (
    estimate_candidates as estimate_candidates,
)
from .api.maps import (
    cautious_blur_map as cautious_blur_map,
)
from .api.maps import (
    confidence_map as confidence_map,
)
from .api.maps import (
    estimate_blur_map as estimate_blur_map,
)
from .api.maps import (
    label_blur_map as label_blur_map,
)
from .api.masks import (
    focus_threshold as focus_threshold,
)
from .api.masks import (
    known_places as known_places,
)
from .api.masks import (
    matte_in_focus as matte_in_focus,
)
from .api.masks import (
    segment_in_focus as segment_in_focus,
)
from .api.remarks import (
    picture_remarks as picture_remarks,
)
from .api.restoration import (
    restore_all_in_focus as restore_all_in_focus,
)
from .batch.batch import (
    measure_batch as measure_batch,
)
from .batch.outcome import (
    BatchReport as BatchReport,
)
from .batch.report import (
    write_report as write_report,
)
from .core.progress import (
    Cancelled as Cancelled,
)
from .forward.occlusion import (
    simulate_layered_defocus as simulate_layered_defocus,
)
from .forward.simulation import (
    simulate_defocus as simulate_defocus,
)
from .io.microscope_metadata import (
    read_microscope as read_microscope,
)
from .io.pictures import (
    UnreadablePicture as UnreadablePicture,
)
from .io.pictures import (
    read_picture as read_picture,
)
from .io.settings_file import (
    Settings as Settings,
)
from .labeling.blur_map import (
    labeling_energy as labeling_energy,
)
from .labeling.explanation import (
    PixelExplanation as PixelExplanation,
)
from .labeling.explanation import (
    draw_explanation as draw_explanation,
)
from .labeling.explanation import (
    explain_pixel as explain_pixel,
)
from .labeling.regions import (
    RegionTable as RegionTable,
)
from .labeling.regions import (
    measure_regions as measure_regions,
)
from .likelihood.candidates import (
    BlurCandidates as BlurCandidates,
)
from .likelihood.fitted_spectra import (
    FitReport as FitReport,
)
from .likelihood.fitted_spectra import (
    fit_report as fit_report,
)
from .likelihood.noise import (
    estimate_noise_variance as estimate_noise_variance,
)
from .likelihood.psf_choice import (
    PSFChoice as PSFChoice,
)
from .likelihood.psf_comparison import (
    PSFComparison as PSFComparison,
)
from .likelihood.psf_comparison import (
    PSFEvidence as PSFEvidence,
)
from .likelihood.psf_comparison import (
    compare_psf as compare_psf,
)
from .likelihood.shot_noise import (
    ShotNoise as ShotNoise,
)
from .likelihood.shot_noise import (
    estimate_shot_noise as estimate_shot_noise,
)
from .optics.mesh import (
    DepthSurface as DepthSurface,
)
from .optics.mesh import (
    depth_surface as depth_surface,
)
from .optics.thin_lens import (
    ThinLens as ThinLens,
)
from .optics.thin_lens import (
    blur_from_depth as blur_from_depth,
)
from .optics.thin_lens import (
    depth_from_blur as depth_from_blur,
)
from .psf.calibration import (
    calibrate_psf as calibrate_psf,
)
from .psf.families import (
    Annulus as Annulus,
)
from .psf.families import (
    AutomaticPSF as AutomaticPSF,
)
from .psf.families import (
    Disc as Disc,
)
from .psf.families import (
    Gaussian as Gaussian,
)
from .psf.families import (
    GeneralizedGaussian as GeneralizedGaussian,
)
from .psf.families import (
    KernelFunction as KernelFunction,
)
from .psf.families import (
    Polygon as Polygon,
)
from .psf.families import (
    PSFFamily as PSFFamily,
)
from .psf.measured import (
    MeasuredPSF as MeasuredPSF,
)
from .psf.microscope import (
    Microscope as Microscope,
)
from .psf.parsing import (
    psf_from_text as psf_from_text,
)
from .restoration.all_in_focus import (
    RestorationFit as RestorationFit,
)
from .restoration.all_in_focus import (
    TiledRestorationFit as TiledRestorationFit,
)
from .restoration.refocusing import (
    change_focus as change_focus,
)
from .settings import (
    FieldLimits as FieldLimits,
)
from .stacks.alignment import (
    StackAlignment as StackAlignment,
)
from .stacks.composites import (
    composite_at as composite_at,
)
from .stacks.focus_curve import (
    FocusCurve as FocusCurve,
)
from .stacks.focus_curve import (
    focus_curve as focus_curve,
)
from .stacks.focus_stacking import (
    SharpestPlane as SharpestPlane,
)
from .stacks.focus_stacking import (
    sharpest_plane as sharpest_plane,
)
from .tiled.candidates import (
    LazyCandidates as LazyCandidates,
)

__version__: str
