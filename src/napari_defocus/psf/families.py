"""PSF families: point spread functions indexed by one scale, in px of the input picture.

The scale of every family here, but for functions of your own, is the *blur radius*: that of the
disc with the same second moment along an axis. A disc of radius r has the standard deviation r / 2
along an axis, so that the blur radius of any kernel is twice its standard deviation. Maps,
thresholds and tables mean the same with each of them.

Kernels hold what falls on each pixel, not samples at the pixels' centres: the shape's exact
area, or the exact integral of its profile. All are continuous in the scale and become a point
where the shape fits into one pixel: no picture can tell it from a point there, so all such
scales have the same likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from typing import ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf, gammaincinv, gammaln

from napari_defocus.core.checks import check_number
from napari_defocus.psf import BLUR_RADIUS, MAX_RADIUS, MAX_SCALE_OF_FUNCTION
from napari_defocus.psf.checks import check_largest, checked_kernels, checked_scale
from napari_defocus.psf.pixel_areas import (
    corners_to,
    disc_area,
    from_cumulative,
    from_quadrant,
    polygon_area_below,
)

Float64 = NDArray[np.floating]

_Radius = TypeVar("_Radius", float, NDArray[np.floating])

_GAUSSIAN_CUT = 4.0
"""Standard deviations: beyond them, on an axis, lies 6e-5 of the light."""

_TAIL, _NODES = 1e-4, 128
"""For `GeneralizedGaussian`: the share of its largest discs that is left out, and how many discs
stand for the others (Gauss-Legendre nodes). Chosen by hand.
"""


@runtime_checkable
class PSFFamily(Hashable, Protocol):
    """The interface of every PSF family.

    A family must be hashable and equal to another one that makes the same kernels: spectra
    are kept for the families that were used last.
    """

    @property
    def max_scale(self) -> float:
        """Upper end of the domain [0, max_scale] of scales, in px."""

    @property
    def scale_name(self) -> str:
        """What the scale measures, with its unit, such as "blur radius (px)"."""

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the kernel of one scale: (K, K), K odd, non-negative, sum 1."""


@dataclass(frozen=True)
class Disc:
    r"""Uniform disc, the PSF of an ideal lens with a round aperture; its scale is its radius.

    .. math:: h(\mathbf{x}; r) = \frac{1}{\pi r^2} \text{ where } \|\mathbf{x}\| \le r,
        \text{ else } 0

    A pixel has the integral over its area. A disc of a radius up to 0.5 px is a point. It is the
    model of the paper (Section IV).

    Parameters
    ----------
    max_radius : float
        Largest radius that is looked for, in px.

    Raises
    ------
    TypeError, ValueError
        If `max_radius` is not a number, is not finite or below 1 px.

    Examples
    --------
    >>> Disc().kernel(1.0).round(3)
    array([[0.025, 0.145, 0.025],
           [0.145, 0.318, 0.145],
           [0.025, 0.145, 0.025]])
    """

    max_radius: float = MAX_RADIUS
    scale_name: ClassVar[str] = BLUR_RADIUS

    def __post_init__(self) -> None:
        check_largest("max_radius", self.max_radius)

    @property
    def max_scale(self) -> float:
        """The largest radius, in px."""
        return self.max_radius

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the area-coverage disc of radius `scale` (px), normalised to sum 1."""
        scale = checked_scale(scale)
        return from_quadrant(disc_area(corners_to(scale), max(scale, 0.5)))


@dataclass(frozen=True)
class Annulus:
    r"""Uniform ring, the PSF of a mirror lens; its scale is the blur radius.

    With the obstruction :math:`\epsilon` and the outer radius R,

    .. math:: h(\mathbf{x}; r) = \frac{1}{\pi R^2 (1 - \epsilon^2)}
        \text{ where } \epsilon R \le \|\mathbf{x}\| \le R, \text{ else } 0

    The ring has the variance :math:`R^2 (1 + \epsilon^2) / 4` along an axis, a disc of radius r
    has :math:`r^2 / 4`: :math:`r = R \sqrt{1 + \epsilon^2}`. A pixel has the integral over its
    area.

    Parameters
    ----------
    obstruction : float
        The inner radius over the outer one, from 0 (a disc) to below 1.
    max_radius : float
        Largest blur radius that is looked for, in px.

    Raises
    ------
    TypeError, ValueError
        If `obstruction` is not in [0, 1) or `max_radius` is not finite or below 1 px.

    Examples
    --------
    >>> round(Annulus(0.5).outer_radius(5**0.5), 3)
    2.0
    >>> Annulus(0.5).kernel(5**0.5).round(2)[2]
    array([0.05, 0.06, 0.  , 0.06, 0.05])
    """

    obstruction: float = 0.5
    max_radius: float = MAX_RADIUS
    scale_name: ClassVar[str] = BLUR_RADIUS

    def __post_init__(self) -> None:
        check_number(
            "obstruction", self.obstruction, lambda o: 0 <= o < 1, "a number from 0 to below 1"
        )
        check_largest("max_radius", self.max_radius)

    @property
    def max_scale(self) -> float:
        """The largest blur radius, in px."""
        return self.max_radius

    def outer_radius(self, radius: _Radius) -> _Radius:
        """Return the outer radius of rings of a blur radius, in px; of a float or an array."""
        return radius / math.sqrt(1 + self.obstruction**2)

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the area-coverage ring of blur radius `scale` (px), normalised to sum 1."""
        outer = max(self.outer_radius(checked_scale(scale)), 0.5)
        area = disc_area(corners_to(outer), outer)
        inner = self.obstruction * outer
        if inner > 0:
            area -= disc_area(corners_to(outer), inner)
        return from_quadrant(area)


