"""The settings as a form: every default is read from the settings classes."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from magicgui.widgets import CheckBox, FloatSpinBox, LineEdit, PushButton, Widget

from napari_defocus.core.checks import LARGEST_SOFTNESS
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.forms.lens_form import LensForm
from napari_defocus.widgets.forms.slider_field import SliderField
from napari_defocus.widgets.forms.threshold_field import ThresholdFields
from napari_defocus.widgets.jobs.estimation import LARGEST_RADIUS

AUTOMATIC = "automatic"

_MORE = "{} More settings"

_SMOOTHNESS = (
    "How strongly neighbouring pixels are drawn to the same {what}. Higher gives larger, "
    "calmer regions; lower follows small details, and noise."
)
_COLOR_STEP = (
    "How much the colours of neighbouring pixels must differ before the {what} may change "
    "between them freely; 0 to 1, where 1 is the contrast of the picture. Lower ties its "
    "boundaries to faint edges of the picture too."
)


class SettingsForm:
    """The fields of the map's and the mask's settings.

    Parameters
    ----------
    blur_map : bool
        Whether a blur map is made, and its fields are shown.
    mask : bool
        Whether a mask is made, and its fields are shown.
    last_measured : callable
        See `LensForm`.

    Attributes
    ----------
    lens : LensForm
    max_radius, noise_variance, shot_noise, camera_softness, linear_light : magicgui widgets
        What the radii are estimated with.
    map_smoothness, map_color_sigma : magicgui widgets
        What the blur map is labelled with.
    confidence, min_confidence : magicgui widgets
        Whether the confidence is shown, and below which the map is covered.
    threshold_fields : ThresholdFields
        Up to which blur the mask is in focus; `threshold` is its slider.
    leave_unknown : magicgui.widgets.CheckBox
        Whether what says nothing itself is left.
    mask_smoothness, mask_color_sigma : SliderField
        What the mask is segmented with.
    more : magicgui.widgets.PushButton
        Shows and hides the fields that few people need.
    """

    def __init__(self, *, blur_map: bool, mask: bool, last_measured: Callable[[], str]) -> None:
        self._blur_map = blur_map
        self._mask = mask
        self._others = MapSettings()
        self.lens = LensForm(last_measured)
        self.max_radius = _max_radius_field()
        self.noise_variance = _noise_variance_field()
        self.shot_noise = _shot_noise_field()
        self.camera_softness = _camera_softness_field()
        self.linear_light = _linear_light_field()
        self.map_smoothness = _smoothness_field("map", "radius", MapSettings.smoothness)
        self.map_color_sigma = _color_sigma_field("map", "radius", MapSettings.color_sigma)
        self.confidence = _confidence_field()
        self.min_confidence = _min_confidence_field()
        self.threshold_fields = ThresholdFields()
        self.threshold = self.threshold_fields.slider
        self.leave_unknown = _leave_unknown_field()
        self.mask_smoothness = _smoothness_field("mask", "answer", MaskSettings.smoothness)
        self.mask_color_sigma = _color_sigma_field("mask", "answer", MaskSettings.color_sigma)
        self.more = PushButton(name="more", text=_MORE.format("▸"))
        self._more_shown = False
        self._unneeded: list[Widget] = []
        self.max_radius.changed.connect(lambda largest: self._limit_threshold(largest))
        self.more.changed.connect(lambda _: self.show_more(not self._more_shown))
        self.shot_noise.changed.connect(lambda on: _enable(self.noise_variance, not on))
        self.confidence.changed.connect(lambda on: _enable(self.min_confidence, on))

    def fields(self) -> list[Widget]:
        """Return the fields of these settings, from top to bottom."""
        return [*self.lens.fields(), *self.main_fields(), *self.more_fields()]

    def all_fields(self) -> list[Any]:
        """Return all that `map_settings` and `mask_settings` read, shown or not."""
        asked: list[Any] = [
            self.max_radius,
            self.noise_variance,
            self.shot_noise,
            self.camera_softness,
        ]
        weights = [field.number for field in self.weights()]
        asked += [self.threshold_fields.found, self.leave_unknown]
        return [*self.lens.fields(), *asked, self.linear_light, *weights]

    def main_fields(self) -> list[Widget]:
        """Return the fields below the lens' that are always shown."""
        shown: list[Widget] = [self.max_radius]
        if self._mask:
            shown += [self.threshold, self.threshold_fields.found]
        if self._blur_map:
            shown += [self.confidence, self.min_confidence]
        return shown

    def more_fields(self) -> list[Widget]:
        """Return the fields that few people need."""
        fields: list[Widget] = [self.noise_variance, self.shot_noise]
        fields += [self.camera_softness, self.linear_light]
        if self._blur_map:
            fields += [self.map_smoothness, self.map_color_sigma]
        if self._mask:
            fields += [self.leave_unknown, self.mask_smoothness, self.mask_color_sigma]
        return fields

    def weights(self) -> list[SliderField]:
        """Return the fields that only label again what is known already."""
        mapped = [self.map_smoothness, self.map_color_sigma] * self._blur_map
        masked = [self.threshold, self.mask_smoothness, self.mask_color_sigma] * self._mask
        return mapped + masked

    def show_more(self, shown: bool) -> None:
        """Show or hide the fields that few people need; only once they are in a form."""
        self._more_shown = shown
        self.more.text = _MORE.format("▾" if shown else "▸")
        for field in self.more_fields():
            field.visible = shown and field not in self._unneeded

    def show_needed(self, *, estimating: bool, lens: bool, more: Sequence[Widget] = ()) -> None:
        """Hide what only an estimation needs, if there is none; only once it is in a form.

        Parameters
        ----------
        estimating : bool
            Whether a map is estimated.
        lens : bool
            Whether the lens has to be chosen.
        more : sequence of widgets, optional
            Those of `more_fields` that are needed even if no map is estimated.
        """
        fields = self.more_fields()
        self._unneeded = [field for field in fields if not (estimating or field in more)]
        self.max_radius.visible = estimating
        self.lens.show(lens)
        self.more.visible = len(self._unneeded) < len(fields)
        self.show_more(self._more_shown)
        _enable(self.noise_variance, not (estimating and self.shot_noise.value))

    def _limit_threshold(self, largest: float) -> None:
        self.threshold.largest = largest

    def map_settings(self) -> MapSettings:
        """Return what the fields say about the estimation and the map.

        Raises
        ------
        ValueError
            If the noise variance is no number, or the lens' file is missing.
        """
        return replace(
            self._others,
            psf=self.lens.text(),
            max_radius=self.max_radius.value,
            noise_variance=None if self.shot_noise.value else self.given_noise_variance(),
            shot_noise=self.shot_noise.value,
            camera_softness=self.camera_softness.value,
            linearize="srgb" if self.linear_light.value else None,
            smoothness=self.map_smoothness.value,
            color_sigma=self.map_color_sigma.value,
        )

    def take(self, estimation: MapSettings, mask: MaskSettings) -> None:
        """Fill the fields.

        What has no field here (window, stride, mode) is kept, too.
        """
        self._others = estimation
        self.lens.take(estimation.psf)
        self.max_radius.value = min(estimation.max_radius, LARGEST_RADIUS)
        known = estimation.noise_variance
        self.noise_variance.value = "" if known is None else f"{known:g}"
        self.shot_noise.value = estimation.shot_noise
        self.camera_softness.value = estimation.camera_softness
        self.linear_light.value = estimation.linearize == "srgb"
        self.map_smoothness.value = estimation.smoothness
        self.map_color_sigma.value = estimation.color_sigma
        self.threshold_fields.threshold = mask.threshold
        self.leave_unknown.value = mask.unknown == "leave"
        self.mask_smoothness.value = mask.smoothness
        self.mask_color_sigma.value = mask.color_sigma

    def given_noise_variance(self) -> float | None:
        """Return the noise variance that was typed, None if it is to be found.

        Raises
        ------
        ValueError
            If it is no number.
        """
        return number_or_none(self.noise_variance.value, "noise variance", "1e-5")

    def mask_settings(self) -> MaskSettings | None:
        """Return what the fields say about the mask, None if none is made."""
        if not self._mask:
            return None
        return MaskSettings(
            threshold=self.threshold_fields.threshold,
            smoothness=self.mask_smoothness.value,
            color_sigma=self.mask_color_sigma.value,
            unknown="leave" if self.leave_unknown.value else "fill",
        )


