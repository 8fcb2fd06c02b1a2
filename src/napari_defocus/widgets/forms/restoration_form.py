"""How a picture is restored, as fields: defaults are read from the settings class."""

from magicgui.widgets import CheckBox, Widget

from napari_defocus.core.checks import Linearize
from napari_defocus.settings import RestorationSettings
from napari_defocus.widgets.forms.settings_form import automatic_field, number_or_none
from napari_defocus.widgets.jobs.map_source import MapSource
from napari_defocus.widgets.jobs.restoration import Restoration
from napari_defocus.widgets.layers.image_layers import Plane


class RestorationForm:
    """The fields of a restoration."""

    def __init__(self) -> None:
        self.protect = CheckBox(
            name="protect",
            text="protect uncertain places",
            value=True,
            tooltip="Change the picture less where the blur map is not sure: a wrong blur taken "
            "away leaves ringing. It uses the map's confidence, or its confidence layer.",
        )
        self.show_left = CheckBox(
            name="show_left",
            text="show what is left as it was",
            value=False,
            tooltip="Add a layer that veils, in orange, the places that are not restored because "
            "they would get rings: its value is 1 where the picture is as it was, 0 where it is "
            "restored.",
        )
        self.tv_weight = automatic_field(
            "tv_weight",
            "smoothing",
            RestorationSettings.tv_weight,
            "How much noise is smoothed away where the blur is taken away, such as 1e-3, for "
            "intensities from 0 to 1. Leave it empty to have it found from the noise, and from how "
            "badly the picture fits its map. Higher is calmer, "
            "lower is crisper, with more noise and ringing.",
        )

    def fields(self) -> list[Widget]:
        """Return the fields, from top to bottom."""
        return [self.protect, self.tv_weight, self.show_left]

    def restoration(
        self,
        plane: Plane,
        source: MapSource,
        noise_variance: float | None,
        linearize: Linearize | None,
    ) -> Restoration:
        """Return what the fields ask for, see `settings`."""
        return Restoration(
            plane=plane,
            source=source,
            settings=self.settings(noise_variance),
            linearize=linearize,
            protect=self.protect.value,
            show_left=self.show_left.value,
        )

    def settings(self, noise_variance: float | None) -> RestorationSettings:
        """Return what the fields say.

        Raises
        ------
        ValueError
            If the smoothing is no number above 0.
        """
        tv_weight = number_or_none(self.tv_weight.value, "smoothing", "1e-3")
        if tv_weight is not None and not 0 < tv_weight < float("inf"):
            raise ValueError(
                f"The smoothing is {tv_weight:g}. Type a number above 0 such as 1e-3, or leave it "
                "empty to have it found from the picture."
            )
        return RestorationSettings(noise_variance=noise_variance, tv_weight=tv_weight)
