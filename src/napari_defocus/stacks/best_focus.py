"""Where a stack is in focus: from its planes, read once and compared, to positions of pixels.

What is only needed to find the positions is let go with them: it is most of the memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.intensity import Intensities
from napari_defocus.core.progress import Progress, within
from napari_defocus.labeling.pairwise_term import Blocks
from napari_defocus.likelihood.noise import noise_variance_of
from napari_defocus.psf.families import PSFFamily
from napari_defocus.stacks.contrast_peaks import Peak, one_peak
from napari_defocus.stacks.depth_from_focus import RingBank, StackPower, heard_where
from napari_defocus.stacks.focus_labels import FocusCostVolume, focus_measure
from napari_defocus.stacks.halos import without_spread_light
from napari_defocus.stacks.plane_reader import PlaneReader
from napari_defocus.stacks.shown_detail import ShownDetail

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Mask = NDArray[np.bool_]

_RATE_WINDOW, _RATE_STRIDE = 33, 8
"""px. It is larger, because how fast the blur grows follows from its width, which needs resolution
in frequency. Chosen by hand.
"""

_LABELS_A_PLANE, _PX_A_LABEL = 4, 0.125
"""Labels from plane to plane at most, and px of blur from label to label at least. By hand."""

_ASSUMED_RATE = 1.0
"""px a plane that are assumed where no texture tells it. Chosen by hand."""

_MEASURE_AREA = 2.0
"""px: standard deviation of the Gaussian over which the focus measure is averaged, for the colours
of the sharpest plane. Chosen by hand.
"""

_LEAST_BRIGHTNESS, _LARGEST_DRIFT = 0.01, 2.0
"""Planes are compared in brightness if their mean is so much above the darkest places, in units of
the contrast; and the largest factor between them. Chosen by hand.
"""

_DARKEST = 0.001
"""Quantile of a plane that counts as dark. Chosen by hand."""


@dataclass(frozen=True, eq=False)
class BestFocus:
    """Where a stack is in focus, and what was found on the way.

    Attributes
    ----------
    position, confidence : (H, W) float32 ndarray
    two_peaks : (H, W) bool ndarray
    share_of_two_peaks : float
        Of the windows.
    px_per_plane : float
        NaN if there was no texture to find it by.
    noise_variance : float
    intensities : Intensities
    shown : ShownDetail
    """

    position: Float32
    confidence: Float32
    two_peaks: Mask
    share_of_two_peaks: float
    px_per_plane: float
    noise_variance: float
    intensities: Intensities
    shown: ShownDetail

    @property
    def usable_rate(self) -> float:
        """The growth of the blur, px a plane, assumed where none was found."""
        return _usable(self.px_per_plane)


def best_focus(
    read: PlaneReader,
    *,
    psf: PSFFamily,
    window: int,
    stride: int,
    noise_variance: float | None,
    px_per_plane: float | None,
    peak: Peak,
    smoothness: float,
    color_sigma: float,
    progress: Progress,
) -> BestFocus:
    """Find where each pixel of a stack is in focus; the arguments are those of `sharpest_plane`."""
    size = read.planes.shape[0], read.planes.shape[1]
    banks = (
        RingBank.over(size, psf, window, stride),
        RingBank.over(size, psf, max(window, _RATE_WINDOW), _RATE_STRIDE),
    )
    powers, color, shown, intensities = _read_planes(
        read, banks, noise_variance, within(progress, 0.0, 0.35)
    )
    variance, unit = powers[0].noise_variance, intensities.unit
    progress("Finding the blur from plane to plane", 0.35)
    peaks = [one_peak(each, peak) for each in powers]
    powers, two = [power for power, _ in peaks], peaks[0][1]
    if px_per_plane is None:
        # What a window mixes, in scale or in frequency, makes the blur seem to grow slower.
        rate = float(np.fmax.reduce([power.px_per_plane() for power in powers]))
    else:
        rate = float(px_per_plane)
    progress("Comparing the planes", 0.45)
    volume = _costs(powers[0], _usable(rate), size, stride, unit)
    del powers, peaks
    labeled = volume.labeled(
        read,
        color if unit == 1 else color / np.float32(unit),
        smoothness=smoothness,
        color_sigma=color_sigma * intensities.contrast / unit,
        progress=within(progress, 0.55, 0.9),
    )
    del color
    position = volume.position(labeled, within(progress, 0.9, 0.95))
    progress("Measuring the confidence", 0.95)
    return BestFocus(
        position,
        volume.confidence(position),
        volume.blocks.spread(two.reshape(volume.cost.shape[:2])),
        float(two.mean()),
        rate,
        variance,
        intensities,
        shown,
    )


def _usable(rate: float) -> float:
    return rate if math.isfinite(rate) else _ASSUMED_RATE


def _costs(
    power: StackPower, rate: float, size: tuple[int, int], stride: int, unit: float
) -> FocusCostVolume:
    """Return what positions cost, once planes that show spread light have no say."""
    bank, planes = power.bank, len(power.gain)
    labels_a_plane = int(np.clip(rate / _PX_A_LABEL, 1, _LABELS_A_PLANE))
    positions = np.arange((planes - 1) * labels_a_plane + 1) / labels_a_plane
    costs = power.cost(positions, rate)
    power, changed = without_spread_light(power, positions[costs.argmin(axis=1)], rate)
    costs[changed] = power.at(changed).cost(positions, rate)
    grid = len(bank.rows), len(bank.columns)
    blocks = Blocks.around(bank.rows, bank.columns, size)
    excess = power.excess().reshape(grid)
    return FocusCostVolume(costs.reshape(*grid, -1), excess, labels_a_plane, blocks, stride, unit)


def _read_planes(
    read: PlaneReader,
    banks: tuple[RingBank, ...],
    noise_variance: float | None,
    progress: Progress,
) -> tuple[list[StackPower], Float32, ShownDetail, Intensities]:
    """Read all planes: their power, each pixel's colour where it has the most detail, and more."""
    planes = read.planes
    power = [bank.room_for(len(planes)) for bank in banks]
    shares: list[list[Float32]] = [[] for _ in banks]
    noise, brightness, darkness = [], [], []
    most, color = np.zeros((0, 0), np.float32), np.zeros((0, 0, 0), np.float32)
    shown = ShownDetail(planes.shape, len(planes))
    for number in range(len(planes)):
        progress("Reading the planes", number / len(planes))
        plane = planes.look_at(number)
        picture = read.prepared(plane)
        for found, known, bank in zip(power, shares, banks, strict=True):
            of_plane = bank.power(picture.luminance, picture.opaque)
            found[..., number] = of_plane.reshape(-1, of_plane.shape[2])
            known.append(bank.known_share(picture))
        if noise_variance is not None:
            noise.append(noise_variance)
        elif not planes.moves(number):  # splines between pixels average noise
            noise.append(noise_variance_of(picture))
        if not planes.evenly_lit:
            brightness.append(float(picture.luminance.mean()))
            darkness.append(float(np.quantile(picture.luminance, _DARKEST)))
        shown.see(number, picture.luminance, planes.brightest(plane, number))
        detail = focus_measure(picture, _MEASURE_AREA)
        if number == 0:
            most, color = detail, picture.color.copy()
        else:
            sharper = detail > most
            color[sharper], most[sharper] = picture.color[sharper], detail[sharper]
    variance = float(np.median(noise))
    intensities = picture.intensities.with_contrast_of(color).above_noise(variance)
    gain = np.ones(len(planes))
    if not planes.evenly_lit:
        gain = _gains(np.array(brightness) - min(darkness), intensities.contrast)
    powers = [
        StackPower.of(found, bank, variance, gain, heard_where(known), intensities.unit)
        for found, known, bank in zip(power, shares, banks, strict=True)
    ]
    return powers, color, shown, intensities


def _gains(brightness: Float64, contrast: float) -> Float64:
    """Return how bright planes are against the others; 1 where their means cannot tell.

    Blur leaves the mean as it is, a lamp that flickers does not. It is counted from the darkest
    places, since cameras add an offset.
    """
    middle = float(np.median(brightness))
    if middle < _LEAST_BRIGHTNESS * contrast:
        return np.ones(len(brightness))
    gain = brightness / middle
    even = gain.min() > 1 / _LARGEST_DRIFT and gain.max() < _LARGEST_DRIFT
    return gain if even else np.ones(len(brightness))
