"""How near a picture with a changed focus comes to one taken that way.

    python benchmarks/refocus.py --data FOLDER_OF_SHARP_PICTURES

Two scenes with true depth, in linear light: the motorcycle of scikit-image, scaled down by 2,
blurred by `simulate_layered_defocus`; and three of the sharp pictures, one before the other,
each known also where a nearer one hides it, so that the truth shows what no method can know.
Both are taken three times, with the focus on the nearest thing, half-way and on the farthest,
and discs of at most 4 px. Then the focus is moved to the other end (from half-way: to the
nearest) or half as far, or the aperture made half or twice as wide.

Prints a Markdown table of PSNR in dB / SSIM against the truth, means over the three: of the
picture as it was taken, of `change_focus` with the true map, and with our map of the
picture, whose blur is taken away as far as `cautious_blur_map` says.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from layered import motorcycle
from pictures import SIDE, sharp_pictures
from scipy.signal import oaconvolve
from skimage.metrics import structural_similarity

from napari_defocus import (
    Disc,
    cautious_blur_map,
    change_focus,
    confidence_map,
    estimate_candidates,
    label_blur_map,
    restore_all_in_focus,
    simulate_layered_defocus,
)
from napari_defocus.core.image import decode_srgb, encode_srgb

LARGEST = 4.0
DISC = Disc(2 * LARGEST)
LAYERS = 64
FOCUSED = {"nearest": 0.0, "half-way": 0.5, "farthest": 1.0}


@dataclass
class Scene:
    signed: np.ndarray
    """True radii as the picture is taken, in px: negative before the focus."""

    seen: Callable[[float, float], np.ndarray]
    """The truth with the focus on a signed radius, and the aperture some times as wide."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    shared = Path(__file__).parents[2] / "shared" / "data" / "sharp"
    parser.add_argument("--data", type=Path, default=shared, help="folder of sharp pictures")
    parser.add_argument("--noise", type=float, nargs="+", default=[1e-6, 1e-5])
    parser.add_argument("--quantize", action="store_true", help="round what is taken to 8 bits")
    parser.add_argument("--each", action="store_true", help="a row for each focus too")
    arguments = parser.parse_args()
    pictures = list(sharp_pictures(arguments.data).values())
    kinds = {"motorcycle": motorcycle_scene, "planes": lambda at: planes_scene(pictures, at)}
    print("| scene | noise | change | as taken | true map | our map |\n" + "|---" * 6 + "|")
    for kind, scene_at in kinds.items():
        for variance in arguments.noise:
            scores = {}
            for focused, at in FOCUSED.items():
                scores[focused] = compared(scene_at(at), variance, arguments.quantize)
                if arguments.each:
                    for change, score in scores[focused].items():
                        print(table_row(f"{kind}, {focused}", variance, change, score), flush=True)
            for change in scores["nearest"]:
                mean = np.mean([score[change] for score in scores.values()], axis=0)
                print(table_row(kind, variance, change, mean), flush=True)


def compared(scene: Scene, variance: float, quantize: bool) -> dict[str, np.ndarray]:
    """Return (PSNR, SSIM) of the picture as taken, with the true map, and with ours: (3, 2)."""
    rng = np.random.default_rng(0)
    noise = np.sqrt(variance) * rng.standard_normal((*scene.signed.shape, 3))
    taken = np.clip(scene.seen(0.0, 1.0) + noise, 0, 1).astype(np.float32)
    if quantize:
        taken = np.rint(255 * taken) / np.float32(255)
    candidates = estimate_candidates(taken)
    ours = label_blur_map(candidates, taken)
    safe, sure = cautious_blur_map(candidates, ours), confidence_map(candidates, ours)
    maps = [np.abs(scene.signed), ours]
    restored = [
        restore_all_in_focus(taken, maps[0], confidence=np.ones_like(maps[0]), linearize="srgb"),
        restore_all_in_focus(taken, safe, confidence=sure, linearize="srgb"),
    ]
    end = float(max(scene.signed.min(), scene.signed.max(), key=abs))
    scores = {}
    for change, (focus, aperture) in {
        "focus to the other end": (end, 1.0),
        "focus half as far": (end / 2, 1.0),
        "half the aperture": (0.0, 0.5),
        "twice the aperture": (0.0, 2.0),
    }.items():
        truth = np.clip(scene.seen(focus, aperture), 0, 1)
        results = [
            change_focus(
                taken,
                blur_map,
                focus=focus,
                aperture=aperture,
                side=scene.signed >= 0,
                psf=DISC,
                all_in_focus=sharp,
            )
            for blur_map, sharp in zip(maps, restored, strict=True)
        ]
        scores[change] = np.array([likeness(result, truth) for result in (taken, *results)])
    return scores


