"""
Smoothness and colour step of the map
=====================================

How much a change of the blur costs, and where it costs less.

*smoothness* is the cost of a difference of 0.1 px between neighbours. It is weighed against what
the windows say. *color_sigma* is how much the colours of neighbours must differ until a jump of
the blur costs little. In the example, a sharp picture stands before a blurred one.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut, grass

from napari_defocus import estimate_candidates, label_blur_map, simulate_layered_defocus

meadow = grass()[:400, :400].reshape(200, 2, 200, 2).mean(axis=(1, 3)) / 255
background = meadow[..., None] * [0.7, 1.0, 0.6]
subject = astronaut()[:400, 40:440].reshape(200, 2, 200, 2, 3).mean(axis=(1, 3)) / 255
row, column = np.indices((200, 200))
near = np.hypot(row - 105, column - 95) < 60
scene = np.where(near[..., None], subject, background)
depth = np.where(near, 1.0, 2.0)
seen, truth = simulate_layered_defocus(
    scene, depth, lambda d: 5.0 * (d - 1.0), noise_variance=1e-5, rng=0
)
candidates = estimate_candidates(seen)


def draw(settings):
    """Draw the map with each of several settings."""
    figure, axes = plt.subplots(1, len(settings) + 1, figsize=(9.6, 2.7))
    axes[0].imshow(seen.clip(0, 1))
    axes[0].set_title("picture: 0 px, behind it 5 px")
    for each, chosen in zip(axes[1:], settings, strict=True):
        blur_map = label_blur_map(candidates, seen, **chosen)
        shown = each.imshow(blur_map, vmin=0, vmax=8)
        (name, value), *_ = chosen.items()
        each.set_title(f"{name}={value:g}: {np.abs(blur_map - truth).mean():.2f} px")
    for each in axes:
        each.set_axis_off()
    figure.colorbar(shown, ax=axes, label="radius (px)", shrink=0.8)


# %%
# With too small a smoothness, errors of single windows stay. With too large a one, slopes become
# flat and small things vanish. The numbers are the mean error.

draw([{"smoothness": 1}, {"smoothness": 20}, {"smoothness": 400}])

# %%
# If the colour step is too small, jumps cost little everywhere, even at texture. If it is too
# large, jumps cost the same everywhere, and outlines do not follow the picture's edges.

draw([{"color_sigma": 0.01}, {"color_sigma": 0.1}, {"color_sigma": 1.0}])
