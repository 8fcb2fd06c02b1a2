"""Other measures of blur: three scores without a unit, each larger where a picture is blurred."""

import warnings

import numpy as np
from blur_detector import detectBlur
from scipy.ndimage import gaussian_filter, laplace, map_coordinates
from skimage.measure import blur_effect

LUMA = np.array([0.299, 0.587, 0.114])

_TILE, _TILE_STEP = 40, 12
_LEAST_VARIANCE = 1e-12


def scores(picture: np.ndarray) -> dict[str, np.ndarray]:
    """Return all three of a picture, in [0, 1] or uint8: (H, W) each."""
    luma = luminance(picture)
    return {name: score(luma) for name, score in SCORES.items()}


def luminance(picture: np.ndarray) -> np.ndarray:
    scaled = picture / 255 if picture.dtype == np.uint8 else picture.astype(np.float64)
    return np.clip(scaled @ LUMA if scaled.ndim == 3 else scaled, 0, 1)


def lack_of_laplacian(luma: np.ndarray) -> np.ndarray:
    """Return minus the logarithm of the Laplacian's variance over a Gaussian of 15 px.

    None of 4 to 20 px did better over all.
    """
    response = laplace(luma)
    variance = gaussian_filter(response**2, 15) - gaussian_filter(response, 15) ** 2
    return -np.log(np.maximum(variance, 0) + _LEAST_VARIANCE)


def lack_of_detected_sharpness(luma: np.ndarray) -> np.ndarray:
    """Return minus what PyPI's blur-detector says, at a quarter of the resolution."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sharpness = detectBlur(
            luma,
            downsampling_factor=4,
            num_scales=4,
            scale_start=2,
            num_iterations_RF_filter=3,
            show_progress=False,
        )
    return -np.nan_to_num(np.asarray(sharpness, np.float64))


def tiled_blur_effect(luma: np.ndarray) -> np.ndarray:
    """Return scikit-image's blur_effect of tiles of 40 px, 12 px apart, interpolated between."""
    starts = [np.arange(0, length - _TILE + 1, _TILE_STEP) for length in luma.shape]
    effect = [
        [blur_effect(luma[top : top + _TILE, left : left + _TILE]) for left in starts[1]]
        for top in starts[0]
    ]
    # A tile without any texture is 0 / 0 there.
    known = np.nan_to_num(np.array(effect), nan=1.0)
    places = [
        np.clip((np.arange(length) - _TILE / 2 + 0.5) / _TILE_STEP, 0, len(start) - 1)
        for length, start in zip(luma.shape, starts, strict=True)
    ]
    return map_coordinates(known, np.meshgrid(*places, indexing="ij"), order=1)


SCORES = {
    "blur-detector": lack_of_detected_sharpness,
    "blur_effect": tiled_blur_effect,
    "Laplacian": lack_of_laplacian,
}