@dataclass(frozen=True)
class Polygon:
    r"""Regular polygon, the PSF of a leaf shutter (Section III-A).

    Its scale r is the blur radius. With n corners at the distance R from the centre, its variance
    along an axis is :math:`R^2 (2 + \cos(2 \pi / n)) / 12`, and that of a disc :math:`r^2 / 4`:

    .. math:: R = r \sqrt{\frac{3}{2 + \cos(2 \pi / n)}},

    1.10 times as far out for 6 blades, where the disc of the same area has 0.996 times the blur
    radius (`equal_area_radius`). Inside, the PSF is the same everywhere; a pixel has the integral
    over its area. With an odd number of blades, the PSF in front of the focal plane is
    the one behind it turned by 180 degrees; their spectra are the same.

    Parameters
    ----------
    blades : int
        Number of corners, 3 or more.
    rotation : float
        Direction of one corner from the centre, in degrees: 0 points right along the columns,
        positive turns counter-clockwise as the picture is shown, with row 0 on top.
    max_radius : float
        Largest blur radius that is looked for, in px.

    Raises
    ------
    TypeError, ValueError
        If `blades` is not a whole number from 3 up, `rotation` is not finite or `max_radius` not
        finite or below 1 px.

    Examples
    --------
    >>> Polygon(3, rotation=90).kernel(1.5).round(2)
    array([[0.  , 0.  , 0.04, 0.  , 0.  ],
           [0.  , 0.03, 0.17, 0.03, 0.  ],
           [0.  , 0.12, 0.17, 0.12, 0.  ],
           [0.02, 0.1 , 0.1 , 0.1 , 0.02],
           [0.  , 0.  , 0.  , 0.  , 0.  ]])
    """

    blades: int = 6
    rotation: float = 0.0
    max_radius: float = MAX_RADIUS
    scale_name: ClassVar[str] = BLUR_RADIUS

    def __post_init__(self) -> None:
        check_number("blades", self.blades, lambda n: n >= 3, "a whole number from 3 up", Integral)
        check_number("rotation", self.rotation, math.isfinite, "a finite number of degrees")
        check_largest("max_radius", self.max_radius)

    @property
    def max_scale(self) -> float:
        """The largest blur radius, in px."""
        return self.max_radius

    def equal_area_radius(self, radius: _Radius) -> _Radius:
        """Return the radius of the disc as large as polygons of a blur radius, in px.

        Of a float or an array.
        """
        turn = 2 * math.pi / self.blades
        return self._corner_radius(radius) * math.sqrt(math.sin(turn) / turn)

    def _corner_radius(self, radius: _Radius) -> _Radius:
        return radius * math.sqrt(3 / (2 + math.cos(2 * math.pi / self.blades)))

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the area-coverage polygon of blur radius `scale` (px), normalised to sum 1."""
        turn = 2 * np.pi / self.blades
        radius = self._corner_radius(checked_scale(scale))
        if radius <= 0.5:
            return np.ones((1, 1))
        angle = np.deg2rad(float(self.rotation) % 360) + turn * np.arange(self.blades)
        half = corners_to(radius)
        corners = np.concatenate([-half[::-1], half])
        below = polygon_area_below(-radius * np.sin(angle), radius * np.cos(angle), corners)
        return from_cumulative(below)


@dataclass(frozen=True)
class Gaussian:
    r"""Gaussian, for optics that diffraction and aberrations round off; its scale is 2 sigma.

    .. math:: h(\mathbf{x}; r) = \frac{1}{2 \pi \sigma^2}
        \exp\left(-\frac{\|\mathbf{x}\|^2}{2 \sigma^2}\right), \qquad \sigma = r / 2

    The disc with the same standard deviation has the radius r, the blur radius. A pixel has the
    integral over its area. Cut off at 4 sigma.

    Parameters
    ----------
    max_radius : float
        Largest blur radius that is looked for, in px.

    Raises
    ------
    TypeError, ValueError
        If `max_radius` is not a number, is not finite or below 1 px.

    Examples
    --------
    >>> Gaussian().sigma(0.6)
    0.3
    >>> Gaussian().kernel(0.6).round(3)
    array([[0.002, 0.043, 0.002],
           [0.043, 0.818, 0.043],
           [0.002, 0.043, 0.002]])
    """

    max_radius: float = MAX_RADIUS
    scale_name: ClassVar[str] = BLUR_RADIUS

    def __post_init__(self) -> None:
        check_largest("max_radius", self.max_radius)

    @property
    def max_scale(self) -> float:
        """The largest blur radius, in px."""
        return self.max_radius

    def sigma(self, radius: _Radius) -> _Radius:
        """Return the standard deviation, along an axis, of a blur radius; in px.

        Of a float or an array.
        """
        return radius / 2

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the Gaussian of blur radius `scale` (px), integrated over pixels, sum 1."""
        sigma = self.sigma(checked_scale(scale))
        reach = _GAUSSIAN_CUT * sigma
        half = np.minimum(corners_to(reach), reach) if reach > 0.5 else np.ones(1)
        below = erf(np.concatenate([-half[::-1], half]) / (np.sqrt(2) * max(sigma, 0.1)))
        profile = np.diff(below) / (below[-1] - below[0])
        return np.multiply.outer(profile, profile)


