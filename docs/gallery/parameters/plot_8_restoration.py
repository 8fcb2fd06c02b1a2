"""
Risk and smoothing of the restoration
=====================================

How much blur is taken away, and how much noise is left.

Too small a radius leaves some blur. Too large a radius makes rings, which look worse. `risk` is the
probability of the worse error that you accept: that more blur is taken away than there was.
`tv_weight` is lambda of (19). It is found from the noise if you do not give it.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut

from napari_defocus import (
    cautious_blur_map,
    confidence_map,
    estimate_candidates,
    label_blur_map,
    restore_all_in_focus,
    simulate_defocus,
)

sharp = astronaut()[20:260, 110:350].reshape(120, 2, 120, 2, 3).mean(axis=(1, 3)) / 255
truth = np.broadcast_to(np.linspace(1, 5, 120)[:, None], (120, 120))
seen = simulate_defocus(sharp, truth, noise_variance=1e-5, rng=0)
candidates = estimate_candidates(seen)
blur_map = label_blur_map(candidates, seen)
confidence = confidence_map(candidates, blur_map)


def decibels(picture):
    """Return the PSNR, 12 px at the border left out."""
    error = (picture.clip(0, 1) - sharp)[12:-12, 12:-12]
    return -10 * np.log10(np.mean(error**2))


def draw(pictures):
    """Show pictures beside the input."""
    _, axes = plt.subplots(1, len(pictures) + 1, figsize=(8.4, 3.2))
    for each, (name, picture) in zip(axes, {"input": seen, **pictures}.items(), strict=True):
        each.imshow(picture.clip(0, 1))
        each.set_title(f"{name}: {decibels(picture):.1f} dB")
        each.set_axis_off()


# %%
# **Risk**, 0.3 by default. On photographs, where the map is less sure than here, more risk makes
# rings.

draw(
    {
        f"risk={risk}": restore_all_in_focus(
            seen, cautious_blur_map(candidates, blur_map, risk=risk), confidence=confidence
        )
        for risk in (0.3, 1.0)
    }
)

# %%
# **Smoothing.** Small weights keep detail and noise, large ones remove both.

safe = cautious_blur_map(candidates, blur_map)
draw(
    {
        f"tv_weight={weight:g}": restore_all_in_focus(
            seen, safe, confidence=confidence, tv_weight=weight
        )
        for weight in (1e-5, 3e-3)
    }
)
