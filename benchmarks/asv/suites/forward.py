"""The forward model, and the way back."""

from napari_defocus import (
    change_focus,
    restore_all_in_focus,
    simulate_defocus,
    simulate_layered_defocus,
)

from .pictures import SIDES, ready


class Pictures:
    """Pictures blurred, restored and refocused."""

    params = SIDES[:2]
    param_names = ("side",)
    timeout = 300

    def setup(self, side: int) -> None:
        self.ready = ready(side)
        self.sharp = restore_all_in_focus(self.ready.picture, self.ready.blur_map)

    def time_simulation(self, side: int) -> None:
        simulate_defocus(self.ready.picture, self.ready.truth)

    def time_layered_simulation(self, side: int) -> None:
        simulate_layered_defocus(self.ready.picture, self.ready.truth, self.ready.truth)

    def time_restoration(self, side: int) -> None:
        restore_all_in_focus(self.ready.picture, self.ready.blur_map)

    def time_refocusing(self, side: int) -> None:
        change_focus(self.ready.picture, self.ready.blur_map, all_in_focus=self.sharp, focus=4.0)

    def peakmem_restoration(self, side: int) -> None:
        restore_all_in_focus(self.ready.picture, self.ready.blur_map)
