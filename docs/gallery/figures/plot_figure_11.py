"""
Figure 11: what is in focus
===========================

The binary cut on its own: sharp subjects cut out of their photographs.

A mask needs candidates, but no map. It follows the picture's colour edges, so that outlines
are much finer than the window. All settings are the defaults. The picture tells up to which blur
it counts as in focus.
The nuthatch is by Lukas Baubkus (*Kleiber*, CC-BY-SA-3.0, and so is this figure), the ladybird
is from mate-backgrounds (GPL-2.0-or-later), the dandelion is by Clements Engelhardt (CC0).
"""

from importlib.resources import files
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from matplotlib import pyplot as plt

from napari_defocus import estimate_candidates, focus_threshold, segment_in_focus

# The folder of this script is the current one while the documentation is built.
paths = [Path("../photographs") / f"{name}.jpg" for name in ("nuthatch", "ladybird")]
paths.append(files("napari_defocus.samples") / "dandelion.jpg")

figure, grid = plt.subplots(3, 2, figsize=(7.4, 6.6))
for axes, path in zip(grid, paths, strict=True):
    picture = imageio.imread(path)
    candidates = estimate_candidates(picture)
    in_focus, largest = segment_in_focus(candidates, picture), focus_threshold(candidates, picture)
    axes[0].imshow(picture)
    axes[1].imshow(np.where(in_focus[..., None] == 1, picture, picture // 5 + 30))
    axes[1].set_title(f"{in_focus.mean():.0%} in focus, up to {largest} px")
for axes in grid.flat:
    axes.set_axis_off()

# %%
# The bark beside the nuthatch goes out of focus where the trunk turns away. As in the paper's
# Figure 11 (f), a bright edge draws the outline beyond the subject: the white patch below the
# bird's tail has no texture of its own. Thin things, such as the ladybird's stem, are cut off.
