"""From an image layer to the plane that is analysed, and from results back to layers.

No Qt here: everything works on a `napari.components.ViewerModel` too.
"""

import weakref
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from napari.components import Dims, LayerList, ViewerModel
from napari.layers import Image, Labels, Layer
from napari.types import LayerDataTuple
from napari.utils.colormaps import DirectLabelColormap
from napari.utils.transforms import CompositeAffine
from numpy.typing import NDArray

from napari_defocus import __version__
from napari_defocus.measured_psf import MeasuredPSF
from napari_defocus.psf import PSFFamily
from napari_defocus.settings import MapSettings, MaskSettings

METADATA_KEY = "napari_defocus"
"""Where a result layer's metadata say how it was made."""

BLUR_MAP = "blur map"
CONFIDENCE = "confidence"
NOT_TRUSTED = "not trusted"
IN_FOCUS = "in focus"
MEASURED_PSF = "measured PSF"

MAX_PIXELS = 64_000_000
"""Larger planes are refused: their spectra would fill an ordinary computer's memory."""

COLOR_MAP = "viridis"
MASK_COLOR = (0.1, 0.9, 0.6, 1.0)
MASK_OPACITY = 0.4
CONFIDENCE_COLOR_MAP = "gray"
KERNEL_COLOR_MAP = "magma"
NOT_TRUSTED_COLOR = (0.15, 0.15, 0.15, 1.0)
NOT_TRUSTED_OPACITY = 0.85

_PLACEMENT = ("scale", "translate", "rotate", "shear", "affine", "units", "axis_labels")


class NotAnalysableError(ValueError):
    """The layer, as it is shown now, has no plane to analyse; the message says why."""


@dataclass(frozen=True)
class Plane:
    """One plane of an image layer, not read yet, and where it lies.

    Attributes
    ----------
    layer : weak reference to napari.layers.Image
        The layer that it belongs to; it does not keep the layer alive.
    name : str
        The layer's name.
    data : array
        The layer's data, of level 0 if there are several.
    index : tuple of int or slice
        What picks the plane out of `data`.
    placement : dict
        The layer's scale, translate, rotate, shear, affine, units and axis labels, with
        `translate` moved to the plane.
    contrast_limits, contrast_limits_range : (float, float)
        The layer's own.
    """

    layer: weakref.ref[Image]
    name: str
    data: Any
    index: tuple[int | slice, ...]
    placement: dict[str, Any]
    contrast_limits: tuple[float, float]
    contrast_limits_range: tuple[float, float]

    def read(self) -> NDArray[Any]:
        """Return a copy of the plane's pixels; dask computes this plane and no other.

        Raises
        ------
        NotAnalysableError
            If the plane has NaN or infinite pixels, or is too large.
        """
        plane = self.data[self.index]
        if np.prod(plane.shape[:2]) > MAX_PIXELS:
            raise NotAnalysableError(
                f"it has {np.prod(plane.shape[:2]) / 1e6:.0f} million pixels, more than "
                f"{MAX_PIXELS / 1e6:.0f} million. Crop it first."
            )
        image = np.array(plane)
        if image.dtype.kind == "f" and not np.isfinite(image).all():
            raise NotAnalysableError(
                "it has pixels without a value (NaN or infinite). "
                "Replace them first, for instance with the median."
            )
        return image

    def intensity_range(self, image: NDArray[Any]) -> tuple[float, float] | None:
        """Return the intensities that stand for 0 and 1, None if the dtype says it all.

        The contrast limits speak for integers of more than 8 bit and for floats outside
        [0, 1]: 12-bit data in uint16 fill a sixteenth of their dtype's range.
        """
        if image.dtype.kind in "ui" and image.dtype.itemsize > 1:
            return self.contrast_limits
        if image.dtype.kind == "f" and not self._within_unit_range(image):
            return self.contrast_limits
        return None

    def _within_unit_range(self, image: NDArray[Any]) -> bool:
        low, high = self.contrast_limits_range
        return bool(min(low, image.min()) >= 0.0 and max(high, image.max()) <= 1.0)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in px; nothing is read."""
        height, width = (
            length
            for length, at in zip(self.data.shape, self.index, strict=False)
            if not isinstance(at, int)
        )
        return height, width

    def expanded(self, result: NDArray[Any]) -> NDArray[Any]:
        """Return a result of the plane's height and width with the layer's number of axes."""
        sliced = [axis for axis, at in enumerate(self.index) if isinstance(at, int)]
        return np.expand_dims(result, tuple(sliced))

    def is_current(self, layers: LayerList) -> bool:
        """Tell whether the layer is still in the list, with the data that were read."""
        layer = self.layer()
        return layer is not None and layer in layers and finest(layer) is self.data


def shown_plane(layer: Image, dims: Dims) -> Plane:
    """Return the plane of an image layer that a viewer shows.

    Parameters
    ----------
    layer : napari.layers.Image
        Grey, RGB or RGBA; one picture, a stack, several scales, dask.
    dims : napari.components.Dims
        The viewer's dimensions: which are displayed, and where its sliders are.

    Returns
    -------
    Plane

    Raises
    ------
    NotAnalysableError
        If the layer is shown as a volume, or the sliders are outside of it.
    """
    # Plugins are lent a proxy; the layer itself is what lives and dies.
    layer = getattr(layer, "__wrapped__", layer)
    return plane_at(layer, shown_index(layer, dims, finest(layer).shape))


def plane_at(layer: Image, index: tuple[int | slice, ...]) -> Plane:
    """Return the plane of an image layer that an index picks."""
    return Plane(
        layer=weakref.ref(layer),
        name=layer.name,
        data=finest(layer),
        index=index,
        placement=placement(layer, index),
        contrast_limits=_pair(layer.contrast_limits),
        contrast_limits_range=_pair(layer.contrast_limits_range),
    )


def finest(layer: Image | Labels) -> Any:
    """Return a layer's data, of level 0 if there are several."""
    return layer.data[0] if layer.multiscale else layer.data


