"""
Lens and largest radius
=======================

The shape that a lens makes of a point, and the largest radius that is looked for.

Every family of PSFs is indexed by its blur radius in px: the radius of the disc with the same
second moment, or twice the standard deviation along an axis. An iris is nearly a disc. A mirror
lens, or a microscope at its diffraction limit, is not, and with the wrong family the map is wrong
by pixels.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut, gravel

from napari_defocus import (
    Annulus,
    Disc,
    Gaussian,
    Polygon,
    compare_psf,
    estimate_blur_map,
    simulate_defocus,
)

families = {
    "Disc()": Disc(),
    "Polygon(6)": Polygon(6),
    "Annulus(0.5)": Annulus(0.5),
    "Gaussian()": Gaussian(),
}
figure, axes = plt.subplots(1, 4, figsize=(7.4, 2.2))
for each, (name, family) in zip(axes, families.items(), strict=True):
    kernel = family.kernel(6.0)
    half = len(kernel) / 2
    each.imshow(kernel, cmap="gray", extent=(-half, half, half, -half))
    each.set(title=name, xlim=(-9, 9), ylim=(9, -9))
    each.set_axis_off()

# %%
# The same ramp from 2 to 6 px, seen by each lens. It is measured as if the lens made discs, and
# with the lens's own family. The radius means the same in all maps.

sharp = gravel()[:320, :320].reshape(160, 2, 160, 2).mean(axis=(1, 3)) / 255
truth = np.broadcast_to(np.linspace(2, 6, 160), (160, 160))

seen = {}
for name, family in families.items():
    seen[name] = simulate_defocus(sharp, truth, psf=family, noise_variance=1e-6, rng=0)
    as_disc = np.abs(estimate_blur_map(seen[name]) - truth).mean()
    as_itself = np.abs(estimate_blur_map(seen[name], psf=family) - truth).mean()
    print(f"{name:12s} as a disc {as_disc:.2f} px, as itself {as_itself:.2f} px")

# %%
# Which family fits? The likelihood tells, without knowing the truth.

print(compare_psf(seen["Annulus(0.5)"], list(families.values())))

# %%
# **Largest radius.** Wide blur is measured on the picture with averaged pixels, up to 64 px, and
# up to less in small pictures. A larger window would not do that. What happens beyond the largest
# radius is shown in :ref:`sphx_glr_examples_limits_plot_5_beyond.py`.

photograph = astronaut().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3)) / 255
wide = np.broadcast_to(np.linspace(2, 14, 256), (256, 256))
blurred = simulate_defocus(photograph, wide, psf=Disc(14.0), noise_variance=1e-6, rng=0)
maps = {
    "true radius, 2 to 14 px": wide,
    "up to 8 px": estimate_blur_map(blurred, psf=Disc(8.0)),
    "up to 14 px, window 71": estimate_blur_map(blurred, psf=Disc(14.0), window=71),
    "as it is, up to 16 px": estimate_blur_map(blurred),
}
figure, axes = plt.subplots(1, 4, figsize=(10.4, 2.7))
for each, (name, values) in zip(axes, maps.items(), strict=True):
    shown = each.imshow(values, vmin=0, vmax=16)
    each.set_title(f"{name}: {np.abs(values - wide).mean():.1f} px")
    each.set_axis_off()
axes[0].set_title("true radius, 2 to 14 px")
figure.colorbar(shown, ax=axes, label="radius (px)", shrink=0.8)
