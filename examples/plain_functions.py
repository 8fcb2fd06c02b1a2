"""How wide is the blur of a picture whose blur is known? No napari here."""

import numpy as np
from skimage.data import grass

from napari_defocus import (
    confidence_map,
    estimate_candidates,
    label_blur_map,
    segment_in_focus,
    simulate_defocus,
)


def main():
    sharp = grass()[:192, :256]
    true_map = np.linspace(0.5, 4.0, 256) * np.ones((192, 1))
    picture = simulate_defocus(sharp, true_map, noise_variance=1e-6, rng=0)

    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture)
    confidence = confidence_map(candidates, blur_map)
    in_focus = segment_in_focus(candidates, picture, threshold=2.0)

    print(f"noise variance found: {candidates.noise_variance:.1e}")
    error = np.abs(blur_map - true_map)
    print(f"mean error of the blur radius: {error.mean():.2f} px")
    print(f"within 0.5 px: {(error <= 0.5).mean():.0%}, mean confidence {confidence.mean():.0%}")
    print(f"in focus: {in_focus.mean():.0%} of the pixels, {(true_map <= 2.0).mean():.0%} in truth")


if __name__ == "__main__":
    main()
