"""The widget that finds where each pixel of a stack is in focus."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from magicgui.widgets import CheckBox, ComboBox
from napari.components import ViewerModel
from napari.layers import Image, Layer
from napari.utils.notifications import show_error, show_warning

from napari_defocus import StackAlignment
from napari_defocus.core.axes import CHOSEN_BY, known_axis
from napari_defocus.widgets.export.map_files import saving_failure
from napari_defocus.widgets.forms.alignment_fields import AlignmentFields
from napari_defocus.widgets.forms.file_dialogs import asked_where
from napari_defocus.widgets.forms.image_panel import ImagePanel
from napari_defocus.widgets.forms.settings_form import SettingsForm, automatic_field, number_or_none
from napari_defocus.widgets.forms.slider_number import SliderNumber
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs.focus_stacking import CHANNELS_ONLY, NO_PLANES, FocusStacking
from napari_defocus.widgets.layers.image_layers import NotAnalysableError, finest, shown_plane
from napari_defocus.widgets.layers.preferences import preferred_settings
from napari_defocus.widgets.layers.result_metadata import (
    ALIGNMENT,
    METADATA_KEY,
    SHARPEST,
    Results,
    layer_of_result,
)


def _choice(name: str, label: str, tooltip: str) -> ComboBox:
    choices = [("automatic", "auto"), ("always", True), ("never", False)]
    return ComboBox(name=name, label=label, choices=choices, value="auto", tooltip=tooltip)


class SharpestPlaneWidget(ImagePanel):
    """Find in which plane of a stack each pixel is in focus, and put those pixels together.

    Attributes
    ----------
    along : magicgui.widgets.ComboBox
        Along which slider the focus changes; only shown if there are several. Sliders of length
        1, and of channels, are none.
    channel, time : SliderNumber
        Which one is taken; only shown if there are several, and the focus changes along another
        slider.
    px_per_plane : magicgui.widgets.LineEdit
        By how much the blur grows from plane to plane; empty to find it.
    align, match_brightness, peak : magicgui.widgets.ComboBox
        Whether planes are laid on each other first, and made equally bright; and which plane is
        meant where two are sharp.
    alignment : AlignmentFields
        Motion that was found before, and what keeps it.
    blend : magicgui.widgets.CheckBox
        Whether planes are blended.
    also : magicgui.widgets.ComboBox
        Another stack, put together at the same positions.
    settings : SettingsForm
        Lens, noise and smoothness.
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, action="Find the sharpest plane")
        self.image.tooltip = "A stack of one scene whose planes are at equal steps of the focus."
        self.along = ComboBox(
            name="along",
            label="focus along",
            choices=self._sliders,
            tooltip="Along which slider the focus changes; the others stay where they stand.",
        )
        self.channel = SliderNumber("channel", napari_viewer.dims)
        self.time = SliderNumber("time", napari_viewer.dims)
        self.px_per_plane = automatic_field(
            "px_per_plane",
            "blur (px a plane)",
            None,
            "By how many px the radius of the blur grows from plane to plane. Leave it empty to "
            "have it found from the stack.",
        )
        self.align = _choice(
            "align",
            "align planes",
            "Lay planes that drift, turn or are magnified on the middle one first: if motion is "
            "surely there, always, or never.",
        )
        self.alignment = AlignmentFields()
        self.match_brightness = _choice(
            "match_brightness",
            "even brightness",
            "Make planes that a lamp made brighter or darker equally bright: if they surely "
            "differ, always, or never.",
        )
        self.blend = CheckBox(
            name="blend",
            text="blend planes",
            value=True,
            tooltip="Blend the planes about each position, which averages noise and has no seams. "
            "Without, each pixel is that of one plane.",
        )
        self.peak = ComboBox(
            name="peak",
            label="of two peaks",
            choices=["strongest", "first", "last"],
            tooltip="Which plane is meant where two are sharp, with blurred ones between them, as "
            "in something transparent.",
        )
        self.also = ComboBox(
            name="also",
            label="also put together",
            choices=self._others,
            nullable=True,
            tooltip="Another stack of the same planes, such as another channel: it is put together "
            "at the positions that this one tells.",
        )
        self.settings = SettingsForm(blur_map=True, mask=False, last_measured=self._last_measured)
        settings = self.settings
        self._finish_form(
            [
                self.image,
                self.region,
                self.along,
                self.channel,
                self.time,
                self.px_per_plane,
                self.align,
                *self.alignment.fields(),
                self.match_brightness,
                self.blend,
                self.peak,
                self.also,
                *settings.lens.fields(),
                settings.max_radius,
                settings.more,
                *settings.more_fields(),
            ]
        )
        settings.take(preferred_settings().map, preferred_settings().mask)
        settings.shot_noise.value = False
        settings.lens.microscope.attach(self.image)
        settings.show_needed(estimating=True, lens=True)
        settings.show_more(False)
        self.image.changed.connect(lambda _: self._on_image())
        self.along.changed.connect(lambda _: self._follow_sliders())
        self.alignment.use.changed.connect(lambda _: self._show_alignment())
        self.alignment.save_button.clicked.connect(lambda _: self.save_alignment())
        napari_viewer.layers.events.removed.connect(self._show_alignment)
        napari_viewer.dims.events.point.connect(self._follow_sliders)
        napari_viewer.dims.events.order.connect(self._on_order)
        self._choose_active()
        self._on_image()

    def _images(self, choice: Any) -> list[Image]:
        return [layer for layer in super()._images(choice) if layer.ndim > 2]

    def _others(self, choice: Any) -> list[Image]:
        return [layer for layer in self._images(choice) if layer is not self.image.value]

    def _sliders(self, _: Any) -> list[tuple[str, int]]:
        """Return the axes along which the focus may change, the most likely first.

        That is the last one that is not displayed; times come after all others.
        """
        layer = self.image.value
        axes = [axis for axis in reversed(self._long_sliders()) if self._kind(axis) != "channel"]
        axes.sort(key=lambda axis: self._kind(axis) == "time")
        return [(str(layer.axis_labels[axis]), axis) for axis in axes]

    def _long_sliders(self) -> list[int]:
        """Return the axes of the layer that are not displayed and have several positions."""
        layer = self.image.value
        if layer is None:
            return []
        first = self._viewer.dims.ndim - layer.ndim
        shown = {axis - first for axis in self._viewer.dims.displayed}
        shape = finest(layer).shape
        return [axis for axis in range(layer.ndim) if axis not in shown and shape[axis] > 1]

    def _kind(self, axis: int) -> str:
        """Return whether an axis is that of a channel or a time; "" for others."""
        letter = known_axis(self.image.value.axis_labels[axis])
        return CHOSEN_BY.get(letter, "")

    def _on_image(self) -> None:
        self.along.reset_choices()
        self.along.visible = len(self.along.choices) > 1
        self.also.reset_choices()
        self.also.visible = len(self.also.choices) > 1
        self._follow_sliders()
        self._show_alignment()

    def _show_alignment(self, _: Any = None) -> None:
        """Let nobody choose what has no say, and save what is not there."""
        self.align.enabled = not self.alignment.is_chosen
        self.alignment.save_button.enabled = self._found_alignment() is not None

    def _found_alignment(self) -> StackAlignment | None:
        """Return how the planes of the chosen stack lie on each other, as it was found last."""
        name = getattr(self.image.value, "name", "")
        layer = layer_of_result(self._viewer.layers, SHARPEST, name)
        made = {} if layer is None else layer.metadata[METADATA_KEY]
        return StackAlignment.from_dict(made[ALIGNMENT]) if ALIGNMENT in made else None

    def save_alignment(self, path: Path | None = None, *, overwrite: bool = False) -> None:
        """Write how the planes lie on each other, see `StackAlignment.save`.

        Parameters
        ----------
        path : Path, optional
            Without, a dialog asks for it.
        overwrite : bool, optional
            Whether a file that exists is replaced; the dialog asks that too.
        """
        found = self._found_alignment()
        if found is None:
            show_warning("There is no alignment to save yet. Find the sharpest plane first.")
            return
        if path is None:
            suggested = f"{self.image.value.name} alignment.json"
            path, overwrite = asked_where(
                self.native, "Save the alignment", suggested, "Alignments (*.json)"
            )
        if path is None:
            return
        try:
            found.save(path, force=overwrite)
        except OSError as reason:
            show_error(saving_failure(reason))
        else:
            self.say(f"Saved in {path.name}: {found}")

    def _on_order(self, _: Any = None) -> None:
        self._on_image()

    def _follow_sliders(self, _: Any = None) -> None:
        """Say which channel and which time are taken, if there are several."""
        stay = {self._kind(axis): axis for axis in self._long_sliders() if axis != self.along.value}
        for field in (self.channel, self.time):
            field.follow(self.image.value, stay.get(field.name))

    def _on_closed(self) -> None:
        super()._on_closed()
        self._viewer.dims.events.point.disconnect(self._follow_sliders)
        self._viewer.dims.events.order.disconnect(self._on_order)
        self._viewer.layers.events.removed.disconnect(self._show_alignment)

    def wanted(self) -> FocusStacking:
        """Return what the form asks for now.

        Raises
        ------
        NotAnalysableError
            If the chosen layer shows no plane, or there is nothing to compare.
        ValueError
            If a field holds no valid value.
        """
        plane = self.shown_plane()
        self.along.reset_choices()
        if self.along.value is None:
            raise NotAnalysableError(CHANNELS_ONLY if self._long_sliders() else NO_PLANES)
        other = self.also.value
        return FocusStacking(
            plane=plane,
            axis=self.along.value,
            settings=self.settings.map_settings(),
            px_per_plane=number_or_none(self.px_per_plane.value, "blur a plane", "0.5"),
            align=self.align.value,
            laid=self.alignment.alignment(),
            match_brightness=self.match_brightness.value,
            blend=self.blend.value,
            peak=self.peak.value,
            also=None if other is None else shown_plane(other, self._viewer.dims),
        )

    def run(self) -> Run | None:
        """Start to compare the planes, and return the run; None if it cannot be done."""
        return self._run_job(self.wanted)

    def _show_results(self, results: Results) -> Iterator[Layer]:
        layers = []
        for layer in super()._show_results(results):
            layers.append(layer)
            yield layer
        if layers:
            # The picture: what lies above it is hidden.
            self._viewer.layers.selection.active = layers[0]
            self._show_alignment()
