"""
Window and stride
=================

How much of the picture decides about one place, and how far apart these places are.

A window of N x N px must hold enough texture to tell radii apart. It works best if it is at least
four times as wide as the largest radius. A larger one is surer, but sees more of what lies beside
the place.
"""

import time

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut, grass

from napari_defocus import estimate_candidates, label_blur_map, simulate_defocus

sharp = grass()[:400, :400].reshape(200, 2, 200, 2).mean(axis=(1, 3)) / 255
row, column = np.indices(sharp.shape) * 2 * np.pi / 200
truth = 0.5 + 6 * (1 - np.cos(column) * np.cos(row)) / 2
seen = simulate_defocus(sharp, truth, noise_variance=1e-5, rng=0)

figure, grid = plt.subplots(2, 4, figsize=(9.6, 5.0))
shown = grid[0, 0].imshow(truth, vmin=0, vmax=8)
grid[0, 0].set_title("true radius")
grid[1, 0].imshow(seen, cmap="gray")
grid[1, 0].set_title("picture")
for axes, window in zip(grid[:, 1:].T, (21, 41, 61), strict=True):
    candidates = estimate_candidates(seen, window=window)
    blur_map = label_blur_map(candidates, seen)
    extent = (0, 200, 200, 0)
    axes[0].imshow(candidates.radii[..., 0], vmin=0, vmax=8, extent=extent)
    axes[0].set_title(f"{window} px: likeliest radii")
    axes[1].imshow(blur_map, vmin=0, vmax=8)
    axes[1].set_title(f"map, error {np.abs(blur_map - truth).mean():.2f} px")
for axes in grid.flat:
    axes.set_axis_off()
figure.colorbar(shown, ax=grid, label="radius (px)", shrink=0.7)

# %%
# The stride is the distance between windows. Half the stride costs four times as much, and gains
# little, because neighbouring windows see nearly the same. On a photograph that was blurred by a
# ramp:

portrait = astronaut()[:400, 40:440].reshape(200, 2, 200, 2, 3).mean(axis=(1, 3)) / 255
truth = np.broadcast_to(np.linspace(1, 6, 200), (200, 200))
seen = simulate_defocus(portrait, truth, noise_variance=1e-5, rng=0)

for stride in (1, 2, 4, 8):
    begun = time.perf_counter()
    candidates = estimate_candidates(seen, stride=stride)
    seconds = time.perf_counter() - begun
    error = np.abs(label_blur_map(candidates, seen) - truth).mean()
    print(f"stride {stride}: candidates in {seconds:.2f} s, error of the map {error:.3f} px")