def _pair(limits: Any) -> tuple[float, float]:
    low, high = limits
    return float(low), float(high)


def shown_index(
    layer: Image | Labels, dims: Dims, shape: tuple[int, ...]
) -> tuple[int | slice, ...]:
    """Return what picks the plane that a viewer shows out of a layer's data, see `shown_plane`."""
    if layer.ndim == 2:
        return (slice(None), slice(None))
    first = dims.ndim - layer.ndim
    shown = {axis - first for axis in dims.displayed if axis >= first}
    if len(shown) != 2:
        raise NotAnalysableError(
            "it is shown as a volume. Switch the viewer to 2-D and go to the plane you want."
        )
    # As napari slices: only the axes that are not displayed have a say.
    point = [0.0 if axis - first in shown else at for axis, at in enumerate(dims.point)]
    at = np.round(layer.world_to_data(point)).astype(int)
    if any(not 0 <= at[axis] < shape[axis] for axis in range(layer.ndim) if axis not in shown):
        raise NotAnalysableError(
            "the viewer shows no plane of it. Move the sliders to where the picture appears."
        )
    return tuple(slice(None) if axis in shown else int(at[axis]) for axis in range(layer.ndim))


def placement(layer: Image, index: tuple[int | slice, ...]) -> dict[str, Any]:
    """Return where a plane of a layer lies, as keywords of a new layer, see `Plane`."""
    to_physical = CompositeAffine(
        scale=layer.scale,
        translate=layer.translate,
        rotate=layer.rotate,
        shear=layer.shear,
        ndim=layer.ndim,
    )
    corner = [at if isinstance(at, int) else 0 for at in index]
    return {
        "scale": np.array(layer.scale),
        "translate": np.asarray(to_physical(corner)),
        "rotate": np.array(layer.rotate),
        "shear": np.array(layer.shear),
        "affine": np.array(layer.affine.affine_matrix),
        "units": tuple(layer.units),
        "axis_labels": tuple(layer.axis_labels),
    }


