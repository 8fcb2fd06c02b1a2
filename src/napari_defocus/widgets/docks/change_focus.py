"""The widget that chooses another focus, afterwards."""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from magicgui.widgets import CheckBox, PushButton, Widget
from napari.components import ViewerModel
from napari.layers import Image, Layer
from napari.utils.notifications import show_warning

from napari_defocus.core.checks import Linearize
from napari_defocus.core.color_range import LEAST_COLOR_LIMIT
from napari_defocus.settings import RefocusSettings
from napari_defocus.widgets.forms.from_map_panel import FromMapPanel
from napari_defocus.widgets.forms.restoration_form import RestorationForm
from napari_defocus.widgets.forms.run_panel import wrap
from napari_defocus.widgets.forms.side_field import side_field, side_note
from napari_defocus.widgets.forms.slider_field import SliderField
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs.estimation import LARGEST_RADIUS
from napari_defocus.widgets.jobs.job import Job
from napari_defocus.widgets.jobs.restoration import Refocusing, Restoration
from napari_defocus.widgets.layers.picker import ClickPicker, value_at
from napari_defocus.widgets.layers.result_metadata import BLUR_MAP, Results, layer_of_result

PICK = "Pick in the picture"
PICKING = "Click on what shall be sharp"

_WIDEST_APERTURE = 4.0


class ChangeFocusWidget(FromMapPanel):
    """Make another part of a picture sharp, with more or less depth of field.

    The picture is restored once; another focus or aperture only blurs it again.

    Attributes
    ----------
    focus, aperture, side, linear_light : magicgui widgets
        How the restored picture is blurred again.
    pick : magicgui.widgets.PushButton
        Takes the focus from the next click in the picture.
    follow : magicgui.widgets.CheckBox
        Whether the picture follows these fields by itself, once there is one.
    restoration : RestorationForm
    """

    def __init__(self, napari_viewer: ViewerModel) -> None:
        super().__init__(napari_viewer, action="Change focus")
        self.focus = SliderField(
            name="focus",
            label="focus (px)",
            value=RefocusSettings.focus,
            largest=LEAST_COLOR_LIMIT,
            step=0.1,
            tooltip="What is this much blurred in the picture becomes sharp: a value of the blur "
            "map, in px. 0 keeps the focus where it was.",
        )
        self.pick = PushButton(
            name="pick",
            text=PICK,
            tooltip="Click on something in the picture: what the blur map says there becomes the "
            "focus. Another press on this button waits for no click any more.",
        )
        self.aperture = SliderField(
            name="aperture",
            label="aperture",
            value=RefocusSettings.aperture,
            largest=_WIDEST_APERTURE,
            step=0.1,
            tooltip="How many times as wide the blur becomes: 1 as it was, above 1 less depth of "
            "field, below 1 more, 0 all in focus.",
        )
        self.side = side_field(RefocusSettings.side)
        self.side_note = side_note()
        self.linear_light = CheckBox(
            name="refocus_linear_light",
            text="blur in linear light (sRGB)",
            value=RefocusSettings.linearize == "srgb",
            tooltip="For photographs that a camera made for screens (JPEG, PNG): bright points "
            "become bright discs, as in a lens. Turn it off for raw and scientific pictures.",
        )
        self.follow = CheckBox(
            name="follow",
            text="follow the sliders",
            value=True,
            tooltip="Once there is a result, make it again whenever the focus, the aperture or "
            "the side changes. The picture is not restored again for it.",
        )
        self.restoration = RestorationForm()
        self.settings.linear_light.text = "estimate in linear light (sRGB)"
        self._started: Restoration | None = None
        self._restored: Restoration | None = None
        self._again = False
        self._picker = ClickPicker(napari_viewer, lambda position: self.focus_on(position))
        self._finish_form(
            [
                *(self.focus, self.pick, self.aperture, self.side, self.side_note),
                *(self.follow, self.linear_light, *self.restoration.fields()),
            ]
        )
        wrap(self.side_note)
        self.pick.clicked.connect(lambda _: self.pick_focus())
        self.settings.max_radius.changed.connect(lambda _: self._show_needed())
        for field in (self.focus.number, self.aperture.number, self.side):
            field.changed.connect(lambda _: self._on_view())

    def _always_needed(self) -> list[Widget]:
        return [self.settings.noise_variance]

    def work(self) -> Refocusing:
        """Return what the form asks for now, see `FromMapPanel.work`."""
        plane = self.shown_plane()
        linearize: Linearize | None = "srgb" if self.linear_light.value else None
        return Refocusing(
            restoration=self.restoration.restoration(
                plane, self.source(plane), self.noise_variance(), linearize
            ),
            view=RefocusSettings(
                focus=self.focus.value,
                aperture=self.aperture.value,
                side=self.side.value,
                linearize=linearize,
            ),
        )

    def pick_focus(self) -> None:
        """Wait for a click in the picture, and take the focus from there; if waiting, stop."""
        if self._picker.waiting:
            self._picker.stop()
        elif self._known_map() is None:
            show_warning("There is no blur map to read the focus from. Run once, or choose one.")
        elif self._viewer.dims.ndisplay == 3:
            show_warning("Switch the viewer to 2-D to pick a place in the picture.")
        else:
            self._picker.start()
        self.pick.text = PICKING if self._picker.waiting else PICK

    def focus_on(self, position: tuple[float, ...]) -> bool:
        """Take the focus from the blur map at world coordinates; False if there is none."""
        layer = self._known_map()
        blur = None if layer is None else value_at(layer, position)
        if blur is None:
            self.say("No blur is known there. Click somewhere else.")
            return False
        self.pick.text = PICK
        self.say(f"Focus on what is blurred by {blur:.2f} px")
        self.focus.largest = max(self.focus.largest, blur)
        self.focus.value = blur
        return True

    def _known_map(self) -> Image | None:
        if self.blur_map.value is not None:
            return self.blur_map.value
        name = getattr(self.image.value, "name", "")
        return layer_of_result(self._viewer.layers, BLUR_MAP, name)

    def _show_needed(self) -> None:
        super()._show_needed()
        self.focus.largest = self._largest_focus()

    def _largest_focus(self) -> float:
        layer = self._known_map()
        if layer is None:
            return LEAST_COLOR_LIMIT
        return float(np.clip(layer.contrast_limits_range[1], 1.0, LARGEST_RADIUS))

    def _on_view(self) -> None:
        """Blur the restored picture again, if that is all there is to do."""
        if not self.follow.value or self.image.value is None:
            return
        if self._running is not None:
            self._again = True
            if self._started == self._restored:
                self._running.cancel()
            return
        with suppress(ValueError):
            work = self.work()
            if work.restoration == self._restored:
                self._start_job(work)

    def _start_job(self, job: Job, action: str = "") -> Run:
        self._started = job.restoration if isinstance(job, Refocusing) else None
        return super()._start_job(job, action)

    def _show_results(self, results: Results) -> Iterator[Layer]:
        yield from super()._show_results(results)
        self._restored = self._started

    def _on_finished(self) -> None:
        super()._on_finished()
        if self._again and not self._closed:
            self._again = False
            self._on_view()

    def cancel(self) -> None:
        """Stop what runs; nothing is added to the viewer."""
        self._again = False
        super().cancel()

    def _on_closed(self) -> None:
        super()._on_closed()
        self._picker.stop()
