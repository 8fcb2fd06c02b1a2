"""
Linear light
============

Blur mixes light, but files hold encoded brightness.

A lens blurs radiance. A photograph in JPEG or PNG holds intensities that are encoded for screens
(sRGB). In these, the same blur is not a convolution: bright things spread farther than dark ones.
``linearize="srgb"`` decodes first. It is off by default, because raw data, scans and microscopes
are linear already.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut

from napari_defocus import estimate_blur_map, simulate_defocus
from napari_defocus.core.image import decode_srgb, encode_srgb

sharp = astronaut().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3)) / 255
truth = np.broadcast_to(np.linspace(1, 6, 256)[:, None], (256, 256))
light = simulate_defocus(decode_srgb(sharp), truth, noise_variance=1e-6, rng=0)
photograph = encode_srgb(light.clip(0, 1))

figure, axes = plt.subplots(1, 4, figsize=(10.4, 2.7))
axes[0].imshow(photograph)
axes[0].set_title("photograph, 1 to 6 px")
axes[1].imshow(truth, vmin=0, vmax=8)
axes[1].set_title("true radius")
for each, linearize in zip(axes[2:], (None, "srgb"), strict=True):
    blur_map = estimate_blur_map(photograph, linearize=linearize)
    shown = each.imshow(blur_map, vmin=0, vmax=8)
    error = np.abs(blur_map - truth).mean()
    each.set_title(f"linearize={linearize!r}: error {error:.2f} px")
for each in axes:
    each.set_axis_off()
figure.colorbar(shown, ax=axes, label="radius (px)", shrink=0.8)
