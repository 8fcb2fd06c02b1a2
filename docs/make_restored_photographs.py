"""Show photographs before and after their blur was taken away, without ground truth.

``python docs/make_restored_photographs.py PHOTOGRAPHS [folder]`` writes NAME-restored.jpg for the
photographs named below, into docs/images/photographs unless told otherwise: the picture on the
left, all in focus on the right, at full size. All settings are the defaults.
"""

import sys
from pathlib import Path

import imageio.v3 as imageio
import numpy as np

from napari_defocus import (
    cautious_blur_map,
    confidence_map,
    estimate_candidates,
    label_blur_map,
    restore_all_in_focus,
)

NAMES = ("brushes", "dandelion", "ladybird")


def main(photographs: Path, folder: Path) -> None:
    """Write a JPEG for every named photograph."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in NAMES:
        picture = imageio.imread(photographs / f"{name}.jpg")[..., :3]
        candidates = estimate_candidates(picture)
        blur_map = label_blur_map(candidates, picture)
        restored = restore_all_in_focus(
            picture,
            cautious_blur_map(candidates, blur_map),
            noise_variance=candidates.noise_variance,
            confidence=confidence_map(candidates, blur_map),
        )
        both = np.hstack([picture, np.rint(255 * restored).astype(np.uint8)])
        path = folder / f"{name}-restored.jpg"
        imageio.imwrite(path, both, quality=75)
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        raise SystemExit(__doc__)
    images = Path(__file__).parent / "images" / "photographs"
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) == 3 else images)
