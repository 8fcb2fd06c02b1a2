"""
Threshold, smoothness and seeds of the mask
===========================================

How much blur counts as in focus is found from the picture, or you say it. Seeds correct what is
still wrong.

The pictures show the brushes (*Picture 1A*, freespace, CC-BY-4.0), at half their
size. The mask is cut from the same candidates each time, in a fraction of a second.
"""

from importlib.resources import files

import imageio.v3 as imageio
import numpy as np
from matplotlib import pyplot as plt

from napari_defocus import estimate_candidates, focus_threshold, segment_in_focus

picture = imageio.imread(files("napari_defocus.samples") / "brushes.jpg")
picture = picture.reshape(354, 2, 450, 2, 3).mean(axis=(1, 3)).astype(np.uint8)
candidates = estimate_candidates(picture)


def draw(settings):
    """Draw the mask with each of several settings."""
    _, axes = plt.subplots(1, len(settings), figsize=(9.6, 2.9))
    for each, chosen in zip(axes, settings, strict=True):
        in_focus = segment_in_focus(candidates, picture, **chosen)
        each.imshow(np.where(in_focus[..., None] == 1, picture, picture // 5 + 30))
        each.set_title(", ".join(f"{name}={value}" for name, value in chosen.items()))
        each.set_axis_off()


# %%
# **Threshold**: the largest radius that counts as in focus, in px. By default it is found from the
# picture: the sharpest places are in focus, and from there it moves to a blur that few places have.

found = focus_threshold(candidates, picture)
print(f"In focus up to {found} px")
draw([{"threshold": 0.6}, {"threshold": "auto"}, {"threshold": 3.0}])

# %%
# **Unknown**: plain places say nothing of their focus. They are filled from around, or left.

figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.3))
for each, unknown in zip(axes, ("fill", "leave"), strict=True):
    in_focus = segment_in_focus(candidates, picture, unknown=unknown)
    each.imshow(np.where(in_focus[..., None] == 1, picture, picture // 5 + 30))
    each.imshow(np.ma.masked_where(in_focus != 2, in_focus), cmap="Blues", alpha=0.7)
    each.set_title(f"unknown={unknown}")
    each.set_axis_off()

# %%
# **Smoothness**: how much an outline costs. If it is small, outlines fray and small things stay. If
# it is large, outlines are smooth and small things vanish.

draw([{"smoothness": 30}, {"smoothness": 1000}, {"smoothness": 20000}])

# %%
# **Colour step**: if it is small, the outline follows faint edges of the picture.

draw([{"color_sigma": 0.01}, {"color_sigma": 0.04}, {"color_sigma": 0.4}])

# %%
# **Seeds**: 1 is in focus, 2 is blurred, 0 is not known. The mask keeps to these pixels, and their
# surroundings follow up to the picture's edges. At a threshold of 1 px, the tips of the blue
# bristles are missed. A stroke of 1 brings them back.

seeds = np.zeros(picture.shape[:2], int)
seeds[15:25, 20:95] = 1
figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.3))
for each, known, title in zip(axes, (None, seeds), ("without seeds", "with a stroke"), strict=True):
    in_focus = segment_in_focus(candidates, picture, threshold=1.0, seeds=known)
    each.imshow(np.where(in_focus[..., None] == 1, picture, picture // 5 + 30))
    if known is not None:
        each.contour(known == 1, [0.5], colors="w", linewidths=0.8)
    each.set_title(title)
    each.set_axis_off()
