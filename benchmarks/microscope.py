"""How far defocus in um is from the truth, on simulated fields of beads and of stained specimens.

    python benchmarks/microscope.py [--quick] [--blur 2 4 8]

Five objectives, from NA 0.3 in air to 1.3 in oil, at a usual pixel size each. The specimen is drawn
on pixels a quarter as wide, and blurred by the PSF of dipoles that turn freely: Fourier transforms
of the pupil over the whole field, not the integrals that `Microscope` takes. Then come the pixels,
counted photons and the noise of reading. Beads are 0.2 um wide; at NA 0.3, those that shine are 0.5
um and dark ones 1 um, at NA 0.5 dark ones 0.5 um. They shine on a dark ground, or swallow light in
bright field. Tissue is a stained section in bright field: leaves of all sizes, from 0.4 Airy radii
up, that cover each other (dead leaves).

Prints a Markdown table: the median of the map over the field in um for every true defocus, its
error in um and in %, and the share of pixels within 0.15 um or 10 % (** where the median is not).
Then the share of pixels with a confidence of 0.5 or more, and what the simplest thing makes of the
same picture: discs, and z = r sqrt(n^2 - NA^2) / NA.
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fftfreq, ifft2, irfft2, rfft2

from napari_defocus import (
    Disc,
    Microscope,
    confidence_map,
    estimate_blur_map,
    estimate_candidates,
    label_blur_map,
)
from napari_defocus.psf.microscope import IMMERSIONS
from napari_defocus.settings import CONFIDENT

SIDE, FINE = 336, 4
WAVELENGTH = 0.52
OBJECTIVES = {
    "10x 0.3 air": Microscope(0.3, WAVELENGTH, 0.645),
    "20x 0.5 air": Microscope(0.5, WAVELENGTH, 0.325),
    "40x 0.8 air": Microscope(0.8, WAVELENGTH, 0.1625),
    "60x 1.2 water": Microscope(1.2, WAVELENGTH, 0.108, IMMERSIONS["water"]),
    "60x 1.3 oil": Microscope(1.3, WAVELENGTH, 0.108, IMMERSIONS["oil"]),
}
KINDS = ("shining beads", "dark beads", "tissue")
BEADS_UM = {("shining beads", 0.3): 0.5, ("dark beads", 0.3): 1.0, ("dark beads", 0.5): 0.5}
USUAL_BEAD_UM = 0.2
LEAST_UM, RELATIVE = 0.15, 0.1
PHOTONS_OF_BEAD, BACKGROUND, PHOTONS_OF_LIGHT, READ_NOISE, OFFSET = 20_000, 10, 30_000, 2.0, 100

Array = NDArray[np.floating]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--blur", type=float, nargs="+", default=[2, 3, 4, 6, 8, 12, 20])
    parser.add_argument("--specimen", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--quick", action="store_true", help="two objectives, two blurs")
    arguments = parser.parse_args()
    names, blurs = list(OBJECTIVES), arguments.blur
    if arguments.quick:
        names, blurs = names[::4], [3, 8]
    print("| objective | specimen | blur px | true um | found um | error | within | sure | discs |")
    print("|---" * 9 + "|")
    for name in names:
        for kind in arguments.specimen:
            for blur in blurs:
                print(row(name, OBJECTIVES[name], kind, blur), flush=True)


def row(name: str, lens: Microscope, kind: str, blur: float) -> str:
    """Simulate one field, measure it, and return what the table says of it."""
    truth = lens.defocus_um(blur)
    picture = Specimen(lens, kind, seed=0).picture(truth)
    candidates = estimate_candidates(picture, psf=lens)
    blur_map = label_blur_map(candidates, picture)
    sure = (confidence_map(candidates, blur_map) >= CONFIDENT).mean()
    found = lens.defocus_um(blur_map)
    discs = simplest(lens, estimate_blur_map(picture, psf=Disc()))
    error, allowed = float(np.median(found)) - truth, max(LEAST_UM, RELATIVE * truth)
    return (
        f"| {name} | {kind} | {blur:g} | {truth:.2f} | {np.median(found):.2f} "
        f"| {error:+.2f} um, {error / truth:+.0%}{'' if abs(error) <= allowed else ' **'} "
        f"| {np.mean(np.abs(found - truth) <= allowed):.0%} | {sure:.0%} "
        f"| {np.median(discs) / truth - 1:+.0%} |"
    )


def simplest(lens: Microscope, blur_map: Array) -> Array:
    """Return the defocus, in um, whose marginal rays fall on the edge of a disc."""
    aperture = lens.numerical_aperture
    tangent = aperture / math.sqrt(lens.refractive_index**2 - aperture**2)
    return blur_map * lens.pixel_size_um / tangent


@dataclass(frozen=True)
class Specimen:
    """What lies before an objective, and what its camera counts.

    `picture` takes the defocus in um.
    """

    lens: Microscope
    kind: str
    seed: int

    def picture(self, defocus: float) -> NDArray[np.uint16]:
        """Return the counts of the camera: (H, W)."""
        rng = np.random.default_rng(self.seed)
        spectrum = rfft2(self.light(defocus, rng)) * rfft2(psf(self.lens, defocus))
        seen = irfft2(spectrum, (SIDE * FINE,) * 2)
        photons = np.maximum(seen, 0).reshape(SIDE, FINE, SIDE, FINE).sum(axis=(1, 3))
        counts = rng.poisson(photons) + rng.normal(OFFSET, READ_NOISE, photons.shape)
        return np.clip(np.rint(counts), 0, 65535).astype(np.uint16)

    def light(self, defocus: float, rng: np.random.Generator) -> Array:
        """Return how many photons each fine pixel sends: (4 H, 4 W)."""
        white = PHOTONS_OF_LIGHT / FINE**2
        if self.kind == "tissue":
            return white * self.leaves(rng)
        spot = math.pi * (self.lens.airy_radius + self.lens.blur_radius(defocus)) ** 2
        beads = self.beads(max(int(0.1 * SIDE**2 / spot), 40), rng)
        if self.kind == "dark beads":
            # A bead takes the light of a quarter of the Airy disc.
            taken = math.pi * (self.lens.airy_radius * FINE) ** 2 / 4
            return white * np.maximum(1 - beads * taken, 0)
        return beads * PHOTONS_OF_BEAD + BACKGROUND / FINE**2

    def beads(self, count: int, rng: np.random.Generator) -> Array:
        """Draw balls at random, each of sum 1."""
        side, fine = SIDE * FINE, self.lens.pixel_size_um / FINE
        wide = BEADS_UM.get((self.kind, self.lens.numerical_aperture), USUAL_BEAD_UM)
        radius = max(wide / 2 / fine, 1.0)
        drawn, around = np.zeros((side, side)), np.arange(-math.ceil(radius), math.ceil(radius) + 2)
        for row, column in rng.uniform(0, side, (count, 2)):
            rows, columns = int(row) + around, int(column) + around
            square = (rows[:, None] - row) ** 2 + (columns - column) ** 2
            thick = np.sqrt(np.maximum(radius**2 - square, 0))
            drawn[np.ix_(rows % side, columns % side)] += thick / thick.sum()
        return drawn

    def leaves(self, rng: np.random.Generator) -> Array:
        """Draw discs that cover each other, as many of each size as make all scales alike."""
        side = SIDE * FINE
        least, most = 0.4 * self.lens.airy_radius * FINE, side / 8
        shown = np.zeros((side, side))
        share = rng.uniform(0, 1, 12_000)
        # Density of radii ~ r^-3.
        radii = 1 / np.sqrt(least**-2 + share * (most**-2 - least**-2))
        for radius in radii:
            row, column, seen = *rng.uniform(0, side, 2), rng.uniform(0.2, 1)
            around = np.arange(-math.ceil(radius), math.ceil(radius) + 2)
            rows, columns = int(row) + around, int(column) + around
            inside = (rows[:, None] - row) ** 2 + (columns - column) ** 2 <= radius**2
            place = np.ix_(rows % side, columns % side)
            shown[place] = np.where(inside, seen, shown[place])
        return shown


def psf(lens: Microscope, defocus: float) -> Array:
    """Return the PSF on fine pixels, its middle at (0, 0), sum 1, by transforms of the pupil."""
    fine = lens.pixel_size_um / FINE
    frequency = fftfreq(SIDE * FINE, fine) * lens.wavelength_um / lens.refractive_index
    down, across = frequency[:, None], frequency[None]
    square = down**2 + across**2
    inside = square < (lens.numerical_aperture / lens.refractive_index) ** 2
    cosine = np.sqrt(np.where(inside, 1 - square, 1.0))
    wave = 2 * math.pi * lens.refractive_index / lens.wavelength_um
    pupil = inside / np.sqrt(cosine) * np.exp(1j * wave * defocus * (cosine - 1))
    intensity = sum(np.abs(ifft2(pupil * field)) ** 2 for field in dipoles(down, across, cosine))
    return intensity / intensity.sum()


def dipoles(down: Array, across: Array, cosine: Array) -> Iterator[Array]:
    """Yield the field that a dipole along each axis makes in the pupil, for both polarizations."""
    sine = np.maximum(down**2 + across**2, 1e-12)
    along, crossed = across**2 / sine, down * across / sine
    yield cosine * along + (1 - along)
    yield (cosine - 1) * crossed
    yield cosine * (1 - along) + along
    yield (cosine - 1) * crossed
    yield across
    yield down


if __name__ == "__main__":
    main()
