"""
Figure 10: more photographs
===========================

Maps and masks of photographs with real lenses, where nobody knows the truth.

All settings are the defaults. The brushes come with the plugin (*Picture 1A*, freespace,
CC-BY-4.0), the marigold is from mate-backgrounds (GPL-2.0-or-later), the cat from scikit-image
(*Chelsea*, Stéfan van der Walt, CC0).
"""

from importlib.resources import files
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from matplotlib import pyplot as plt
from skimage.data import chelsea

from napari_defocus import (
    estimate_candidates,
    focus_threshold,
    label_blur_map,
    segment_in_focus,
)

# The folder of this script is the current one while the documentation is built.
photographs = Path("../photographs")
brushes = imageio.imread(files("napari_defocus.samples") / "brushes.jpg")
brushes = brushes.reshape(354, 2, 450, 2, 3).mean(axis=(1, 3))
pictures = {
    "brushes, at half of their size": brushes.astype(np.uint8),
    "marigold": imageio.imread(photographs / "marigold.jpg"),
    "cat": chelsea(),
}

figure, grid = plt.subplots(3, 3, figsize=(9.6, 7.0))
for axes, (name, picture) in zip(grid, pictures.items(), strict=True):
    candidates = estimate_candidates(picture)
    in_focus = segment_in_focus(candidates, picture)
    axes[0].imshow(picture)
    axes[0].set_title(name)
    shown = axes[1].imshow(label_blur_map(candidates, picture), vmin=0, vmax=8)
    axes[1].set_title("blur map")
    axes[2].imshow(np.where(in_focus[..., None] == 1, picture, picture // 5 + 30))
    axes[2].set_title(f"in focus up to {focus_threshold(candidates, picture)} px")
for axes in grid.flat:
    axes.set_axis_off()
figure.colorbar(shown, ax=grid[:, 1], label="radius (px)", location="bottom", shrink=0.9, pad=0.02)

# %%
# Not all of them are right. The handles on the right of the brushes and the cat's
# eyes have hardly any texture; the marigold's petals are one colour with a soft shade. The
# confidence says so, see :ref:`sphx_glr_examples_limits_plot_4_flat.py`, and seeds correct a mask,
# see :ref:`sphx_glr_examples_parameters_plot_7_mask.py`.
