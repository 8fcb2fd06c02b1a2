"""
How far is it?
==============

Turn the blur of one picture into distances in metres, if you know the lens.

The scene is the *Motorcycle* of the Middlebury stereo data, as scikit-image has it: a photograph
that comes with the distance of every pixel. We look at it through a lens that we choose, so that
the answer is known.
"""

import numpy as np
from matplotlib import pyplot as plt
from scipy.ndimage import distance_transform_edt
from skimage.data import stereo_motorcycle

from napari_defocus import (
    ThinLens,
    blur_from_depth,
    confidence_map,
    depth_from_blur,
    estimate_candidates,
    label_blur_map,
    simulate_layered_defocus,
)

scene, _, disparity = stereo_motorcycle()
scene, disparity = scene[120:420, 150:550], disparity[120:420, 150:550]
unknown = ~np.isfinite(disparity)
nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
disparity = disparity[tuple(nearest)]
truth = 0.193 * 994.978 / (disparity + 31.086)  # metres: baseline and focal length of the cameras

# %%
# The lens
# --------
#
# Four numbers are needed. Cameras note most of them in EXIF, and ``ThinLens.from_exif(path)`` reads
# them. They rarely note the distance that the lens was focused at: measure it.

lens = ThinLens(focal_length_mm=50, f_number=2.0, focus_distance_m=2.0, pixel_pitch_um=36)
seen, _ = simulate_layered_defocus(
    scene / 255, truth, lambda depth: blur_from_depth(depth, lens), noise_variance=1e-5, rng=0
)

# %%
# The blur, and the distance
# --------------------------
#
# The blur says how far something is from the plane in focus, but not on which side. Here everything
# is farther away: ``side="far"``. In a terminal: ``napari-defocus depth photo.jpg --focal-length 50
# --f-number 2 --focus-distance 2 --pixel-pitch 36 --side far``.

candidates = estimate_candidates(seen)
blur_map = label_blur_map(candidates, seen)
sure = confidence_map(candidates, blur_map) >= 0.5
depth = depth_from_blur(blur_map, lens, side="far")

figure, axes = plt.subplots(1, 3, figsize=(10.0, 2.8))
axes[0].imshow(seen.clip(0, 1))
axes[0].set_title("through the lens")
for each, title, values in (
    (axes[1], "true distance (m)", truth),
    (axes[2], "distance found (m), where it is sure", np.where(sure, depth, np.nan)),
):
    shown = each.imshow(values, vmin=2, vmax=5, cmap="cividis")
    each.set_title(title)
for each in axes:
    each.set_axis_off()
figure.colorbar(shown, ax=axes, shrink=0.8)

# %%
# How well does it fit?

error = np.abs(depth - truth)[sure] / truth[sure]
print(f"sure on {sure.mean():.0%} of the picture; there, half of the distances are within")
print(f"{np.median(error):.1%} of the truth, and {np.mean(error < 0.1):.0%} are within 10 %")

# %%
# Distances get worse far from the focus: there the blur hardly grows any more. A phone has such a
# small lens that its distances end after a metre or two.
