"""Draw figure 8 of the paper with this package, from a picture of scikit-image.

``python docs/make_figure_8.py [folder]`` writes figure-8.png, into docs/images unless told
otherwise: a picture with a blur that changes everywhere, what is left of the blur when nothing
is known of it, the true and the estimated map, and zooms; with PSNR and SSIM, 20 px at the
border left out.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from skimage.data import astronaut
from skimage.metrics import structural_similarity

from napari_defocus import (
    cautious_blur_map,
    confidence_map,
    estimate_candidates,
    label_blur_map,
    restore_all_in_focus,
    simulate_defocus,
)

Array = NDArray[np.floating]

NOISE_VARIANCE = 1e-6
LOW, HIGH = 0.9, 5.1
INNER = np.s_[20:-20, 20:-20]
ZOOMS = ((60, 95), (165, 55))
ZOOM = 50
COLORS = ("#ffd400", "#00e5ff")
STYLE = {"font.size": 9, "axes.titlesize": 9, "axes.titlelocation": "left", "savefig.dpi": 140}


def main(folder: Path) -> None:
    """Write the figure."""
    mpl.use("agg")
    mpl.rcParams.update(STYLE)
    sharp = astronaut().reshape(256, 2, 256, 2, 3).mean(axis=(1, 3)) / 255
    row, column = np.indices(sharp.shape[:2]) / 255
    truth = LOW + (HIGH - LOW) * (0.3 * column + 0.7 * row)
    seen = simulate_defocus(sharp, truth, noise_variance=NOISE_VARIANCE, rng=0)
    candidates = estimate_candidates(seen)
    blur_map = label_blur_map(candidates, seen)
    restored = restore_all_in_focus(
        seen,
        cautious_blur_map(candidates, blur_map),
        confidence=confidence_map(candidates, blur_map),
    )
    figure, axes = plt.subplots(2, 4, figsize=(12, 6.3), layout="constrained")
    error = np.mean((blur_map - truth) ** 2)
    pictures = {
        f"(a) input: {quality(seen, sharp)}": seen,
        f"(b) restored: {quality(restored, sharp)}": restored,
    }
    for each, (title, picture) in zip(axes[0, :2], pictures.items(), strict=True):
        draw(each, picture, title)
        for (top, left), color in zip(ZOOMS, COLORS, strict=True):
            each.add_patch(Rectangle((left, top), ZOOM, ZOOM, fill=False, color=color, lw=1.2))
    for each, values, title in (
        (axes[0, 2], truth, "(c) true radius, px"),
        (axes[0, 3], blur_map, f"(d) estimated: mean squared error {error:.3f} px²"),
    ):
        image = each.imshow(values, vmin=0, vmax=HIGH)
        each.set_title(title)
        each.set_axis_off()
    figure.colorbar(image, ax=axes[0, 3], shrink=0.85)
    letters = iter("efgh")
    for (top, left), color, pair in zip(ZOOMS, COLORS, (axes[1, :2], axes[1, 2:]), strict=True):
        for each, picture, name in zip(pair, (seen, restored), ("of (a)", "of (b)"), strict=True):
            zoom = picture[top : top + ZOOM, left : left + ZOOM]
            draw(each, zoom, f"({next(letters)}) zoom {name}")
            each.set_axis_on()
            each.set(xticks=[], yticks=[])
            each.spines[:].set(color=color, linewidth=2)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "figure-8.png"
    figure.savefig(path, pil_kwargs={"optimize": True})
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB; {'; '.join(pictures)}")


def quality(picture: Array, truth: Array) -> str:
    """Say how near a picture is to the sharp one."""
    inner, expected = picture.clip(0, 1)[INNER], truth[INNER].astype(np.float32)
    decibels = -10 * np.log10(np.mean((inner - expected) ** 2))
    similarity = structural_similarity(inner, expected, data_range=1, channel_axis=2)
    return f"{decibels:.1f} dB, SSIM {similarity:.3f}"


def draw(axes: Axes, picture: Array, title: str) -> None:
    """Show a picture in [0, 1]."""
    axes.imshow(picture.clip(0, 1))
    axes.set_title(title)
    axes.set_axis_off()


if __name__ == "__main__":
    if len(sys.argv) > 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]) if len(sys.argv) == 2 else Path(__file__).parent / "images")
