"""A number with a slider: napari's style leaves no room for the one that magicgui shows."""

from typing import Any

from magicgui.widgets import Container, FloatSlider, FloatSpinBox, Widget


class SliderField(Container[Widget]):
    """A slider, and beside it the number that it stands for.

    Parameters
    ----------
    name, label, tooltip : str
    value, largest : float
        What it starts with, and the end of the slider; it begins at 0.
    step : float

    Attributes
    ----------
    number : magicgui.widgets.FloatSpinBox
        Holds the value; it changes when the slider is let go.
    """

    def __init__(
        self, *, name: str, label: str, tooltip: str, value: float, largest: float, step: float
    ) -> None:
        limits: dict[str, Any] = {
            "value": value,
            "min": 0.0,
            "max": largest,
            "step": step,
            "tooltip": tooltip,
        }
        self.number = FloatSpinBox(name=name, **limits)
        self._slider = FloatSlider(readout=False, tracking=False, **limits)
        super().__init__(
            widgets=[self._slider, self.number],
            layout="horizontal",
            labels=False,
            label=label,
            tooltip=tooltip,
        )
        self.margins = (0, 0, 0, 0)
        self._slider.changed.connect(lambda value: self._on_slider(value))
        self.number.changed.connect(lambda value: self._on_number(value))

    @property
    def value(self) -> float:
        """The number."""
        return float(self.number.value)

    @value.setter
    def value(self, value: float) -> None:
        self.number.value = value

    @property
    def largest(self) -> float:
        """The end of the slider, never below the number."""
        return float(self.number.max)

    @largest.setter
    def largest(self, largest: float) -> None:
        largest = max(largest, self.value)
        self.number.max = largest
        self._slider.max = largest

    def _on_slider(self, value: float) -> None:
        self.number.value = round(value, 2)

    def _on_number(self, value: float) -> None:
        with self._slider.changed.blocked():
            self._slider.value = value