@dataclass(frozen=True)
class GeneralizedGaussian:
    r"""A profile from round to steep; its scale is twice its standard deviation along an axis.

    With the exponent p and the blur radius r,

    .. math:: h(\mathbf{x}; r) \propto \exp\left(-(\|\mathbf{x}\| / \alpha)^p\right),
        \qquad \alpha = r \sqrt{\frac{\Gamma(1 + 2/p)}{\Gamma(1 + 4/p)}}

    2 is the Gaussian; the larger p is, the steeper the edge; infinity is a disc of radius r. A
    profile that falls everywhere is a mixture of discs: here
    :math:`t = (R / \alpha)^p` of their radii R has a gamma distribution of shape 1 + 2/p, of
    which the last 1e-4 is left out.

    Parameters
    ----------
    exponent : float
        From 1 up to infinity.
    max_radius : float
        Largest blur radius that is looked for, in px.

    Raises
    ------
    TypeError, ValueError
        If `exponent` is not a number from 1 up or `max_radius` is not finite or below 1 px.

    Examples
    --------
    >>> GeneralizedGaussian(8.0).kernel(0.8).round(3)
    array([[0.006, 0.112, 0.006],
           [0.112, 0.527, 0.112],
           [0.006, 0.112, 0.006]])
    """

    exponent: float = 2.0
    max_radius: float = MAX_RADIUS
    scale_name: ClassVar[str] = BLUR_RADIUS

    def __post_init__(self) -> None:
        check_number("exponent", self.exponent, lambda e: e >= 1, "a number from 1 up")
        check_largest("max_radius", self.max_radius)

    @property
    def max_scale(self) -> float:
        """The largest blur radius, in px."""
        return self.max_radius

    def sigma(self, radius: _Radius) -> _Radius:
        """Return the standard deviation, along an axis, of a blur radius; in px.

        Of a float or an array.
        """
        return radius / 2

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the profile of blur radius `scale` (px), integrated over pixels, sum 1."""
        scale = checked_scale(scale)
        radii, weights = self._discs
        radii = radii * scale
        if radii[-1] <= 0.5:
            return np.ones((1, 1))
        areas = disc_area(corners_to(radii[-1]), radii[:, None, None])
        return from_quadrant(np.einsum("k,kij->ij", weights / radii**2, areas))

    @cached_property
    def _discs(self) -> tuple[Float64, Float64]:
        """Radii, increasing, and weights of the discs whose sum the profile of 1 px is."""
        shape = 1 + 2 / self.exponent
        log_square = gammaln(shape) - gammaln(1 + 4 / self.exponent)
        low, high = gammaincinv(shape, [_TAIL**2, 1 - _TAIL])
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)
        t = low + (high - low) * (nodes + 1) / 2
        weights = weights * np.exp((shape - 1) * np.log(t) - t)
        return np.exp(log_square / 2) * t ** (1 / self.exponent), weights / weights.sum()


@dataclass(frozen=True)
class KernelFunction:
    """A family from a function of your own, whose scale is what the function takes.

    Maps and thresholds are in that scale. To have the scale of all other families, take twice the
    kernel's standard deviation along an axis. Scale 0 is a point; the function is called for scales
    above 0 only.

    Parameters
    ----------
    function : callable
        Takes a scale in px, returns a (K, K) array_like, K odd, finite and non-negative, of any
        positive sum. It must change continuously with the scale.
    max_scale : float
        Largest scale that is looked for, in px.
    scale_name : str
        What the scale measures, with its unit.

    Raises
    ------
    TypeError, ValueError
        If `function` cannot be called or `max_scale` is not finite or below 1 px; by `kernel`,
        if `function` returns something else.

    Examples
    --------
    >>> import numpy as np
    >>> def motion(length):
    ...     inside = np.clip(length / 2 + 0.5 - np.abs(np.arange(-5, 6)), 0, 1)
    ...     return np.outer(np.arange(-5, 6) == 0, inside)
    >>> KernelFunction(motion, scale_name="length (px)").kernel(3.0)[5, 3:8].round(3)
    array([0.   , 0.333, 0.333, 0.333, 0.   ])
    """

    function: Callable[[float], ArrayLike]
    max_scale: float = MAX_SCALE_OF_FUNCTION
    scale_name: str = "scale (px)"

    def __post_init__(self) -> None:
        if not (callable(self.function) and isinstance(self.function, Hashable)):
            raise TypeError(f"function is {self.function!r}; it takes a function of the scale")
        check_largest("max_scale", self.max_scale)

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return what the function gives at `scale` (px), normalised to sum 1."""
        scale = checked_scale(scale)
        if scale <= 0:
            return np.ones((1, 1))
        return checked_kernels(
            self.function(scale), 2, f"psf function returned at {scale:g} px", "a kernel"
        )


