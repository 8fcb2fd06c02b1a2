"""
Noise variance
==============

The parameter that matters most, and the one that you rarely have to set.

Blur takes fine detail away, and noise adds some. To measure one, you have to know the other.
The noise variance is that of the luminance, for intensities from 0 to 1. By default it is found
from the picture. Here a ramp from 1 to 6 px with noise of a known variance is measured with
several.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import coffee

from napari_defocus import (
    estimate_blur_map,
    estimate_noise_variance,
    estimate_shot_noise,
    simulate_defocus,
)

sharp = coffee()[:400, 100:500].reshape(200, 2, 200, 2, 3).mean(axis=(1, 3)) / 255
truth = np.broadcast_to(np.linspace(1, 6, 200), (200, 200))
seen = simulate_defocus(sharp, truth, noise_variance=3e-5, rng=0)
found = estimate_noise_variance(seen)
print(f"true 3e-05 in each colour, 1.3e-05 in the luminance; found {found:.1e}")

figure, grid = plt.subplots(2, 3, figsize=(7.4, 5.2))
grid[0, 0].imshow(seen.clip(0, 1))
grid[0, 0].set_title("ramp from 1 to 6 px")
for axes, variance in zip(grid.flat[1:], (None, 1e-7, 1e-6, 1e-4, 1e-3), strict=True):
    blur_map = estimate_blur_map(seen, noise_variance=variance)
    name = "found" if variance is None else f"{variance:.0e}"
    shown = axes.imshow(blur_map, vmin=0, vmax=8)
    axes.set_title(f"{name}: error {np.abs(blur_map - truth).mean():.2f} px")
for axes in grid.flat:
    axes.set_axis_off()
figure.colorbar(shown, ax=grid, label="radius (px)", shrink=0.7)

# %%
# With too small a variance, noise counts as detail, and places with little texture go wrong. With
# too large a one, detail counts as noise, and little is left to tell radii apart.
#
# Give the variance if you know it, such as that of your camera's raw data. Fine texture that is
# sharp everywhere looks like noise: there you have to give it. Counted photons make noise that
# grows with the intensity. How fast it grows is found from the picture, and is given in place of a
# variance:

photons = seen.clip(0, 1) * 5000
counted = np.random.default_rng(0).poisson(photons) / 5000
noise = estimate_shot_noise(counted)
print(noise)
blur_map = estimate_blur_map(counted, noise_variance=noise)
