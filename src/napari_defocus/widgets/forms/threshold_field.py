"""Up to which blur things are in focus: a slider, or what is found from the picture."""

from typing import Literal

from magicgui.widgets import CheckBox

from napari_defocus.psf import AUTO
from napari_defocus.settings import USUAL_THRESHOLD, MapSettings, MaskSettings
from napari_defocus.widgets.forms.slider_field import SliderField


class ThresholdFields:
    """A slider in px, and the choice to have it found; whoever moves the slider chooses not to.

    Attributes
    ----------
    slider : SliderField
        Shows what was found, too.
    found : magicgui.widgets.CheckBox
    """

    def __init__(self) -> None:
        self.slider = SliderField(
            name="threshold",
            label="in focus up to (px)",
            value=USUAL_THRESHOLD,
            largest=MapSettings.max_radius,
            step=0.1,
            follows=True,
            tooltip="The widest blur that still counts as in focus: its radius in pixels, as the "
            "map shows it. Changing it does not analyse the picture again.",
        )
        self.found = CheckBox(
            name="threshold_found",
            text="found from the picture",
            value=MaskSettings.threshold == AUTO,
            tooltip="Let the picture say up to which blur it is in focus: its sharpest places, and "
            "a blur above them that few places have. The slider shows what was found, and moving "
            "it takes your number instead.",
        )
        self._showing = False
        self.slider.number.changed.connect(lambda _: self._on_number())

    @property
    def threshold(self) -> float | Literal["auto"]:
        """What `MaskSettings` take."""
        return "auto" if self.found.value else self.slider.value

    @threshold.setter
    def threshold(self, threshold: float | Literal["auto"]) -> None:
        if not isinstance(threshold, str):
            self.slider.value = min(threshold, self.slider.largest)
        self.found.value = isinstance(threshold, str)

    def show_found(self, threshold: float) -> None:
        """Let the slider show what was found from the picture."""
        self._showing = True
        try:
            self.slider.value = min(threshold, self.slider.largest)
        finally:
            self._showing = False

    def _on_number(self) -> None:
        if not self._showing:
            self.found.value = False
