"""The picture that every suite times, and what is made of it."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from skimage.data import astronaut

from napari_defocus import BlurCandidates, estimate_candidates, label_blur_map, simulate_defocus
from napari_defocus.labeling.problem import LabelingProblem

SIDES = (256, 512, 1024)
NOISE = 1e-5


@dataclass(frozen=True, eq=False)
class Ready:
    """A picture of known blur, its candidates and its map."""

    picture: np.ndarray
    truth: np.ndarray
    candidates: BlurCandidates
    blur_map: np.ndarray

    def scene(self) -> LabelingProblem:
        return LabelingProblem.of(self.candidates, self.picture)


@cache
def blurred(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Blur an astronaut, mirrored if it is too small, by a ramp from 1 to 5 px."""
    sharp = astronaut()
    missing = max(0, side - len(sharp))
    sharp = np.pad(sharp, ((0, missing), (0, missing), (0, 0)), mode="symmetric")[:side, :side]
    truth = np.linspace(1, 5, side)[:, None] * np.ones(side)
    return simulate_defocus(sharp, truth, noise_variance=NOISE, rng=0), truth


@cache
def ready(side: int, mode: str = "curve") -> Ready:
    picture, truth = blurred(side)
    candidates = estimate_candidates(picture, mode=mode)
    return Ready(picture, truth, candidates, label_blur_map(candidates, picture))
