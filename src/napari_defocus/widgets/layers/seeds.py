"""Seeds as labels layers: a new one for an image, and what one says about the plane shown.

No Qt here, as in `layers`.
"""

import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from napari.components import Dims, ViewerModel
from napari.layers import Image, Labels
from numpy.typing import NDArray

from napari_defocus import __version__
from napari_defocus.labeling.seeds import BLURRED, IN_FOCUS, checked_seeds
from napari_defocus.widgets.layers.alignment import lies_on, same_part
from napari_defocus.widgets.layers.image_layers import (
    Plane,
    corner,
    finest,
    placement,
    shown_index,
    unwrapped,
)
from napari_defocus.widgets.layers.result_layers import MASK_COLOR, fixed_colors
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY

SEEDS = "seeds"
BLURRED_COLOR = (0.63, 0.13, 0.0, 1.0)
"""Of all colours the one that is farthest from the mask's, from those of the map, from black and
from white, for whoever sees all colours and for whoever sees less red, green or blue."""
OPACITY = 0.7
BRUSH_SIZE = 10


@dataclass(frozen=True, eq=False)
class Seeds:
    """What is known of a plane.

    Attributes
    ----------
    name : str
        Of the labels layer that it was in.
    values : (H, W) integer ndarray
        1 in focus, 2 blurred, 0 not known; a copy.
    """

    name: str
    values: NDArray[np.integer]


class SeedsWatch:
    """Tells when somebody has painted on a labels layer, or taken it back.

    Parameters
    ----------
    notify : callable
        Called after each change.
    """

    def __init__(self, notify: Callable[[], None]) -> None:
        self._notify = notify
        self._watched: weakref.ref[Labels] | None = None

    def watch(self, layer: Labels | None) -> None:
        """Watch a layer, or none, instead of the one before."""
        before = None if self._watched is None else self._watched()
        layer = unwrapped(layer)
        self._watched = None if layer is None else weakref.ref(layer)
        for each, connect in ((before, False), (layer, True)):
            if each is not None:
                # Undo and redo say nothing else than that the layer is drawn again.
                for event in (each.events.paint, each.events.set_data, each.events.data):
                    (event.connect if connect else event.disconnect)(self._on_change)

    def _on_change(self, event: Any) -> None:
        self._notify()


def shown_seeds(layer: Labels, plane: Plane, dims: Dims) -> Seeds:
    """Return what a labels layer says about a plane that a viewer shows, or a part of it.

    The layer has the axes of the image, or of the plane alone. Of seeds of the whole plane, a part
    takes its own.

    Raises
    ------
    ValueError
        If it lies elsewhere, has another height and width, or values beside 0, 1 and 2.
    """
    layer = unwrapped(layer)
    with _layers_named(layer, plane):
        return _seeds_in(layer, shown_index(layer, dims, finest(layer).shape), plane)


def seeds_of_plane(layer: Labels, plane: Plane) -> Seeds:
    """Return what a labels layer says about a plane of a stack, whichever is shown.

    The layer has the axes of the stack, or of its planes alone: those seeds hold for every plane.

    Raises
    ------
    ValueError
        As `shown_seeds`, and if it has no plane there.
    """
    with _layers_named(layer, plane):
        return _seeds_in(layer, _index_at(layer, plane), plane)


def _index_at(layer: Labels, plane: Plane) -> tuple[int | slice, ...]:
    """Return what picks out of a labels layer the plane that lies where an image's plane does."""
    image = plane.layer()
    if image is None or layer.ndim > image.ndim:
        raise ValueError("it has other axes than the image")
    world = image.data_to_world(corner(plane.index))
    at = np.round(layer.world_to_data(world)).astype(int)
    shape, shown = finest(layer).shape, plane.index[-layer.ndim :]
    if any(isinstance(n, int) and not 0 <= at[a] < shape[a] for a, n in enumerate(shown)):
        raise ValueError("it has no plane where the image has one")
    return tuple(int(at[a]) if isinstance(n, int) else slice(None) for a, n in enumerate(shown))


def _seeds_in(layer: Labels, index: tuple[int | slice, ...], plane: Plane) -> Seeds:
    index = same_part(index, finest(layer).shape, plane)
    values = checked_seeds(np.array(finest(layer)[index]), plane.shape)
    if not lies_on(layer, index, plane):
        raise ValueError("it lies elsewhere than the image, or has another scale")
    return Seeds(layer.name, values)


@contextmanager
def _layers_named(layer: Labels, plane: Plane) -> Iterator[None]:
    """Let errors say which layer does not fit which image, and how to get one that does."""
    try:
        yield
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"“{layer.name}” cannot be the seeds of “{plane.name}”: {str(error).rstrip('.')}. "
            "“New seeds layer” makes one that fits."
        ) from None


def add_seeds_layer(viewer: ViewerModel, image: Image) -> Labels:
    """Add an empty labels layer for the seeds of an image layer's planes, ready for the brush.

    Returns
    -------
    napari.layers.Labels
        The label "in focus" is chosen.
    """
    image = unwrapped(image)
    made: dict[str, Any] = {"version": __version__, "result": SEEDS, "source": image.name}
    layer = Labels(
        np.zeros(finest(image).shape[: image.ndim], np.uint8),
        name=f"{image.name} seeds",
        colormap=fixed_colors({IN_FOCUS: MASK_COLOR, BLURRED: BLURRED_COLOR}),
        features={"meaning": ["not painted", "in focus", "blurred"]},
        opacity=OPACITY,
        metadata={METADATA_KEY: made},
        **placement(image, (slice(None),) * image.ndim),
    )
    viewer.add_layer(layer)
    layer.brush_size = BRUSH_SIZE
    layer.selected_label = IN_FOCUS
    layer.mode = "paint"
    return layer
