"""
Mode: the paper's method, or what measurements added
====================================================

``mode="paper"`` keeps to the paper; ``mode="curve"`` is the default.

The default takes the whole likelihood curve instead of three candidates. It expects that windows
hold more than one radius. It asks windows on each place's own side of edges, and makes the map
continuous. :doc:`/measured/ablation` says what each step gains.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut

from napari_defocus import estimate_blur_map, simulate_defocus

sharp = astronaut().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3)) / 255
row, column = np.indices(sharp.shape[:2]) * 2 * np.pi / 256
truths = {
    "gentle ramp": 1 + 4 * row / (2 * np.pi),
    "steep bumps": 0.5 + 6.5 * (1 - np.cos(column) * np.cos(row)) / 2,
}

figure, grid = plt.subplots(2, 4, figsize=(9.6, 4.9))
for axes, (name, truth) in zip(grid, truths.items(), strict=True):
    seen = simulate_defocus(sharp, truth, noise_variance=1e-5, rng=0)
    axes[0].imshow(seen.clip(0, 1))
    axes[0].set_title(name)
    axes[1].imshow(truth, vmin=0, vmax=8)
    axes[1].set_title("true radius")
    for each, mode in zip(axes[2:], ("paper", "curve"), strict=True):
        blur_map = estimate_blur_map(seen, mode=mode)
        shown = each.imshow(blur_map, vmin=0, vmax=8)
        each.set_title(f"mode={mode!r}: {np.abs(blur_map - truth).mean():.2f} px")
for axes in grid.flat:
    axes.set_axis_off()
figure.colorbar(shown, ax=grid, label="radius (px)", shrink=0.7)
