"""
Flat is not sharp and not blurred
=================================

Where there is no texture, nothing can be known. The map is filled from around.

A wall and a sky without any texture are painted into a picture that is blurred by 1 to 6 px. The
map fills them from what surrounds them, mostly from where the colours are the same. It can only be
right by chance. The confidence is low there, and ``return_extrapolated=True`` returns where.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut

from napari_defocus import confidence_map, estimate_candidates, label_blur_map, simulate_defocus

sharp = astronaut().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3)) / 255
row, column = np.indices((256, 256)) / 256
flat = (row < 0.3) | ((row > 0.55) & (column > 0.6))
sharp[row < 0.3] = (0.45, 0.62, 0.85)
sharp[(row > 0.55) & (column > 0.6)] = (0.72, 0.66, 0.58)
truth = 1 + 5 * column
seen = simulate_defocus(sharp, truth, noise_variance=1e-5, rng=0)

candidates = estimate_candidates(seen)
blur_map, extrapolated = label_blur_map(candidates, seen, return_extrapolated=True)
confidence = confidence_map(candidates, blur_map)

figure, grid = plt.subplots(2, 3, figsize=(8.4, 5.4))
grid[0, 0].imshow(seen.clip(0, 1))
grid[0, 0].set_title("picture")
grid[0, 1].imshow(truth, vmin=0, vmax=8)
grid[0, 1].set_title("true radius")
shown = grid[0, 2].imshow(blur_map, vmin=0, vmax=8)
grid[0, 2].set_title("map")
figure.colorbar(shown, ax=grid[0, 2], label="px", shrink=0.8)
grid[1, 0].imshow(extrapolated, cmap="gray_r")
grid[1, 0].set_title("extrapolated (black)")
sure = grid[1, 1].imshow(confidence, cmap="gray", vmin=0, vmax=1)
grid[1, 1].set_title("confidence")
figure.colorbar(sure, ax=grid[1, 1], shrink=0.8)
wrong = grid[1, 2].imshow(np.abs(blur_map - truth), cmap="magma", vmin=0, vmax=4)
grid[1, 2].set_title("error")
figure.colorbar(wrong, ax=grid[1, 2], label="px", shrink=0.8)
for axes in grid.flat:
    axes.set_axis_off()

# %%
for name, where in (("flat", flat), ("texture", ~flat)):
    error = np.abs(blur_map - truth)[where].mean()
    print(f"{name}: mean error {error:.2f} px, mean confidence {confidence[where].mean():.2f}")
