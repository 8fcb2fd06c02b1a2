"""The blur under the cursor, in the status bar and the tooltip: no Qt.

napari computes the status in a thread of its own and hands it to the viewer in the main thread.
There the numbers are added, when the viewer says that its status has changed: no layer is
touched, and nothing is read in napari's thread.
"""

import math
import weakref
from typing import Any

from napari.components import ViewerModel
from napari.layers import Image, Layer

from napari_defocus.psf import BLUR_RADIUS, MICROSCOPE
from napari_defocus.psf.microscope import Microscope
from napari_defocus.psf.parsing import psf_from_text
from napari_defocus.settings import CONFIDENT, UNKNOWN
from napari_defocus.widgets.layers.image_layers import unwrapped
from napari_defocus.widgets.layers.picker import value_at
from napari_defocus.widgets.layers.result_metadata import (
    BLUR_MAP,
    CONFIDENCE,
    DEFOCUS,
    IN_FOCUS,
    METADATA_KEY,
    NOT_TRUSTED,
    made_by_us,
    results_of,
    run_of,
    same_estimation,
    scale_prefix,
)

_DESCRIBED = (BLUR_MAP, DEFOCUS, CONFIDENCE, IN_FOCUS, NOT_TRUSTED)
"""Results whose own value, as napari tells it, says nothing more."""

AS_AROUND = "like its surroundings"

_NOTHING_SEEN = 0.15
"""Confidence below which there is no texture, see `confidence_map`."""

_BEFORE_VALUES = " » "
"""What napari puts between coordinates and values if several layers are selected."""


def show_under_cursor(viewer: ViewerModel) -> None:
    """Let a viewer tell the blur under the cursor from now on; once or often is the same.

    See Also
    --------
    text_under_cursor : What is told.
    """
    emitter = viewer.events.status
    if _on_status in emitter.callbacks:
        return
    emitter.connect(_on_status)
    alive = weakref.ref(unwrapped(viewer))
    viewer.tooltip.events.text.connect(lambda _: _on_tooltip(alive()))


def text_under_cursor(viewer: ViewerModel) -> str:
    """Return what is known of the blur under the cursor, in a few words.

    Parameters
    ----------
    viewer : napari.components.ViewerModel or napari.Viewer
        Its active layer, or the topmost selected one if several are, is a picture or a result
        of ours of it. A result speaks itself; what else is told comes from the same run if it
        can, else from the newest one. Layers are asked in world coordinates, whether they are
        visible or not.

    Returns
    -------
    str
        Such as "3.2 px, confidence 0.94, in focus". It is empty if nothing is known there, or
        the viewer shows a volume. A confidence below that of the cover, or below `CONFIDENT`
        if nothing is covered, is "not trusted", with the reason. A mask follows its surroundings
        there, and where it does not say what the map says: that is said, too.

    Examples
    --------
    >>> import numpy as np
    >>> from napari.components import ViewerModel
    >>> viewer = ViewerModel()
    >>> made = {"napari_defocus": {"result": "blur map", "source": "leaf"}}
    >>> layer = viewer.add_image(np.full((9, 9), 3.21), metadata=made)
    >>> viewer.cursor.position = 4, 5
    >>> text_under_cursor(viewer)
    '3.2 px'
    """
    active = _asked(viewer)
    if active is None or viewer.dims.ndisplay != 2:
        return ""
    at = _Place(viewer, active)
    blur_map, scale = at.found(BLUR_MAP, like=active)
    confidence, sure = at.found(CONFIDENCE, like=blur_map or active)
    mask_layer, mask = at.found(IN_FOCUS)
    words = []
    if blur_map is not None and scale is not None:
        name = str(blur_map.metadata[METADATA_KEY].get("scale", BLUR_RADIUS))
        words.append(f"{scale_prefix(name)}{scale:.1f} px{_in_um(blur_map, scale)}")
    trusted = True
    if confidence is not None and sure is not None:
        trusted = sure >= at.least_confidence(confidence)
        # Rounded up, it might read like one that is trusted.
        untrusted = f"{math.floor(100 * sure) / 100:.2f} (not trusted: {_reason(sure)})"
        words.append(f"confidence {f'{sure:.2f}' if trusted else untrusted}")
    if mask_layer is not None and mask is not None:
        words.append(_focus(mask_layer, mask, scale, known=trusted))
    return ", ".join(words)


def _in_um(blur_map: Layer, scale: float) -> str:
    """Return a blur in um of defocus, if a microscope measured it."""
    settings = blur_map.metadata[METADATA_KEY].get("settings")
    psf = str(settings.get("psf")) if isinstance(settings, dict) else ""
    if not psf.startswith(MICROSCOPE):
        return ""
    lens = psf_from_text(psf)
    return f" = {lens.defocus_um(scale):.2f} µm" if isinstance(lens, Microscope) else ""


