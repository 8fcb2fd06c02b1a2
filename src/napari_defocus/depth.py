"""From blur to distance for a thin lens, and back; distances as a surface for 3-D viewers."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.image import prepare_image
from napari_defocus.psf import Disc, PSFFamily, as_family, check_number
from napari_defocus.settings import Side, radius_per_scale

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_ROUNDING = float(np.finfo(np.float32).eps)

_EXIF_FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP")
_INFINITELY_FAR = 0xFFFFFFFF
"""The numerator of EXIF's SubjectDistance for infinity."""

_INCH = 2
_MICROMETRES = {_INCH: 25400.0, 3: 10000.0, 4: 1000.0, 5: 1.0}
"""Of EXIF's FocalPlaneResolutionUnit."""

_DIAGONAL_OF_35_MM = 43.27
_CROPPED = 0.01

_MOST_VERTICES = 250_000
_RANGE = (1, 99)


@dataclass(frozen=True, kw_only=True)
class ThinLens:
    """An ideal lens, and how fine its picture is sampled.

    A point at the distance d has the blur radius r = K |d - s| / d, in px, if the plane at the
    distance s is in focus. With the focal length f, the f-number N and the pixel pitch p,
    K = f^2 / (2 N p (s - f)), all lengths in one unit; with the focus at infinity,
    r = f^2 / (2 N p d). A real lens has its distances from planes inside of it, a little apart
    from each other, and its f changes when it focuses: close to the lens, both matter.

    Parameters
    ----------
    focal_length_mm : float
        f, in mm; the real one, not that of a 35 mm camera with the same view.
    f_number : float
        N, the focal length over the diameter of the aperture.
    focus_distance_m : float
        s, in m, from the lens to the plane in focus; infinity is allowed.
    pixel_pitch_um : float
        p, in um on the sensor: how far the pixels of the picture as it is are apart. A picture
        that was scaled down to a half has twice the pitch of the sensor.

    Raises
    ------
    TypeError
        If one is no number.
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
            lambda s: s > 0 and self.focal_length_mm / 1000 / s < 1,
            f"a distance above the focal length, {self.focal_length_mm / 1000:g} m",
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
        aperture_mm = self.focal_length_mm / self.f_number
        at_infinity = aperture_mm * self.focal_length_mm / (2 * self.pixel_pitch_um)
        return at_infinity / (1 - self.focal_length_mm / 1000 / self.focus_distance_m)

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
        """Take from a photograph what its camera noted (EXIF); what is given wins.

        Most cameras do not note the focus distance, or only roughly and as seen from the
        sensor. The pitch comes from the resolution of the focal plane, else from the focal
        length that has the same view on 35 mm film (a diagonal of 43.27 mm). It is that of the
        picture as it is: if the size at capture is noted and the picture is larger or smaller
        now, it was scaled. That a picture was cropped cannot be told, and one cropped to the
        same shape passes for scaled: then give the pitch. The pitch counts as not noted if the
        sides have another ratio than at capture, by more than 1 %. Programs that scale a picture
        and write its new size over that at capture make the pitch too small.

        Parameters
        ----------
        path : path-like
            A JPEG, TIFF, PNG, WebP or BMP file.
        focal_length_mm, f_number, focus_distance_m, pixel_pitch_um : float, optional
            What the file lacks, or has wrong; see `ThinLens`.
        image_size : (int, int), optional
            Height and width in px of the picture that is analysed, if it was scaled after
            it was read from the file. Upright or not does not matter.

        Returns
        -------
        ThinLens

        Raises
        ------
        TypeError
            If `image_size` is no pair of whole numbers, or something given is no number.
        ValueError
            If the file cannot be read, or the lens is not known completely: the message names
            all that is missing. Also if the values, noted or given, make no lens.

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
        if image_size is not None:
            _check_size(image_size)
        exif, stored = _read_exif(Path(path))
        noted_focal_length = _noted(exif, "FocalLength")
        values = {
            "focal_length_mm": (focal_length_mm, noted_focal_length),
            "f_number": (f_number, _noted_f_number(exif)),
            "focus_distance_m": (focus_distance_m, _noted_focus_distance(exif)),
            "pixel_pitch_um": (
                pixel_pitch_um,
                _noted_pitch(exif, noted_focal_length or focal_length_mm, stored, image_size),
            ),
        }
        known = {name: noted if given is None else given for name, (given, noted) in values.items()}
        lens = {name: value for name, value in known.items() if value is not None}
        missing = [name for name in known if name not in lens]
        if missing:
            raise ValueError(f"{path} does not note {_enumerated(missing)}; give what is missing")
        return cls(**lens)


