"""A picture as a relief of its blur or its distances, in 3-D and back: no Qt."""

import math
import weakref
from collections.abc import Callable
from functools import partial
from typing import Literal, get_args

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image, Surface
from numpy.typing import NDArray

from napari_defocus.core.checks import check_confidence, check_number
from napari_defocus.core.color_range import LEAST_COLOR_LIMIT
from napari_defocus.optics.mesh import DepthSurface, blur_surface, depth_surface, picture_colors
from napari_defocus.settings import CONFIDENT
from napari_defocus.widgets.display.view_state import CameraView, ViewState, show_alone, view_state
from napari_defocus.widgets.jobs.distances import above, upright
from napari_defocus.widgets.jobs.estimation import Picture
from napari_defocus.widgets.jobs.map_source import confidence_of, plane_on
from napari_defocus.widgets.layers.image_layers import (
    Plane,
    shown_plane,
    unwrapped,
)
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    DEPTH,
    RELIEF,
    layer_of_result,
    provenance,
)

HeightsFrom = Literal["blur", "depth"]

_RELIEF = 0.3
"""How high the largest blur or distance stands above 0, as a share of the picture's longer side."""

_LONGEST_TEXTURE = 4096
"""In px; graphics cards take more, but a screen shows no more."""

_DIMMED = 0.5
"""How bright the picture is where its blur is not trusted.

Holes there would leave tatters of a photograph, and the veil of the 2-D view catches the eye.
"""

_LOOKING = (-1.0, -0.55, 0.4)
"""Where the camera looks, as height, rows, columns: down on the picture, from below and left."""


def show_relief(
    viewer: ViewerModel,
    image_layer: Image,
    exaggeration: float = 1.0,
    *,
    heights: HeightsFrom = "blur",
    min_confidence: float = CONFIDENT,
) -> Surface:
    """Show a picture in 3-D as a relief: what is in focus, or near, stands out.

    Everything else is hidden until `hide_relief` is called or the relief is deleted; then the
    viewer is as it was. Whoever switches the viewer to 2-D sees the other layers meanwhile, and
    in 3-D the relief again. Another relief of the same picture takes its place under the same
    camera.

    Parameters
    ----------
    viewer : napari.components.ViewerModel or napari.Viewer
    image_layer : napari.layers.Image
        The picture, of a stack the plane that is shown. Its newest blur map, or its newest
        distances, are the heights: see `blur_surface` and `depth_surface`.
    exaggeration : float, optional
        At 1, the whole range of the map is 0.3 of the picture's longer side high; at 2, twice
        as much.
    heights : {"blur", "depth"}, optional
        What stands out.
    min_confidence : float, optional
        In [0, 1]. Where the confidence of the blur map is below, the relief is dimmed. Distances
        that are not trusted are not known, and leave holes.

    Returns
    -------
    napari.layers.Surface
        At most 0.5 million triangles, with the picture as their texture.

    Raises
    ------
    NotAnalysableError
        If the layer shows no plane, see `shown_plane`.
    TypeError
        If a number is none.
    ValueError
        If the picture has no such map of its height and width here, or another argument is out
        of its range.

    Examples
    --------
    >>> import numpy as np
    >>> from napari.components import ViewerModel
    >>> viewer = ViewerModel()
    >>> image = viewer.add_image(np.random.default_rng(0).random((32, 48)), name="leaf")
    >>> made = {"napari_defocus": {"result": "blur map", "source": "leaf"}}
    >>> blur_map = viewer.add_image(np.full((32, 48), 2.0), contrast_limits=(0, 8), metadata=made)
    >>> show_relief(viewer, image).name
    'leaf relief'
    >>> viewer.dims.ndisplay, image.visible
    (3, False)
    >>> hide_relief(viewer)
    True
    >>> viewer.dims.ndisplay, image.visible
    (2, True)
    """
    _check(exaggeration, heights, min_confidence)
    viewer, image_layer = unwrapped(viewer), unwrapped(image_layer)
    earlier = view_state(viewer)
    view = earlier.view_of(image_layer) if earlier is not None else None
    hide_relief(viewer)
    make = wanted_relief(
        viewer, image_layer, exaggeration, heights=heights, min_confidence=min_confidence
    )
    return show_made_relief(viewer, image_layer, make(), view)


def wanted_relief(
    viewer: ViewerModel,
    image_layer: Image,
    exaggeration: float = 1.0,
    *,
    heights: HeightsFrom = "blur",
    min_confidence: float = CONFIDENT,
) -> Callable[[], Surface]:
    """Return what makes the surface of `show_relief`, which see, in any thread."""
    _check(exaggeration, heights, min_confidence)
    viewer, image_layer = unwrapped(viewer), unwrapped(image_layer)
    plane = shown_plane(image_layer, viewer.dims)
    layer, found = _map_of(plane, viewer, heights)
    confidence = confidence_of(layer, found, viewer)
    return partial(
        _relief_of, plane, layer, found, confidence, float(exaggeration), heights, min_confidence
    )


