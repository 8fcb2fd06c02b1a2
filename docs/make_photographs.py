"""Show the paper's plain method beside this package's on photographs, without ground truth.

``python docs/make_photographs.py PHOTOGRAPHS [folder]`` writes a JPEG for every photograph of a
folder, into docs/images/photographs unless told otherwise: the picture, the map and the mask of
mode "paper", and those of the default. All settings are the defaults.
"""

import sys
from pathlib import Path

import imageio.v3 as imageio
import matplotlib as mpl
from matplotlib import pyplot as plt

from napari_defocus import Disc, estimate_candidates, label_blur_map, segment_in_focus

LARGEST_PIXELS = 1_000_000


def main(photographs: Path, folder: Path) -> None:
    """Write a JPEG for every photograph that is not too large."""
    mpl.use("agg")
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(photographs.glob("*.jpg")):
        picture = imageio.imread(path)[..., :3]
        if picture.shape[0] * picture.shape[1] > LARGEST_PIXELS:
            continue
        figure, axes = plt.subplots(1, 5, figsize=(15, 2.4), layout="constrained")
        axes[0].imshow(picture)
        axes[0].set_title(path.stem, loc="left", fontsize=9)
        for mode, name, (of_map, of_mask) in (
            ("paper", "the paper's plain method", axes[1:3]),
            ("curve", "default", axes[3:5]),
        ):
            candidates = estimate_candidates(picture, mode=mode)
            image = of_map.imshow(
                label_blur_map(candidates, picture), vmin=0, vmax=Disc().max_radius
            )
            of_map.set_title(f"{name}: radius, px", loc="left", fontsize=9)
            of_mask.imshow(segment_in_focus(candidates, picture), cmap="gray", vmin=0, vmax=1)
            of_mask.set_title("in focus", loc="left", fontsize=9)
        figure.colorbar(image, ax=axes[3], shrink=0.8)
        for each in axes:
            each.set_axis_off()
        figure.savefig(folder / f"{path.stem}.jpg", dpi=90, pil_kwargs={"quality": 85})
        plt.close(figure)


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        raise SystemExit(__doc__)
    images = Path(__file__).parent / "images" / "photographs"
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) == 3 else images)
