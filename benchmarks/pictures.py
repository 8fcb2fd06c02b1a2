"""Sharp pictures to blur, photographs, and maps of blur: what the benchmarks share."""

from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import skimage.data
from skimage.transform import resize
from skimage.util import img_as_float

SIDE = 300
SHIPPED = ("astronaut", "brick", "camera", "chelsea", "coffee", "grass", "gravel")
SAMPLES = Path(__file__).parents[1] / "src" / "napari_defocus" / "samples"
OUTLINES = Path(__file__).parent / "masks"


def sharp_pictures(folder: Path) -> dict[str, np.ndarray]:
    """Read the middle 300 x 300 px of every picture of a folder.

    Without the folder, take pictures that scikit-image ships, scaled down so that they are
    sharp at the scale of a pixel.
    """
    paths = picture_paths(folder)
    if paths:
        return {path.stem: middle(imageio.imread(path)[..., :3]) for path in paths}
    print(f"{folder} holds no pictures; taking those of scikit-image")
    return {name: middle(shipped_picture(name)) for name in SHIPPED}


def whole_sharp_pictures(folder: Path | None) -> dict[str, np.ndarray]:
    """Read every picture of a folder, or those of scikit-image: (H, W) or (H, W, 3), [0, 1]."""
    if folder is None:
        return {name: shipped_picture(name) for name in SHIPPED}
    paths = picture_paths(folder)
    if len(paths) < 2:
        raise SystemExit(f"--data is {folder}; it takes a folder of two or more PNG or JPEG files")
    return {path.stem: img_as_float(imageio.imread(path)[..., :3]) for path in paths}


def picture_paths(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.png")) + sorted(folder.glob("*.jpg"))


def shipped_picture(name: str) -> np.ndarray:
    return halved(getattr(skimage.data, name)())


def photographs(folder: Path | None) -> dict[str, np.ndarray]:
    """Read the outlined photographs of a folder, or those that the package ships: uint8."""
    names = (path.stem for path in sorted(OUTLINES.glob("*.json")))
    paths = [(folder or SAMPLES) / f"{name}.jpg" for name in names]
    found = {path.stem: imageio.imread(path)[..., :3] for path in paths if path.exists()}
    if not found:
        raise SystemExit(f"--photos is {folder}; it holds none of the outlined photographs")
    return found


def halved(picture: np.ndarray) -> np.ndarray:
    """Scale down by 2, or by less if a side would end below 300 px."""
    factor = max(0.5, SIDE / min(picture.shape[:2]))
    shape = [max(SIDE, round(length * factor)) for length in picture.shape[:2]]
    return resize(picture, (*shape, *picture.shape[2:]), anti_aliasing=True)


def middle(picture: np.ndarray, side: int = SIDE) -> np.ndarray:
    top, left = ((length - side) // 2 for length in picture.shape[:2])
    return picture[top : top + side, left : left + side]


def ramp(side: int = SIDE) -> np.ndarray:
    """0.92 + 0.003 x + 0.011 y px."""
    row, column = np.indices((side, side))
    return 0.92 + 0.003 * column + 0.011 * row


def bumps(side: int = SIDE) -> np.ndarray:
    """Hills and valleys from 0.5 to 7 px, one period across the picture each way."""
    row, column = np.indices((side, side)) * 2 * np.pi / side
    return 0.5 + 6.5 * (1 - np.cos(column) * np.cos(row)) / 2


def uniform(radius: float, side: int = SIDE) -> np.ndarray:
    return np.full((side, side), float(radius))


def at_windows(truth: np.ndarray, candidates) -> np.ndarray:
    """Return the true radius in the middle of each window, which may lie between pixels."""
    values = truth
    for axis, centers in enumerate((candidates.row_centers, candidates.column_centers)):
        low, high = np.floor(centers).astype(int), np.ceil(centers).astype(int)
        values = (values.take(low, axis) + values.take(high, axis)) / 2
    return values
