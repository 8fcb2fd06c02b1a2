"""Pictures that break an assumption: other lenses, motion, sharpening, upscaling, nothing to see.

Each is a `Picture` of `scenes.py`. The truth is the blur radius, in px, where defocus made the
picture; -1 where there is no right answer.
"""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
from pictures import SIDE, uniform
from PIL import Image, ImageDraw
from scenes import Picture, eight_bits
from scipy.ndimage import gaussian_filter, zoom
from scipy.signal import fftconvolve

from napari_defocus import simulate_defocus

NO_ANSWER = -1.0
LENGTHS = (6, 13, 20)
"""px, of motion."""

_ENLARGED, _DRAWN = 4, (240, 300)
_PARTS = 8


def random_ramp(rng: np.random.Generator, largest: float = 7.5) -> np.ndarray:
    """Draw a ramp of the radius, px, in any direction."""
    row, column = np.indices((SIDE, SIDE))
    angle = rng.uniform(0, 2 * np.pi)
    height = np.cos(angle) * row + np.sin(angle) * column
    low, high = rng.uniform(0.4, largest, 2)
    return low + (high - low) * (height - height.min()) / np.ptp(height)


def through_lenses(sources: dict[str, np.ndarray], folder: Path) -> Iterator[tuple[str, Picture]]:
    """Blur every source by the PSF of every file of a folder, with its name."""
    for path in sorted(folder.glob("*.npz")):
        for number, (name, source) in enumerate(sources.items()):
            rng = np.random.default_rng([1, number])
            radius, variance = rng.uniform(1, 7), 10 ** rng.uniform(-6, -4)
            seen = convolved(source, lens_kernel(path, radius))
            seen += rng.normal(0, np.sqrt(variance), seen.shape)
            yield path.stem, Picture(name, seen, uniform(radius))


@lru_cache(maxsize=256)
def lens_kernel(path: Path, radius: float) -> np.ndarray:
    """Scale a PSF so that its second moment is that of the disc of a radius in px."""
    psf = np.maximum(np.load(path)["psf"].astype(float), 0)
    psf /= psf.sum()
    row, column = np.indices(psf.shape)
    middle = (psf * row).sum(), (psf * column).sum()
    spread = (psf * ((row - middle[0]) ** 2 + (column - middle[1]) ** 2)).sum() / 2
    factor = radius / (2 * np.sqrt(spread))
    half = int(np.ceil(3.2 * radius)) + 2
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    inner = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
    for down in inner:
        for along in inner:
            y = np.rint((row + down - middle[0]) * factor + half).astype(int)
            x = np.rint((column + along - middle[1]) * factor + half).astype(int)
            inside = (y >= 0) & (y < len(kernel)) & (x >= 0) & (x < len(kernel))
            np.add.at(kernel, (y[inside], x[inside]), psf[inside])
    return kernel / kernel.sum()