def blur_map_layer(
    plane: Plane,
    blur_map: NDArray[np.floating],
    settings: MapSettings,
    noise_variance: float,
    psf: PSFFamily | None = None,
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
        The family of the settings, if it is at hand; its largest scale is the upper end of the
        colour range.

    Returns
    -------
    LayerDataTuple
    """
    psf = psf or settings.family()
    what = "" if psf.scale_name.endswith("radius (px)") else psf.scale_name.removesuffix("(px)")
    keywords = {
        "name": f"{plane.name} blur {what}(px)",
        "colormap": COLOR_MAP,
        "contrast_limits": (0.0, float(psf.max_scale)),
        "metadata": _provenance(plane, BLUR_MAP, asdict(settings), noise_variance),
        **plane.placement,
    }
    keywords["metadata"][METADATA_KEY]["scale"] = psf.scale_name
    return LayerDataTuple((plane.expanded(blur_map), keywords, "image"))


def confidence_layer(
    plane: Plane,
    confidence: NDArray[np.floating],
    settings: MapSettings,
    noise_variance: float,
) -> LayerDataTuple:
    """Return the confidence of a blur map as an image layer that lies on the plane.

    It is hidden at first: it would cover the map.

    Parameters
    ----------
    plane : Plane
        What the map was estimated from.
    confidence : (H, W) float ndarray
        In [0, 1].
    settings : MapSettings
        What the map was estimated with.
    noise_variance : float
        The variance that was used, found or given; intensities in [0, 1].

    Returns
    -------
    LayerDataTuple
    """
    keywords = {
        "name": f"{plane.name} confidence",
        "colormap": CONFIDENCE_COLOR_MAP,
        "contrast_limits": (0.0, 1.0),
        "visible": False,
        "metadata": _provenance(plane, CONFIDENCE, asdict(settings), noise_variance),
        **plane.placement,
    }
    return LayerDataTuple((plane.expanded(confidence), keywords, "image"))


def not_trusted_layer(confidence: LayerDataTuple, min_confidence: float) -> LayerDataTuple:
    """Return what lies below a confidence as a labels layer: 1 there, 0 elsewhere.

    Parameters
    ----------
    confidence : LayerDataTuple
        From `confidence_layer`, or of the layer that was made of it.
    min_confidence : float
        In [0, 1].

    Returns
    -------
    LayerDataTuple
    """
    data, made_with, _ = confidence
    made = dict(made_with["metadata"][METADATA_KEY])
    made |= {"result": NOT_TRUSTED, "min_confidence": min_confidence}
    keywords = {
        "name": f"{made['source']} not trusted",
        "colormap": fixed_colors({1: NOT_TRUSTED_COLOR}),
        "opacity": NOT_TRUSTED_OPACITY,
        "metadata": {METADATA_KEY: made},
        **{name: made_with[name] for name in _PLACEMENT},
    }
    return LayerDataTuple(
        ((np.asarray(data) < min_confidence).astype(np.uint8), keywords, "labels")
    )


def in_focus_layer(
    plane: Plane,
    mask: NDArray[np.integer],
    settings: MaskSettings,
    estimation: MapSettings,
    noise_variance: float,
    seeds: str | None = None,
) -> LayerDataTuple:
    """Return an in-focus mask as a labels layer that lies on the plane.

    Parameters
    ----------
    plane : Plane
        What the mask was made from.
    mask : (H, W) integer ndarray
        1 in focus, 0 blurred.
    settings : MaskSettings
        What it was segmented with.
    estimation : MapSettings
        What the candidates were estimated with.
    noise_variance : float
        The variance that was used, found or given; intensities in [0, 1].
    seeds : str, optional
        Name of the layer of its seeds.

    Returns
    -------
    LayerDataTuple
    """
    keywords = {
        "name": f"{plane.name} in focus",
        "colormap": fixed_colors({1: MASK_COLOR}),
        "opacity": MASK_OPACITY,
        "metadata": _provenance(
            plane, IN_FOCUS, {**asdict(estimation), **asdict(settings)}, noise_variance
        ),
        **plane.placement,
    }
    keywords["metadata"][METADATA_KEY]["seeds"] = seeds
    return LayerDataTuple((plane.expanded(mask), keywords, "labels"))


def fixed_colors(color_of: dict[int, tuple[float, ...]]) -> DirectLabelColormap:
    """Return colours of labels; all others are transparent."""
    transparent: dict[int | None, Any] = {None: "transparent", 0: "transparent"}
    colors = DirectLabelColormap(color_dict=transparent | color_of)
    # napari compiles this mapping when it is first used: better here, in the worker thread,
    # than in the window's.
    colors.map(np.zeros((1, 1), np.uint8))
    return colors


def _provenance(
    plane: Plane, result: str, settings: dict[str, Any], noise_variance: float
) -> dict[str, Any]:
    return {
        METADATA_KEY: {
            "version": __version__,
            "result": result,
            "source": plane.name,
            "noise_variance": float(noise_variance),
            "settings": settings,
        }
    }


def kernels_layer(lens: MeasuredPSF, file: str, picture: Plane) -> LayerDataTuple:
    """Return measured kernels as a stack, one plane a setting, brightest pixel 1 in each.

    Parameters
    ----------
    lens : MeasuredPSF
    file : str
        Where it was saved.
    picture : Plane
        One of those that it was measured from, whose pixels are as large.

    Returns
    -------
    LayerDataTuple
        Its metadata have the scales, in px, and the file.
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


def made_by_us(layer: Layer) -> str | None:
    """Return what result a layer holds, None if it is no result of ours."""
    made = layer.metadata.get(METADATA_KEY, {})
    return made.get("result") if isinstance(made, dict) else None


def layer_of_result(layers: LayerList, result: str, source: str) -> Layer | None:
    """Return the layer that holds a result of the layer named `source`, if there is one."""
    for layer in layers:
        if made_by_us(layer) == result and layer.metadata[METADATA_KEY].get("source") == source:
            return layer
    return None


def show_results(viewer: ViewerModel, results: list[LayerDataTuple]) -> list[Layer]:
    """Put results into a viewer; those of an earlier run on the same layer are updated.

    Parameters
    ----------
    viewer : napari.components.ViewerModel or napari.Viewer
    results : list of LayerDataTuple
        From the functions above.

    Returns
    -------
    list of napari.layers.Layer
        The layers that hold the results now. An updated layer keeps the colours, the
        opacity and the visibility that its user gave it.
    """
    return [_shown_result(viewer, *result) for result in results]


def _shown_result(viewer: ViewerModel, data: Any, keywords: dict[str, Any], kind: str) -> Layer:
    layer = _earlier_result(viewer.layers, keywords)
    if layer is None:
        layer = viewer.add_layer(Layer.create(data, keywords, kind))
        if kind == "image" and keywords["metadata"][METADATA_KEY]["result"] != MEASURED_PSF:
            layer.colorbar.visible = True
        return layer
    layer.data = data
    for name in _PLACEMENT:
        if name in keywords:
            setattr(layer, name, keywords[name])
    layer.metadata = {**layer.metadata, **keywords["metadata"]}
    if kind == "image":
        layer.contrast_limits_range = keywords["contrast_limits"]
        layer.contrast_limits = keywords["contrast_limits"]
    return layer


def _earlier_result(layers: LayerList, keywords: dict[str, Any]) -> Layer | None:
    """Find the layer of that name, unless it is somebody else's work."""
    made = keywords["metadata"][METADATA_KEY]
    for layer in layers:
        if layer.name == keywords["name"] and made_by_us(layer) == made["result"]:
            return layer
    return None
