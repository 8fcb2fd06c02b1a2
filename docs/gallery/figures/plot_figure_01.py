"""
Figure 1: a photograph, its blur map, what is in focus
======================================================

The whole method in three lines: candidates, a coherent map, a mask.

In the paper this is a herdsman before cattle, hills and sky. Here it is the dandelion that comes
with the plugin (Clements Engelhardt, CC0): a seed head in focus, stalks and a meadow that melt
away behind it.
"""

from importlib.resources import files

import imageio.v3 as imageio
import numpy as np
from matplotlib import pyplot as plt

from napari_defocus import estimate_candidates, label_blur_map, segment_in_focus

picture = imageio.imread(files("napari_defocus.samples") / "dandelion.jpg")

candidates = estimate_candidates(picture)
blur_map = label_blur_map(candidates, picture)
in_focus = segment_in_focus(candidates, picture)

# %%
# The radius is in px of the picture. Purple is sharp. The sky has no texture: what the map says
# there comes from around it, see :ref:`sphx_glr_examples_limits_plot_4_flat.py`.

figure, axes = plt.subplots(3, 1, figsize=(6.4, 9.6))
axes[0].imshow(picture)
axes[0].set_title("(a) photograph")
shown = axes[1].imshow(blur_map, vmin=0, vmax=8)
axes[1].set_title("(b) blur map")
figure.colorbar(shown, ax=axes[1], label="radius (px)", pad=0.01)
dimmed = np.where(in_focus[..., None] == 1, picture, picture // 5 + 30)
axes[2].imshow(dimmed)
axes[2].set_title(f"(c) in focus: {in_focus.mean():.0%} of the picture")
for each in axes:
    each.set_axis_off()

# %%
# How wide is the blur where it is in focus, and where not?

for name, label in (("in focus", 1), ("blurred", 0)):
    low, middle, high = np.percentile(blur_map[in_focus == label], [5, 50, 95])
    print(f"{name}: median {middle:.1f} px, 5 to 95 %: {low:.1f} to {high:.1f} px")