def _max_radius_field() -> FloatSpinBox:
    return FloatSpinBox(
        name="max_radius",
        label="largest radius (px)",
        value=MapSettings.max_radius,
        min=1.0,
        max=LARGEST_RADIUS,
        step=0.5,
        tooltip="The widest blur that is looked for, as the radius of the disc that a point "
        "becomes, in pixels of this picture. Small pictures cannot tell as much: those with a "
        "shorter side below 656 pixels are searched up to 32, below 328 up to 16, below 164 up to "
        "8. "
        "Of a lens that is no disc, it is the radius of the disc that blurs as far: twice the "
        "standard deviation of a Gaussian.",
    )


def _noise_variance_field() -> LineEdit:
    return automatic_field(
        "noise_variance",
        "noise variance",
        MapSettings.noise_variance,
        "Variance of the picture's noise, for intensities from 0 to 1, such as 1e-5. "
        "Leave it empty to have it found from the picture. If flat regions look sharp, "
        "raise it; if textured regions look blurred, lower it.",
    )


def automatic_field(name: str, label: str, value: float | None, tooltip: str) -> LineEdit:
    """Return a field for a number that is found if none is given, see `number_or_none`."""
    text = "" if value is None else f"{value:g}"
    field = LineEdit(name=name, label=label, value=text, tooltip=tooltip)
    field.native.setPlaceholderText(AUTOMATIC)
    return field


