"""Results put into a viewer, in place or beside earlier ones: no Qt."""

import re
from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np
from napari.components import LayerList, ViewerModel
from napari.layers import Labels, Layer, Surface
from napari.types import LayerDataTuple
from numpy.typing import NDArray

from napari_defocus.widgets.display.cursor_text import show_under_cursor
from napari_defocus.widgets.display.renaming import rename_with
from napari_defocus.widgets.layers.image_layers import move_to
from napari_defocus.widgets.layers.result_metadata import (
    ALL_IN_FOCUS,
    AT,
    BEST_FOCUS,
    BLUR_MAP,
    CONFIDENCE,
    DEFOCUS,
    DEPTH,
    FOCUS_CONFIDENCE,
    HEIGHT,
    IN_FOCUS,
    METADATA_KEY,
    PLACEMENT,
    PLANES,
    REFOCUSED,
    RUN,
    STORE,
    layer_of_result,
    made_by_us,
    newest_first,
    region_of_result,
    results_of,
    run_of,
)

_WITH_COLOR_BAR = (BLUR_MAP, DEFOCUS, CONFIDENCE, DEPTH, BEST_FOCUS, HEIGHT, FOCUS_CONFIDENCE)

_PICTURES = (ALL_IN_FOCUS, REFOCUSED)

OUTLINE = 2
"""How wide the outline of a mask is inside of it, in px; a wider one takes napari long to draw."""


def add_results(
    viewer: ViewerModel, results: list[LayerDataTuple], *, keep_earlier: bool = False
) -> list[Layer]:
    """Put results into a viewer; those of an earlier run on the same layer are updated or kept.

    From then on the viewer tells the blur under the cursor, see `cursor_text`.

    Parameters
    ----------
    viewer : napari.components.ViewerModel or napari.Viewer
    results : list of LayerDataTuple
        From `result_layers` and other modules that make them.
    keep_earlier : bool, optional
        If true, earlier results stay as they are, and all new ones get the same number after
        their names: "leaf blur (px) 2", "leaf confidence 2".

    Returns
    -------
    list of napari.layers.Layer
        The layers that hold the results now. An updated layer keeps the colours, the
        opacity and the visibility that its user gave it, and the contrast limits, too, if
        their range is the same. Of several earlier results the newest is updated.

    Examples
    --------
    >>> import numpy as np
    >>> from napari.components import ViewerModel
    >>> viewer = ViewerModel()
    >>> made = {"napari_defocus": {"result": "blur map", "source": "leaf"}}
    >>> result = np.ones((9, 9)), {"name": "leaf blur (px)", "metadata": made}, "image"
    >>> for keep in (False, False, True):
    ...     layers = add_results(viewer, [result], keep_earlier=keep)
    >>> [layer.name for layer in viewer.layers]
    ['leaf blur (px)', 'leaf blur (px) 2']
    """
    return list(dict.fromkeys(add_results_stepwise(viewer, results, keep_earlier=keep_earlier)))


def add_results_stepwise(
    viewer: ViewerModel, results: list[LayerDataTuple], *, keep_earlier: bool = False
) -> Iterator[Layer]:
    """Do the work of `add_results` in small steps, for a window that must not stop.

    Yields
    ------
    napari.layers.Layer
        After each step, the layer that it was about.
    """
    run = 1 + max(map(run_of, viewer.layers), default=0)
    results = [_of_run(result, run) for result in results]
    if keep_earlier:
        results = _with_free_names(viewer.layers, results)
    for result in results:
        yield from _showing(viewer, *result)
    _follow_names(viewer, results)
    show_under_cursor(viewer)


def _follow_names(viewer: ViewerModel, results: list[LayerDataTuple]) -> None:
    sources = {keywords["metadata"][METADATA_KEY].get("source") for _, keywords, _ in results}
    for layer in viewer.layers:
        if layer.name in sources and made_by_us(layer) is None:
            rename_with(viewer, layer)


