"""A number that says where one of napari's sliders stands, and moves it."""

from magicgui.widgets import SpinBox
from napari.components import Dims
from napari.layers import Image

from napari_defocus.widgets.layers.image_layers import finest, move_slider, shown_position


class SliderNumber(SpinBox):
    """Which channel, time or the like is taken: what napari shows.

    Parameters
    ----------
    name : str
        What lies along the slider, such as "channel".
    dims : napari.components.Dims
        The sliders of the viewer.
    """

    def __init__(self, name: str, dims: Dims) -> None:
        super().__init__(
            name=name,
            label=name,
            min=0,
            tooltip=f"Which {name} is taken, counted from 0. It goes with napari's slider.",
        )
        self._dims = dims
        self._layer: Image | None = None
        self._axis = 0
        self.changed.connect(self._move)

    def follow(self, layer: Image | None, axis: int | None) -> None:
        """Show where a slider stands.

        Parameters
        ----------
        layer : napari.layers.Image or None
        axis : int or None
            Of the layer; None if it has none, and the field is hidden then.
        """
        self._layer = None
        self.visible = layer is not None and axis is not None
        if layer is None or axis is None:
            return
        self.max = finest(layer).shape[axis] - 1
        self.value = int(shown_position(layer, self._dims)[axis].clip(0, self.max))
        # From here on, a change is somebody's wish.
        self._layer, self._axis = layer, axis

    def _move(self, number: int) -> None:
        if self._layer is not None:
            move_slider(self._layer, self._dims, self._axis, number)
