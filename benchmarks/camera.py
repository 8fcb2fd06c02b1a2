"""How much of the accuracy is left after a camera has been at work.

    python benchmarks/camera.py --data FOLDER_OF_SHARP_PICTURES

The camera: sharp pictures are decoded into linear light and blurred by a known map at twice the
radii; photons and the sensor make noise; denoising, encoding for a display, sharpening, scaling
down by 2, 8 bits and a JPEG of quality 75 to 95 follow. Clean: the sharp pictures scaled down
by 2, blurred by the map as they are, with noise of variance 1e-6.

Prints a Markdown table: the mean absolute error of the map in px for both, and their ratio; with
a wall and a sky painted in, also on these alone, a quarter of a window away from their edges.
"""

import argparse
import io
from collections.abc import Callable
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from pictures import bumps, middle, ramp
from scipy.ndimage import binary_erosion, gaussian_filter
from skimage.restoration import denoise_nl_means
from skimage.util import img_as_float

from napari_defocus import Disc, estimate_blur_map, simulate_defocus
from napari_defocus.core.image import decode_srgb, encode_srgb

SIDE = 232
GAIN, READ_VARIANCE = 2e-4, 1e-6
MAPS = {"ramp": ramp(SIDE), "bumps": bumps(SIDE)}
LUMA = np.array([0.299, 0.587, 0.114])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "sharp"
    parser.add_argument("--data", type=Path, default=shared, help="folder of sharp pictures")
    parser.add_argument("--mode", default="curve", choices=("curve", "paper"))
    parser.add_argument("--linearize", choices=("srgb",), help="decode the camera's pictures")
    arguments = parser.parse_args()
    pictures = large_pictures(arguments.data)
    print(f"mode {arguments.mode}; {', '.join(pictures)}\n")
    print(
        "| blur | pictures | pixels | clean MAE | camera MAE | camera / clean |\n"
        + "|---" * 6
        + "|"
    )
    for blur, truth in MAPS.items():
        for content, paint in {"as they are": None, "wall and sky": with_flats}.items():
            errors = np.array(
                [
                    errors_of(picture, truth, number, paint, arguments)
                    for number, picture in enumerate(pictures.values())
                ]
            )
            inner = binary_erosion(flats(SIDE), iterations=10)
            parts = {"all": np.ones_like(inner)}
            if paint:
                parts |= {"flat": inner, "others": ~flats(SIDE)}
            for part, pixels in parts.items():
                clean, camera = errors[..., pixels].mean(axis=(0, 2))
                print(
                    f"| {blur} | {content} | {part} | {clean:.3f} | {camera:.3f} "
                    f"| {camera / clean:.2f} |",
                    flush=True,
                )


def errors_of(
    picture: np.ndarray,
    truth: np.ndarray,
    seed: int,
    paint: Callable[[np.ndarray], np.ndarray] | None,
    arguments: argparse.Namespace,
) -> np.ndarray:
    """Return the absolute errors in px, clean and by the camera: (2, H, W)."""
    sharp = paint(picture) if paint else picture
    maps = (
        estimate_blur_map(clean(sharp, truth, seed), mode=arguments.mode),
        estimate_blur_map(
            photographed(sharp, truth, seed), mode=arguments.mode, linearize=arguments.linearize
        ),
    )
    return np.array([np.abs(blur_map - truth) for blur_map in maps])


def large_pictures(folder: Path) -> dict[str, np.ndarray]:
    """Read the middle of every picture of a folder: (464, 464, 3), [0, 1]."""
    paths = sorted(folder.glob("*.png")) + sorted(folder.glob("*.jpg"))
    if not paths:
        raise SystemExit(f"{folder} holds no pictures; --data takes a folder of sharp ones")
    return {p.stem: middle(img_as_float(imageio.imread(p)[..., :3]), 2 * SIDE) for p in paths}


def flats(side: int) -> np.ndarray:
    """Return where the sky and the wall are: the top third, and the bottom right corner."""
    row, column = np.indices((side, side)) / side
    return (row < 0.3) | ((row > 0.55) & (column > 0.6))


def with_flats(picture: np.ndarray) -> np.ndarray:
    """Paint a sky and a wall into a picture."""
    side = len(picture)
    row = np.indices((side, side))[0] / side
    sky = np.array([0.45, 0.62, 0.85]) + 0.2 * row[..., None]
    wall = np.array([0.72, 0.66, 0.58])
    painted = np.where((row < 0.3)[..., None], sky, wall)
    return np.where(flats(side)[..., None], painted, picture)


def clean(sharp: np.ndarray, truth: np.ndarray, seed: int) -> np.ndarray:
    return simulate_defocus(halved(sharp), truth, noise_variance=1e-6, rng=seed)


def photographed(sharp: np.ndarray, truth: np.ndarray, seed: int) -> np.ndarray:
    """Take a sharp picture, (2 H, 2 W, 3), with the blur (H, W): (H, W, 3) uint8."""
    rng = np.random.default_rng(seed)
    radii = 2 * truth.repeat(2, axis=0).repeat(2, axis=1)
    light = simulate_defocus(decode_srgb(sharp), radii, psf=Disc(16.0))
    return camera(light, rng, quality=int(rng.integers(75, 96)))


def camera(light: np.ndarray, rng: np.random.Generator, quality: int) -> np.ndarray:
    """Make a JPEG of linear light, (2 H, 2 W, 3) in [0, 1]: (H, W, 3) uint8."""
    variance = GAIN * light.clip(0, 1) + READ_VARIANCE
    exposed = light + np.sqrt(variance) * rng.standard_normal(light.shape)
    finished = sharpened(denoised(encode_srgb(exposed.clip(0, 1))))
    whole = np.rint(255 * halved(finished).clip(0, 1)).astype(np.uint8)
    file = imageio.imwrite("<bytes>", whole, extension=".jpg", quality=quality)
    return imageio.imread(io.BytesIO(file))


def denoised(picture: np.ndarray) -> np.ndarray:
    """Take out half of the noise of the luminance, and the finest grain of the colours."""
    luma = picture @ LUMA
    color = gaussian_filter(picture - luma[..., None], (0.8, 0.8, 0))
    quiet = denoise_nl_means(luma, patch_size=3, patch_distance=4, h=0.01, fast_mode=True)
    return (luma + quiet)[..., None] / 2 + color


def sharpened(picture: np.ndarray) -> np.ndarray:
    return picture + 0.3 * (picture - gaussian_filter(picture, (1, 1, 0)))


def halved(picture: np.ndarray) -> np.ndarray:
    height, width = (length // 2 for length in picture.shape[:2])
    return picture.reshape(height, 2, width, 2, -1).mean(axis=(1, 3))


if __name__ == "__main__":
    main()
