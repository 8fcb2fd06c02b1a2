"""
JPEG
====

Compression takes the finest detail away, and leaves blocks.

JPEG leaves out the detail that tells small radii apart, and the blocks that it leaves look like
detail. The steps of its quantization are found from the picture and count as noise. The example is
a ramp from 0.5 to 6 px, saved with several qualities:
"""

import io

import imageio.v3 as imageio
import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut

from napari_defocus import confidence_map, estimate_candidates, label_blur_map, simulate_defocus

sharp = astronaut().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3)) / 255
truth = np.broadcast_to(np.linspace(0.5, 6, 256)[:, None], (256, 256))
seen = simulate_defocus(sharp, truth, noise_variance=1e-5, rng=0)
whole = np.rint(255 * seen.clip(0, 1)).astype(np.uint8)

figure, grid = plt.subplots(2, 4, figsize=(10.0, 5.2))
for axes, quality in zip(grid.T, (100, 90, 70, 30), strict=True):
    file = imageio.imwrite("<bytes>", whole, extension=".jpg", quality=quality)
    picture = imageio.imread(io.BytesIO(file))
    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture)
    sure = confidence_map(candidates, blur_map)
    axes[0].imshow(picture)
    axes[0].set_title(f"quality {quality}: variance {candidates.noise_variance:.0e}")
    shown = axes[1].imshow(blur_map, vmin=0, vmax=8)
    error = np.abs(blur_map - truth).mean()
    axes[1].set_title(f"error {error:.2f} px, confidence {sure.mean():.2f}")
for axes in grid.flat:
    axes.set_axis_off()
figure.colorbar(shown, ax=grid[1], label="radius (px)", shrink=0.9)

# %%
# If you can, measure raw data or PNG, before denoising and sharpening. Both change the spectra that
# the measurement rests on.