def motorcycle_scene(at: float) -> Scene:
    """The focus is a share of the way from the nearest to the farthest disparity."""
    picture, disparity = motorcycle()
    low, high = np.nanmin(disparity), np.nanmax(disparity)
    # Scaled to [0, 1], the depth passes for radii: it comes back without gaps.
    _, depth = simulate_layered_defocus(
        picture, -disparity, lambda depth: (depth + high) / (high - low)
    )
    signed = LARGEST / max(at, 1 - at) * (depth - at)

    def seen(focus: float, aperture: float) -> np.ndarray:
        radius = aperture * np.abs(signed - focus)
        return simulate_layered_defocus(
            picture, depth, radius, psf=DISC, layers=LAYERS, linearize="srgb"
        )[0]

    return Scene(signed, seen)


def planes_scene(pictures: list[np.ndarray], at: float) -> Scene:
    """Three pictures: a whole one, a slanted half before it, a disc and a bar before both."""
    row, column = np.indices((SIDE, SIDE))
    disc = (row - 190) ** 2 + (column - 120) ** 2 < 70**2
    bar = np.abs(column - 60 - 0.2 * row) < 7
    masks = [np.ones((SIDE, SIDE), bool), column + 0.3 * row > 190, disc | bar]
    radii = LARGEST / max(at, 1 - at) * (np.array([1.0, 0.5, 0.0]) - at)
    # Another three for each focus.
    first = round(4 * at)
    planes = [linear(pictures[(first + plane) % len(pictures)]) for plane in range(3)]
    signed = np.zeros((SIDE, SIDE))
    for mask, radius in zip(masks, radii, strict=True):
        signed[mask] = radius

    def seen(focus: float, aperture: float) -> np.ndarray:
        light = np.zeros((SIDE, SIDE, 3))
        for plane, mask, radius in zip(planes, masks, radii, strict=True):
            kernel = DISC.kernel(aperture * abs(radius - focus))
            cover = blurred(mask[..., None].astype(float), kernel)
            light = (1 - cover) * light + blurred(mask[..., None] * plane, kernel)
        return encode_srgb(light.astype(np.float32))

    return Scene(signed, seen)


def linear(picture: np.ndarray) -> np.ndarray:
    """Return the light of a picture, (H, W, 3)."""
    if picture.dtype == np.uint8:
        picture = picture / np.float32(255)
    color = picture if picture.ndim == 3 else np.dstack([picture] * 3)
    return decode_srgb(color.astype(np.float32))


def blurred(light: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    reach = len(kernel) // 2
    padded = np.pad(light, ((reach, reach), (reach, reach), (0, 0)), mode="symmetric")
    return oaconvolve(padded, kernel[..., None], mode="valid", axes=(0, 1))


def likeness(picture: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Return PSNR in dB, and SSIM."""
    similarity = structural_similarity(picture, truth, channel_axis=2, data_range=1)
    return -10 * np.log10(np.mean((picture - truth) ** 2)), similarity


def table_row(kind: str, variance: float, change: str, scores: np.ndarray) -> str:
    cells = [f"{psnr:.1f} / {ssim:.3f}" for psnr, ssim in scores]
    return f"| {kind} | {variance:.0e} | {change} | {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
