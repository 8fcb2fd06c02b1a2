"""Results go with their picture when it is renamed: no Qt."""

import weakref
from typing import Any

from napari.components import ViewerModel
from napari.layers import Layer

from napari_defocus.widgets.layers.image_layers import unwrapped
from napari_defocus.widgets.layers.result_metadata import METADATA_KEY, made_by_us


class _Renaming:
    """A callback of a picture's name, which lives as long as the picture."""

    def __init__(self, viewer: ViewerModel, picture: Layer) -> None:
        self._viewer = weakref.ref(viewer)
        self._name = picture.name

    def __call__(self, event: Any) -> None:
        viewer, before, now = self._viewer(), self._name, event.source.name
        self._name = now
        if viewer is None:
            return
        for layer in viewer.layers:
            made = layer.metadata.get(METADATA_KEY) if made_by_us(layer) else None
            if made and made.get("source") == before:
                layer.metadata = {**layer.metadata, METADATA_KEY: {**made, "source": now}}
                if layer.name.startswith(before):
                    layer.name = now + layer.name.removeprefix(before)


def rename_with(viewer: ViewerModel, picture: Layer) -> None:
    """Let the results of a picture be renamed when it is, from now on; once or often is one."""
    viewer, picture = unwrapped(viewer), unwrapped(picture)
    if not any(isinstance(each, _Renaming) for each in picture.events.name.callbacks):
        picture.events.name.connect(_Renaming(viewer, picture))
