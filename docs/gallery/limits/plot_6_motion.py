"""
Motion is not defocus
=====================

A picture that was moved is measured as if it was out of focus.

The model knows only discs, or the family that you give. Motion takes away detail along one
direction only. The method finds the radius that fits best, although none fits well.
"""

import numpy as np
from matplotlib import pyplot as plt
from scipy.ndimage import uniform_filter1d
from skimage.data import grass

from napari_defocus import confidence_map, estimate_candidates, label_blur_map

sharp = grass()[:400, :400].reshape(200, 2, 200, 2).mean(axis=(1, 3)) / 255
rng = np.random.default_rng(0)
lengths = (1, 5, 9, 15)

figure, grid = plt.subplots(2, 4, figsize=(9.6, 5.0))
for axes, length in zip(grid.T, lengths, strict=True):
    moved = uniform_filter1d(sharp, length, axis=1, mode="reflect")
    seen = moved + 1e-3 * rng.standard_normal(moved.shape)
    candidates = estimate_candidates(seen)
    blur_map = label_blur_map(candidates, seen)
    sure = confidence_map(candidates, blur_map).mean()
    axes[0].imshow(seen[60:140, 60:140], cmap="gray")
    axes[0].set_title(f"moved by {length - 1} px (detail)")
    shown = axes[1].imshow(blur_map, vmin=0, vmax=8)
    axes[1].set_title(f"median {np.median(blur_map):.1f} px, confidence {sure:.2f}")
for axes in grid.flat:
    axes.set_axis_off()
figure.colorbar(shown, ax=grid[1], label="radius (px)", shrink=0.9)

# %%
# The true radius is 0 in all of them. The confidence belongs to a model that knows defocus only: do
# not rely on it to find motion.
