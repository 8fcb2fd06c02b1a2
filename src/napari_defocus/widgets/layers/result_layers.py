"""What the map, the mask and a measured lens look like as layers.

No Qt here, as in `layers`.
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from napari.types import LayerDataTuple
from napari.utils.colormaps import Colormap, DirectLabelColormap
from numpy.typing import NDArray

from napari_defocus import __version__
from napari_defocus.core.axes import is_lazy
from napari_defocus.core.color_range import color_limit
from napari_defocus.core.intensity import Intensities
from napari_defocus.psf.families import PSFFamily
from napari_defocus.psf.measured import MeasuredPSF
from napari_defocus.psf.microscope import Microscope
from napari_defocus.settings import UNKNOWN, MapSettings, MaskSettings
from napari_defocus.widgets.layers.image_layers import Plane
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    DEFOCUS,
    IN_FOCUS,
    LEFT_AS_IT_WAS,
    MEASURED_PSF,
    METADATA_KEY,
    NOT_TRUSTED,
    PLACEMENT,
    REGION,
    STORE,
    THRESHOLD_FOUND,
    region_suffix,
    result_layer,
    scale_prefix,
)

_NO_SIDE = "above or below the focus: one picture cannot tell"
COLOR_MAP = "viridis"
MASK_COLOR = (1.0, 0.2, 0.8, 1.0)
"""Far from all colours of the map, and from those of most pictures."""
MASK_OPACITY = 0.4
CONFIDENCE_COLOR_MAP = "gray"
KERNEL_COLOR_MAP = "magma"
NOT_TRUSTED_COLOR = (0.8, 0.8, 0.8, 1.0)
NOT_TRUSTED_OPACITY = 0.6
"""A veil, no lid: the map is read through it, and what is seen is no colour of the map.

