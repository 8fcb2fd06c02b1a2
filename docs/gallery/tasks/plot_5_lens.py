"""
My lens
=======

Find out whether your lens makes discs, and measure it if it does not.

The photographs are *Kleiber*, by Lukas Baubkus (CC-BY-SA-3.0), and the astronaut of scikit-image
(in the public domain).
"""

from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut

from napari_defocus import (
    Annulus,
    Disc,
    Gaussian,
    Polygon,
    calibrate_psf,
    compare_psf,
    estimate_blur_map,
    simulate_defocus,
)

photograph = imageio.imread(Path("..", "photographs", "nuthatch.jpg"))[:, :400]

# %%
# Which lens fits?
# ----------------
#
# One photograph can tell, if it has texture that is blurred by a few px. In a terminal:
# ``napari-defocus compare-psf photo.jpg``.

print(compare_psf(photograph, [Disc(), Polygon(6), Annulus(0.5), Gaussian()]))

# %%
# What if it is a mirror lens?
# ----------------------------
#
# A telescope or a mirror lens makes rings. We look at a portrait through one; its blur grows from
# 2 px at the top to 6 px at the bottom. If the rings are taken for discs, the map is wrong by more
# than 1 px in the mean. ``psf="auto"`` notices the ring.

sharp = astronaut()[:400, 40:440].reshape(200, 2, 200, 2, 3).mean(axis=(1, 3)) / 255
truth = np.broadcast_to(np.linspace(2, 6, 200)[:, None], (200, 200))
mirror = Annulus(0.5)
seen = simulate_defocus(sharp, truth, psf=mirror, noise_variance=1e-5, rng=0)
maps = {"taken for a disc": Disc(), "auto": "auto"}
maps = {title: estimate_blur_map(seen, psf=psf) for title, psf in maps.items()}

# %%
# Measure your own
# ----------------
#
# Take a distant lamp at night, or a pinhole, at about nine settings of the focus, and let
# ``calibrate_psf`` learn the shapes. Here the pictures of the lamp are simulated, with noise. In a
# terminal: ``napari-defocus calibrate lamp-*.png --scales 1,2,3,4,5,6,7,8 -o lens.npz``.

point = np.zeros((64, 64))
point[32, 32] = 0.9
scales = [0.5, 1, 2, 3, 4, 5, 6, 7, 8]
rng = np.random.default_rng(0)
lamps = [simulate_defocus(point, np.full(point.shape, scale), psf=mirror) for scale in scales]
lamps = [lamp + rng.normal(0, 0.02 * lamp.max(), lamp.shape) for lamp in lamps]
measured = calibrate_psf(lamps, scales=scales)
maps["measured with lamps"] = estimate_blur_map(seen, psf=measured)

figure, axes = plt.subplots(1, 4, figsize=(10.0, 2.8))
axes[0].imshow(seen.clip(0, 1))
axes[0].set_title("through a mirror lens")
for each, (title, blur_map) in zip(axes[1:], maps.items(), strict=True):
    shown = each.imshow(blur_map, vmin=0, vmax=8)
    each.set_title(f"{title}: off by {np.abs(blur_map - truth).mean():.2f} px")
for each in axes:
    each.set_axis_off()
figure.colorbar(shown, ax=axes, label="radius (px)", shrink=0.8)

# %%
# ``measured.save("lens.npz")`` keeps it for the next time: ``--psf lens.npz`` in a terminal, *psf*
# in napari. The manual has :doc:`the table of all lenses </manual/lenses>`.