def depth_from_blur(
    blur_map: ArrayLike,
    lens: ThinLens,
    *,
    side: Side | ArrayLike = "far",
    psf: PSFFamily = Disc(),
) -> Float32:
    """Turn blur into distance, for a thin lens.

    With the radius r of the blur and s, K of `ThinLens`, a point beyond the focus lies at
    d = s / (1 - r / K), one before it at d = s / (1 + r / K); with the focus at infinity at
    d = f^2 / (2 N p r). A radius alone cannot say on which side of the focus a point lies: the
    same blur belongs to one distance on either side. You choose, for the whole picture or for
    each pixel. Radii below 0.5 px cannot be told from 0, so that near the focus distances are
    rough.

    Parameters
    ----------
    blur_map : array_like of any shape
        The family's scale, in px, from 0 up; such as from `estimate_blur_map`. NaN is unknown.
    lens : ThinLens
    side : {"far", "near"} or bool array_like of the same shape, optional
        Whether points lie beyond the focus; for each pixel, True where they do.
    psf : PSFFamily or callable, optional
        The family of the map. A scale that is a standard deviation is half of the radius; any
        other scale is taken as the radius.

    Returns
    -------
    float32 ndarray
        Distance from the lens in m, of the map's shape. Infinity beyond the focus where the
        radius is K or more: no point is that much blurred there. NaN where the map has NaN.

    Raises
    ------
    TypeError
        If `blur_map` holds no real numbers, `side` is an array of another dtype than bool,
        `lens` is no `ThinLens` or `psf` no family.
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
    scale = _real("blur_map", blur_map)
    if (scale < 0).any() or np.isinf(scale).any():
        raise ValueError(
            f"blur_map has values from {np.nanmin(scale):g} to {np.nanmax(scale):g}; "
            "it takes finite ones from 0 px up, NaN unknown"
        )
    beyond = _checked_side(side, scale.shape, lens)
    radius = radius_per_scale(as_family(psf)) * scale
    in_focus = 1 / lens.focus_distance_m
    dioptres = in_focus + np.where(beyond, -1, 1) * radius / lens._radius_per_dioptre
    # K as float32 may be rounded down; a point infinitely far away stays there.
    infinite = dioptres <= _ROUNDING * in_focus
    depth = np.divide(1, dioptres, out=np.full(scale.shape, np.inf), where=~infinite)
    return _as_float32(depth)


def blur_from_depth(depth: ArrayLike, lens: ThinLens, *, psf: PSFFamily = Disc()) -> Float32:
    """Turn distance into blur, for a thin lens: r = K |d - s| / d, see `ThinLens`.

    Parameters
    ----------
    depth : array_like of any shape
        Distance d from the lens, in m, above 0; infinity is allowed. NaN is unknown.
    lens : ThinLens
    psf : PSFFamily or callable, optional
        The family whose scale is wanted, see `depth_from_blur`.

    Returns
    -------
    float32 ndarray
        The family's scale in px, of the shape of `depth`; not limited to the scales that the
        family is looked for. NaN where `depth` has NaN.

    Raises
    ------
    TypeError
        If `depth` holds no real numbers, `lens` is no `ThinLens` or `psf` no family.
    ValueError
        If a distance is 0 or negative.

    Examples
    --------
    >>> import math
    >>> from napari_defocus import Gaussian
    >>> lens = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=5)
    >>> blur_from_depth([1.9, 2.0, 2.1], lens).round(2)
    array([3.37, 0.  , 3.05], dtype=float32)
    >>> blur_from_depth([1.9, 2.0, 2.1], lens, psf=Gaussian()).round(2)
    array([1.69, 0.  , 1.53], dtype=float32)
    """
    _check_lens(lens)
    distance = _checked_depth(depth)
    with np.errstate(over="ignore"):
        dioptres = np.abs(1 / distance - 1 / lens.focus_distance_m)
        radius = lens._radius_per_dioptre * dioptres
    return _as_float32(radius / radius_per_scale(as_family(psf)))


@dataclass(frozen=True)
class DepthSurface:
    """A surface of triangles, as `depth_surface` makes it.

    Attributes
    ----------
    vertices : (V, 3) float32 ndarray
        z, y, x of each corner, in px of the picture: y and x are row and column, and z grows
        towards who looks at it.
    faces : (F, 3) int32 ndarray
        The three corners of each triangle, as indices of `vertices`: counter-clockwise for who
        looks at the picture. Every vertex is a corner of at least one.
    colors : (V, 3) float32 ndarray or None
        Red, green and blue of each vertex, in [0, 1].
    """

    vertices: Float32
    faces: NDArray[np.int32]
    colors: Float32 | None


def depth_surface(
    depth: ArrayLike,
    image: ArrayLike | None = None,
    *,
    step: int | None = None,
    largest_jump: float = 0.05,
    relief: float = 0.5,
    intensity_range: tuple[float, float] | None = None,
) -> DepthSurface:
    """Make a surface of a map of distances, to be looked at in three dimensions.

    It is a relief on top of the picture: z = relief max(H, W) (far - d) / (far - near), in px,
    where near and far are the 1st and the 99th percentile of the distances d. So z is 0 at far
    and the larger the nearer, which is towards you in napari's 3-D view as it first opens.
    It is no scale model. What lies farther outside of near and far than they are apart is drawn
    no farther out than that. The surface has a hole where a distance is infinite or NaN, and is
    torn where distances jump.

    Parameters
    ----------
    depth : (H, W) array_like
        Distance in any unit, above 0, such as from `depth_from_blur`. Infinity and NaN are
        left out.
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like, optional
        A picture of the same height and width that gives the colours, see
        `estimate_candidates`; opacity is left out.
    step : int, optional
        Take every `step`-th row and column; by default as many as 250 000 vertices allow.
    largest_jump : float, optional
        No triangle spans distances whose difference is more than this share of the smallest.
    relief : float, optional
        How far near and far are apart in z, as a share of the longer side.
    intensity_range : (float, float), optional
        The intensities of `image` that are drawn black and white.

    Returns
    -------
    DepthSurface

    Raises
    ------
    TypeError
        If `depth` holds no real numbers, `image` is no picture, `step` is no whole number, or
        another argument is no number.
    ValueError
        If `depth` has another number of axes than two, or distances of 0 or below, `image` has
        another size, `step` is not from 1 to below the shorter side, `largest_jump` or
        `relief` is not above 0, or no triangle is left.

    Examples
    --------
    In napari: ``viewer.add_surface((surface.vertices, surface.faces),
    vertex_colors=surface.colors)``.

    >>> import numpy as np
    >>> surface = depth_surface([[1.00, 1.02, 1.04], [1.00, 1.02, 2.00]])
    >>> surface.vertices.round(2)
    array([[1.5 , 0.  , 0.  ],
           [1.47, 0.  , 1.  ],
           [1.44, 0.  , 2.  ],
           [1.5 , 1.  , 0.  ],
           [1.47, 1.  , 1.  ]], dtype=float32)
    >>> surface.faces
    array([[0, 3, 1],
           [1, 4, 2],
           [1, 3, 4]], dtype=int32)
    """
    distance = _checked_depth(depth)
    if distance.ndim != 2 or min(distance.shape) < 2:
        raise ValueError(f"depth has shape {distance.shape}; it takes (H, W), 2 px or more a side")
    check_number("largest_jump", largest_jump, lambda j: j > 0, "a number above 0")
    check_number("relief", relief, lambda r: 0 < r < math.inf, "a finite number above 0")
    color = None if image is None else _colors(image, distance.shape, intensity_range)
    rows, columns = _grid(distance.shape, step)
    corner = distance[rows, columns]
    triangles = _triangles(corner, largest_jump)
    if not len(triangles):
        raise ValueError(
            "depth leaves no triangle; it takes neighbours that are finite and within "
            f"largest_jump = {largest_jump:g} of each other"
        )
    used, faces = np.unique(triangles, return_inverse=True)
    row, column = (np.broadcast_to(index, corner.shape).ravel()[used] for index in (rows, columns))
    z = _heights(corner, relief * max(distance.shape)).ravel()[used]
    return DepthSurface(
        vertices=np.stack([z, row, column], axis=1).astype(np.float32),
        faces=faces.reshape(-1, 3).astype(np.int32),
        colors=None if color is None else color[row, column],
    )


def _grid(shape: tuple[int, ...], step: int | None) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows, (R, 1), and columns, (1, C), that are taken, about the picture's middle."""
    if step is None:
        step = 1
        while math.prod(-(-side // step) for side in shape) > _MOST_VERTICES:
            step += 1
        step = min(step, min(shape) - 1)
    takes = f"a whole number from 1 to below the shorter side, {min(shape)} px, or None"
    check_number("step", step, lambda s: 1 <= s < min(shape), takes, Integral)
    rows, columns = (np.arange((side - 1) % step // 2, side, step) for side in shape)
    return rows[:, None], columns[None]


def _triangles(corner: Float64, largest_jump: float) -> NDArray[np.intp]:
    """Return the triangles of a grid of distances that tear nowhere: flat indices, (F, 3)."""
    index = np.arange(corner.size).reshape(corner.shape)
    above, below = index[:-1], index[1:]
    upper = np.stack([above[:, :-1], below[:, :-1], above[:, 1:]], axis=-1)
    lower = np.stack([above[:, 1:], below[:, :-1], below[:, 1:]], axis=-1)
    triangles = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    distances = corner.ravel()[triangles]
    triangles = triangles[np.isfinite(distances).all(axis=1)]
    distances = corner.ravel()[triangles]
    nearest = distances.min(axis=1)
    return triangles[distances.max(axis=1) - nearest <= largest_jump * nearest]


def _heights(corner: Float64, height: float) -> Float64:
    """Return z of distances: 0 at their 99th percentile, `height` at their 1st."""
    finite = corner[np.isfinite(corner)]
    near, far = np.percentile(finite, _RANGE)
    if near == far:
        near, far = finite.min(), finite.max()
    span = far - near
    if span == 0:
        return np.zeros(corner.shape)
    return height * (far - np.clip(corner, near - span, far + span)) / span


def _colors(
    image: ArrayLike, shape: tuple[int, ...], intensity_range: tuple[float, float] | None
) -> Float32:
    """Return the colours of a picture, (H, W, 3) in [0, 1]."""
    picture = prepare_image(image, intensity_range)
    if picture.shape != shape:
        raise ValueError(
            f"image has height and width {picture.shape}; it takes the depth's, {shape}"
        )
    return np.broadcast_to(np.clip(picture.color, 0, 1), (*shape, 3))


def _check_lens(lens: object) -> None:
    if not isinstance(lens, ThinLens):
        raise TypeError(f"lens is {lens!r}; it takes a ThinLens")


def _checked_side(
    side: Side | ArrayLike, shape: tuple[int, ...], lens: ThinLens
) -> NDArray[np.bool_]:
    """Return whether points lie beyond the focus: of the given shape, or ()."""
    if isinstance(side, str):
        if side not in get_args(Side):
            raise ValueError(f"side is {side!r}; it takes 'far', 'near' or a bool array")
        beyond = np.asarray(side == "far")
    else:
        beyond = np.asarray(side)
        if beyond.dtype.kind != "b":
            raise TypeError(f"side has dtype {beyond.dtype}; it takes 'far', 'near' or bool")
        if beyond.shape != shape:
            raise ValueError(f"side has shape {beyond.shape}; it takes that of blur_map, {shape}")
    if math.isinf(lens.focus_distance_m) and beyond.any():
        raise ValueError(
            "side says that points lie beyond the focus, but it is at infinity; it takes 'near'"
        )
    return beyond


def _checked_depth(depth: ArrayLike) -> Float64:
    distance = _real("depth", depth)
    if (distance <= 0).any():
        raise ValueError(f"depth has values down to {np.nanmin(distance):g}; it takes ones above 0")
    return distance


def _real(name: str, values: ArrayLike) -> Float64:
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{name} is no array: {error}") from None
    if array.dtype.kind not in "uif":
        raise TypeError(f"{name} has dtype {array.dtype}; it takes real numbers")
    return array.astype(np.float64)


def _as_float32(values: ArrayLike) -> Float32:
    with np.errstate(over="ignore"):
        return np.asarray(values, np.float32)


def _check_size(image_size: object) -> None:
    takes = "it takes two whole numbers from 1 up, the height and the width in px"
    sides = image_size if isinstance(image_size, tuple | list) else ()
    if len(sides) != 2 or not all(isinstance(side, Integral) for side in sides):
        raise TypeError(f"image_size is {image_size!r}; {takes}")
    if min(sides) < 1:
        raise ValueError(f"image_size is {image_size!r}; {takes}")


def _read_exif(path: Path) -> tuple[Mapping[int, Any], tuple[int, int]]:
    """Return what a camera noted, and the size of the picture in px."""
    from PIL import ExifTags, Image, UnidentifiedImageError

    try:
        with Image.open(path, formats=_EXIF_FORMATS) as image:
            exif: Mapping[int, Any] = {}
            # Damaged bytes raise anything; what cannot be read is not noted.
            with suppress(Exception):
                exif = image.getexif().get_ifd(ExifTags.IFD.Exif)
            return exif, image.size
    except FileNotFoundError:
        reason = "there is no such file"
    except IsADirectoryError:
        reason = "it is a folder"
    except UnidentifiedImageError:
        reason = "it is no picture (PNG, JPEG, TIFF, WebP or BMP)"
    except Exception as error:
        reason = " ".join((getattr(error, "strerror", None) or str(error)).split())
    raise ValueError(f"cannot read {path}: {reason}")


def _noted(exif: Mapping[int, Any], name: str) -> float | None:
    """Return what is noted under a name if it is a positive finite number."""
    from PIL import ExifTags

    value = exif.get(ExifTags.Base[name])
    number = math.nan
    if isinstance(value, Real):
        with suppress(ArithmeticError):
            number = float(value)
    return number if 0 < number < math.inf else None


def _noted_f_number(exif: Mapping[int, Any]) -> float | None:
    """Return the f-number N, noted as such or as the aperture value 2 log2 N."""
    aperture = _noted(exif, "ApertureValue")
    f_number = _noted(exif, "FNumber")
    if f_number is None and aperture is not None:
        with suppress(OverflowError):
            f_number = 2 ** (aperture / 2)
    return f_number


def _noted_focus_distance(exif: Mapping[int, Any]) -> float | None:
    from PIL import ExifTags

    value = exif.get(ExifTags.Base.SubjectDistance)
    if getattr(value, "numerator", None) == _INFINITELY_FAR:
        return math.inf
    return _noted(exif, "SubjectDistance")


def _noted_pitch(
    exif: Mapping[int, Any],
    focal_length_mm: float | None,
    stored: tuple[int, int],
    image_size: tuple[int, int] | None,
) -> float | None:
    """Return the pixel pitch, in um, of a picture of `image_size` px.

    Sides are compared by their length: cameras and programs do not agree on whether what they
    note is turned with the picture.
    """
    width, height = _noted(exif, "ExifImageWidth"), _noted(exif, "ExifImageHeight")
    captured = stored if width is None or height is None else (width, height)
    short_captured, long_captured = sorted(captured)
    short, long = sorted(image_size or stored)
    fitting = long * short_captured / long_captured
    if abs(short - fitting) > 1 + _CROPPED * fitting:
        return None
    pitch = _noted_photosite_pitch(exif)
    if pitch is not None:
        return pitch * long_captured / long
    in_35_mm = _noted(exif, "FocalLengthIn35mmFilm")
    if in_35_mm is None or focal_length_mm is None:
        return None
    diagonal_mm = _DIAGONAL_OF_35_MM * focal_length_mm / in_35_mm
    return 1000 * diagonal_mm / math.hypot(long, short)


def _noted_photosite_pitch(exif: Mapping[int, Any]) -> float | None:
    """Return the pixel pitch at capture, in um."""
    from PIL import ExifTags

    per_unit = _noted(exif, "FocalPlaneXResolution")
    unit = _MICROMETRES.get(exif.get(ExifTags.Base.FocalPlaneResolutionUnit, _INCH))
    return None if per_unit is None or unit is None else unit / per_unit


def _enumerated(names: list[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
