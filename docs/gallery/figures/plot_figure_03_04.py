r"""
Figures 3 and 4: the likelihood of one window
=============================================

Is the most likely radius the true one?

A picture is blurred by a disc of 5 px, and noise of variance :math:`10^{-7}` is added. For one
window of 41 px, :math:`\log p` of (5) is drawn over the radius :math:`r` and the variance
:math:`s` of the gradients before the blur. On some windows the highest point lies at the true
radius (Figure 3). On others the truth is a maximum, but another one is higher (Figure 4): a window
alone cannot decide, its neighbours have to.
"""

import numpy as np
from matplotlib import pyplot as plt
from skimage.data import astronaut

from napari_defocus import Disc, simulate_defocus
from napari_defocus.likelihood.blur_spectra import label_scales, spectrum_table
from napari_defocus.likelihood.gabor import gradients, local_power
from napari_defocus.likelihood.profile_likelihood import noise_power

TRUE_RADIUS, NOISE_VARIANCE = 5.0, 1e-7
WINDOW, REACH = 41, 20
SCALES = label_scales(Disc(8.0))
STRENGTHS = np.geomspace(1e-4, 1, 601)
DEPTH = 60.0  # how far below its maximum log p is shown

# %%
# At half its size, the photograph is as sharp as its pixels.

halves = astronaut().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3))
sharp = halves @ [0.299, 0.587, 0.114] / 255
true_map = np.full(sharp.shape, TRUE_RADIUS)
blurred = simulate_defocus(sharp, true_map, noise_variance=NOISE_VARIANCE, rng=0)

# %%
# The likelihood of a window needs the local powers of its gradient (3)(4) and the spectra of blur
# and noise (6)(7). As in the paper's figures, this is the horizontal gradient alone.


def log_likelihoods(power, scales, strengths):
    """Evaluate log p of (5) for windows (R, C): (R, C, strengths, scales)."""
    table = spectrum_table(Disc(8.0), WINDOW, 0.0, 0.0, "exact")
    noise = noise_power(table, NOISE_VARIANCE)[0]
    variance = strengths[:, None, None] * table.at(scales)[:, 0] + noise
    linear = np.einsum("ijf,slf->ijsl", power[:, :, 0], 1 / variance, optimize=True)
    return -linear - np.log(variance).sum(axis=2)


def power_around(rows, columns):
    """Return the powers of the windows around a lattice of places: (R, C, 2, 60)."""
    gradient = gradients(blurred.astype(np.float32), None, WINDOW)
    return local_power(gradient, np.asarray(rows), np.asarray(columns), WINDOW)


# %%
# Look for a window whose true radius stands out, and for one where another radius wins.

centers = np.arange(REACH + 2.0, len(blurred) - REACH - 2, 6)
profiles = log_likelihoods(power_around(centers, centers), SCALES, STRENGTHS[::5]).max(axis=2)
true = int(np.argmin(np.abs(SCALES - TRUE_RADIUS)))
near = np.abs(np.arange(len(SCALES)) - true) <= 5
top, elsewhere = profiles[..., near].max(axis=2), profiles[..., ~near].max(axis=2)
stands_out = top - np.maximum(profiles[..., true - 5], profiles[..., true + 5])
at_true = profiles[..., near].argmax(axis=2) == 5


def best_place(score):
    """Return row and column of the window with the highest score."""
    row, column = np.unravel_index(score.argmax(), score.shape)
    return float(centers[row]), float(centers[column])


likely = best_place(np.where(at_true, top - elsewhere, -np.inf))
second = best_place(np.where(at_true & (elsewhere - top > 2), stands_out, -np.inf))

# %%
# Each figure: the patch, the patch blurred, the PSF, and the surface.


def draw_pictures(figure, grid, place):
    """Draw (a) to (c)."""
    window = tuple(slice(int(center) - REACH, int(center) + REACH + 1) for center in place)
    low, high = sharp[window].min(), sharp[window].max()
    kernel = Disc().kernel(TRUE_RADIUS)
    pictures = {
        "(a) sharp patch": (sharp[window], low, high),
        "(b) blurred patch": (blurred[window], low, high),
        "(c) disc of 5 px": (kernel, 0, kernel.max()),
    }
    for cell, (title, (values, dark, bright)) in zip(grid, pictures.items(), strict=True):
        axes = figure.add_subplot(cell)
        axes.imshow(values, cmap="gray", vmin=dark, vmax=bright)
        axes.set(title=title, xticks=[], yticks=[])


def draw_surface(figure, axes, place):
    """Draw (d): log p(r, s) below its maximum, the best s of every r, and the truth."""
    scales = np.arange(0, SCALES[-1] + 0.01, 0.02)
    surface = log_likelihoods(power_around([place[0]], [place[1]]), scales, STRENGTHS)[0, 0]
    surface -= surface.max()
    shown = axes.pcolormesh(
        scales, STRENGTHS, surface, cmap="magma", vmin=-DEPTH, vmax=0, shading="nearest"
    )
    axes.contour(scales, STRENGTHS, surface, [-40, -20, -10, -5], colors="w", linewidths=0.4)
    ridge = STRENGTHS[surface.argmax(axis=0)]
    best = surface.max(axis=0).argmax()
    axes.plot(scales, ridge, "w--", lw=1, label=r"$\hat{s}(r)$, (9)")
    axes.axvline(TRUE_RADIUS, color="#56b4e9", lw=1.2, label="true radius")
    axes.plot(scales[best], ridge[best], "wo", mec="k", ms=6, ls="", label="global maximum")
    axes.set(yscale="log", xlim=(0, SCALES[-1]), ylim=STRENGTHS[[0, -1]], xlabel="radius $r$ (px)")
    axes.set(ylabel="gradient variance $s$ (intensity$^2$)", title=r"(d) $\log p(r, s)$")
    axes.legend(loc="upper left", labelcolor="w")
    figure.colorbar(shown, ax=axes, label="below the maximum (nats)", extend="min", pad=0.02)


def draw(place):
    """Draw Figure 3 or 4."""
    figure = plt.figure(figsize=(7.2, 4.4))
    left, right = figure.add_gridspec(1, 2, width_ratios=[1, 2.7])
    draw_pictures(figure, left.subgridspec(3, 1), place)
    draw_surface(figure, figure.add_subplot(right), place)


# %%
# **Figure 3**, the global maximum is the true radius:

draw(likely)

# %%
# **Figure 4**, it is not, but there is a maximum at the truth. The spectrum of a disc has zeros
# that move with the radius: radii that share some of them look alike.

draw(second)