def _of_run(result: LayerDataTuple, run: int) -> LayerDataTuple:
    data, keywords, kind = result
    made = {**keywords["metadata"][METADATA_KEY], RUN: run}
    metadata = {**keywords["metadata"], METADATA_KEY: made}
    return LayerDataTuple((data, {**keywords, "metadata": metadata}, kind))


def _with_free_names(layers: LayerList, results: list[LayerDataTuple]) -> list[LayerDataTuple]:
    """Return results whose names no layer has: all with the same number, or all with none."""
    taken = {layer.name for layer in layers}
    numbered = (
        [_numbered(keywords["name"], number) for _, keywords, _ in results] for number in count(1)
    )
    names = next(names for names in numbered if taken.isdisjoint(names))
    return [
        LayerDataTuple((data, {**keywords, "name": name}, kind))
        for name, (data, keywords, kind) in zip(names, results, strict=True)
    ]


def _numbered(name: str, number: int) -> str:
    return name if number == 1 else f"{name} {number}"


def _showing(
    viewer: ViewerModel, data: Any, keywords: dict[str, Any], kind: str
) -> Iterator[Layer]:
    layer = _earlier_result(viewer.layers, keywords)
    if layer is not None and _is_of_stored_stack(layer, keywords):
        layer = None
    if layer is not None and not _can_hold(layer, keywords):
        viewer.layers.remove(layer)
        layer = None
    if layer is None:
        [free] = _with_free_names(viewer.layers, [LayerDataTuple((data, keywords, kind))])
        layer = Layer.create(*free)
        if _is_mask_on_map(viewer, layer):
            layer.contour, layer.opacity = OUTLINE, 1.0
        layer = viewer.add_layer(layer)
        _share_colors(viewer, layer)
        _hide_what_it_covers(viewer, layer)
        if made_by_us(layer) in _WITH_COLOR_BAR:
            yield layer
            show_color_bar(layer)
        yield layer
        return
    if _is_plane_of(layer, data, keywords):
        _set_plane(layer, data, keywords)
        yield layer
        return
    _set_data(layer, data, keywords)
    move_to(layer, {name: keywords[name] for name in PLACEMENT if name in keywords})
    layer.metadata = {**layer.metadata, **keywords["metadata"]}
    limits = keywords.get("contrast_limits")
    if limits is not None and tuple(layer.contrast_limits_range) != limits:
        layer.contrast_limits_range = limits
        layer.contrast_limits = limits
        _share_colors(viewer, layer)
    yield layer


def _share_colors(viewer: ViewerModel, layer: Layer) -> None:
    """Let the map of a part have the colours of the whole map on which it lies, if they reach."""
    if made_by_us(layer) != BLUR_MAP or not region_of_result(layer):
        return
    whole = layer_of_result(viewer.layers, BLUR_MAP, layer.metadata[METADATA_KEY]["source"], "")
    if whole is not None and whole.contrast_limits[1] > layer.contrast_limits[1]:
        layer.contrast_limits_range = whole.contrast_limits_range
        layer.contrast_limits = whole.contrast_limits


def _hide_what_it_covers(viewer: ViewerModel, layer: Layer) -> None:
    """Hide maps below a new picture that covers them: their colour bars would lie on it."""
    if made_by_us(layer) not in _PICTURES or region_of_result(layer):
        return
    source = layer.metadata[METADATA_KEY].get("source")
    for result in _WITH_COLOR_BAR:
        for covered in results_of(viewer.layers, result, source):
            covered.visible = False


def show_color_bar(layer: Layer) -> None:
    """Show what the colours mean, and the layer's name, with its unit, beside it.

    Maps that are often shown together have their bars in different corners: side by side in one,
    their names would be wider than small windows.
    """
    corner = "top_left" if made_by_us(layer) in (DEFOCUS, DEPTH) else "top_right"
    corner = "bottom_right" if region_of_result(layer) else corner
    for overlay in (layer.colorbar, layer.name_overlay):
        overlay.position = corner
        overlay.visible = True


def move_to_top(viewer: ViewerModel, layer: Layer) -> None:
    """Let no other layer lie above one."""
    if viewer.layers[-1] != layer:
        viewer.layers.move(viewer.layers.index(layer), len(viewer.layers))