A dark one is seen on yellow, but hardly on the purple of what is in focus.
"""

LEFT_COLOR, LEFT_OPACITY = (1.0, 0.55, 0.0), 0.6
"""Orange is seen on dark and on bright pictures; they are seen through it."""


def blur_map_layer(
    plane: Plane,
    blur_map: NDArray[np.floating],
    settings: MapSettings,
    noise_variance: float,
    psf: PSFFamily | None = None,
    intensities: Intensities | None = None,
) -> LayerDataTuple:
    """Return a blur map as an image layer that lies on the plane.

    Parameters
    ----------
    plane : Plane
        What the map was estimated from.
    blur_map : (H, W) float ndarray
        Blur scale in px.
    settings : MapSettings
        What it was estimated with.
    noise_variance : float
        The variance that was used, found or given; intensities in [0, 1].
    psf : PSFFamily, optional
        The family of the settings, if it is at hand.
    intensities : Intensities, optional
        What the variance is measured in.
    """
    psf = psf or settings.family()
    return result_layer(
        *(plane, BLUR_MAP, blur_map, asdict(settings)),
        _noise(noise_variance, intensities) | {"scale": psf.scale_name},
        name=f"blur {scale_prefix(psf.scale_name)}(px)",
        colormap=COLOR_MAP,
        contrast_limits=(0.0, color_limit(blur_map)),
    )


def defocus_layer(blur_map: LayerDataTuple, lens: Microscope) -> LayerDataTuple:
    """Return a blur map, as `blur_map_layer` gives it, as a layer of the defocus in um."""
    values, keywords, kind = blur_map
    made = {**keywords["metadata"][METADATA_KEY], "result": DEFOCUS, "unit": "um", "side": _NO_SIDE}
    name = keywords["name"].removesuffix("blur (px)") + "defocus (µm)"
    limits = tuple(lens.defocus_um(limit) for limit in keywords["contrast_limits"])
    looks = {**keywords, "name": name, "contrast_limits": limits, "metadata": {METADATA_KEY: made}}
    return LayerDataTuple((lens.defocus_um(values).astype(np.float32), looks, kind))


def confidence_layer(
    plane: Plane,
    confidence: NDArray[np.floating],
    settings: MapSettings,
    noise_variance: float,
    intensities: Intensities | None = None,
) -> LayerDataTuple:
    """Return the confidence of a blur map, in [0, 1], as an image layer: see `blur_map_layer`.

    It is hidden at first: it would cover the map.
    """
    return result_layer(
        *(plane, CONFIDENCE, confidence, asdict(settings)),
        _noise(noise_variance, intensities),
        colormap=CONFIDENCE_COLOR_MAP,
        contrast_limits=(0.0, 1.0),
        visible=False,
    )


def left_as_it_was_layer(
    plane: Plane, left: NDArray[np.floating], settings: dict[str, Any], facts: dict[str, Any]
) -> LayerDataTuple:
    """Return how far a picture was left as it was, from 0 to 1, as a veil over what was restored.

    Parameters
    ----------
    plane : Plane
        What was restored.
    left : (H, W) float ndarray
        See `RestorationFit`.
    settings, facts : dict
        See `provenance`.
    """
    return result_layer(
        *(plane, LEFT_AS_IT_WAS, left, settings, facts),
        colormap=Colormap([(*LEFT_COLOR, 0.0), (*LEFT_COLOR, LEFT_OPACITY)], LEFT_AS_IT_WAS),
        contrast_limits=(0.0, 1.0),
    )


def in_levels(layer: LayerDataTuple, levels: list[Any]) -> LayerDataTuple:
    """Return a layer with a pyramid of lazy arrays, the largest first, instead of its data."""
    _, keywords, kind = layer
    # napari takes one level for none.
    if len(levels) == 1:
        return LayerDataTuple((levels[0], keywords, kind))
    return LayerDataTuple((levels, {**keywords, "multiscale": True}, kind))


def not_trusted_layer(confidence: LayerDataTuple, min_confidence: float) -> LayerDataTuple:
    """Return what lies below a confidence, in [0, 1], as a labels layer: 1 there, 0 elsewhere.

    It is made of what `confidence_layer` returns, or of the layer that was made of that. It lies
    over the map like fog: what the map says there can still be read.
    """
    data, made_with, _ = confidence
    levels = list(data) if made_with.get("multiscale") else [data]
    made = dict(made_with["metadata"][METADATA_KEY])
    made |= {"result": NOT_TRUSTED, "min_confidence": min_confidence}
    made.pop(STORE, None)
    region = (made.get(REGION) or {}).get("of", "")
    keywords = {
        "name": f"{made['source']}{region_suffix(region)} not trusted",
        "colormap": fixed_colors({1: NOT_TRUSTED_COLOR}),
        "opacity": NOT_TRUSTED_OPACITY,
        "metadata": {METADATA_KEY: made},
        **{name: made_with[name] for name in PLACEMENT},
    }
    covers = [
        ((level if is_lazy(level) else np.asarray(level)) < min_confidence).astype(np.uint8)
        for level in levels
    ]
    return in_levels(LayerDataTuple((covers[0], keywords, "labels")), covers)


def in_focus_layer(
    plane: Plane,
    mask: NDArray[np.integer],
    settings: MaskSettings,
    estimation: MapSettings,
    noise_variance: float,
    seeds: str | None = None,
    intensities: Intensities | None = None,
    *,
    threshold_found: bool = False,
) -> LayerDataTuple:
    """Return an in-focus mask as a labels layer that lies on the plane.

    Parameters
    ----------
    plane : Plane
        What the mask was made from.
    mask : (H, W) integer ndarray
        1 in focus, 0 blurred, 2 not known.
    settings : MaskSettings
        What it was segmented with.
    estimation : MapSettings
        What the candidates were estimated with.
    noise_variance, intensities
        See `blur_map_layer`.
    seeds : str, optional
        Name of the layer of its seeds.
    threshold_found : bool, optional
        Whether the threshold of the settings was found from the picture.
    """
    more = {"seeds": seeds} | ({THRESHOLD_FOUND: True} if threshold_found else {})
    return result_layer(
        *(plane, IN_FOCUS, mask, asdict(estimation) | asdict(settings)),
        _noise(noise_variance, intensities) | more,
        kind="labels",
        colormap=fixed_colors({1: MASK_COLOR, UNKNOWN: NOT_TRUSTED_COLOR}),
        opacity=MASK_OPACITY,
    )


def _noise(variance: float, intensities: Intensities | None) -> dict[str, Any]:
    facts = None if intensities is None else intensities.facts()
    return {"noise_variance": float(variance), "intensities": facts}


def fixed_colors(color_of: dict[int, tuple[float, ...]]) -> DirectLabelColormap:
    """Return colours of labels; all others are transparent."""
    transparent: dict[int | None, Any] = {None: "transparent", 0: "transparent"}
    colors = DirectLabelColormap(color_dict=transparent | color_of)
    # napari compiles this mapping when it is first used: better here, in the worker thread,
    # than in the window's.
    colors.map(np.zeros((1, 1), np.uint8))
    return colors


def kernels_layer(lens: MeasuredPSF, file: str, picture: Plane) -> LayerDataTuple:
    """Return measured kernels as a stack, one plane a setting, brightest pixel 1 in each.

    Its pixels are as large as those of a picture that the lens was measured from. Its metadata
    have the scales, in px, and the file in which the lens is.
    """
    kernels = lens.kernels / lens.kernels.max(axis=(1, 2), keepdims=True)
    made = {
        "version": __version__,
        "result": MEASURED_PSF,
        "file": file,
        "scales": lens.scales.tolist(),
        "provenance": dict(lens.provenance),
    }
    keywords = {
        "name": f"{Path(file).stem} kernels",
        "colormap": KERNEL_COLOR_MAP,
        "contrast_limits": (0.0, 1.0),
        "metadata": {METADATA_KEY: made},
        "scale": (1.0, *picture.placement["scale"][-2:]),
        "units": (picture.placement["units"] * 3)[-3:],
        "axis_labels": ("setting", "y", "x"),
    }
    return LayerDataTuple((kernels, keywords, "image"))
