"""What decoding into linear light is worth, on pictures blurred in linear light.

    python benchmarks/linear_light.py --data FOLDER_OF_SHARP_PICTURES

Sharp pictures are decoded, blurred by a ramp of disc radii, given noise, encoded for a display
with the transfer function of sRGB and rounded to 8 bits, as a camera does. Prints the map's mean
absolute error in px with and without ``linearize="srgb"``.
"""

import argparse
from pathlib import Path

import numpy as np
from pictures import ramp, sharp_pictures, uniform

from napari_defocus import estimate_blur_map, simulate_defocus
from napari_defocus.image import decode_srgb, encode_srgb, prepare_image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "sharp"
    parser.add_argument("--data", type=Path, default=shared, help="folder of sharp pictures")
    pictures = sharp_pictures(parser.parse_args().data)
    print("| blur | as it is | linear light |\n|---|---|---|")
    for name, truth in {"ramp": ramp(), **{f"{r} px": uniform(r) for r in (2, 4, 7)}}.items():
        errors = [errors_of(picture, truth) for picture in pictures.values()]
        plain, linear = np.mean(errors, axis=0)
        print(f"| {name} | {plain:.3f} | {linear:.3f} |", flush=True)


def errors_of(picture: np.ndarray, truth: np.ndarray) -> list[float]:
    light = decode_srgb(prepare_image(picture).color)
    blurred = simulate_defocus(light, truth, noise_variance=1e-6, rng=0)
    seen = np.rint(255 * encode_srgb(blurred.clip(0, 1))).astype(np.uint8)
    maps = (estimate_blur_map(seen, linearize=kind) for kind in (None, "srgb"))
    return [float(np.abs(blur_map - truth).mean()) for blur_map in maps]


if __name__ == "__main__":
    main()