def _can_hold(layer: Layer, keywords: dict[str, Any]) -> bool:
    """Tell whether a layer can get data of this kind; napari fixes it when it makes the layer."""
    return all(
        getattr(layer, kind, False) == keywords.get(kind, False) for kind in ("rgb", "multiscale")
    )


def _is_of_stored_stack(layer: Layer, keywords: dict[str, Any]) -> bool:
    """Tell whether a layer has a stack on the disk, and these are results of a single plane.

    Nothing is written into a store; the results of one plane do not replace those of all.
    """
    held, made = layer.metadata[METADATA_KEY], keywords["metadata"][METADATA_KEY]
    return STORE in held and PLANES in held and PLANES not in made


def _is_mask_on_map(viewer: ViewerModel, layer: Layer) -> bool:
    """Tell whether a layer is a mask whose area would hide a blur map."""
    source = layer.metadata[METADATA_KEY].get("source")
    maps = results_of(viewer.layers, BLUR_MAP, source)
    return made_by_us(layer) == IN_FOCUS and any(each.visible for each in maps)


def prepare_napari() -> None:
    """Load what layers and their labels need: better before work begins than amidst it."""
    import napari_defocus.likelihood.estimation  # noqa: F401

    Labels(np.zeros((2, 2), np.uint8), features={"index": [0, 1]})


def _is_plane_of(layer: Layer, data: Any, keywords: dict[str, Any]) -> bool:
    """Tell whether a layer holds results of a whole stack, and these are those of one plane."""
    at = keywords["metadata"][METADATA_KEY].get(AT, ())
    if not isinstance(layer.data, np.ndarray) or PLANES not in layer.metadata[METADATA_KEY]:
        return False
    same = layer.data.ndim == data.ndim == len(at)
    return same and all(
        now == new if n is None else new == 1 and n < now
        for now, new, n in zip(layer.data.shape, data.shape, at, strict=True)
    )


def _set_plane(layer: Layer, data: NDArray[Any], keywords: dict[str, Any]) -> None:
    """Renew one plane of the results of a stack; the others stay."""
    at = keywords["metadata"][METADATA_KEY][AT]
    index = tuple(slice(None) if n is None else slice(n, n + 1) for n in at)
    layer.data[index] = data
    _emit_data(layer)


def _set_data(layer: Layer, data: Any, keywords: dict[str, Any]) -> None:
    if isinstance(layer, Surface):
        # Colours of another number of vertices would not fit the new data.
        layer.vertex_colors = None
        layer.data = data
        layer.vertex_colors = keywords.get("vertex_colors")
    elif isinstance(layer.data, np.ndarray) and _alike(layer.data, data):
        if not np.array_equal(layer.data, data, equal_nan=data.dtype.kind == "f"):
            # Other data of the same shape would make napari build the picture anew.
            layer.data[...] = data
            _emit_data(layer)
    else:
        layer.data = data


def _emit_data(layer: Layer) -> None:
    """Draw a layer whose data were changed in place, and tell whoever listens."""
    layer.refresh(extent=False)
    # At an event "data", napari would make the shaders of labels anew.
    (layer.events.paint if isinstance(layer, Labels) else layer.events.data)(value=None)


def _alike(now: NDArray[Any], data: Any) -> bool:
    """Tell whether data can be put into an array; what is on the disk stays there."""
    same = isinstance(data, np.ndarray) and now.shape == data.shape and now.dtype == data.dtype
    return bool(same and now.flags.writeable)


def _earlier_result(layers: LayerList, keywords: dict[str, Any]) -> Layer | None:
    """Find the newest layer of that name, with any number, unless it is somebody else's work."""
    made, name = keywords["metadata"][METADATA_KEY], re.escape(keywords["name"])
    found = [
        layer
        for layer in layers
        if made_by_us(layer) == made["result"] and re.fullmatch(rf"{name}( \d+)?", layer.name)
    ]
    return next(iter(newest_first(found)), None)