def _reason(sure: float) -> str:
    """Return why a radius is not trusted, in a few words."""
    return "no details here" if sure < _NOTHING_SEEN else "details fit several radii"


def _focus(mask_layer: Layer, mask: float, scale: float | None, *, known: bool) -> str:
    """Return what a mask says, and that it follows its neighbours where the place itself does not.

    That is where the place is not known, or the map says otherwise.
    """
    if mask == UNKNOWN:
        return "in focus or not is not known"
    settings = mask_layer.metadata[METADATA_KEY].get("settings")
    threshold = settings.get("threshold") if isinstance(settings, dict) else None
    word = "in focus" if mask else "blurred"
    if known and scale is not None and isinstance(threshold, float):
        known = bool(mask) == (scale <= threshold)
    return word if known else f"{word} {AS_AROUND}"


def _asked(viewer: ViewerModel) -> Layer | None:
    """Return the active layer; of several selected ones none is active, so the topmost."""
    selection = viewer.layers.selection
    if selection.active is not None:
        return selection.active
    return next((layer for layer in reversed(viewer.layers) if layer in selection), None)


class _Place:
    """Where the cursor is, among the results of the active layer's picture.

    Parameters
    ----------
    viewer : napari.components.ViewerModel
    active : napari.layers.Layer
        A picture, or a result of it.
    """

    def __init__(self, viewer: ViewerModel, active: Layer) -> None:
        self._layers = viewer.layers
        self._position = viewer.cursor.position
        self._active = active
        if made_by_us(active) is not None:
            self._source = active.metadata[METADATA_KEY].get("source")
        else:
            self._source = active.name if isinstance(active, Image) else None

    def found(self, result: str, like: Layer | None = None) -> tuple[Layer | None, float | None]:
        """Return the layer that holds a result here, and its value here; None for no layer.

        If `like` is an estimation's result, only layers of the same estimation are asked.
        """
        for layer in self._results(result):
            if like is not None and not _may_go_with(layer, like):
                continue
            value = value_at(layer, self._position)
            if value is not None:
                return layer, value
        return None, None

    def least_confidence(self, confidence: Layer) -> float:
        """Return the confidence from which on a map is trusted."""
        for cover in self._results(NOT_TRUSTED):
            least = cover.metadata[METADATA_KEY].get("min_confidence")
            if isinstance(least, float) and least > 0 and same_estimation(cover, confidence):
                return least
        return CONFIDENT

    def _results(self, result: str) -> list[Layer]:
        if made_by_us(self._active) == result:
            return [self._active]
        if self._source is None:
            return []
        found = results_of(self._layers, result, self._source)
        run = run_of(self._active)
        return sorted(found, key=lambda layer: run_of(layer) != run)


def _may_go_with(layer: Layer, other: Layer) -> bool:
    estimated = made_by_us(other) in (BLUR_MAP, CONFIDENCE, NOT_TRUSTED)
    return layer is other or not estimated or same_estimation(layer, other)


def _on_status(event: Any) -> None:
    """Add what is known to the status, and to the tooltip before napari sets it."""
    viewer = event.source
    status = viewer.status
    of_cursor = "coordinates" in status if isinstance(status, dict) else _BEFORE_VALUES in status
    text = text_under_cursor(viewer) if of_cursor else ""
    if not text:
        return
    if isinstance(status, dict):
        coordinates = _with_text(status, _asked(viewer), text)
        viewer.status = {**status, "coordinates": coordinates}
    elif not status.endswith(text):
        viewer.status = f"{status}    {text}"
    if viewer.tooltip.visible and not viewer.tooltip.text.endswith(text):
        viewer.tooltip.text = text


def _with_text(status: dict[str, Any], asked: Layer, text: str) -> str:
    if status["coordinates"].endswith(text):
        return str(status["coordinates"])
    coordinates, value = status.get("coords"), status.get("value")
    if coordinates and (made_by_us(asked) in _DESCRIBED or not value):
        return f"{coordinates}: {text}"
    return f"{status['coordinates']}; {text}"


def _on_tooltip(viewer: ViewerModel | None) -> None:
    """Add what is known to the tooltip that napari has set."""
    if viewer is None or not viewer.tooltip.visible:
        return
    text, usual = text_under_cursor(viewer), viewer.tooltip.text
    if text and not usual.endswith(text):
        viewer.tooltip.text = f"{usual}\n{text}".strip()
