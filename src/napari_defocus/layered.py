"""The forward model of a scene with depth: nearer things hide parts of what lies behind them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt
from scipy.signal import oaconvolve

from napari_defocus.image import encode_srgb, prepare_image
from napari_defocus.psf import Disc, PSFFamily, as_family
from napari_defocus.settings import Linearize

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
RadiusOfDepth = Callable[[Float64], ArrayLike]

_NOTHING = 1e-4
"""Coverage that counts as none, above the rounding errors of the convolutions."""


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
    """Blur a sharp picture of a scene whose depth is known, with what hides what.

    The scene is cut into layers. The light of each is spread by the PSF of its own scale, and
    fills, nearest layer first, what the nearer ones leave of each pixel: no light of a sharp
    foreground gets into the blurred background, a blurred foreground is transparent at its
    edge, and layers of one surface add up without seams. What still is left was hidden in the
    sharp picture: it is filled with the blurred colours of the nearest places that are farther
    away. `simulate_defocus` knows no layers, and mixes both sides of every edge.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        The sharp picture; a fourth channel (opacity) is left out.
    depth : (H, W) array_like
        Any measure that grows with the distance, in any unit. NaN is unknown: it becomes the
        farthest of the next known depths to the left, right, top and bottom, as what one of two
        cameras does not see lies behind. Layers are equally thick in it, so let the scale be
        about linear in it: for a lens, minus the disparity, or minus one over the distance.
    radius_of_depth : callable or (H, W) array_like
        Scale in px, within the family's domain: a function that is given the depth without
        gaps, (H, W) float64, or its values. A layer has the mean of its pixels.
    psf : PSFFamily or callable, optional
    layers : int, optional
        The largest number of layers. If there are no more depths than that, each is a layer.
        Nothing hides what is less than the whole range divided by `layers` farther away.
    linearize : {"srgb"}, optional
        Decode the picture into linear light before, and encode it afterwards.
    noise_variance : float, optional
        Variance of the white Gaussian noise in each channel of the result, intensities in
        [0, 1].
    rng : int or numpy.random.Generator, optional
        Seed or source of the noise.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1.

    Returns
    -------
    picture : (H, W) or (H, W, 3) float32 ndarray
        Nominally in [0, 1]; noise may go beyond, nothing is clipped.
    blur_map : (H, W) float32 ndarray
        Scale in px of what the sharp picture shows at each pixel.

    Raises
    ------
    TypeError, ValueError
        If `image` is no picture (see `estimate_candidates`), `depth` or `radius_of_depth` has
        another shape or no real numbers, `depth` is infinite or unknown everywhere, a scale is
        outside the domain, `layers` is no whole number from 1 up, `linearize` is unknown, or
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
    picture = prepare_image(image, intensity_range, linearize)
    distance = _without_gaps(_checked_depth(depth, picture.shape))
    radii = _checked_radii(radius_of_depth, distance, psf)
    _check_layers(layers)
    if not (np.isfinite(noise_variance) and noise_variance >= 0):
        raise ValueError(f"noise_variance is {noise_variance}; it takes a finite number from 0 up")
    seen = _composite(picture.color, distance, radii, psf, layers)
    if linearize == "srgb":
        seen = encode_srgb(seen)
    if noise_variance > 0:
        noise = np.random.default_rng(rng).standard_normal(seen.shape, np.float32)
        seen += np.float32(np.sqrt(noise_variance)) * noise
    return seen[..., 0] if seen.shape[2] == 1 else seen, radii.astype(np.float32)


def _composite(
    color: Float32, distance: Float64, radii: Float64, psf: PSFFamily, layers: int
) -> Float32:
    """Spread the light of each layer, what is in front first: (H, W, C)."""
    layer_of, thickness = _cut(distance, layers)
    pixels = np.bincount(layer_of.ravel())
    means = np.bincount(layer_of.ravel(), radii.ravel()) / pixels
    kernels = [psf.kernel(min(mean, psf.max_scale)) for mean in means]
    reach = max(len(kernel) for kernel in kernels) // 2
    edge = ((reach, reach), (reach, reach))
    layer_of = np.pad(layer_of, edge, mode="symmetric")
    distance = np.pad(distance, edge, mode="symmetric")
    # The last channel is coverage.
    light = np.dstack([np.pad(color, (*edge, (0, 0)), mode="symmetric"), np.ones_like(distance)])
    light = light.astype(np.float32)
    behind, layer_behind = _behind(light, distance, layer_of, thickness)
    seen, hidden = np.zeros_like(light), np.zeros_like(light)
    for layer, kernel in enumerate(kernels):
        own = _spread(light * (layer_of == layer)[..., None], kernel)
        left = 1 - seen[..., -1:]
        seen += own * np.minimum(1, left / np.maximum(own[..., -1:], _NOTHING))
        hidden += _spread(behind * (layer_behind == layer)[..., None], kernel)
    # Where nothing is hidden, what is left comes from layers of different blur on one surface.
    rest = hidden + _NOTHING * seen
    seen += (1 - seen[..., -1:]) * rest / np.maximum(rest[..., -1:], _NOTHING**2)
    height, width = distance.shape
    return seen[reach : height - reach, reach : width - reach, :-1]


def _cut(distance: Float64, layers: int) -> tuple[NDArray[np.intp], float]:
    """Return the layer of each pixel, 0 the nearest, none of them empty, and the thickness."""
    depths, layer_of = np.unique(distance, return_inverse=True)
    thickness = float(np.ptp(depths)) / layers
    if len(depths) > layers:
        slot = np.minimum(((distance - depths[0]) / thickness).astype(np.intp), layers - 1)
        layer_of = np.unique(slot, return_inverse=True)[1]
    return layer_of.reshape(distance.shape), thickness


def _behind(
    light: Float32, distance: Float64, layer_of: NDArray[np.intp], thickness: float
) -> tuple[Float32, NDArray[np.intp]]:
    """Return the light that each pixel hides, (H, W, C), and its layer, -1 for none.

    It is that of the nearest pixel more than a layer farther away.
    """
    behind, layer_behind = np.zeros_like(light), np.full_like(layer_of, -1)
    for layer in range(layer_of.max()):
        here = layer_of == layer
        nearer = distance <= distance[here].max() + thickness
        if not nearer.all():
            rows, columns = distance_transform_edt(
                nearer, return_distances=False, return_indices=True
            )[:, here]
            behind[here], layer_behind[here] = light[rows, columns], layer_of[rows, columns]
    return behind, layer_behind


def _spread(light: Float32, kernel: Float64) -> Float32:
    if len(kernel) == 1:
        return light
    return oaconvolve(light, kernel[..., None].astype(np.float32), mode="same", axes=(0, 1))


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
        name, values = "radius_of_depth returned", radius_of_depth(distance)
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
    array = np.asarray(values)
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