@dataclass(frozen=True)
class AutomaticPSF:
    """Let the picture choose the family, see `napari_defocus.estimate_candidates`.

    It has no kernels. The candidates of a picture have the family that was chosen.

    Parameters
    ----------
    max_radius : float
        Largest blur radius that is looked for, in px.

    Raises
    ------
    TypeError, ValueError
        If `max_radius` is not a number, is not finite or below 1 px.

    Examples
    --------
    >>> AutomaticPSF().scale_name
    'blur radius (px)'
    """

    max_radius: float = MAX_RADIUS
    scale_name: ClassVar[str] = BLUR_RADIUS

    def __post_init__(self) -> None:
        check_largest("max_radius", self.max_radius)

    @property
    def max_scale(self) -> float:
        """The largest blur radius, in px."""
        return self.max_radius

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Raise a ValueError: only a picture can say which family it is."""
        raise ValueError(
            "psf is 'auto', which a picture chooses when its candidates are estimated; "
            "it takes a PSF family such as Disc() here"
        )


def as_family(psf: PSFFamily | Callable[[float], ArrayLike]) -> PSFFamily:
    """Return a PSF family as it is, and a function of the scale as a `KernelFunction`.

    Raises
    ------
    TypeError
        If `psf` is neither.

    Examples
    --------
    >>> as_family(Disc())
    Disc(max_radius=64.0)
    """
    if not isinstance(psf, type):
        if isinstance(psf, PSFFamily):
            return psf
        if callable(psf):
            return KernelFunction(psf)
    raise TypeError(f"psf is {psf!r}; it takes a PSF family such as Disc()")
