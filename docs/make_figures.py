"""Draw figures 3 to 6 of the paper with this package, from a picture of scikit-image.

``python docs/make_figures.py [folder]`` writes figure-3.png to figure-6.png, into docs/images
unless told otherwise.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from skimage.data import astronaut

from napari_defocus import BlurCandidates, Disc, estimate_candidates, simulate_defocus
from napari_defocus.gabor import gradients, local_power
from napari_defocus.likelihood import noise_power, profile_log_likelihood
from napari_defocus.spectrum import label_scales, spectrum_table

Array = NDArray[np.floating]
Place = tuple[float, float]

TRUE_RADIUS = 5.0
NOISE_VARIANCE = 1e-7
WINDOW = 41
REACH = WINDOW // 2
SCALES = label_scales(Disc())
STRENGTHS = np.geomspace(1e-4, 1, 601)
DEPTH = 60.0
"""How far below its maximum log p(r, s) is shown."""

COLORS = ("#0072b2", "#d55e00", "#009e73")
STYLE = {
    "savefig.dpi": 140,
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "image.interpolation": "nearest",
    "legend.frameon": False,
    "legend.fontsize": 8,
}


def main(folder: Path) -> None:
    """Write the four figures."""
    mpl.use("agg")
    mpl.rcParams.update(STYLE)
    sharp = sharp_picture()
    blurred = simulate_defocus(
        sharp, np.full(sharp.shape, TRUE_RADIUS), noise_variance=NOISE_VARIANCE, rng=0
    )
    likely, second = patches_of_figures_3_and_4(blurred)
    candidates = estimate_candidates(blurred, noise_variance=NOISE_VARIANCE, stride=2, mode="paper")
    places = places_of_figure_6(candidates)
    figures = {
        "figure-3": draw_patch(sharp, blurred, likely),
        "figure-4": draw_patch(sharp, blurred, second),
        "figure-5": draw_maps(sharp, blurred, candidates, places),
        "figure-6": draw_curves(blurred, places),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        figure.savefig(path, pil_kwargs={"optimize": True})
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def sharp_picture() -> Array:
    """Return a photograph at half its size, so that it is as sharp as its pixels: [0, 1]."""
    halves = astronaut().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3))
    return halves @ [0.299, 0.587, 0.114] / 255


def power_around(picture: Array, rows: Array, columns: Array) -> Array:
    """Return |g_i|^2 of (4) of the windows around a lattice of places: (R, C, 2, F)."""
    gradient = gradients(picture.astype(np.float32), None, WINDOW)
    return local_power(gradient, rows, columns, WINDOW)


def log_likelihoods(power: Array, scales: Array, strengths: Array) -> Array:
    """Evaluate the logarithm of (5) over s and r, horizontal gradient alone: (R, C, S, L)."""
    table = spectrum_table(Disc(), WINDOW, 0.0, 0.0, "exact")
    noise = noise_power(table, NOISE_VARIANCE)[0]
    variance = strengths[:, None, None] * table.at(scales)[:, 0] + noise
    linear = np.einsum("ijf,slf->ijsl", power[:, :, 0], 1 / variance, optimize=True)
    return -linear - np.log(variance).sum(axis=2)


def patches_of_figures_3_and_4(blurred: Array) -> tuple[Place, Place]:
    """Find a patch whose true radius is by far the likeliest, and one where it is second."""
    centers = np.arange(REACH + 2.0, len(blurred) - REACH - 2, 6)
    power = power_around(blurred, centers, centers)
    profiles = log_likelihoods(power, SCALES, STRENGTHS[::5]).max(axis=2)
    true = int(np.argmin(np.abs(SCALES - TRUE_RADIUS)))
    near = np.abs(np.arange(len(SCALES)) - true) <= 5
    top, elsewhere = profiles[..., near].max(axis=2), profiles[..., ~near].max(axis=2)
    stands_out = top - np.maximum(profiles[..., true - 5], profiles[..., true + 5])
    at_true = profiles[..., near].argmax(axis=2) == 5
    likely = np.where(at_true, top - elsewhere, -np.inf)
    second = np.where(at_true & (elsewhere - top > 2), stands_out, -np.inf)
    return _best_place(likely, centers), _best_place(second, centers)


def _best_place(score: Array, centers: Array) -> Place:
    row, column = np.unravel_index(score.argmax(), score.shape)
    return float(centers[row]), float(centers[column])


def draw_patch(sharp: Array, blurred: Array, place: Place) -> Figure:
    """Draw Fig. 3 or 4: patch, blurred patch, PSF, and log p(r, s)."""
    figure = plt.figure(figsize=(7.2, 4.4), layout="constrained")
    left, right = figure.add_gridspec(1, 2, width_ratios=[1, 2.7])
    grid = left.subgridspec(3, 1)
    window = tuple(slice(int(center) - REACH, int(center) + REACH + 1) for center in place)
    darkest, brightest = sharp[window].min(), sharp[window].max()
    for k, (title, picture) in enumerate(
        [("(a) sharp patch", sharp[window]), ("(b) blurred patch", blurred[window])]
    ):
        axes = figure.add_subplot(grid[k])
        axes.imshow(
            picture, cmap="gray", vmin=darkest, vmax=brightest, extent=(0, WINDOW, WINDOW, 0)
        )
        axes.set(title=title, xticks=[0, 20, 40], yticks=[0, 20, 40], ylabel="px")
    axes = figure.add_subplot(grid[2])
    kernel = Disc().kernel(TRUE_RADIUS)
    half = len(kernel) / 2
    axes.imshow(kernel, cmap="gray", extent=(-half, half, half, -half))
    axes.set(title="(c) disc of 5 px", xticks=[-5, 0, 5], yticks=[-5, 0, 5])
    axes.set(xlabel="px", ylabel="px")
    draw_surface(figure, figure.add_subplot(right), blurred, place)
    return figure


def draw_surface(figure: Figure, axes: Axes, blurred: Array, place: Place) -> None:
    """Draw log p(r, s) below its maximum, the best s of every r, and the truth."""
    row, column = place
    power = power_around(blurred, np.array([row]), np.array([column]))
    scales = np.arange(0, SCALES[-1] + 0.01, 0.02)
    surface = log_likelihoods(power, scales, STRENGTHS)[0, 0]
    surface -= surface.max()
    shown = axes.pcolormesh(
        scales, STRENGTHS, surface, cmap="magma", vmin=-DEPTH, vmax=0, shading="nearest"
    )
    axes.contour(
        scales, STRENGTHS, surface, [-40, -20, -10, -5], colors="w", linewidths=0.4, linestyles="-"
    )
    ridge = STRENGTHS[surface.argmax(axis=0)]
    axes.plot(scales, ridge, "w--", lw=1, label=r"$\hat{s}(r)$, (9)")
    axes.axvline(TRUE_RADIUS, color="#56b4e9", lw=1.2, label="true radius")
    best = surface.max(axis=0).argmax()
    axes.plot(scales[best], ridge[best], "wo", mec="k", ms=6, ls="", label="global maximum")
    axes.set(
        yscale="log",
        xlim=(0, SCALES[-1]),
        ylim=STRENGTHS[[0, -1]],
        xlabel="radius $r$ (px)",
        ylabel="gradient variance $s$ (intensity$^2$)",
        title=r"(d) $\log p(r, s)$, horizontal gradient",
    )
    axes.legend(loc="upper left", labelcolor="w")
    figure.colorbar(shown, ax=axes, label="below the maximum (nats)", extend="min", pad=0.02)


def places_of_figure_6(candidates: BlurCandidates) -> list[Place]:
    """Find a pixel that is right at once, and two whose second maximum is the right one.

    They lie deepest within the parts of the picture of which that is true.
    """
    first, second = (np.abs(candidates.radii[..., k] - TRUE_RADIUS) for k in (0, 1))
    parts = [first < 0.05, (first > 1) & (second < 0.2), (first > 1) & (second < 0.2)]
    row, column = np.meshgrid(candidates.row_centers, candidates.column_centers, indexing="ij")
    inside = np.minimum(row, row.max() - row) > WINDOW
    inside &= np.minimum(column, column.max() - column) > WINDOW
    places: list[Place] = []
    for part in parts:
        depth = distance_transform_edt(part) * inside
        for y, x in places:
            depth[np.hypot(row - y, column - x) < WINDOW] = 0
        i, j = np.unravel_index(depth.argmax(), depth.shape)
        places.append((float(row[i, j]), float(column[i, j])))
    return places


def draw_maps(
    sharp: Array, blurred: Array, candidates: BlurCandidates, places: list[Place]
) -> Figure:
    """Draw Fig. 5: the pictures, and the radii of the highest and second highest maximum."""
    figure, grid = plt.subplots(2, 2, figsize=(6.4, 6.0), layout="constrained")
    height, width = sharp.shape
    extent = (0, width, height, 0)
    pictures = [("(a) sharp picture", sharp), ("(b) blurred by a disc of $r^*$ = 5 px", blurred)]
    for axes, (title, picture) in zip(grid[0], pictures, strict=True):
        axes.imshow(picture, cmap="gray", vmin=0, vmax=1, extent=extent)
        axes.set_title(title)
    colors = mpl.colormaps["viridis"].with_extremes(bad="0.8")
    titles = (r"(c) global maximum $\hat{r}_1$", r"(d) second maximum $\hat{r}_2$")
    for k, (axes, title) in enumerate(zip(grid[1], titles, strict=True)):
        shown = axes.imshow(
            candidates.radii[..., k], cmap=colors, vmin=0, vmax=SCALES[-1], extent=extent
        )
        axes.set_title(title)
        for (row, column), color in zip(places, COLORS, strict=True):
            axes.plot(column, row, "o", mfc=color, mec="w", ms=7)
    for axes in grid.flat:
        # Nearer to the border the windows do not fit.
        axes.set(xlim=(REACH + 1, width - REACH - 1), ylim=(height - REACH - 1, REACH + 1))
        axes.set(xticks=[50, 100, 150, 200], yticks=[50, 100, 150, 200])
        axes.label_outer()
    for axes in grid[:, 0]:
        axes.set_ylabel("row (px)")
    for axes in grid[1]:
        axes.set_xlabel("column (px)")
    figure.colorbar(shown, ax=grid[1], label="radius (px)", shrink=0.9)
    return figure


def draw_curves(blurred: Array, places: list[Place]) -> Figure:
    """Draw Fig. 6: log p(r) at three pixels of Fig. 5, both gradients added."""
    figure, axes = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
    kinds = ("global maximum is right", "second maximum is right", "second maximum is right")
    for (row, column), color, kind in zip(places, COLORS, kinds, strict=True):
        power = power_around(blurred, np.array([row]), np.array([column]))[0]
        table = spectrum_table(Disc(), WINDOW, row % 1, column % 1, "exact")
        curve = profile_log_likelihood(power, table, table.scales, NOISE_VARIANCE)[0]
        label = f"({row:.0f}, {column:.0f}): {kind}"
        axes.plot(table.scales, curve - curve.max(), color=color, lw=1.4, label=label)
    axes.axvline(TRUE_RADIUS, color="k", lw=1, label="true radius")
    axes.set(
        xlim=(0, SCALES[-1]),
        ylim=(-DEPTH, 2),
        xlabel="radius $r$ (px)",
        ylabel=r"$\log p(r)$ below its maximum (nats)",
    )
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper left", title="pixel (row, column)", alignment="left")
    return figure


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "images")
