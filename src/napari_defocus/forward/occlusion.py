"""The occlusion model of a scene with depth: nearer things hide parts of what lies behind them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft
from scipy.ndimage import distance_transform_edt
from scipy.signal import oaconvolve

from napari_defocus.core.checks import Linearize
from napari_defocus.core.image import encode_srgb, given_array, prepare_light, with_unknown
from napari_defocus.core.progress import Progress, silent
from napari_defocus.forward.simulation import noise_for
from napari_defocus.psf.families import Disc, PSFFamily, as_family

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
RadiusOfDepth = Callable[[Float64], ArrayLike]

_NOTHING = 1e-4
"""Coverage that counts as none; it is above the rounding errors of the convolutions. By hand."""


def simulate_layered_defocus(
    image: ArrayLike,
    depth: ArrayLike,
    radius_of_depth: RadiusOfDepth | ArrayLike,
    *,
    psf: PSFFamily = Disc(),
    layers: int = 32,
    linearize: Linearize | None = None,
    noise_variance: float = 0.0,
    rng: int | np.random.Generator | None = None,
    intensity_range: tuple[float, float] | None = None,
) -> tuple[Float32, Float32]:
    r"""Blur a sharp picture of a scene whose depth is known; near things hide far ones.

    The scene is cut into layers. The light of each is spread by the PSF of its own scale. Beginning
    with the nearest layer, each fills what the nearer ones leave of a pixel. So no light of a sharp
    foreground gets into the blurred background, a blurred foreground is transparent at its edge,
    and layers of one surface add up without seams. What is still left was hidden in the sharp
    picture. It is filled with the blurred colours of the nearest places that are farther away.
    `simulate_defocus` has no layers, and mixes both sides of every edge.

    With the mask :math:`m_l` of each layer, 1 in it and 0 elsewhere, and the kernel :math:`h_l`
    of its scale, light and coverage of layer l, the nearest being 1, are

    .. math::
        c_l = h_l \otimes (m_l f), \qquad \alpha_l = h_l \otimes m_l, \qquad
        a_l = \min\left(\alpha_l, \, 1 - \sum_{k < l} a_k\right), \qquad
        g = \frac{\sum_l c_l \, a_l / \alpha_l}{\sum_l a_l}

    where what was hidden counts as more layers behind all others.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The sharp picture; a fourth channel (opacity) is left out.
    depth : (H, W) array_like
        Any measure that grows with the distance, in any unit. NaN is unknown: it becomes the
        farthest of the next known depths to the left, right, top and bottom, because places that
        one of two cameras does not see lie behind. All layers are equally thick, so the scale
        should be about linear in the depth: for a lens, take minus the disparity, or minus one
        over the distance.
    radius_of_depth : callable or (H, W) array_like
        Scale in px, within the family's domain: a function of the depth, (H, W) float64 without
        gaps, or its values. A layer has the mean scale of its pixels.
    psf : PSFFamily or callable, optional
    layers : int, optional
        The largest number of layers. If there are not more depths than that, each is a layer.
        Things hide each other only if they are farther apart than the whole range divided by
        `layers`.
    linearize : {"srgb"}, optional
        Decode the picture into linear light before, and encode it afterwards.
    noise_variance : float, optional
        Variance of the white Gaussian noise in each channel of the result, intensities in
        [0, 1].
    rng : int or numpy.random.Generator, optional
        Seed or source of the noise.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1. By default floats are taken as they are, and
        integers as `estimate_candidates` takes them.

    Returns
    -------
    picture : (H, W) or (H, W, 3) float32 ndarray
        Nominally in [0, 1]; noise may go beyond, nothing is clipped. NaN where `image` is NaN
        or masked.
    blur_map : (H, W) float32 ndarray
        Scale in px of what the sharp picture shows at each pixel.

    Raises
    ------
    TypeError, ValueError
        If `image` is not a picture (see `estimate_candidates`), `depth` or `radius_of_depth` has
        another shape or no real numbers, `depth` is infinite or unknown everywhere, a scale is
        outside the domain, `layers` is not a whole number from 1 up, `linearize` is unknown, or
        `noise_variance` is negative.

    Examples
    --------
    A sharp white wall, nearer than a black background that is blurred:

    >>> import numpy as np
    >>> wall = np.arange(6) >= np.full((6, 1), 3)
    >>> picture, blur_map = simulate_layered_defocus(wall, -1.0 * wall, lambda z: 2 * (z + 1))
    >>> picture[0]
    array([0., 0., 0., 1., 1., 1.], dtype=float32)
    >>> blur_map[0]
    array([2., 2., 2., 0., 0., 0.], dtype=float32)
    """
    psf = as_family(psf)
    picture = prepare_light(image, intensity_range, linearize)
    distance = _without_gaps(_checked_depth(depth, picture.shape))
    radii = _checked_radii(radius_of_depth, distance, psf)
    _check_layers(layers)
    noise = noise_for(noise_variance, rng)
    scene = Layers.cut(distance, layers)
    kernels = [psf.kernel(min(mean, psf.max_scale)) for mean in scene.mean(radii)]
    seen = spread_layers(picture.color, scene, kernels)
    if linearize == "srgb":
        seen = encode_srgb(seen)
    if noise_variance > 0:
        white = noise.standard_normal(seen.shape, np.float32)
        seen += np.float32(np.sqrt(noise_variance)) * white
    seen = with_unknown(seen[..., 0] if seen.shape[2] == 1 else seen, image)
    return seen, radii.astype(np.float32)


@dataclass(frozen=True)
class Layers:
    """A scene cut into layers, equally thick in its depth.

    Attributes
    ----------
    number : (H, W) intp ndarray
        The layer of each pixel: 0 is the nearest, none is empty.
    behind : (H, W) intp ndarray
        The pixel, counted row by row, that continues behind each one: the next that is more
        than a layer farther away; -1 for none.
    """

    number: NDArray[np.intp]
    behind: NDArray[np.intp]

    @classmethod
    def cut(cls, depth: Float64, most: int, progress: Progress = silent) -> Self:
        """Cut a scene into at most so many layers; if it has no more depths, each is a layer."""
        depths, number = np.unique(depth, return_inverse=True)
        thickness = float(np.ptp(depths)) / most
        if len(depths) > most:
            slot = np.minimum(((depth - depths[0]) / thickness).astype(np.intp), most - 1)
            number = np.unique(slot, return_inverse=True)[1]
        number = number.reshape(depth.shape)
        behind = np.full_like(number, -1)
        for layer in range(number.max()):
            progress("Finding what hides what", layer / number.max())
            here = number == layer
            nearer = depth <= depth[here].max() + thickness
            if not nearer.all():
                pixel = distance_transform_edt(nearer, return_distances=False, return_indices=True)
                behind[here] = np.ravel_multi_index(tuple(pixel[:, here]), depth.shape)
        return cls(number, behind)

    def mean(self, values: Float64) -> Float64:
        """Return the mean of some values, (H, W), in each layer."""
        pixels = np.bincount(self.number.ravel())
        return np.bincount(self.number.ravel(), values.ravel()) / pixels


def spread_layers(
    color: Float32, layers: Layers, kernels: Sequence[Float64], progress: Progress = silent
) -> Float32:
    """Spread the light of each layer by its own kernel, what is in front first.

    Parameters
    ----------
    color : (H, W, C) float32 ndarray
        Linear light; values below 0 are light that is missing.
    layers : Layers
    kernels : sequence of (K, K) ndarray
        One for each layer.
    progress : callable, optional

    Returns
    -------
    (H, W, C) float32 ndarray
    """
    height, width = layers.number.shape
    # The last channel is coverage.
    light = np.dstack([color, np.ones((height, width), np.float32)])
    hides = layers.behind >= 0
    parts = [
        (light, layers.number),
        (
            light.reshape(height * width, -1)[layers.behind],
            np.where(hides, layers.number.ravel()[layers.behind], -1),
        ),
    ]
    reach = max(len(kernel) for kernel in kernels) // 2
    seen = np.zeros((height + 2 * reach, width + 2 * reach, light.shape[2]), np.float32)
    for part, (source, number) in enumerate(parts):
        source = np.pad(source, ((reach, reach), (reach, reach), (0, 0)), mode="symmetric")
        number = np.pad(number, reach, mode="symmetric")
        for layer, kernel in enumerate(kernels):
            progress("Spreading the light", (part + layer / len(kernels)) / len(parts))
            box, own = _spread(source, number == layer, kernel)
            left = 1 - seen[box][..., -1:]
            seen[box] += own * np.minimum(1, left / np.maximum(own[..., -1:], _NOTHING))
    # What is still left comes from layers of different blur on one surface.
    seen /= np.maximum(seen[..., -1:], _NOTHING)
    return seen[reach : height + reach, reach : width + reach, :-1]


def _spread(
    light: Float32, here: NDArray[np.bool_], kernel: Float64
) -> tuple[tuple[slice, ...], Float32]:
    """Spread the light of some pixels: where it falls, a box of the picture, and how much."""
    reach = len(kernel) // 2
    box = tuple(
        slice(max(int(at[0]) - reach, 0), int(at[-1]) + reach + 1) if len(at) else slice(0)
        for at in (np.flatnonzero(here.any(axis=1 - axis)) for axis in (0, 1))
    )
    own = light[box] * here[box][..., None]
    if len(kernel) == 1 or own.size == 0:
        return box, own
    with fft.set_workers(-1):
        return box, oaconvolve(own, kernel[..., None].astype(np.float32), "same", axes=(0, 1))


def _without_gaps(depth: Float64) -> Float64:
    """Fill NaN with the farthest of the next known values to four sides."""
    while np.isnan(depth).any():
        sides = [
            np.flip(_last_known(np.flip(depth, axis), axis), axis) if back
            else _last_known(depth, axis)
            for axis in (0, 1)
            for back in (False, True)
        ]  # fmt: skip
        depth = np.where(np.isnan(depth), np.fmax.reduce(sides), depth)
    return depth


def _last_known(depth: Float64, axis: int) -> Float64:
    """Return the last value along an axis that is not NaN; NaN before the first."""
    place = np.where(np.isnan(depth), 0, np.indices(depth.shape)[axis])
    return np.take_along_axis(depth, np.maximum.accumulate(place, axis=axis), axis)


def _checked_depth(depth: ArrayLike, shape: tuple[int, int]) -> Float64:
    array = _checked_plane("depth has", depth, shape)
    if np.isinf(array).any() or np.isnan(array).all():
        raise ValueError("depth has infinite values or only NaN; it takes finite ones, NaN unknown")
    return array


def _checked_radii(
    radius_of_depth: RadiusOfDepth | ArrayLike, distance: Float64, psf: PSFFamily
) -> Float64:
    if callable(radius_of_depth):
        try:
            name, values = "radius_of_depth returned", radius_of_depth(distance)
        # Functions of others raise anything.
        except Exception as error:
            raise ValueError(
                f"radius_of_depth of an array of shape {distance.shape} ends in "
                f"{type(error).__name__}: {error}"
            ) from error
    else:
        name, values = "radius_of_depth has", radius_of_depth
    radii = _checked_plane(name, values, distance.shape)
    if not (np.isfinite(radii).all() and radii.min() >= 0 and radii.max() <= psf.max_scale):
        raise ValueError(
            f"{name} scales from {radii.min()} to {radii.max()} px; "
            f"{psf!r} takes 0 to {psf.max_scale} px"
        )
    return radii


def _checked_plane(found: str, values: ArrayLike, shape: tuple[int, ...]) -> Float64:
    array = given_array(found.split()[0], values)
    if array.dtype.kind not in "uif":
        raise TypeError(f"{found} dtype {array.dtype}; it takes real numbers")
    if array.shape != shape:
        raise ValueError(f"{found} shape {array.shape}; it takes the picture's, {shape}")
    return array.astype(np.float64)


def _check_layers(layers: object) -> None:
    if not isinstance(layers, int | np.integer):
        raise TypeError(f"layers is {layers!r}; it takes a whole number from 1 up")
    if layers < 1:
        raise ValueError(f"layers is {layers}; it takes a whole number from 1 up")
