"""Stacks as they come off a microscope: planes that drift, breathe, turn and flicker, simulated.

A scene is drawn twice as fine as the planes. Each plane sees it blurred by k |z - z0| px, softened
by the camera, and samples it where its own shift, magnification and turn put its pixels, by the
mean over a pixel's area: no interpolation of pixels that were already sampled, which would be the
error that is measured. The plane in the middle is the one that did not move.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import affine_transform, gaussian_filter, uniform_filter

from napari_defocus import Disc, simulate_defocus

LARGEST = 16.0
SOFTNESS = 0.5
BRIGHTNESS = 0.7
"""Of the picture, so that a lamp 25 % brighter clips nothing."""


@dataclass(frozen=True, eq=False)
class MovingStack:
    """A simulated stack.

    Attributes
    ----------
    planes : (Z, H, W) or (Z, H, W, 3) float32 ndarray
    sharp : (H, W) or (H, W, 3) ndarray
        What the plane in the middle would show if all were in focus.
    truth : (H, W) ndarray
        Positions of best focus, there.
    shift : (Z, 2) ndarray
        px by which the scene has moved in each plane, as `StackAlignment.shift` has it.
    magnification, gain : (Z,) ndarray
    """

    planes: np.ndarray
    sharp: np.ndarray
    truth: np.ndarray
    shift: np.ndarray
    magnification: np.ndarray
    gain: np.ndarray


def taken(
    fine: np.ndarray,
    focus: Callable[[np.ndarray, np.ndarray], np.ndarray],
    *,
    planes: int = 9,
    px_per_plane: float = 1.0,
    drift: float = 0.0,
    breathing: float = 0.0,
    turning: float = 0.0,
    flicker: float = 0.0,
    noise_variance: float = 1e-6,
    margin: int = 40,
    clipped: bool = False,
    seed: int = 0,
) -> MovingStack:
    """Take a stack of a scene.

    Parameters
    ----------
    fine : (2 H + 4 margin, 2 W + 4 margin[, 3]) ndarray
        The scene, in [0, 1]; what is beyond is clipped in the planes.
    focus : callable
        z0, from the share of the height and of the width.
    drift : float
        px from plane to plane, 0.7 of them in one direction.
    breathing, turning : float
        By which factor beyond 1, and by how many degrees, from plane to plane.
    flicker : float
        Planes are brighter or darker by a factor of up to 1 + flicker; one of them is so bright.
    clipped : bool
        Whether planes end at 1.
    """
    rng = np.random.default_rng(seed)
    fine = BRIGHTNESS * np.asarray(fine, np.float32)
    soft = (2 * SOFTNESS,) * 2 + (0,) * (fine.ndim - 2)
    fine = gaussian_filter(fine, soft)
    size = tuple(length // 2 - 2 * margin for length in fine.shape[:2])
    share = [
        (((at + 0.5) / 2 - margin) / length).clip(0, 1)
        for at, length in zip(np.indices(fine.shape[:2]), size, strict=True)
    ]
    truth = focus(*share)
    middle = planes // 2
    away = np.arange(planes) - middle
    directions = rng.normal(size=(planes, 2))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    steps = drift * (0.7 * np.array([0.86, 0.51]) + 0.3 * directions)
    shifts = np.cumsum(steps, axis=0)
    shifts -= shifts[middle]
    factors = (1 + breathing) ** away * np.exp(1j * np.deg2rad(turning) * away)
    gain = np.exp(rng.uniform(-1, 1, planes) * np.log1p(flicker))
    gain[middle + 1] = 1 + flicker
    seen = []
    for number in range(planes):
        radius = np.minimum(2 * px_per_plane * np.abs(number - truth), 2 * LARGEST)
        blurred = simulate_defocus(fine, radius, psf=Disc(2 * LARGEST), noise_variance=0)
        plane = gain[number] * _sampled(blurred, factors[number], shifts[number], size, margin)
        plane = plane + rng.normal(0, noise_variance**0.5, plane.shape)
        seen.append(plane.clip(0, 1) if clipped else plane)
    sharp = _sampled(fine, 1.0 + 0j, np.zeros(2), size, margin)
    inner = tuple(slice(2 * margin, 2 * margin + 2 * length, 2) for length in size)
    back = -(shifts[:, 0] + 1j * shifts[:, 1]) / factors
    return MovingStack(
        np.asarray(seen, np.float32),
        sharp.clip(0, 1) if clipped else sharp,
        truth[inner],
        np.stack([back.real, back.imag], axis=1),
        1 / np.abs(factors),
        gain / np.median(gain),
    )


def _sampled(
    fine: np.ndarray, factor: complex, shift: np.ndarray, size: tuple[int, ...], margin: int
) -> np.ndarray:
    """Return the means over pixels at ``factor x + shift``, from the middle of the plane."""
    middle = (np.array(size) - 1) / 2
    turn = np.array([[factor.real, -factor.imag], [factor.imag, factor.real]])
    offset = 2 * (middle - turn @ middle + shift + margin)
    channels = fine.reshape(*fine.shape[:2], -1)
    found = [
        affine_transform(
            uniform_filter(channels[..., each], 2, origin=-1), 2 * turn, offset, size, order=3,
            mode="nearest",
        )
        for each in range(channels.shape[2])
    ]  # fmt: skip
    return np.stack(found, axis=-1).reshape(*size, *fine.shape[2:])
