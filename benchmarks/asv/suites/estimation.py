"""From pixels to candidates."""

from napari_defocus import Disc, estimate_candidates, estimate_noise_variance
from napari_defocus.core.image import prepare_image
from napari_defocus.likelihood.blur_spectra import spectrum_table
from napari_defocus.likelihood.gabor import gradients, local_power, window_centers

from .pictures import NOISE, SIDES, blurred, ready

WINDOW = 41


class Candidates:
    """estimate_candidates, both modes, its memory, and what it begins with."""

    params = SIDES
    param_names = ("side",)
    timeout = 300

    def setup(self, side: int) -> None:
        self.picture, _ = blurred(side)
        estimate_candidates(self.picture[:128, :128])
        self.luminance = prepare_image(self.picture).luminance

    def time_candidates(self, side: int) -> None:
        estimate_candidates(self.picture, noise_variance=NOISE)

    def time_candidates_of_the_paper(self, side: int) -> None:
        estimate_candidates(self.picture, noise_variance=NOISE, mode="paper")

    def time_noise_variance(self, side: int) -> None:
        estimate_noise_variance(self.picture)

    def time_local_power(self, side: int) -> None:
        centers = window_centers(side, 4)[6:-6]
        local_power(gradients(self.luminance, None, WINDOW), centers, centers, WINDOW)

    def peakmem_candidates(self, side: int) -> None:
        estimate_candidates(self.picture, noise_variance=NOISE)


class Tables:
    """The spectra of a family, which are made once a process."""

    def setup(self) -> None:
        ready(SIDES[0])

    def time_exact(self) -> None:
        getattr(spectrum_table, "__wrapped__", spectrum_table)(Disc(), WINDOW, 0.5, 0.5, "exact")
