"""The PSF of a microscope by diffraction: from a blur radius in px to a defocus in um."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.special import jv

from napari_defocus.core.checks import check_number
from napari_defocus.psf import BLUR_RADIUS, MAX_RADIUS
from napari_defocus.psf.checks import check_largest, checked_scale
from napari_defocus.psf.pixel_areas import corners_to, disc_area, from_quadrant

Float64 = NDArray[np.floating]

_Number = TypeVar("_Number", float, NDArray[np.floating])

Specimen = Literal["auto", "texture", "points"]
"""What may lie before a microscope."""

IMMERSIONS = {"air": 1.0, "water": 1.333, "glycerol": 1.47, "oil": 1.515}
"""Refractive indices of what usually lies between the objective and the specimen."""

WAVELENGTHS = 0.1, 20.0
"""um: what lenses make pictures with, from ultraviolet to infrared. Nanometres lie far above."""

_WIDE_PIXELS = 10.0
"""Pixels that are wider, in radii of the Airy disc, are rather those of the camera. By hand."""

_TAIL = 5.0
"""How far kernels reach beyond the geometric spot, in units of wavelength / NA. In focus, 2 % of
the light lies farther out. Chosen by hand."""

_LONGEST_TAIL = 64.0
"""px: kernels reach no farther beyond the spot, if the Airy disc is wider than windows. By hand."""

_TAPER = 0.25
"""The outer part of a kernel's reach in which it fades out, so that it changes continuously with
the scale. By hand."""

_RINGS, _WIDEST_RING = 16, 0.5
"""Samples of the profile in wavelength / NA: ten up to the first zero of the Airy disc; and how
wide the ring of a sample may be, in px. By hand."""

_SAME_PIXELS = 0.02
"""Pixel sizes that differ by a smaller share are the same. By hand."""

_REACH_STEP = 1.25
"""Kernels whose reach differs by less than this factor share their Bessel functions. By hand."""


@dataclass(frozen=True)
class Microscope:
    r"""A microscope's PSF by diffraction, for pictures taken out of focus.

    With the half angle of the aperture :math:`\alpha = \arcsin(\mathrm{NA} / n)` and
    :math:`k = 2 \pi / \lambda`, a point at the defocus z makes, at the distance rho from its
    middle, the intensity

    .. math:: h(\rho; z) &\propto |I_0|^2 + 2 |I_1|^2 + |I_2|^2 \\
        I_m(\rho; z) &= \int_0^\alpha \sqrt{\cos\theta} \; w_m(\theta) \; J_m(k n \rho \sin\theta)
        \; e^{i k n z (\cos\theta - 1)} \sin\theta \, d\theta \\
        w_0, w_1, w_2 &= 1 + \cos\theta, \; \sin\theta, \; 1 - \cos\theta

    These are the integrals of Richards and Wolf (1959) for an objective without aberrations that
    obeys Abbe's sine condition, and light of all polarizations: fluorescent molecules that turn
    freely. For a small NA, I_0 alone is left, and the PSF in focus is the Airy disc. A pixel has
    the integral over its area.

    The scale is the blur radius of the geometric spot, in px. Rays fall at
    :math:`z \tan\theta`, and a point sends as much light into every solid angle. Twice the
    standard deviation of that along an axis is

    .. math:: r = z \, \sqrt{\frac{2 (1 - \cos\alpha)}{\cos\alpha}} \Big/ p

    with the pixel size p. For a small NA this is z NA / (n p). The standard deviation of the PSF
    itself is no measure: it is infinite for every sharp aperture. Scale 0 is the microscope in
    focus, so maps are the defocus beyond diffraction.

    Parameters
    ----------
    numerical_aperture : float
        NA of the objective, above 0 and below the refractive index.
    wavelength_um : float
        Wavelength of the light in vacuum, from 0.1 to 20 um: that of emission in fluorescence,
        the middle of the band in bright field.
    pixel_size_um : float
        Distance of the picture's pixels in the specimen, in um.
    refractive_index : float
        n between objective and specimen: 1 for air, 1.333 for water, 1.515 for oil. The
        specimen is taken to have the same index.
    specimen : {"auto", "texture", "points"}
        What the picture shows in focus: things with edges, as tissue and nuclei, or points, as
        beads and vesicles. Points have more fine details, and look sharper than they are if they
        are taken for texture. "auto" lets the picture choose, when its candidates are estimated.
    max_radius : float
        Largest blur radius that is looked for, in px.

    Raises
    ------
    TypeError, ValueError
        If one is not a number or is out of its range.

    See Also
    --------
    read_microscope : take these numbers from a file's OME metadata.

    Notes
    -----
    Fluorescence is incoherent, and so is bright field with the condenser opened as wide as the
    objective. A closed condenser makes pictures out of focus that no PSF describes. One picture
    cannot tell on which side of the focus something lies: um of defocus have no sign. Within
    `depth_of_field_um`, pictures hardly differ.

    Examples
    --------
    >>> lens = Microscope(0.8, wavelength_um=0.52, pixel_size_um=0.1)
    >>> round(lens.airy_radius, 2), round(lens.depth_of_field_um, 2)
    (3.96, 0.81)
    >>> round(lens.blur_radius(2.0), 2), round(lens.defocus_um(23.09), 2)
    (23.09, 2.0)
    >>> lens.kernel(0.0)[32, 32:37].round(3)
    array([0.06 , 0.049, 0.025, 0.007, 0.001])
    """

    numerical_aperture: float
    wavelength_um: float
    pixel_size_um: float
    refractive_index: float = 1.0
    specimen: Specimen = "auto"
    max_radius: float = MAX_RADIUS
    scale_name: ClassVar[str] = BLUR_RADIUS

    def __post_init__(self) -> None:
        least, most = WAVELENGTHS
        check_number(
            "wavelength_um",
            self.wavelength_um,
            lambda wavelength: least <= wavelength <= most,
            f"a number of um from {least:g} to {most:g}, such as 0.52 for 520 nm",
        )
        check_number("pixel_size_um", self.pixel_size_um, _above_0, "a finite number of um above 0")
        check_number(
            "refractive_index", self.refractive_index, lambda n: 1 <= n <= 2, "a number from 1 to 2"
        )
        check_number(
            "numerical_aperture",
            self.numerical_aperture,
            lambda aperture: 0 < aperture < self.refractive_index,
            f"a number above 0 and below the refractive index, {self.refractive_index:g} here "
            "(air 1, water 1.333, oil 1.515)",
        )
        if self.specimen not in get_args(Specimen):
            raise ValueError(f"specimen is {self.specimen!r}; it takes one of {get_args(Specimen)}")
        check_largest("max_radius", self.max_radius)

    @property
    def max_scale(self) -> float:
        """The largest blur radius, in px."""
        return self.max_radius

    @property
    def airy_radius(self) -> float:
        """Where the PSF in focus is first dark, in px: 0.61 wavelengths / NA."""
        return 0.61 * self.wavelength_um / self.numerical_aperture / self.pixel_size_um

    @property
    def softness(self) -> float:
        """The standard deviation, in px, of the Gaussian that is closest to the PSF in focus.

        0.225 wavelengths / NA (Zhang, Zerubia and Olivo-Marin, Applied Optics 2007).
        """
        return 0.225 * self.wavelength_um / self.numerical_aperture / self.pixel_size_um

    @property
    def depth_of_field_um(self) -> float:
        """How deep the range is that looks sharp, in um: n wavelengths / NA^2, half on each side.

        Defocus of less than half of it cannot be told from none.
        """
        return self.refractive_index * self.wavelength_um / self.numerical_aperture**2

    @property
    def radius_per_um(self) -> float:
        """The blur radius, in px, of a defocus of 1 um."""
        cosine = math.sqrt(1 - (self.numerical_aperture / self.refractive_index) ** 2)
        return math.sqrt(2 * (1 - cosine) / cosine) / self.pixel_size_um

    def blur_radius(self, defocus_um: _Number) -> _Number:
        """Return the blur radius, in px, of a defocus in um; of a float or an array."""
        return abs(defocus_um) * self.radius_per_um

    def defocus_um(self, radius: _Number) -> _Number:
        """Return the defocus, in um and without its sign, of a blur radius in px.

        Of a float or an array, such as a blur map.
        """
        return radius / self.radius_per_um

    def remark_on_pixels(self, noted_um: float | None) -> str | None:
        """Return what to say if pixels cannot be right, or a picture notes others in um.

        None if there is nothing to say.
        """
        if noted_um is None or abs(noted_um / self.pixel_size_um - 1) <= _SAME_PIXELS:
            return self._remark_on_wide_pixels()
        return (
            f"The picture notes pixels of {noted_um:.4g} um, but the microscope that was given has "
            f"{self.pixel_size_um:.4g} um: um are wrong if the picture is right."
        )

    def _remark_on_wide_pixels(self) -> str | None:
        if self.airy_radius * _WIDE_PIXELS >= 1:
            return None
        times = 1 / self.airy_radius
        return (
            f"A pixel of {self.pixel_size_um:.4g} um is {times:.0f} times as wide as the Airy "
            "disc of this microscope: um are wrong if that is not its size in the specimen."
        )

    def with_wider_pixels(self, side: int, largest: float) -> Microscope:
        """Return the same with pixels that are means of `side` x `side` px, up to a scale."""
        pixel_size, radius = self.pixel_size_um * side, min(self.max_radius / side, largest)
        return replace(self, pixel_size_um=pixel_size, max_radius=radius)

    def kernel(self, scale: float) -> NDArray[np.float64]:
        """Return the PSF whose geometric spot has a blur radius (px), integrated over pixels."""
        defocus = self.defocus_um(checked_scale(scale))
        reach = self._reach(defocus)
        spot = _Spot.with_reach(
            self.numerical_aperture,
            self.wavelength_um,
            self.pixel_size_um,
            self.refractive_index,
            math.ceil(math.log(reach, _REACH_STEP)),
        )
        fading = np.clip((1 - spot.radii / reach) / _TAPER, 0, 1)
        profile = spot.profile(defocus) * np.sin(np.pi / 2 * fading) ** 2
        corners = len(corners_to(reach))
        rings = int(np.searchsorted(spot.radii, reach))
        areas = spot.areas[:rings, :corners, :corners]
        return from_quadrant(np.einsum("k,kij->ij", profile[:rings], areas))

    def _reach(self, defocus: float) -> float:
        """Return how far from its middle, in px, the kernel of a defocus in um is kept."""
        sine = self.numerical_aperture / self.refractive_index
        spot = defocus * sine / math.sqrt(1 - sine**2)
        tail = _TAIL * self.wavelength_um / self.numerical_aperture / self.pixel_size_um
        return max(spot / self.pixel_size_um + min(tail, _LONGEST_TAIL), 1.0)


class _Spot(NamedTuple):
    """What profiles of one reach share.

    Attributes
    ----------
    radii : (K,) float64 ndarray
        The middles of rings, in px.
    areas : (K, C, C) float64 ndarray
        How much of each ring lies between its middle and each pair of corners.
    pupil : (Q,) float64 ndarray
        The light of each part of the aperture, with the weight of its node.
    bessel : (3, K, Q) float64 ndarray
        J_0, J_1, J_2 with the weights of their integrals.
    phase : (Q,) float64 ndarray
        Of each part, in radians for 1 um of defocus.
    """

    radii: Float64
    areas: Float64
    pupil: Float64
    bessel: Float64
    phase: Float64

    @staticmethod
    @lru_cache(maxsize=8)
    def with_reach(
        aperture: float, wavelength: float, pixel: float, index: float, steps: int
    ) -> _Spot:
        """Tabulate what kernels need that reach up to 1.25^steps px."""
        reach = _REACH_STEP**steps
        k, alpha = 2 * math.pi / wavelength, math.asin(aperture / index)
        ring = min(wavelength / (aperture * pixel * _RINGS), _WIDEST_RING)
        edges = ring * np.arange(math.ceil(reach / ring) + 1)
        middles = (edges[1:] + edges[:-1]) / 2
        # As many nodes as the phases of the farthest ring and of the largest defocus ask for.
        turns = k * (aperture + index * (1 - math.cos(alpha)) / math.tan(alpha)) * reach * pixel
        nodes, weights = np.polynomial.legendre.leggauss(32 + int(0.6 * turns))
        theta = alpha * (nodes + 1) / 2
        discs = disc_area(corners_to(reach), edges[1:, None, None])
        return _Spot(
            middles,
            np.diff(discs, axis=0, prepend=0.0),
            weights * np.sqrt(np.cos(theta)) * np.sin(theta),
            np.stack(_weighted_bessel(k * index * pixel * middles, theta)),
            k * index * (np.cos(theta) - 1),
        )

    def profile(self, defocus: float) -> Float64:
        """Return the intensity at all radii for a defocus in um, up to a factor: (K,)."""
        amplitudes = self.bessel @ (self.pupil * np.exp(1j * self.phase * defocus))
        return (np.abs(amplitudes) ** 2).sum(axis=0)


def _weighted_bessel(radii: Float64, theta: Float64) -> list[Float64]:
    """Return sqrt(c) w_m J_m(radius sin(theta)) of all integrals, c their count in h: (K, Q)."""
    sine, cosine = np.sin(theta), np.cos(theta)
    weights = (1 + cosine, math.sqrt(2) * sine, 1 - cosine)
    at = np.outer(radii, sine)
    return [weight * jv(order, at) for order, weight in enumerate(weights)]


def _above_0(value: float) -> bool:
    return 0 < value < math.inf
