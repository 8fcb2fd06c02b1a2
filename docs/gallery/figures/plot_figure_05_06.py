"""
Figures 5 and 6: where the likeliest radius is wrong
====================================================

If the best maximum is wrong, the second best is often right.

A picture was blurred by 5 px everywhere, and every window of it is measured. The likeliest radius
is right nearly everywhere, but there are holes. There, the second maximum is mostly the truth.
That is why the method keeps three candidates of every window, and lets the neighbours choose.
"""

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from scipy.ndimage import distance_transform_edt
from skimage.data import astronaut

from napari_defocus import estimate_candidates, simulate_defocus

TRUE_RADIUS, NOISE_VARIANCE = 5.0, 1e-7
REACH = 20
COLORS = ("#0072b2", "#d55e00", "#009e73")

halves = astronaut().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3))
sharp = halves @ [0.299, 0.587, 0.114] / 255
true_map = np.full(sharp.shape, TRUE_RADIUS)
blurred = simulate_defocus(sharp, true_map, noise_variance=NOISE_VARIANCE, rng=0)

# %%
# ``mode="paper"`` is the likelihood (5) as it stands.

candidates = estimate_candidates(blurred, noise_variance=NOISE_VARIANCE, stride=2, mode="paper")
first, second = (np.abs(candidates.radii[..., k] - TRUE_RADIUS) for k in (0, 1))
holes = first > 0.5
print(f"the best maximum is wrong by more than 0.5 px on {holes.mean():.1%} of the windows")
print(f"of these, the second is right on {(second[holes] <= 0.5).mean():.0%}")

# %%
# For Figure 6, take a window whose best maximum is right, and two whose second maximum is right.
# Take each from the middle of a part of the picture where the same holds.

row, column = np.meshgrid(candidates.row_centers, candidates.column_centers, indexing="ij")
inside = np.minimum(row, row.max() - row) > 2 * REACH
inside &= np.minimum(column, column.max() - column) > 2 * REACH
places = []
for part in (first < 0.05, (first > 1) & (second < 0.2), (first > 1) & (second < 0.2)):
    depth = distance_transform_edt(part) * inside
    for y, x in places:
        depth[np.hypot(row - y, column - x) < 2 * REACH] = 0
    i, j = np.unravel_index(depth.argmax(), depth.shape)
    places.append((float(row[i, j]), float(column[i, j])))

# %%
# **Figure 5.** Dots are the places of Figure 6; grey has no second maximum.

figure, grid = plt.subplots(2, 2, figsize=(6.6, 6.2))
height, width = sharp.shape
extent = (0, width, height, 0)
pictures = {"(a) sharp picture": sharp, "(b) blurred by a disc of $r^*$ = 5 px": blurred}
for axes, (title, picture) in zip(grid[0], pictures.items(), strict=True):
    axes.imshow(picture, cmap="gray", vmin=0, vmax=1, extent=extent)
    axes.set_title(title)
colors = mpl.colormaps["viridis"].with_extremes(bad="0.8")
titles = (r"(c) global maximum $\hat{r}_1$", r"(d) second maximum $\hat{r}_2$")
for k, (axes, title) in enumerate(zip(grid[1], titles, strict=True)):
    shown = axes.imshow(candidates.radii[..., k], cmap=colors, vmin=0, vmax=8, extent=extent)
    axes.set_title(title)
    for (y, x), color in zip(places, COLORS, strict=True):
        axes.plot(x, y, "o", mfc=color, mec="w", ms=7)
for axes in grid.flat:
    # Nearer to the border windows do not fit.
    axes.set(xlim=(REACH + 1, width - REACH - 1), ylim=(height - REACH - 1, REACH + 1))
    axes.set(xticks=[50, 100, 150, 200], yticks=[50, 100, 150, 200])
    axes.label_outer()
figure.colorbar(shown, ax=grid[1], label="radius (px)", shrink=0.9)

# %%
# **Figure 6.** The curves of the three windows, both gradients added.

figure, axes = plt.subplots(figsize=(6.4, 3.8))
kinds = ("global maximum is right", "second maximum is right", "second maximum is right")
for (y, x), color, kind in zip(places, COLORS, kinds, strict=True):
    scales, curve = candidates.log_likelihood_at(y, x)
    label = f"({y:.0f}, {x:.0f}): {kind}"
    axes.plot(scales, curve - curve.max(), color=color, lw=1.4, label=label)
axes.axvline(TRUE_RADIUS, color="k", lw=1, label="true radius")
axes.set(xlim=(0, 8), ylim=(-60, 2), xlabel="radius $r$ (px)")
axes.set(ylabel=r"$\log p(r)$ below its maximum (nats)")
axes.spines[["top", "right"]].set_visible(False)
axes.legend(loc="upper left", title="pixel (row, column)", alignment="left")
