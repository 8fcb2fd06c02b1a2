"""From blur to distance for a thin lens, and back."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import Side, check_number
from napari_defocus.core.image import given_array, given_reals
from napari_defocus.optics.exif import noted_lens, pitch_advice

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_ROUNDING = float(np.finfo(np.float32).eps)
"""The relative error of a distance whose blur is in single precision."""


@dataclass(frozen=True, kw_only=True)
class ThinLens:
    r"""An ideal lens, and how fine its picture is sampled.

    A point at the distance d has the blur radius r, in px, if the plane at the distance s is in
    focus. With the focal length f, the f-number N and the pixel pitch p, all lengths in one unit,

    .. math:: r = K \frac{|d - s|}{d}, \qquad K = \frac{f^2}{2 N p \, (s - f)}

    With the focus at infinity, :math:`r = f^2 / (2 N p d)`. A real lens has its distances from
    planes inside of it, a little apart from each other, and its f changes when it focuses: close
    to the lens, both matter.

    Parameters
    ----------
    focal_length_mm : float
        f, in mm; the real one, not that of a 35 mm camera with the same view.
    f_number : float
        N, the focal length over the diameter of the aperture.
    focus_distance_m : float
        s, in m, from the lens to the plane in focus; infinity is allowed.
    pixel_pitch_um : float
        p, in um on the sensor: the distance of the picture's pixels. A picture that was scaled
        down to a half has twice the pitch of the sensor. If nothing was cropped, it is 1000 times
        the width of the sensor in mm over the width of the picture in px.

    Raises
    ------
    TypeError
        If one is not a number.
    ValueError
        If one is not above 0, or not finite but for the focus distance, or if the focus
        distance is not above the focal length.

    Examples
    --------
    >>> import math
    >>> lens = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=5)
    >>> round(lens.largest_radius, 2)
    64.1
    >>> blur_from_depth([1.0, 2.0, 3.0, math.inf], lens).round(2)
    array([64.1 ,  0.  , 21.37, 64.1 ], dtype=float32)
    """

    focal_length_mm: float
    f_number: float
    focus_distance_m: float
    pixel_pitch_um: float

    def __post_init__(self) -> None:
        for name in ("focal_length_mm", "f_number", "pixel_pitch_um"):
            value = getattr(self, name)
            check_number(name, value, lambda v: 0 < v < math.inf, "a finite number above 0")
        check_number(
            "focus_distance_m",
            self.focus_distance_m,
            lambda s: s > 0 and float(self.focal_length_mm) / 1000 / s < 1,
            f"a distance above the focal length, {self.focal_length_mm / 1000:g} m",
        )
        if not math.isfinite(self._radius_per_dioptre):
            raise ValueError(
                f"f_number is {self.f_number} and pixel_pitch_um is {self.pixel_pitch_um}; "
                "it takes larger ones, as blur would be infinite"
            )

    @property
    def largest_radius(self) -> float:
        """K, the radius in px of a point infinitely far away; 0 for a focus at infinity.

        No point beyond the focus is more blurred.
        """
        return self._radius_per_dioptre / self.focus_distance_m

    @property
    def _radius_per_dioptre(self) -> float:
        """K s: the radius in px over |1/d - 1/s|, in 1/m."""
        # In double precision, whatever was given.
        focal_length_mm = float(self.focal_length_mm)
        aperture_mm = focal_length_mm / self.f_number
        at_infinity = aperture_mm * focal_length_mm / (2 * self.pixel_pitch_um)
        return at_infinity / (1 - focal_length_mm / 1000 / self.focus_distance_m)

    @classmethod
    def from_exif(
        cls,
        path: str | os.PathLike[str],
        *,
        focal_length_mm: float | None = None,
        f_number: float | None = None,
        focus_distance_m: float | None = None,
        pixel_pitch_um: float | None = None,
        image_size: tuple[int, int] | None = None,
    ) -> Self:
        """Take the lens from what the camera noted in a photograph (EXIF).

        Values that you give count more than what is noted. Most cameras do not note the focus
        distance, or only roughly and from the sensor. The pitch comes from the resolution of the
        focal plane, or otherwise from the focal length that has the same view on 35 mm film (a
        diagonal of 43.27 mm). If the size at capture is noted and the picture has another size
        now, the pitch is that of the scaled picture. A picture that was cropped to the same shape
        looks like a scaled one: then give the pitch. The pitch counts as not noted if the ratio
        of the sides differs from that at capture by more than 1 %. Programs that scale a picture
        and write its new size over that at capture make the pitch too small. Where a pitch came
        from is in ``noted_lens(path).pitch_from`` of `napari_defocus.optics.exif`.

        Parameters
        ----------
        path : path-like
            A JPEG, TIFF, PNG, WebP or BMP file; HEIC with the extra "heic".
        focal_length_mm, f_number, focus_distance_m, pixel_pitch_um : float, optional
            What the file does not note, or notes wrongly; see `ThinLens`.
        image_size : (int, int), optional
            Height and width in px of the picture that is analysed, if it was scaled after it
            was read from the file. Their order does not matter.

        Returns
        -------
        ThinLens

        Raises
        ------
        TypeError
            If `image_size` is not a pair of whole numbers, or something given is not a number.
        ValueError
            If the file cannot be read, or the lens is not known completely: the message names
            all that is missing. Also if no lens can have these values.

        Examples
        --------
        >>> import tempfile, pathlib, PIL.Image
        >>> exif = PIL.Image.Exif()
        >>> exif.get_ifd(0x8769).update({0x829D: 2.8, 0x920A: 35.0, 0xA405: 52})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = pathlib.Path(folder, "photograph.jpg")
        ...     PIL.Image.new("L", (600, 400)).save(file, exif=exif)
        ...     lens = ThinLens.from_exif(file, focus_distance_m=3.0)
        >>> lens.focal_length_mm, lens.f_number, round(lens.pixel_pitch_um, 1)
        (35.0, 2.8, 40.4)
        """
        given = {
            "focal_length_mm": focal_length_mm,
            "f_number": f_number,
            "focus_distance_m": focus_distance_m,
            "pixel_pitch_um": pixel_pitch_um,
        }
        noted = noted_lens(path, focal_length_mm, image_size)
        known = {
            name: noted.values[name] if value is None else value for name, value in given.items()
        }
        lens = {name: value for name, value in known.items() if value is not None}
        missing = [name for name in known if name not in lens]
        if missing:
            advice = f". {pitch_advice(noted.image_size)}" if "pixel_pitch_um" in missing else ""
            raise ValueError(
                f"the EXIF of {path} does not note {_enumerated(missing)}; give what is missing"
                f"{advice}"
            )
        try:
            return cls(**lens)
        except ValueError as error:
            if from_file := [name for name in lens if given[name] is None]:
                raise ValueError(f"{error} ({path} notes {_enumerated(from_file)})") from error
            raise


def depth_from_blur(
    blur_map: ArrayLike,
    lens: ThinLens,
    *,
    side: Side | ArrayLike = "far",
) -> Float32:
    r"""Turn blur into distance, for a thin lens.

    With the radius r of the blur and s, K of `ThinLens`, a point lies at

    .. math:: d = \frac{s}{1 - r / K} \text{ beyond the focus}, \qquad
        d = \frac{s}{1 + r / K} \text{ before it}

    and with the focus at infinity at :math:`d = f^2 / (2 N p r)`. A radius alone cannot say on
    which side of the focus a point lies: the same blur belongs to one distance on either side. You
    choose, for the whole picture or for each pixel. Radii below 0.5 px cannot be told from 0, so
    that near the focus distances are rough.

    Parameters
    ----------
    blur_map : array_like of any shape
        The blur radius, in px, from 0 up; such as from `estimate_blur_map`. NaN is unknown.
    lens : ThinLens
    side : {"far", "near"} or bool array_like of the same shape, optional
        Whether points lie beyond the focus; for each pixel, True where they do.

    Returns
    -------
    float32 ndarray
        Distance from the lens in m, of the map's shape. Infinity beyond the focus where the
        radius is K or more: no point is that much blurred there. NaN where the map has NaN.

    Raises
    ------
    TypeError
        If `blur_map` holds no real numbers, `side` is an array of another dtype than bool,
        or `lens` is not a `ThinLens`.
    ValueError
        If the map has negative or infinite values, `side` is another word or has another shape,
        or points are to lie beyond a focus at infinity.

    Examples
    --------
    >>> lens = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=5)
    >>> depth_from_blur([0.0, 4.0, 8.0, 80.0], lens).round(3)
    array([2.   , 2.133, 2.285,   inf], dtype=float32)
    >>> depth_from_blur([0.0, 4.0, 8.0, 80.0], lens, side="near").round(3)
    array([2.   , 1.883, 1.778, 0.89 ], dtype=float32)
    """
    _check_lens(lens)
    radius = given_reals("blur_map", blur_map)
    if (radius < 0).any() or np.isinf(radius).any():
        raise ValueError(
            f"blur_map has values from {np.nanmin(radius):g} to {np.nanmax(radius):g}; "
            "it takes finite ones from 0 px up, NaN unknown"
        )
    beyond = checked_side(side, radius.shape)
    if math.isinf(lens.focus_distance_m) and beyond.any():
        raise ValueError(
            "side says that points lie beyond the focus, but it is at infinity; it takes 'near'"
        )
    in_focus = 1 / lens.focus_distance_m
    dioptres = in_focus + np.where(beyond, -1, 1) * radius / lens._radius_per_dioptre
    # K as float32 may be rounded down; a point infinitely far away stays there.
    infinite = dioptres <= _ROUNDING * in_focus
    depth = np.divide(1, dioptres, out=np.full(radius.shape, np.inf), where=~infinite)
    return _as_float32(depth)


def blur_from_depth(depth: ArrayLike, lens: ThinLens) -> Float32:
    r"""Turn distance into blur, for a thin lens, see `ThinLens`.

    .. math:: r = K \frac{|d - s|}{d}

    Parameters
    ----------
    depth : array_like of any shape
        Distance d from the lens, in m, above 0; infinity is allowed. NaN is unknown.
    lens : ThinLens

    Returns
    -------
    float32 ndarray
        The blur radius in px, of the shape of `depth`; not limited to what is looked for. NaN
        where `depth` has NaN.

    Raises
    ------
    TypeError
        If `depth` holds no real numbers, or `lens` is not a `ThinLens`.
    ValueError
        If a distance is 0 or negative.

    Examples
    --------
    >>> import math
    >>> lens = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=5)
    >>> blur_from_depth([1.9, 2.0, 2.1], lens).round(2)
    array([3.37, 0.  , 3.05], dtype=float32)
    """
    _check_lens(lens)
    distance = checked_depth(depth)
    with np.errstate(over="ignore"):
        dioptres = np.abs(1 / distance - 1 / lens.focus_distance_m)
        radius = lens._radius_per_dioptre * dioptres
    return _as_float32(radius)


def _check_lens(lens: object) -> None:
    if not isinstance(lens, ThinLens):
        raise TypeError(f"lens is {lens!r}; it takes a ThinLens")


def checked_side(side: Side | ArrayLike, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return whether points lie beyond the focus: of the given shape, or ()."""
    if isinstance(side, str):
        if side not in get_args(Side):
            raise ValueError(f"side is {side!r}; it takes 'far', 'near' or a bool array")
        return np.asarray(side == "far")
    beyond = given_array("side", side)
    if beyond.dtype.kind != "b":
        raise TypeError(f"side has dtype {beyond.dtype}; it takes 'far', 'near' or bool")
    if beyond.shape != shape:
        raise ValueError(f"side has shape {beyond.shape}; it takes that of blur_map, {shape}")
    return beyond


def checked_depth(depth: ArrayLike) -> Float64:
    """Check distances, above 0, and return them as float64."""
    distance = given_reals("depth", depth)
    if (distance <= 0).any():
        raise ValueError(f"depth has values down to {np.nanmin(distance):g}; it takes ones above 0")
    return distance


def _as_float32(values: ArrayLike) -> Float32:
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)


def _enumerated(names: list[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
