"""
Two depths in one window
========================

The paper's first problem: where a window sees two blurs, the sharper one wins.

What is sharp has more power. So, before labels are chosen, sharp things look larger by the radius
of a window. The labelling has to bring the outline back to an edge of the picture. The default
also asks windows on each place's own side. Where the blur jumps and the colour does not, the
outline is a guess.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut, grass

from napari_defocus import estimate_candidates, label_blur_map, simulate_layered_defocus

texture = grass()[:400, :400].reshape(200, 2, 200, 2).mean(axis=(1, 3)) / 255
portrait = astronaut()[:400, 40:440].reshape(200, 2, 200, 2, 3).mean(axis=(1, 3)) / 255
row, column = np.indices((200, 200))
near = np.hypot(row - 100, column - 100) < 50
scenes = {
    "another colour": np.where(near[..., None], portrait, texture[..., None]),
    "the same texture": np.where(near[..., None], texture[::-1, :, None], texture[..., None]),
}

figure, grid = plt.subplots(2, 4, figsize=(10.0, 5.0))
for axes, (name, scene) in zip(grid, scenes.items(), strict=True):
    scene = np.broadcast_to(scene, (200, 200, 3))
    seen, truth = simulate_layered_defocus(
        scene, np.where(near, 1.0, 2.0), lambda d: 5.0 * (d - 1), noise_variance=1e-5, rng=0
    )
    axes[0].imshow(seen.clip(0, 1))
    axes[0].set_title(f"sharp disc, {name}")
    plain = estimate_candidates(seen, mode="paper")
    maps = {
        "likeliest radii of windows": plain.radii[..., 0],
        "map, the paper's": label_blur_map(plain, seen),
        "map, default": label_blur_map(estimate_candidates(seen), seen),
    }
    for each, (title, values) in zip(axes[1:], maps.items(), strict=True):
        shown = each.imshow(values, vmin=0, vmax=8, extent=(0, 200, 200, 0))
        each.contour(near, [0.5], colors="w", linewidths=0.8)
        each.set_title(title)
        if values.shape == truth.shape:
            rim = (np.abs(np.hypot(row - 100, column - 100) - 50)) < 10
            error = np.abs(values - truth)[rim].mean()
            each.set_title(f"{title}: {error:.2f} px")
for axes in grid.flat:
    axes.set_axis_off()
figure.colorbar(shown, ax=grid, label="radius (px)", shrink=0.7)

# %%
# White: the true outline. The numbers are the mean error within 10 px of it.