def _check(exaggeration: float, heights: str, min_confidence: float) -> None:
    check_number("exaggeration", exaggeration, lambda e: 0 < e < math.inf, "a number above 0")
    check_confidence("min_confidence", min_confidence)
    if heights not in get_args(HeightsFrom):
        raise ValueError(f"heights is {heights!r}; it takes one of {get_args(HeightsFrom)}")


def show_made_relief(
    viewer: ViewerModel, image_layer: Image, relief: Surface, view: CameraView | None = None
) -> Surface:
    """Show the surface that `wanted_relief` has made, instead of everything else."""
    viewer, image_layer = unwrapped(viewer), unwrapped(image_layer)
    hide_relief(viewer)
    state = ViewState(viewer, image_layer)
    state.relief = weakref.ref(viewer.add_layer(relief))
    _look_at(viewer, relief, view)
    state.wait()
    return relief


def hide_relief(viewer: ViewerModel) -> bool:
    """Take the relief away, and bring back what was seen before; False if none is shown."""
    state = view_state(viewer)
    if state is None:
        return False
    state.restore()
    return True


def _relief_of(
    plane: Plane,
    layer: Image,
    found: Plane,
    confidence: Plane | None,
    exaggeration: float,
    heights: str,
    min_confidence: float,
) -> Surface:
    """Return the relief of a plane, not in the viewer yet: any thread."""
    if heights == "blur":
        surface = blur_surface(
            found.values(), max_scale=_largest_scale(layer), relief=exaggeration * _RELIEF
        )
    else:
        surface = depth_surface(found.values(), relief=exaggeration * _RELIEF)
    vertices, faces, _ = above(surface, plane)
    settings = {
        "heights": heights,
        "exaggeration": exaggeration,
        "min_confidence": min_confidence,
    }
    return Surface(
        (vertices, faces),
        name=f"{plane.name} relief",
        texture=_texture(plane, confidence, min_confidence),
        texcoords=_places(surface, plane.shape),
        shading="none",
        metadata=provenance(plane, RELIEF, settings, map=layer.name),
        **upright(plane),
    )


def _map_of(plane: Plane, viewer: ViewerModel, heights: str) -> tuple[Image, Plane]:
    """Return the layer that the heights come from, and its plane that lies on the picture."""
    result, name = (BLUR_MAP, "blur map") if heights == "blur" else (DEPTH, "distances")
    layer = layer_of_result(viewer.layers, result, plane.name, plane.region)
    if layer is None:
        raise ValueError(f"“{plane.name}” has no {name} yet. Estimate them first.")
    return layer, plane_on(layer, plane, viewer, "relief")


def _largest_scale(layer: Image) -> float:
    """Return the scale, in px, at the upper end of a map's colours, where the relief is 0."""
    largest = float(layer.contrast_limits_range[1])
    return largest if largest > 0 else LEAST_COLOR_LIMIT


def _texture(plane: Plane, confidence: Plane | None, min_confidence: float) -> NDArray[np.uint8]:
    """Return the picture, (h, w, 3), dimmed where its blur is not trusted."""
    picture = Picture.of(plane)
    step = -(-max(plane.shape) // _LONGEST_TEXTURE)
    color = 255 * picture_colors(picture.image, plane.shape, None)[::step, ::step]
    if confidence is not None:
        color[confidence.values()[::step, ::step] < min_confidence] *= _DIMMED
    return np.rint(color).astype(np.uint8)


def _places(surface: DepthSurface, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return where on the texture the corners of `above` lie: from left, from below, in [0, 1]."""
    _, rows, columns = surface.vertices.T
    from_left = (columns + 0.5) / shape[1]
    from_below = 1 - (rows + 0.5) / shape[0]
    places = np.stack([from_left, from_below], axis=1)
    return np.concatenate([places[:1], places]).astype(np.float32)


def _look_at(viewer: ViewerModel, relief: Surface, view: CameraView | None) -> None:
    """Show the relief alone and in 3-D, as it was seen before or from where it is seen well."""
    show_alone(viewer, relief)
    viewer.dims.ndisplay = 3
    if view is not None:
        view.restore(viewer)
        return
    viewer.scene.camera.set_view_direction(_LOOKING, up_direction=(0, -1, 0))
    viewer.fit_to_view(layers=[relief])
