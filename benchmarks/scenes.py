"""Pictures of known blur: what is blurred how, behind which noise, JPEG, lens or camera.

A group holds pictures of one family under one condition: the same truth for every source, but
for layered scenes, which are drawn anew. Groups make their pictures when asked for.
"""

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import imageio.v3 as imageio
import numpy as np
from camera import SIDE as CAMERA_SIDE
from camera import photographed, with_flats
from layered import jump, motorcycle
from pictures import SIDE, bumps, middle, ramp, uniform
from scipy.ndimage import distance_transform_edt

from napari_defocus import (
    Disc,
    PSFFamily,
    psf_from_text,
    simulate_defocus,
    simulate_layered_defocus,
)

NOISE = (1e-6, 1e-5, 1e-4, 1e-3)
QUALITIES = (70, 80, 90, 95, 100)
LENSES = ("polygon:6", "polygon:5", "annulus:0.3", "annulus:0.5", "gaussian")
USUAL_NOISE = 1e-5
LARGEST = 6.0
JUMP, REACH = 0.5, 10
DEEPEST = 7.0


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of known blur.

    Attributes
    ----------
    source : str
        What it was made from.
    seen : (H, W) or (H, W, 3) ndarray
    truth : (H, W) ndarray
        px; NaN is unknown.
    """

    source: str
    seen: np.ndarray
    truth: np.ndarray

    @property
    def known(self) -> np.ndarray:
        return np.isfinite(self.truth)

    @property
    def at_edges(self) -> np.ndarray:
        """Where the radius jumps by more than 0.5 px, and up to 10 px around."""
        filled = np.where(self.known, self.truth, np.nanmin(self.truth))
        still = jump(filled) <= JUMP
        if still.all():
            return np.zeros_like(still)
        return distance_transform_edt(still) <= REACH


@dataclass(frozen=True)
class Group:
    """Pictures of one family under one condition; each source may have several."""

    family: str
    condition: str
    make: Callable[[], Iterator[Picture]]
    layered: bool = False

    @property
    def name(self) -> str:
        return f"{self.family}, {self.condition}"


def groups(sources: dict[str, np.ndarray], *, quick: bool, seed: int) -> Iterator[Group]:
    """Return what the accuracy is measured on; sources are (H, W[, 3]) in [0, 1]."""
    scenes = Scenes(sources, seed)
    for variance in NOISE[::2] if quick else NOISE:
        condition = f"noise {variance:.0e}"
        for family in scenes.families():
            yield scenes.group(family, condition, variance)
    for quality in QUALITIES[1:2] if quick else QUALITIES:
        for family in ("ramp",) if quick else ("ramp", "layers"):
            yield scenes.group(family, f"JPEG {quality}", USUAL_NOISE, quality=quality)
    for lens in LENSES[::4] if quick else LENSES:
        yield scenes.group("ramp", f"lens {lens}", USUAL_NOISE, lens=psf_from_text(lens))
    yield scenes.uniform_group((0, 2, 5, 8) if quick else tuple(range(9)))
    if not quick:
        yield from scenes.camera_groups()


@dataclass(frozen=True)
class Scenes:
    """All that can be made of some sharp pictures, with one seed for noise and layers."""

    sources: dict[str, np.ndarray]
    seed: int

    def families(self) -> tuple[str, ...]:
        return ("ramp", "bumps", "layers", "motorcycle")

    def group(
        self,
        family: str,
        condition: str,
        variance: float,
        *,
        quality: int | None = None,
        lens: PSFFamily = Disc(),
    ) -> Group:
        def make() -> Iterator[Picture]:
            for name, seen, truth in getattr(self, f"_{family}")(variance, lens):
                yield Picture(name, seen if quality is None else jpeg(seen, quality), truth)

        return Group(family, condition, make, layered=family in ("layers", "motorcycle"))

    def uniform_group(self, radii: tuple[int, ...]) -> Group:
        def make() -> Iterator[Picture]:
            for radius in radii:
                for name, seen, truth in self._blurred(uniform(radius), USUAL_NOISE, Disc()):
                    yield Picture(name, seen, truth)

        return Group("uniform", f"noise {USUAL_NOISE:.0e}", make)

    def camera_groups(self) -> Iterator[Group]:
        """Make JPEGs as a camera does, see camera.py; of sources that are large enough."""
        large = {
            name: middle(np.atleast_3d(source) * np.ones(3), 2 * CAMERA_SIDE)
            for name, source in self.sources.items()
            if min(source.shape[:2]) >= 2 * CAMERA_SIDE
        }
        if len(large) < 2:
            return
        for family, truth in {"ramp": ramp(CAMERA_SIDE), "bumps": bumps(CAMERA_SIDE)}.items():
            for condition, paint in {"camera": None, "camera, wall and sky": with_flats}.items():

                def make(
                    truth: np.ndarray = truth, paint: Callable | None = paint
                ) -> Iterator[Picture]:
                    for number, (name, source) in enumerate(large.items()):
                        sharp = paint(source) if paint else source
                        seen = photographed(sharp, truth, number + 1000 * self.seed)
                        yield Picture(name, seen, truth)

                yield Group(family, condition, make)

    def _ramp(self, variance: float, lens: PSFFamily) -> Iterator[tuple]:
        return self._blurred(ramp(), variance, lens)

    def _bumps(self, variance: float, lens: PSFFamily) -> Iterator[tuple]:
        return self._blurred(bumps(), variance, lens)

    def _blurred(self, truth: np.ndarray, variance: float, lens: PSFFamily) -> Iterator[tuple]:
        for number, (name, source) in enumerate(self.sources.items()):
            rng = np.random.default_rng([self.seed, number])
            seen = simulate_defocus(
                middle(source), truth, psf=lens, noise_variance=variance, rng=rng
            )
            yield name, seen, truth

    def _layers(self, variance: float, lens: PSFFamily) -> Iterator[tuple]:
        for number, (name, source) in enumerate(self.sources.items()):
            rng = np.random.default_rng([self.seed, number])
            depth, radii = layered_scene(rng)
            seen, truth = simulate_layered_defocus(
                middle(source), depth, radii, psf=lens, noise_variance=variance, rng=rng
            )
            yield name, seen, truth

    def _motorcycle(self, variance: float, lens: PSFFamily) -> Iterator[tuple]:
        """Blur in linear light, encode for a display, round to 8 bits."""
        picture, disparity = motorcycle()
        low, high = np.nanmin(disparity), np.nanmax(disparity)
        for focus, plane in {"nearest": high, "farthest": low}.items():

            def radius(depth: np.ndarray, plane: float = plane) -> np.ndarray:
                return LARGEST * np.abs(-depth - plane) / (high - low)

            seen, truth = simulate_layered_defocus(
                picture,
                -disparity,
                radius,
                psf=lens,
                linearize="srgb",
                noise_variance=variance,
                rng=self.seed,
            )
            yield focus, eight_bits(seen), np.where(np.isfinite(disparity), truth, np.nan)


def layered_scene(rng: np.random.Generator, side: int = SIDE) -> tuple[np.ndarray, np.ndarray]:
    """Draw two or three ellipses, one before the other, before a background: depth, radii."""
    row, column = np.indices((side, side))
    count = int(rng.integers(2, 4))
    radius = rng.uniform(0.5, DEEPEST, count + 1)
    radius[rng.integers(0, count + 1)] = rng.uniform(0.5, 1.5)
    depth = np.full((side, side), float(count))
    for near in range(count - 1, -1, -1):
        y, x = rng.uniform(0.15 * side, 0.85 * side, 2)
        long, short = rng.uniform(0.15, 0.35, 2) * side
        angle = rng.uniform(0, np.pi)
        along = (column - x) * np.cos(angle) + (row - y) * np.sin(angle)
        across = (row - y) * np.cos(angle) - (column - x) * np.sin(angle)
        depth[(along / long) ** 2 + (across / short) ** 2 < 1] = near
    return depth, radius[depth.astype(int)]


def eight_bits(picture: np.ndarray) -> np.ndarray:
    return np.rint(255 * picture.clip(0, 1)).astype(np.uint8)


def jpeg(picture: np.ndarray, quality: int) -> np.ndarray:
    """Store as JPEG and read again: uint8."""
    whole = picture if picture.dtype == np.uint8 else eight_bits(picture)
    file = imageio.imwrite("<bytes>", whole, extension=".jpg", quality=quality)
    return imageio.imread(io.BytesIO(file))
