"""Another focus, chosen afterwards: the all-in-focus picture, blurred again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import (
    Linearize,
    Side,
    check_aperture,
    check_focus,
    check_noise_variance,
    check_tv_weight,
)
from napari_defocus.core.image import (
    PreparedImage,
    encode_srgb,
    given_image,
    prepare_image,
    with_unknown,
)
from napari_defocus.core.progress import Progress, silent, within
from napari_defocus.forward.blur_operator import checked_scales
from napari_defocus.forward.occlusion import Layers, spread_layers
from napari_defocus.optics.thin_lens import checked_side
from napari_defocus.psf.families import Disc, PSFFamily, as_family
from napari_defocus.psf.measured import MeasuredPSF
from napari_defocus.restoration.all_in_focus import Restoration, in_shape_of
from napari_defocus.settings import RefocusSettings, RestorationSettings

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_LAYER, _MOST_LAYERS = 0.25, 32
"""px of blur from layer to layer, before or after the change, and the most layers. By hand."""


def change_focus(
    image: ArrayLike,
    blur_map: ArrayLike,
    *,
    focus: float = RefocusSettings.focus,
    aperture: float = RefocusSettings.aperture,
    side: Side | ArrayLike = RefocusSettings.side,
    psf: PSFFamily = Disc(),
    all_in_focus: ArrayLike | None = None,
    noise_variance: float | None = RestorationSettings.noise_variance,
    confidence: ArrayLike | None = None,
    tv_weight: float | None = RestorationSettings.tv_weight,
    linearize: Linearize | None = RefocusSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> Float32:
    r"""Change the focus or the aperture of a picture after it was taken.

    A thin lens that is focused at the distance s blurs a point at the distance d by the signed
    radius r, positive beyond s; R is proportional to the diameter of the aperture. Now the lens is
    focused at s' instead, where r was :math:`r_0` (the argument `focus`), and its aperture is made
    A times as wide (the argument `aperture`). Then it blurs the same point by r':

    .. math:: r = R \left(\frac{1}{s} - \frac{1}{d}\right), \qquad r' = A \, (r - r_0)

    This holds for any R, s and d. A real lens that is focused nearer also magnifies the picture, by
    (1 - f/s) / (1 - f/s') with the focal length f: by 1.02 for 50 mm from 2 m to 1.2 m. Here the
    size stays the same. An aperture above 1 magnifies the defocus, as Bae and Durand do [1]_. One
    below 1 reduces it, and 0 gives the all-in-focus picture.

    The all-in-focus picture is blurred again as `simulate_layered_defocus` does it: nearer things
    hide farther ones, and what they hid before is filled from around. The same is done with the old
    radii. What the picture has beyond that, such as noise, fine texture and the light of
    highlights, is added. It is blurred by :math:`\sqrt{r'^2 - r^2}` where the blur grows, and
    reduced by :math:`|r' / r|` where it shrinks. With :math:`B_r` for this forward model and the
    all-in-focus picture :math:`\hat{f}`,

    .. math:: g' = B_{r'} \hat{f} + B_{\sqrt{\max(r'^2 - r^2, \, 0)}} \left(
        \min(1, |r' / r|) \, (g - B_r \hat{f})\right)

    So nothing changes where the radius stays the same. Where it grows, faults of the all-in-focus
    picture hardly show. Where it shrinks, they show.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        Any real dtype, see `estimate_candidates`. A fourth channel is opacity.
    blur_map : (H, W) array_like
        The blur radius at every pixel, in px, within the family's domain; such as from
        `estimate_blur_map`.
    focus : float, optional
        The scale, in px, of what becomes sharp: on the chosen side of the old focus, or on the
        other side if negative. If `side` is an array, positive is beyond. `blur_from_depth`
        returns the scale of a distance.
    aperture : float, optional
        How many times as wide the blur becomes, from 0 up.
    side : {"far", "near"} or (H, W) bool array_like, optional
        Whether what is blurred lies beyond the old focus; for each pixel, True where it does.
    psf : PSFFamily or callable, optional
        The family of the map. Kernels of things that change to the other side of the focus are
        turned by 180 degrees, which matters for odd numbers of blades.
    all_in_focus : array_like, optional
        From `restore_all_in_focus` with the same arguments, in [0, 1], or any other sharp
        version of the picture. If it is missing, it is made first, which takes most of the time.
        For an estimated map, one made with `cautious_blur_map` is better.
    noise_variance, confidence, tv_weight
        See `restore_all_in_focus`; not used if `all_in_focus` is given. The confidence is 1
        everywhere if left out.
    linearize : {"srgb"} or None, optional
        Decode into linear light, restore and blur there, and encode again. A lens adds up light,
        so that highlights become discs and not grey. A clipped highlight counts as white; the
        discs of a real lens would be brighter.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; found by default, see `estimate_candidates`.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    float32 ndarray
        In [0, 1], which is `intensity_range`, of the shape of `image`; a fourth channel is its
        opacity. NaN where `image` is NaN or masked.

    Raises
    ------
    TypeError, ValueError
        If `image` is not a picture (see `estimate_candidates`), or another array has another
        height and width. If an argument is of another kind or out of range. If the new radii are
        larger than the picture's longer side, or than your own family allows. All of this is
        checked before any work.

    References
    ----------
    .. [1] S. Bae, F. Durand, "Defocus Magnification", Computer Graphics Forum 26(3), 2007.

    Examples
    --------
    A far half, blurred by 3 px, that shall be sharp:

    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import *
    >>> sharp, radii = camera()[100:200, 200:300], np.full((100, 100), 3.0)
    >>> radii[50:] = 0
    >>> picture = simulate_defocus(sharp, radii)
    >>> refocused = change_focus(picture, radii, focus=3.0)
    >>> def detail(half):
    ...     return float(np.abs(np.diff(half)).mean())
    >>> detail(refocused[:50]) > 2 * detail(picture[:50])
    True
    >>> detail(refocused[50:]) < 0.7 * detail(picture[50:])
    True
    """
    psf = as_family(psf)
    check_focus(focus)
    check_aperture(aperture)
    check_noise_variance(noise_variance)
    check_tv_weight(tv_weight)
    picture = prepare_image(image, intensity_range, linearize)
    scale = checked_scales(blur_map, picture.shape, psf).astype(np.float64)
    beyond = checked_side(side, picture.shape)
    plane = -focus if isinstance(side, str) and side == "near" else focus
    signed = np.where(beyond, scale, -scale)
    shifted = aperture * (signed - plane)
    wide = _reaching(psf, float(np.abs(shifted).max()), max(picture.shape), focus, aperture)
    sharp = None if all_in_focus is None else _checked_sharp(all_in_focus, picture, linearize)
    if np.array_equal(shifted, signed):
        progress("Nothing changes", 1.0)
        return _as_given(picture.color, image, linearize)
    if sharp is None:
        # With a confidence, less blur is taken away where two depths meet.
        sure = np.ones(picture.shape, np.float32) if confidence is None else confidence
        how = Restoration(psf, noise_variance, tv_weight, linearize, intensity_range)
        restored = how.restored(image, picture, blur_map, sure, within(progress, 0.0, 0.8))
        sharp = prepare_image(restored, (0.0, 1.0), linearize).color
        progress = within(progress, 0.8, 1.0)
    layers = _layers(signed, shifted, within(progress, 0.0, 0.1))
    # What was sharp came from the chosen side.
    crossed = layers.mean(np.where(beyond, shifted, -shifted)) < 0
    change = _Change(layers, np.abs(signed), np.abs(shifted), crossed, wide)
    seen = _blurred_again(picture, sharp, change, within(progress, 0.1, 1.0, "Blurring again"))
    progress("Blurring again", 1.0)
    return _as_given(seen, image, linearize)


@dataclass(frozen=True)
class _Change:
    """What changes: scales before and after, (H, W), and which layers cross the focus, (L,)."""

    layers: Layers
    old: Float64
    new: Float64
    crossed: NDArray[np.bool_]
    psf: PSFFamily

    def kernels(self, scale: Float64) -> list[Float64]:
        """Return each layer's kernel of its mean scale."""
        return [self.psf.kernel(min(mean, self.psf.max_scale)) for mean in self.layers.mean(scale)]

    def new_kernels(self) -> list[Float64]:
        """Return each layer's new kernel, turned by half a turn beyond the focus."""
        return [
            kernel[::-1, ::-1] if turn else kernel
            for kernel, turn in zip(self.kernels(self.new), self.crossed, strict=True)
        ]


def _blurred_again(
    picture: PreparedImage, sharp: Float32, change: _Change, progress: Progress
) -> Float32:
    """Blur an all-in-focus picture, and add what the old blur of it does not explain."""
    layers, old, new = change.layers, change.old, change.new
    explained = spread_layers(sharp, layers, change.kernels(old), within(progress, 0.0, 1 / 3))
    seen = spread_layers(sharp, layers, change.new_kernels(), within(progress, 1 / 3, 2 / 3))
    share = np.divide(new, old, out=np.ones_like(old), where=new < old)
    if picture.opaque is not None:
        share = share * picture.opaque
    left = share[..., None].astype(np.float32) * (picture.color - explained)
    growth = np.sqrt(np.maximum(new**2 - old**2, 0))
    return seen + spread_layers(left, layers, change.kernels(growth), within(progress, 2 / 3, 1.0))


def _layers(signed: Float64, shifted: Float64, progress: Progress) -> Layers:
    span = max(float(np.ptp(signed)), float(np.ptp(shifted)))
    return Layers.cut(signed, int(np.clip(np.ceil(span / _LAYER), 1, _MOST_LAYERS)), progress)


def _reaching(
    psf: PSFFamily, largest: float, longest: int, focus: float, aperture: float
) -> PSFFamily:
    """Return the family, for scales up to the largest new one."""
    found = f"focus is {focus:g} and aperture is {aperture:g}, for blur of up to {largest:g} px"
    if largest > longest:
        raise ValueError(f"{found}; it takes radii up to the picture's longer side, {longest} px")
    if largest <= psf.max_scale:
        return psf
    if isinstance(psf, MeasuredPSF):
        return MeasuredPSF(psf.scales, psf.kernels, max_scale=largest, provenance=psf.provenance)
    family = cast(Any, psf)
    if "max_radius" in getattr(family, "__dataclass_fields__", ()):
        return cast(PSFFamily, replace(family, max_radius=largest))
    raise ValueError(f"{found}; {psf!r} takes 0 to {psf.max_scale:g} px: give one that takes more")


def _checked_sharp(
    all_in_focus: ArrayLike, picture: PreparedImage, linearize: Linearize | None
) -> Float32:
    try:
        floats = given_image("all_in_focus", all_in_focus).dtype.kind == "f"
        sharp = prepare_image(all_in_focus, (0.0, 1.0) if floats else None, linearize).color
    except (TypeError, ValueError) as error:
        raise type(error)(str(error).replace("image", "all_in_focus", 1)) from None
    if sharp.shape != picture.color.shape:
        raise ValueError(
            f"all_in_focus has height, width and channels {sharp.shape}; "
            f"it takes the picture's, {picture.color.shape}"
        )
    return sharp


def _as_given(light: Float32, image: ArrayLike, linearize: Linearize | None) -> Float32:
    """Return light as a picture of the shape of the given one, with its opacity."""
    color = np.clip(encode_srgb(light) if linearize == "srgb" else light, 0, 1)
    return with_unknown(in_shape_of(image, color), image)
