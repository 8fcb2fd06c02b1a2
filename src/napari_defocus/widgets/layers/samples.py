"""Sample data: two photographs, and a picture whose blur is known."""

from importlib.resources import files
from typing import Any

import numpy as np
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.core.color_range import LEAST_COLOR_LIMIT
from napari_defocus.widgets.layers.result_layers import COLOR_MAP
from napari_defocus.widgets.layers.result_metadata import BLUR_MAP, METADATA_KEY

RAMP_SHAPE = (300, 300)
RAMP_NOISE_VARIANCE = 1e-6
RAMP_SEED = 0


def dandelion() -> list[LayerDataTuple]:
    """Return a photograph of a dandelion head before a blurred meadow.

    *seeding* by Clements Engelhardt, CC0-1.0, 1000 x 562 px.
    """
    return [_photograph("dandelion")]


def brushes() -> list[LayerDataTuple]:
    """Return a photograph of brushes, one of them in focus.

    *Picture 1A* by freespace, CC-BY-4.0, 900 x 708 px.
    """
    return [_photograph("brushes")]


def simulated_ramp() -> list[LayerDataTuple]:
    """Return a picture blurred by a known ramp, and the ramp.

    Grass (scikit-image's, CC0) scaled down to 300 x 300 px, seen through discs of radius
    0.92 + 0.003 x + 0.011 y px, with white noise of variance 1e-6.
    """
    from napari_defocus import simulate_defocus

    true_map = ramp()
    picture = simulate_defocus(
        _sharp_grass(), true_map, noise_variance=RAMP_NOISE_VARIANCE, rng=RAMP_SEED
    )
    shown = {"name": "simulated ramp", "contrast_limits": (0.0, 1.0)}
    return [
        LayerDataTuple((true_map, _true_map_keywords(), "image")),
        LayerDataTuple((picture, shown, "image")),
    ]


def ramp() -> NDArray[np.float32]:
    """Return the blur radii of `simulated_ramp`: (300, 300), in px."""
    y, x = np.mgrid[: RAMP_SHAPE[0], : RAMP_SHAPE[1]]
    return np.asarray(0.92 + 0.003 * x + 0.011 * y, np.float32)


def _true_map_keywords() -> dict[str, Any]:
    return {
        "name": "simulated ramp true blur (px)",
        "colormap": COLOR_MAP,
        "contrast_limits": (0.0, LEAST_COLOR_LIMIT),
        "metadata": {METADATA_KEY: {"result": BLUR_MAP, "noise_variance": RAMP_NOISE_VARIANCE}},
    }


def _sharp_grass() -> NDArray[np.float64]:
    from skimage.data import grass
    from skimage.transform import resize

    return np.asarray(resize(grass() / 255.0, RAMP_SHAPE, anti_aliasing=True), np.float64)


def _photograph(name: str) -> LayerDataTuple:
    from skimage.io import imread

    with (files("napari_defocus.samples") / f"{name}.jpg").open("rb") as file:
        return LayerDataTuple((imread(file), {"name": name}, "image"))
