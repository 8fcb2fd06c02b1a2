"""The settings as a form: every default is read from the settings classes."""

from magicgui.widgets import FloatSpinBox, LineEdit, Widget

from napari_defocus.settings import MapSettings, MaskSettings

AUTOMATIC = "automatic"

_SMOOTHNESS = (
    "How strongly neighbouring pixels are drawn to the same {what}. Higher gives larger, "
    "calmer regions; lower follows small details, and noise."
)
_COLOR_STEP = (
    "How much the colours of neighbouring pixels must differ before the {what} may change "
    "between them freely; 0 to 1, where 1 is the step from black to white. Lower ties its "
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

    Attributes
    ----------
    max_radius, noise_variance : magicgui widgets
        What the radii are estimated with.
    map_smoothness, map_color_sigma : magicgui widgets
        What the blur map is labelled with.
    threshold, mask_smoothness, mask_color_sigma : magicgui widgets
        What the mask is segmented with.
    """

    def __init__(self, *, blur_map: bool, mask: bool) -> None:
        self._blur_map = blur_map
        self._mask = mask
        self.max_radius = _max_radius_field()
        self.noise_variance = _noise_variance_field()
        self.map_smoothness = _smoothness_field("map", "radius", MapSettings.smoothness)
        self.map_color_sigma = _color_sigma_field("map", "radius", MapSettings.color_sigma)
        self.threshold = _threshold_field()
        self.mask_smoothness = _smoothness_field("mask", "answer", MaskSettings.smoothness)
        self.mask_color_sigma = _color_sigma_field("mask", "answer", MaskSettings.color_sigma)

    def fields(self) -> list[Widget]:
        """Return the fields that are shown, from top to bottom."""
        shown: list[Widget] = [self.max_radius, self.noise_variance]
        if self._blur_map:
            shown += [self.map_smoothness, self.map_color_sigma]
        if self._mask:
            shown += [self.threshold, self.mask_smoothness, self.mask_color_sigma]
        return shown

    def map_settings(self) -> MapSettings:
        """Return what the fields say about the estimation and the map.

        Raises
        ------
        ValueError
            If the noise variance is no number.
        """
        return MapSettings(
            max_radius=self.max_radius.value,
            noise_variance=_number_or_none(self.noise_variance.value),
            smoothness=self.map_smoothness.value,
            color_sigma=self.map_color_sigma.value,
        )

    def mask_settings(self) -> MaskSettings | None:
        """Return what the fields say about the mask, None if none is made."""
        if not self._mask:
            return None
        return MaskSettings(
            threshold=self.threshold.value,
            smoothness=self.mask_smoothness.value,
            color_sigma=self.mask_color_sigma.value,
        )


def _max_radius_field() -> FloatSpinBox:
    return FloatSpinBox(
        name="max_radius",
        label="largest radius (px)",
        value=MapSettings.max_radius,
        min=1.0,
        max=20.0,
        step=0.5,
        tooltip="The widest blur that is looked for, as the radius of the disc that a point "
        "becomes, in pixels of this picture. It is also the upper end of the map's colours.",
    )


def _noise_variance_field() -> LineEdit:
    field = LineEdit(
        name="noise_variance",
        label="noise variance",
        value="" if MapSettings.noise_variance is None else f"{MapSettings.noise_variance:g}",
        tooltip="Variance of the picture's noise, for intensities from 0 to 1, such as 1e-5. "
        "Leave it empty to have it found from the picture. If flat regions look sharp, "
        "raise it; if textured regions look blurred, lower it.",
    )
    field.native.setPlaceholderText(AUTOMATIC)
    return field


def _threshold_field() -> FloatSpinBox:
    return FloatSpinBox(
        name="threshold",
        label="in focus up to (px)",
        value=MaskSettings.threshold,
        min=0.0,
        max=20.0,
        step=0.1,
        tooltip="The widest blur that still counts as in focus: its radius in pixels. "
        "Changing it does not analyse the picture again.",
    )


def _smoothness_field(of: str, what: str, value: float) -> FloatSpinBox:
    return FloatSpinBox(
        name=f"{of}_smoothness",
        label=f"{of} smoothness",
        value=value,
        min=0.0,
        max=100_000.0,
        step=5.0,
        tooltip=_SMOOTHNESS.format(what=what),
    )


def _color_sigma_field(of: str, what: str, value: float) -> FloatSpinBox:
    return FloatSpinBox(
        name=f"{of}_color_sigma",
        label=f"{of} colour step",
        value=value,
        min=0.001,
        max=10.0,
        step=0.01,
        tooltip=_COLOR_STEP.format(what=what),
    )


def _number_or_none(text: str) -> float | None:
    text = text.strip()
    if text in ("", AUTOMATIC):
        return None
    try:
        return float(text)
    except ValueError:
        raise ValueError(
            f"The noise variance is “{text}”. Type a number such as 1e-5, "
            f"or leave it empty to have it found from the picture."
        ) from None
