"""What the runs of a panel have left on each picture, and whether it is still there: no Qt."""

import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

from napari.components import ViewerModel
from napari.layers import Image, Layer

from napari_defocus.widgets.display.dock_state import DockState, Measured
from napari_defocus.widgets.display.view_state import view_state
from napari_defocus.widgets.display.window_outline import PROBE
from napari_defocus.widgets.layers.image_layers import (
    NotAnalysableError,
    Plane,
    finest,
    shown_plane,
    unwrapped,
)
from napari_defocus.widgets.layers.result_metadata import made_by_us


@dataclass(frozen=True, eq=False)
class _Found:
    run: int
    lines: str
    layers: tuple[weakref.ref[Layer], ...]
    plane: Plane
    all_planes: bool
    asked: Any


class FoundResults:
    """What was found on the pictures of a viewer, the last of each."""

    def __init__(self) -> None:
        self._of: weakref.WeakKeyDictionary[Layer, _Found] = weakref.WeakKeyDictionary()
        self._runs = count(1)

    def note(
        self, plane: Plane, lines: str, layers: Sequence[Layer], asked: Any, *, all_planes: bool
    ) -> None:
        """Note what a run has left.

        Parameters
        ----------
        plane : Plane
            What was measured.
        lines : str
            What there is to say about it.
        layers : sequence of Layer
            Where it is shown.
        asked : object
            What the form asked for; equal to what it asks for later if nothing was changed.
        all_planes : bool
            Whether the other planes of the stack were measured, too.
        """
        image = plane.layer()
        if image is not None:
            there = tuple(weakref.ref(unwrapped(layer)) for layer in layers)
            self._of[image] = _Found(next(self._runs), lines, there, plane, all_planes, asked)

    def layers_of(self, image: Image | None, viewer: ViewerModel) -> list[Layer]:
        """Return the layers of the last run on a picture that are still in the viewer."""
        found = None if image is None else self._of.get(unwrapped(image))
        living = [] if found is None else [reference() for reference in found.layers]
        return [layer for layer in living if layer is not None and layer in viewer.layers]

    def state(
        self,
        viewer: ViewerModel,
        image: Image | None,
        asked: Any,
        *,
        all_planes: bool,
        updating: bool,
    ) -> DockState:
        """Return what is so of a viewer and a picture; `asked` is what the form asks for now."""
        image = unwrapped(image)
        common: dict[str, Any] = {
            "relief": view_state(viewer) is not None,
            "results": _results_in(viewer),
        }
        if image is None or image not in viewer.layers:
            return DockState(others=len(viewer.layers) > 0, **common)
        found = self._of.get(image)
        return DockState(
            picture=image.name,
            count=_count(image, viewer),
            plane=_position(image, viewer),
            all_planes=all_planes,
            updating=updating,
            measured=None if found is None else self._measured(found, viewer, image, asked),
            changed=found is not None and not found.plane.is_current(viewer.layers),
            **common,
        )

    def _measured(self, found: _Found, viewer: ViewerModel, image: Image, asked: Any) -> Measured:
        of_one = found.plane.sliders and not found.all_planes
        return Measured(
            lines=found.lines,
            run=found.run,
            there=bool(self.layers_of(image, viewer)),
            plane=_numbers(found.plane) if of_one else None,
            outdated=asked is not None and asked != found.asked,
        )


def _results_in(viewer: ViewerModel) -> frozenset[int]:
    return frozenset(id(layer) for layer in viewer.layers if made_by_us(layer) not in (None, PROBE))


def _count(image: Image, viewer: ViewerModel) -> int:
    """Return how many planes a picture has."""
    first, number = viewer.dims.ndim - image.ndim, 1
    for axis, length in enumerate(finest(image).shape[: image.ndim]):
        if axis + first not in viewer.dims.displayed:
            number *= length
    return int(number)


def _position(image: Image, viewer: ViewerModel) -> tuple[int, ...]:
    try:
        return _numbers(shown_plane(image, viewer.dims))
    except NotAnalysableError:
        return ()


def _numbers(plane: Plane) -> tuple[int, ...]:
    """Return where the sliders stand."""
    return tuple(at for at in plane.index if isinstance(at, int))
