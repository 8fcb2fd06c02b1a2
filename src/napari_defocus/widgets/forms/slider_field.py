"""A number with a slider: napari's style leaves no room for the one that magicgui shows."""

import math

from magicgui.widgets import Container, FloatSlider, FloatSpinBox, Widget

_LOGARITHMIC_STEP = 0.01


class SliderField(Container[Widget]):
    """A slider, and beside it the number that it stands for.

    Parameters
    ----------
    name, label, tooltip : str
    value, largest : float
        What it starts with, and the end of the slider.
    step : float
        Of the number.
    least : float, optional
        The beginning of the slider.
    follows : bool, optional
        Whether the number changes while the slider is moved, or when it is let go.
    logarithmic : bool, optional
        Whether equal ways of the slider are equal factors; `least` is above 0 then, but the
        number may be 0.

    Attributes
    ----------
    number : magicgui.widgets.FloatSpinBox
        Holds the value.
    slider : magicgui.widgets.FloatSlider
        Its value, or the logarithm of it.
    """

    def __init__(
        self,
        *,
        name: str,
        label: str,
        tooltip: str,
        value: float,
        largest: float,
        step: float,
        least: float = 0.0,
        follows: bool = False,
        logarithmic: bool = False,
    ) -> None:
        self._logarithmic = logarithmic
        self._least = least
        self.number = FloatSpinBox(
            name=name,
            value=value,
            min=0.0 if logarithmic else least,
            max=largest,
            step=step,
            tooltip=tooltip,
        )
        self.slider = FloatSlider(
            value=self._place(value),
            min=self._place(least),
            max=self._place(largest),
            step=_LOGARITHMIC_STEP if logarithmic else step,
            tooltip=tooltip,
            readout=False,
            tracking=follows,
        )
        super().__init__(
            widgets=[self.slider, self.number],
            layout="horizontal",
            labels=False,
            label=label,
            tooltip=tooltip,
        )
        self.margins = (0, 0, 0, 0)
        self.slider.changed.connect(lambda value: self._on_slider(value))
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
        self.slider.max = self._place(largest)

    def _place(self, value: float) -> float:
        """Return where a value is on the slider."""
        return math.log10(max(value, self._least)) if self._logarithmic else value

    def _on_slider(self, place: float) -> None:
        self.number.value = float(f"{10**place:.3g}") if self._logarithmic else round(place, 2)

    def _on_number(self, value: float) -> None:
        with self.slider.changed.blocked():
            self.slider.value = self._place(value)