def convolved(picture: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Convolve every colour, mirrored at the border."""
    margins = [(length // 2, length // 2) for length in kernel.shape]
    if picture.ndim == 3:
        return np.stack([convolved(one, kernel) for one in np.moveaxis(picture, 2, 0)], axis=2)
    return fftconvolve(np.pad(picture, margins, mode="symmetric"), kernel, mode="valid")


def moved(sources: dict[str, np.ndarray]) -> Iterator[Picture]:
    """Blur by motion along a line of 6, 13 and 20 px, in any direction."""
    for number, (name, source) in enumerate(sources.items()):
        rng = np.random.default_rng([2, number])
        for length in LENGTHS:
            seen = convolved(source, line(length, rng.uniform(0, np.pi)))
            yield Picture(name, seen + rng.normal(0, 3e-3, seen.shape), _nothing())


def line(length: float, angle: float) -> np.ndarray:
    """Return the kernel of a motion of so many px."""
    half = int(length / 2) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    along = np.linspace(-length / 2, length / 2, 40 * int(length))
    y, x = half + along * np.sin(angle), half + along * np.cos(angle)
    row, column = np.floor(y).astype(int), np.floor(x).astype(int)
    for down in (0, 1):
        for right in (0, 1):
            share = np.abs(1 - down - y + row) * np.abs(1 - right - x + column)
            place = (row + down).clip(0, 2 * half), (column + right).clip(0, 2 * half)
            np.add.at(kernel, place, share)
    return kernel / kernel.sum()


def sharpened(sources: dict[str, np.ndarray]) -> Iterator[Picture]:
    """Sharpen defocused pictures by unsharp masking, and sharp ones."""
    for number, (name, source) in enumerate(sources.items()):
        rng = np.random.default_rng([3, number])
        for amount in (0.7, 1.5):
            truth = random_ramp(rng, 5)
            seen = simulate_defocus(source, truth, noise_variance=1e-6, rng=rng)
            yield Picture(name, unsharp(seen, amount, rng.uniform(1, 2)), truth)


def sharpened_sharp(sources: dict[str, np.ndarray]) -> Iterator[Picture]:
    """Sharpen pictures that are sharp already."""
    for name, source in sources.items():
        yield Picture(name, unsharp(source, 1.5, 1.5), uniform(0))


def unsharp(picture: np.ndarray, amount: float, sigma: float) -> np.ndarray:
    """Add so much of what a Gaussian takes away: uint8."""
    softer = gaussian_filter(picture, (sigma, sigma, 0)[: picture.ndim])
    return eight_bits(picture + amount * (picture - softer))


def upscaled(sources: dict[str, np.ndarray], *, sharp: bool) -> Iterator[Picture]:
    """Enlarge pictures, defocused or sharp, to twice their size."""
    half = slice(0, SIDE // 2)
    for number, (name, source) in enumerate(sources.items()):
        rng = np.random.default_rng([4, number])
        truth = uniform(0) if sharp else random_ramp(rng, 3.5)
        seen = simulate_defocus(source, truth, noise_variance=1e-6, rng=rng)[half, half]
        for order in (1, 3):
            larger = eight_bits(zoom(seen, (2, 2, 1)[: seen.ndim], order=order))
            yield Picture(name, larger, 2 * zoom(truth[half, half], 2, order=1))


def nothing_to_see(*, noise: bool) -> Iterator[Picture]:
    """Make pictures of noise alone, or smooth gradients."""
    y, x = np.indices((SIDE, SIDE)) / SIDE
    smooth = (x, y, (x + y) / 2, np.hypot(x - 0.5, y - 0.5), x * y, np.sin(3 * x) * np.cos(2 * y))
    for number, shade in enumerate(smooth):
        rng = np.random.default_rng([5, number])
        if noise:
            sigma = 10 ** rng.uniform(-2.5, -1)
            flat = 0.5 + rng.normal(0, sigma, (SIDE, SIDE))
            yield Picture(f"noise {number}", eight_bits(flat), _nothing())
        else:
            grey = 0.2 + 0.6 * shade
            yield Picture(f"gradient {number}", eight_bits(grey), _nothing())
            yield Picture(f"gradient {number}", grey + rng.normal(0, 3e-3, grey.shape), _nothing())


def plain_things(*, noisy: bool) -> Iterator[Picture]:
    """Draw things with edges and little inside, through soft cameras."""
    for number in range(16):
        rng = np.random.default_rng([6, number, noisy])
        sharp = drawing(rng)
        softness, radius = rng.uniform(0, 0.9), rng.uniform(0.5, 7)
        truth = np.full(sharp.shape, radius)
        seen = simulate_defocus(gaussian_filter(sharp, softness), truth)
        sigma = 10 ** (rng.uniform(-1.9, -1.2) if noisy else rng.uniform(-3, -1.9))
        seen = seen + rng.normal(0, sigma, seen.shape)
        yield Picture(f"drawing {number}", seen if number % 2 else eight_bits(seen), truth)


def drawing(rng: np.random.Generator) -> np.ndarray:
    """Draw rectangles, ellipses, polygons and lines: (240, 300) in [0, 1]."""
    height, width = (_ENLARGED * length for length in _DRAWN)
    picture = Image.new("L", (width, height), int(rng.integers(40, 220)))
    pen = ImageDraw.Draw(picture)
    for _ in range(rng.integers(4, 14)):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        a, b = rng.uniform(40, 360, 2)
        grey, kind = int(rng.integers(20, 240)), rng.integers(0, 4)
        box = (x - a, y - b, x + a, y + b)
        if kind == 0:
            pen.rectangle(box, fill=grey)
        elif kind == 1:
            pen.ellipse(box, fill=grey)
        elif kind == 2:
            angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 7)))
            reach = a * rng.uniform(0.4, 1, len(angles))
            corners = zip(x + reach * np.cos(angles), y + reach * np.sin(angles), strict=True)
            pen.polygon([(float(p), float(q)) for p, q in corners], fill=grey)
        else:
            pen.line((x, y, *rng.uniform(0, width, 2)), fill=grey, width=int(rng.integers(4, 24)))
    shape = _DRAWN[0], _ENLARGED, _DRAWN[1], _ENLARGED
    found = np.asarray(picture, float).reshape(shape).mean((1, 3)) / 255
    inside = rng.choice([0, 0.004, 0.012])
    return np.clip(found + inside * gaussian_filter(rng.normal(0, 2, found.shape), 0.8), 0, 1)


def _nothing() -> np.ndarray:
    return uniform(NO_ANSWER)
