"""What is known at one place of the picture, and where its window is outlined.

No Qt here, as in `layers`.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from napari.components import ViewerModel
from napari.layers import Image, Layer, Shapes
from numpy.typing import NDArray

from napari_defocus import __version__
from napari_defocus.widgets.kept import KeptWork
from napari_defocus.widgets.layers import placement
from napari_defocus.widgets.results import METADATA_KEY, made_by_us

if TYPE_CHECKING:
    from napari_defocus import PixelExplanation
    from napari_defocus.widgets.estimation import Analysed

PROBE = "probe"
OUTLINE_COLOR = "#ffd400"
OUTLINE_WIDTH = 2.0
"""In px of the screen."""

_OUTSIDE = "This place is outside of what was measured."


class NothingKnownError(ValueError):
    """Nothing is known at that place; the message says why."""


@dataclass(frozen=True, eq=False)
class Probed:
    """What is known at a place.

    Attributes
    ----------
    explanation : PixelExplanation
    image : napari.layers.Image
    corners : (4, D) float64 ndarray
        Of the analysed window, in the layer's data coordinates.
    """

    explanation: "PixelExplanation"
    image: Image
    corners: NDArray[np.floating]


def probed(
    viewer: ViewerModel, layer: Image | None, position: tuple[float, ...], kept: KeptWork
) -> Probed:
    """Tell what is known of an image layer at a place; nothing is estimated for it.

    Parameters
    ----------
    viewer : napari.components.ViewerModel or napari.Viewer
    layer : napari.layers.Image or None
    position : tuple of float
        World coordinates, as those of mouse events.
    kept : KeptWork
        What runs have found.

    Raises
    ------
    NothingKnownError
        If there is no image, nothing was analysed or another plane, the picture was exchanged
        since, or the place is outside of it.
    """
    from napari_defocus import explain_pixel

    known = _known(viewer, layer, kept)
    image, plane, candidates = _itself(layer), known.picture.plane, known.candidates
    row, column = pixel_at(image, plane.index, candidates.image_shape, position)
    found = known.blur_map
    told = explain_pixel(
        candidates,
        row,
        column,
        blur_map=None if found is None else found.values,
        confidence=None if found is None else found.confidence,
        image=known.picture.image,
        intensity_range=known.picture.span,
    )
    return Probed(told, image, corners_of(told.window, plane.index, candidates.image_shape))


def _known(viewer: ViewerModel, layer: Image | None, kept: KeptWork) -> "Analysed":
    if layer is None:
        raise NothingKnownError("There is no image. Open one and measure it first.")
    known = kept.analysed.latest(_itself(layer))
    if known is None:
        raise NothingKnownError("Nothing is known here yet: measure the picture first.")
    if not known.picture.plane.is_current(viewer.layers):
        raise NothingKnownError("The picture was changed since it was measured: measure it again.")
    if viewer.dims.ndisplay != 2:
        raise NothingKnownError("The viewer shows a volume: switch it to 2-D.")
    return known


def pixel_at(
    layer: Image,
    index: tuple[int | slice, ...],
    shape: tuple[int, int],
    position: tuple[float, ...],
) -> tuple[int, int]:
    """Return the row and the column of a plane's pixel at world coordinates.

    Parameters
    ----------
    layer : napari.layers.Image
    index : tuple of int or slice
        What picks the plane out of the layer's data, an entry an axis.
    shape : (int, int)
        Height and width of the plane, in px.
    position : tuple of float
        World coordinates; those of the last axes count, if the layer has fewer.

    Raises
    ------
    NothingKnownError
        If they are on another plane or outside of this one.
    """
    at = np.asarray(layer.world_to_data(position))
    if not np.isfinite(at).all():
        raise NothingKnownError(_OUTSIDE)
    nearest = np.floor(at + 0.5).astype(int)
    if any(isinstance(i, int) and i != k for i, k in zip(index, nearest, strict=True)):
        measured = ", ".join(str(i) for i in index if isinstance(i, int))
        raise NothingKnownError(f"This plane was not measured; plane {measured} was.")
    row, column = (nearest - _first_pixel(index))[_plane_axes(index)]
    if not (0 <= row < shape[0] and 0 <= column < shape[1]):
        raise NothingKnownError(_OUTSIDE)
    return int(row), int(column)


def corners_of(
    window: tuple[float, float, float, float],
    index: tuple[int | slice, ...],
    shape: tuple[int, int],
) -> NDArray[np.floating]:
    """Return the corners of a window of a plane in its layer's data coordinates: (4, D).

    Not beyond the centres of the plane's outer pixels: a layer that reaches farther than all
    others would change the range of the viewer's sliders.
    """
    height, width = shape
    top, left, bottom, right = np.clip(window, 0, [height - 1, width - 1] * 2)
    corners = np.tile(_first_pixel(index).astype(float), (4, 1))
    corners[:, _plane_axes(index)] += [(top, left), (top, right), (bottom, right), (bottom, left)]
    return corners


def _plane_axes(index: tuple[int | slice, ...]) -> list[int]:
    return [axis for axis, at in enumerate(index) if not isinstance(at, int)]


def _first_pixel(index: tuple[int | slice, ...]) -> NDArray[np.int64]:
    return np.array([at if isinstance(at, int) else at.start or 0 for at in index])


class WindowOutline:
    """A rectangle in the viewer around what was analysed, made when it is first shown.

    Parameters
    ----------
    viewer : napari.components.ViewerModel or napari.Viewer
    on_deleted : callable
        Called when somebody else than this object takes its layer away.

    Attributes
    ----------
    layer : napari.layers.Shapes or None
        None while there is nothing to show.
    """

    def __init__(self, viewer: ViewerModel, on_deleted: Callable[[], None]) -> None:
        self._viewer = viewer
        self._on_deleted = on_deleted
        self._image: Image | None = None
        self._compiling: threading.Thread | None = None
        self._hidden = False
        self.layer: Shapes | None = None

    def show(self, image: Image, corners: NDArray[np.floating]) -> bool:
        """Outline a window of an image instead of another one.

        Parameters
        ----------
        image : napari.layers.Image
        corners : (4, D) float ndarray
            In the layer's data coordinates.

        Returns
        -------
        bool
            False if napari is not ready to draw yet; ask again then.
        """
        if not self._ready():
            return False
        if self._image is not image:
            self.remove()
            self._add(image, corners)
        elif self.layer is not None and not np.array_equal(self.layer.data, [corners]):
            self.layer.data = [corners]
        if self._hidden and self.layer is not None:
            self.layer.visible = True
        self._hidden = False
        self._follow(image)
        self.fit_zoom()
        return True

    def hide(self) -> None:
        """Show no rectangle for now; napari takes some tenths of a second to make a new one."""
        if self._image is not None and self._image not in self._viewer.layers:
            self.remove()
        if self.layer is not None and self.layer.visible:
            self.layer.visible = False
            self._hidden = True

    def _ready(self) -> bool:
        """Have napari compile what it draws shapes with, in a thread.

        The first shape after an installation takes seconds, the first of a session some tenths
        of one; that must not stop the mouse.
        """
        if self._compiling is None:
            corners = np.array([(0, 0), (0, 1), (1, 1), (1, 0)], float)
            self._compiling = threading.Thread(
                target=lambda: Shapes([corners], shape_type="rectangle"), daemon=True
            )
            self._compiling.start()
        return not self._compiling.is_alive()

    def remove(self) -> None:
        """Take the rectangle away."""
        layer, self.layer = self.layer, None
        self._image, self._hidden = None, False
        if layer is None:
            return
        self._viewer.layers.events.removed.disconnect(self._on_removed)
        self._viewer.scene.camera.events.zoom.disconnect(self._on_zoom)
        if layer in self._viewer.layers:
            self._viewer.layers.remove(layer)

    def fit_zoom(self) -> None:
        """Make its line as wide on the screen as it was."""
        if self.layer is None:
            return
        ends = self.layer.data[0][:2]
        drawn = np.linalg.norm(np.subtract(*(self.layer.data_to_world(end) for end in ends)))
        zoom = self._viewer.scene.camera.zoom
        width = OUTLINE_WIDTH / zoom * np.linalg.norm(np.subtract(*ends)) / drawn
        if not np.allclose(self.layer.edge_width, width, rtol=0.02):
            self.layer.edge_width = width
            # Setting it does not draw it.
            self.layer.refresh()

    def _add(self, image: Image, corners: NDArray[np.floating]) -> None:
        layer = Shapes(
            [corners],
            shape_type="rectangle",
            name=PROBE,
            face_color="transparent",
            edge_color=OUTLINE_COLOR,
            metadata={METADATA_KEY: {"version": __version__, "result": PROBE}},
            **_placement(image),
        )
        layer.editable = False
        layers = self._viewer.layers
        selected = set(layers.selection)
        layers.append(layer)
        # What is new is selected; whoever paints goes on painting.
        layers.selection.intersection_update(selected)
        layers.selection.update(selected)
        self._image, self.layer = image, layer
        layers.events.removed.connect(self._on_removed)
        self._viewer.scene.camera.events.zoom.connect(self._on_zoom)

    def _follow(self, image: Image) -> None:
        """Lie where the image lies, should it have been moved."""
        if self.layer is None:
            return
        for name, value in _placement(image).items():
            if not _is_the_same(getattr(self.layer, name), value):
                setattr(self.layer, name, value)

    def _on_zoom(self, _: Any = None) -> None:
        self.fit_zoom()

    def _on_removed(self, event: Any) -> None:
        if self.layer is not None and event.value == self.layer:
            self.remove()
            self._on_deleted()


def _placement(image: Image) -> dict[str, Any]:
    return placement(image, (slice(None),) * image.ndim)


def _is_the_same(shown: Any, wanted: Any) -> bool:
    if isinstance(wanted, tuple):
        return tuple(shown) == wanted
    return np.allclose(getattr(shown, "affine_matrix", shown), wanted)


def image_of(layers: Any, layer: Layer | None) -> Image | None:
    """Return the image layer that a layer is or is a result of; None if there is none."""
    if layer is None:
        return None
    if isinstance(layer, Image) and made_by_us(layer) is None:
        return layer
    made = layer.metadata.get(METADATA_KEY, {})
    source = made.get("source") if isinstance(made, dict) else None
    named = (other for other in layers if other.name == source)
    return next((o for o in named if isinstance(o, Image) and made_by_us(o) is None), None)


def image_to_probe(viewer: ViewerModel, kept: KeptWork) -> Image | None:
    """Return the image layer to begin with: one that was analysed, rather the active one."""
    images = [layer for layer in viewer.layers if image_of([], layer) is not None]
    active = image_of(viewer.layers, viewer.layers.selection.active)
    # The active one last, so that it is taken if several will do.
    ordered = sorted(images, key=lambda image: image is active)
    known = [image for image in ordered if kept.analysed.latest(_itself(image)) is not None]
    return (known or ordered or [None])[-1]


def may_pin(viewer: ViewerModel) -> bool:
    """Tell whether a click means nothing else: no brush and no other tool is at work."""
    active = viewer.layers.selection.active
    return active is None or str(active.mode) == "pan_zoom"


def _itself(layer: Any) -> Any:
    """Return the layer behind the proxy that plugins are lent."""
    return getattr(layer, "__wrapped__", layer)