def _shot_noise_field() -> CheckBox:
    return CheckBox(
        name="shot_noise",
        text="noise grows with intensity",
        value=MapSettings.shot_noise,
        tooltip="For pictures from few photons: bright places have more noise than dark ones. "
        "Raw and microscope pictures mostly say so themselves; this is for those that do not.",
    )


def _camera_softness_field() -> FloatSpinBox:
    return FloatSpinBox(
        name="camera_softness",
        label="camera softness (px)",
        value=MapSettings.camera_softness,
        min=0.0,
        max=LARGEST_SOFTNESS,
        step=0.05,
        tooltip="How blurred the camera itself is, as the standard deviation of a Gaussian: "
        "optics, pixels, demosaicking. Radii are the defocus beyond it. Raise it if what is in "
        "focus reads 1 to 2 px; microscopes with small pixels have 0.6 to 1.3 px.",
    )


def _linear_light_field() -> CheckBox:
    return CheckBox(
        name="linear_light",
        text="linear light (sRGB)",
        value=MapSettings.linearize == "srgb",
        tooltip="For photographs that a camera made for screens (JPEG, PNG): undo their sRGB "
        "encoding first, as blur mixes light. Leave it off for raw and scientific pictures.",
    )


def _confidence_field() -> CheckBox:
    return CheckBox(
        name="confidence",
        text="confidence layer",
        value=True,
        tooltip="Add a layer that says how sure the blur map is at every pixel, from 0 to 1: "
        "the probability that it is right to half a pixel. It is hidden at first.",
    )


def _min_confidence_field() -> FloatSpinBox:
    return FloatSpinBox(
        name="min_confidence",
        label="veil below confidence",
        value=0.0,
        min=0.0,
        max=1.0,
        step=0.05,
        tooltip="Veil the pixels of the map that are less sure than this, with a "
        "labels layer that can be used as a mask. Changing it does not analyse again.",
    )


def _leave_unknown_field() -> CheckBox:
    return CheckBox(
        name="leave_unknown",
        text="leave what is not known",
        value=MaskSettings.unknown == "leave",
        tooltip="Places whose own surroundings tell no radius say nothing of focus. They "
        "are filled from around, or left, grey, as a third label (2).",
    )


def _smoothness_field(of: str, what: str, value: float) -> SliderField:
    return SliderField(
        name=f"{of}_smoothness",
        label=f"{of} smoothness",
        value=value,
        least=0.1,
        largest=100_000.0,
        step=5.0,
        follows=True,
        logarithmic=True,
        tooltip=_SMOOTHNESS.format(what=what),
    )


def _color_sigma_field(of: str, what: str, value: float) -> SliderField:
    return SliderField(
        name=f"{of}_color_sigma",
        label=f"{of} colour step",
        value=value,
        least=0.005,
        largest=2.0,
        step=0.01,
        follows=True,
        logarithmic=True,
        tooltip=_COLOR_STEP.format(what=what),
    )


def number_or_none(text: str, name: str, example: str) -> float | None:
    """Return the number of a field that may be empty.

    Raises
    ------
    ValueError
        If it is no number.
    """
    text = text.strip()
    if text in ("", AUTOMATIC):
        return None
    try:
        return float(text)
    except ValueError:
        raise ValueError(
            f"The {name} is “{text}”. Type a number such as {example}, "
            f"or leave it empty to have it found from the picture."
        ) from None


def _enable(field: Widget, enabled: bool) -> None:
    field.enabled = enabled
