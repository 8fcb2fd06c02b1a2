"""
Thin things are cut off
=======================

The paper's third problem: an outline costs as much as it is long, and thin things have a long one.

A sharp ball with arms of 16, 10, 6 and 3 px stands before a meadow that is blurred by 5 px. In the
paper, the feathers of wings are cut off. In the window of a thin thing, most pixels belong to what
surrounds it. And an outline around a thin thing is twice as long as the thing.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import grass, gravel

from napari_defocus import (
    estimate_candidates,
    label_blur_map,
    segment_in_focus,
    simulate_layered_defocus,
)

row, column = np.indices((240, 240)) - 119.5
ball = np.hypot(row, column) < 40
arms = {
    16: (abs(column) < 8) & (row < 0),
    10: (abs(row) < 5) & (column > 0),
    6: (abs(column) < 3) & (row > 0),
    3: (abs(row) < 1.5) & (column < 0),
}
near = ball | np.any(list(arms.values()), axis=0)
near &= np.maximum(abs(row), abs(column)) < 105

meadow = grass()[:480, :480].reshape(240, 2, 240, 2).mean(axis=(1, 3))[..., None] / 255
stone = gravel()[:480, :480].reshape(240, 2, 240, 2).mean(axis=(1, 3))[..., None] / 255
green = [0.7, 1.0, 0.6]
subjects = {
    "a colour of its own": stone * [1.0, 0.9, 0.8],
    "the same colours": meadow[::-1] * green,
}

# %%
# First the ball has a colour that the meadow has not, then it has the meadow's own.

figure, grid = plt.subplots(2, 3, figsize=(9.0, 6.0))
for axes, (name, subject) in zip(grid, subjects.items(), strict=True):
    scene = np.where(near[..., None], subject, meadow * green)
    seen, truth = simulate_layered_defocus(
        scene, np.where(near, 1.0, 2.0), lambda d: 5.0 * (d - 1), noise_variance=1e-5, rng=0
    )
    candidates = estimate_candidates(seen)
    in_focus = segment_in_focus(candidates, seen)
    bright = seen.clip(0, 1)
    axes[0].imshow(bright)
    axes[0].set_title(name)
    shown = axes[1].imshow(label_blur_map(candidates, seen), vmin=0, vmax=8)
    axes[1].set_title("map")
    axes[2].imshow(np.where(in_focus[..., None] == 1, bright, bright / 5 + 0.1))
    axes[2].contour(near, [0.5], colors="w", linewidths=0.6)
    axes[2].set_title("mask; white: true outline")
    found = {width: in_focus[arm & near & ~ball].mean() for width, arm in arms.items()}
    print(f"{name}: " + ", ".join(f"{width} px wide {share:.0%}" for width, share in found.items()))
for axes in grid.flat:
    axes.set_axis_off()
figure.colorbar(shown, ax=grid[:, 1], label="radius (px)", shrink=0.7)

# %%
# Colour decides. If the arms have a colour of their own, even the thinnest is in the mask. If they
# have not, the arms fray, and the thin ones are partly lost. The same happens in photographs to
# stems, twigs and whiskers before leaves of their colour. Seeds bring back what matters to you.
