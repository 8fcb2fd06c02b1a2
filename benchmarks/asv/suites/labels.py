"""From candidates to maps, masks and their confidence."""

from napari_defocus import confidence_map, label_blur_map, segment_in_focus
from napari_defocus.labeling.blur_map import CURVE_WEIGHT, JUMP
from napari_defocus.labeling.coarse_to_fine import minimize_energy
from napari_defocus.labeling.continuous_refinement import refine_labels
from napari_defocus.settings import MapSettings

from .pictures import SIDES, ready


class Labels:
    """label_blur_map and its steps, segment_in_focus, confidence_map."""

    params = SIDES
    param_names = ("side",)
    timeout = 300

    def setup(self, side: int) -> None:
        self.ready = ready(side)
        scene = self.ready.scene()
        weights = scene.blocks.edge_weights(
            scene.picture.color, MapSettings.color_sigma, MapSettings.smoothness
        )
        self.problem = scene.block_cost(CURVE_WEIGHT), weights
        self.labels = minimize_energy(*self.problem)

    def time_map(self, side: int) -> None:
        label_blur_map(self.ready.candidates, self.ready.picture)

    def time_cuts(self, side: int) -> None:
        minimize_energy(*self.problem)

    def time_refinement(self, side: int) -> None:
        likeness = self.problem[1] / MapSettings.smoothness
        refine_labels(self.ready.candidates, self.labels, likeness, JUMP, MapSettings.smoothness)

    def time_mask(self, side: int) -> None:
        segment_in_focus(self.ready.candidates, self.ready.picture)

    def time_confidence(self, side: int) -> None:
        confidence_map(self.ready.candidates, self.ready.blur_map)

    def peakmem_map(self, side: int) -> None:
        label_blur_map(self.ready.candidates, self.ready.picture)
