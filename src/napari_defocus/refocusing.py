"""Another focus, chosen afterwards: the all-in-focus picture, blurred again."""

from __future__ import annotations

from dataclasses import is_dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.confidence import checked_map
from napari_defocus.image import prepare_image
from napari_defocus.layered import simulate_layered_defocus
from napari_defocus.progress import Progress, silent, within
from napari_defocus.psf import Disc, PSFFamily, as_family
from napari_defocus.restoration import restore_all_in_focus
from napari_defocus.settings import Linearize, RefocusSettings, RestorationSettings, Side

Float32 = NDArray[np.float32]


def change_focus(
    image: ArrayLike,
    blur_map: ArrayLike,
    *,
    focus: float = RefocusSettings.focus,
    aperture: float = RefocusSettings.aperture,
    side: Side | ArrayLike = RefocusSettings.side,
    psf: PSFFamily = Disc(),
    all_in_focus: ArrayLike | None = None,
    noise_variance: float | None = RestorationSettings.noise_variance,
    confidence: ArrayLike | None = None,
    tv_weight: float | None = RestorationSettings.tv_weight,
    linearize: Linearize | None = RefocusSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> Float32:
    psf = as_family(psf)
    picture = prepare_image(image, intensity_range)
    radius = checked_map(blur_map, picture.shape)
    if isinstance(side, str):
        signed = radius if side == "far" else -radius
        plane = focus if side == "far" else -focus
    else:
        signed, plane = np.where(side, radius, -radius), focus
    new = aperture * np.abs(signed - plane)
    if all_in_focus is None:
        all_in_focus = restore_all_in_focus(
            image,
            blur_map,
            psf=psf,
            noise_variance=noise_variance,
            confidence=confidence,
            tv_weight=tv_weight,
            linearize=linearize,
            intensity_range=intensity_range,
            progress=within(progress, 0.0, 0.8),
        )
    progress("Blurring again", 0.8)
    largest = max(float(new.max()), psf.max_scale)
    if is_dataclass(psf) and hasattr(psf, "max_radius"):
        psf = replace(psf, max_radius=largest)
    seen, _ = simulate_layered_defocus(all_in_focus, signed, new, psf=psf, linearize=linearize)
    return np.clip(seen, 0, 1)
