"""What a user may write: mypy --strict has to pass it against the installed package."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import napari_defocus as nd


def measure(image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], float]:
    """Every step from a picture to its map, as the README shows them."""
    candidates = nd.estimate_candidates(image, psf=nd.Polygon(blades=6))
    blur_map = nd.label_blur_map(candidates, image)
    confidence = nd.confidence_map(candidates, blur_map)
    in_focus = nd.segment_in_focus(candidates, image, threshold=1.5)
    scales, curve = candidates.log_likelihood_at(12, 34)
    labels, table = nd.measure_regions(in_focus, blur_map, confidence)
    table.save("regions.csv")
    reason = nd.explain_pixel(candidates, 12, 34, blur_map=blur_map, confidence=confidence)
    print(reason, scales[curve.argmax()], labels.max())
    return blur_map, candidates.noise_variance


def restore(image: NDArray[np.float32], path: Path) -> NDArray[np.float32]:
    """What is done with a map afterwards."""
    blur_map = nd.estimate_blur_map(image, linearize="srgb")
    candidates = nd.estimate_candidates(image)
    safe = nd.cautious_blur_map(candidates, blur_map)
    sharp = nd.restore_all_in_focus(image, safe)
    other = nd.change_focus(image, blur_map, all_in_focus=sharp, focus=4.0, aperture=2.0)
    lens = nd.ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=1.2, pixel_pitch_um=8)
    distance = nd.depth_from_blur(blur_map, lens, side="far")
    again = nd.simulate_defocus(sharp, blur_map, psf=nd.Gaussian(), noise_variance=1e-6, rng=0)
    settings = nd.Settings.load(path)
    print(other.shape, np.median(distance), again.dtype, settings.mask.threshold)
    return sharp


def stack(planes: NDArray[np.float32]) -> NDArray[np.float32]:
    """A stack through focus."""
    found = nd.sharpest_plane(planes)
    curve = nd.focus_curve(np.stack([nd.estimate_blur_map(plane) for plane in planes]))
    print(curve.best, nd.estimate_noise_variance(planes[0]), found.confidence.mean())
    return found.composite
