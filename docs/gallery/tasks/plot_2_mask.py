"""
A mask for my photo editor
==========================

Cut out what is in focus, and save it as a mask or as a layer with transparency.

The photograph is *Kleiber*, by Lukas Baubkus (CC-BY-SA-3.0), and so are the pictures made from it.
In a terminal, ``napari-defocus segment photo.jpg`` writes such a mask.
"""

from pathlib import Path
from tempfile import mkdtemp

import imageio.v3 as imageio
import numpy as np
from matplotlib import pyplot as plt
from scipy.ndimage import gaussian_filter

from napari_defocus import estimate_candidates, read_picture, segment_in_focus

photograph = read_picture(Path("..", "photographs", "nuthatch.jpg"))  # or your own file
candidates = estimate_candidates(photograph)
mask = segment_in_focus(candidates, photograph)


def draw(pictures):
    """Show pictures with titles, side by side."""
    _, axes = plt.subplots(1, len(pictures), figsize=(10.0, 2.4), squeeze=False)
    for each, (title, picture) in zip(axes.flat, pictures.items(), strict=True):
        each.imshow(picture, cmap="gray")
        each.set_title(title)
        each.set_axis_off()


dimmed = np.where(mask[..., None] == 1, photograph, photograph // 5 + 30)
draw({"the photograph": photograph, "the mask": mask, "the rest dimmed": dimmed})

# %%
# Correct it
# ----------
#
# Is something missing, or too much? Two things help. A larger threshold lets more blur count as in
# focus. Strokes say what you know: 1 is in focus, 2 is blurred, 0 says nothing. In napari you paint
# them. Here the white ground below the bird is wrong, and one stroke of 2 takes it away.

seeds = np.zeros(mask.shape, np.uint8)
seeds[266:280, 308:326] = 2
more = segment_in_focus(candidates, photograph, threshold=3.0)
corrected = segment_in_focus(candidates, photograph, seeds=seeds)
draw({"the mask": mask, "up to 3 px": more, "with a stroke of 2": corrected})

# %%
# Save it
# -------
#
# White is in focus. GIMP, Photoshop and others load such a picture as a layer mask. A soft edge of
# a few px looks better than a hard one. The second file has the mask as transparency.

folder = Path(mkdtemp())
soft = gaussian_filter(255.0 * corrected, 1.5)
layer = np.dstack([photograph, soft]).round().astype(np.uint8)
imageio.imwrite(folder / "mask.png", soft.round().astype(np.uint8))
imageio.imwrite(folder / "in-focus.png", layer)
checks = 60 * (np.indices(mask.shape) // 20).sum(axis=0, keepdims=True)[0] % 120 + 120
share = layer[..., 3:] / 255
draw({"in-focus.png": (share * layer[..., :3] + (1 - share) * checks[..., None]).astype(np.uint8)})
