"""Which PSF family fits a picture: the evidence of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from napari_defocus.core.checks import Linearize, check_noise_variance, check_softness
from napari_defocus.core.image import prepare_image
from napari_defocus.core.intensity import Intensities
from napari_defocus.core.progress import Progress, silent
from napari_defocus.likelihood.exact_spectra import within_window
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.likelihood.window_evidence import (
    LARGEST_LOSS,
    FamilyFit,
    Windows,
    family_fit,
)
from napari_defocus.psf.families import PSFFamily, as_family
from napari_defocus.psf.parsing import psf_text
from napari_defocus.settings import MapSettings

_WINDOWS_APART = 4
"""Windows are a quarter of their side apart. Chosen by hand."""


@dataclass(frozen=True)
class PSFEvidence:
    """How well one PSF family explains a picture.

    Attributes
    ----------
    psf : PSFFamily
    log_evidence : float
        Mean over windows of the logarithm of its evidence, relative to the best family of each
        window. A window counts -10 at least; 0 would be the best everywhere.
    share : float
        Share of the windows for which it is the best.
    median_scale : float
        Median over windows of the most likely scale, in px.
    softness : float
        Standard deviation, in px, of the Gaussian that was added to the family and explains the
        picture best: the camera's own, or more if the scene lacks fine details.
    """

    psf: PSFFamily
    log_evidence: float
    share: float
    median_scale: float
    softness: float


@dataclass(frozen=True)
class PSFComparison:
    """PSF families compared on one picture, best first; `str` gives a table.

    Attributes
    ----------
    rows : tuple of PSFEvidence
    windows : int
        How many windows with any texture were looked at.
    noise_variance : float
        Of the luminance, intensities in [0, 1].
    intensities : Intensities or None
        Which intensities of the picture are 0 and 1.
    """

    rows: tuple[PSFEvidence, ...]
    windows: int
    noise_variance: float
    intensities: Intensities | None = None

    def __iter__(self) -> Iterator[PSFEvidence]:
        return iter(self.rows)

    @property
    def best(self) -> PSFFamily:
        """The family of the largest evidence."""
        return self.rows[0].psf

    def __str__(self) -> str:
        lines = [f"{'family':<28} {'log evidence':>12} {'best in':>8} {'median scale':>13}"]
        for row in self.rows:
            name = _name(row.psf)
            lines.append(
                f"{name:<28} {row.log_evidence:>12.3f} {row.share:>8.0%} "
                f"{row.median_scale:>10.1f} px"
            )
        return "\n".join(lines)


def compare_psf(
    image: ArrayLike,
    families: Sequence[PSFFamily | Callable[[float], ArrayLike]],
    *,
    noise_variance: float | ShotNoise | None = MapSettings.noise_variance,
    window: int = MapSettings.window,
    camera_softness: float = MapSettings.camera_softness,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> PSFComparison:
    r"""Compare how well PSF families explain a picture.

    The evidence of a family in a window is the mean over its R scales of p(r) of (9), with the
    prior exp(-0.25 r) of the maps. The camera's softness is part of the kernels. Scenes lack fine
    details, too: if a larger softness of 0.7, 1, 1.4 or 2 px explains the whole picture better
    with this family, it is taken instead (not with `Gaussian`, whose radius includes it). What a
    family loses to the best one is the mean over windows of

    .. math:: \min\left(\max_j \log e_j - \log e, \, 10\right), \qquad
        e = \frac{1}{R} \sum_r p(r) \, e^{-r / 4}, \qquad
        p(r) = \max_s \prod_i \frac{1}{v_i} \exp\left(-\frac{|g_i^{\nabla}|^2}{v_i}\right), \qquad
        v_i = s \, \sigma_i^2(r) + \sigma_{ni}^2

    The limit is there so that a few windows that no family explains do not decide. Families can be
    told apart from about 2 px of blur on, in texture with little noise. Rings whose obstructions
    differ by 0.1 can hardly be told apart.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        See `estimate_candidates`.
    families : sequence of PSFFamily or callable
        At least one.
    noise_variance : float or ShotNoise, optional
        Of the luminance, or how it grows with the intensity. By default it is found.
    window : int, optional
        Side N of the analysis window, px.
    camera_softness : float, optional
        The least standard deviation, in px, of the camera's own blur.
    linearize : {"srgb"}, optional
        Decode the intensities into linear light first.
    intensity_range : (float, float), optional
        The intensities that count as 0 and 1; found by default, see `estimate_candidates`.
    progress : callable, optional
        Called as ``progress(step, done)``; an exception from it ends the work.

    Returns
    -------
    PSFComparison

    Raises
    ------
    TypeError, ValueError
        As `estimate_candidates`; if `families` is empty; if the picture has no texture.

    Examples
    --------
    >>> import numpy as np
    >>> from skimage.data import camera
    >>> from napari_defocus import Annulus, Disc, compare_psf, simulate_defocus
    >>> picture = simulate_defocus(camera()[:200, :200], np.full((200, 200), 5.0),
    ...                            psf=Annulus(0.5))
    >>> compare_psf(picture, [Disc(), Annulus(0.5)]).best
    Annulus(obstruction=0.5, max_radius=64.0)
    """
    try:
        given = list(families)
    except TypeError:
        raise TypeError(f"families is {families!r}; it takes a list, such as [Disc()]") from None
    checked = [within_window(psf, window) for psf in given]
    if not checked:
        raise ValueError("families is empty; it takes at least one PSF family")
    if not isinstance(noise_variance, ShotNoise):
        check_noise_variance(noise_variance)
    check_softness(camera_softness)
    picture = prepare_image(image, intensity_range, linearize)
    progress("Measuring the noise", 0.0)
    windows = Windows.of(picture, noise_variance, window, window // _WINDOWS_APART)
    if not len(windows.power):
        raise ValueError("image has no texture; it cannot tell which PSF family fits")
    fits = []
    for index, psf in enumerate(checked):
        progress("Comparing PSF families", index / len(checked))
        fits.append(family_fit([windows], psf, camera_softness))
    progress("Comparing PSF families", 1.0)
    rows = _rows([as_family(psf) for psf in given], fits)
    return PSFComparison(rows, len(windows.power), windows.noise_variance, picture.intensities)


def _name(psf: PSFFamily) -> str:
    try:
        return psf_text(psf)
    except ValueError:
        return type(psf).__name__


def _rows(families: Sequence[PSFFamily], fits: Sequence[FamilyFit]) -> tuple[PSFEvidence, ...]:
    evidence = np.array([fit.evidence for fit in fits])
    loss = np.minimum(evidence.max(axis=0) - evidence, LARGEST_LOSS).mean(axis=1)
    wins = np.bincount(evidence.argmax(axis=0), minlength=len(families)) / evidence.shape[1]
    found = [
        PSFEvidence(
            psf, -float(loss[i]), float(wins[i]), float(np.median(fits[i].scale)), fits[i].softness
        )
        for i, psf in enumerate(families)
    ]
    return tuple(sorted(found, key=lambda row: -row.log_evidence))
