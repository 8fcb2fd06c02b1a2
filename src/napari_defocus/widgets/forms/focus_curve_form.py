"""The fields of the focus curve: which stack, what is in focus in it, along which slider."""

from collections.abc import Callable
from typing import Any

from magicgui.widgets import ComboBox, FloatSpinBox, Widget
from napari.components import ViewerModel
from napari.layers import Image, Labels, Layer

from napari_defocus.settings import USUAL_THRESHOLD
from napari_defocus.widgets.display.blur_map_stack import (
    BlurMapStack,
    confidence_of,
    mask_of,
    may_be_mask_of,
    may_have_curve,
    slider_names,
)
from napari_defocus.widgets.layers.result_metadata import BLUR_MAP, made_by_us


class FocusCurveForm:
    """The choice of a stack of blur maps, and what a curve of it shows.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel
    read, draw : callable
        Called when the stack must be read again, and when only another part of what was read
        is asked for.
    """

    def __init__(
        self, napari_viewer: ViewerModel, read: Callable[[], None], draw: Callable[[], None]
    ) -> None:
        self._viewer = napari_viewer
        self._read = read
        self._usual_mask = True
        self.blur_maps = ComboBox(
            name="blur_maps",
            label="blur maps",
            choices=self._stacks,
            nullable=True,
            tooltip="A stack of blur maps in px, such as the blur map of all planes of a stack. "
            "Ours is taken by itself; any other stack of floats has to be chosen.",
        )
        self.mask = ComboBox(
            name="mask",
            label="in focus by",
            choices=self._masks,
            tooltip="What counts as in focus: what the map says is blurred by no more than the "
            "radius below, or what a stack of labels marks, such as the in-focus mask.",
        )
        self.threshold = FloatSpinBox(
            name="curve_threshold",
            label="in focus up to (px)",
            value=USUAL_THRESHOLD,
            min=0.0,
            max=20.0,
            step=0.1,
            tooltip="The widest blur of the map that still counts as in focus. Masks know by "
            "themselves what is in focus.",
        )
        self.along = ComboBox(
            name="along",
            label="along",
            choices=self._sliders,
            tooltip="The slider that the curve runs along; the others stay where they are.",
        )
        self.mask.changed.connect(lambda _: self._on_mask())
        self.threshold.changed.connect(lambda _: read())
        self.along.changed.connect(lambda _: draw())

    def fields(self) -> list[Widget]:
        """Return all fields, in order."""
        return [self.blur_maps, self.mask, self.threshold, self.along]

    def _stacks(self, _: Any) -> list[Image]:
        """Return the stacks that may hold blur maps: our own first, the newest first."""
        stacks = [layer for layer in reversed(self._viewer.layers) if may_have_curve(layer)]
        return sorted(stacks, key=lambda layer: made_by_us(layer) != BLUR_MAP)

    def _masks(self, _: Any) -> list[tuple[str, Labels | None]]:
        labels = [
            (f"labels: {layer.name}", layer)
            for layer in self._viewer.layers
            if may_be_mask_of(layer, self.layer)
        ]
        return [("radius of the map", None), *labels]

    def _sliders(self, _: Any) -> list[tuple[str, int]]:
        return [(name, slider) for slider, name in enumerate(self.names())]

    @property
    def layer(self) -> Image | None:
        """The chosen stack."""
        return self.blur_maps.value

    @property
    def slider(self) -> int:
        """Which one of the stack's sliders the curve runs along."""
        return int(self.along.value or 0)

    def names(self) -> list[str]:
        """Return what the stack's sliders are called."""
        return [] if self.layer is None else slider_names(self.layer)

    def choose_usual(self) -> None:
        """Choose a stack of blur maps of ours if none is chosen, the active one before others.

        Only once the fields are in a form.
        """
        ours = [layer for layer in self._stacks(None) if made_by_us(layer) == BLUR_MAP]
        if self.layer is None and ours:
            active = self._viewer.layers.selection.active
            self.blur_maps.value = active if active in ours else ours[0]

    def begin(self) -> None:
        """Begin with another stack: the masks made along with it, its last slider."""
        self._usual_mask = True
        self._follow_mask()
        with self.along.changed.blocked():
            self.along.reset_choices()
            if self.names():
                self.along.value = len(self.names()) - 1
        self.along.visible = len(self.names()) > 1

    def _follow_mask(self) -> None:
        """Choose the masks that were made along with the stack, unless others were chosen."""
        with self.mask.changed.blocked():
            self.mask.reset_choices()
            if self._usual_mask and self.layer is not None:
                self.mask.value = mask_of(self._viewer, self.layer)
        self.threshold.enabled = self.mask.value is None

    def _on_mask(self) -> None:
        self._usual_mask = False
        self.threshold.enabled = self.mask.value is None
        self._read()

    def asked(self) -> tuple[BlurMapStack, list[Layer]] | None:
        """Return what shall be read now, and the layers that it is in; None without a stack."""
        self.blur_maps.reset_choices()
        self.choose_usual()
        self._follow_mask()
        layer = self.layer
        if layer is None:
            return None
        mask, confidence = self.mask.value, confidence_of(self._viewer, layer)
        used = [found for found in (layer, mask, confidence) if found is not None]
        return BlurMapStack.of(layer, mask, confidence, self.threshold.value), used
