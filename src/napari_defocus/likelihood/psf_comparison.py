"""Which PSF family fits a picture: the evidence of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_defocus.core.checks import Linearize, check_noise_variance
from napari_defocus.core.image import prepare_image
from napari_defocus.core.intensity import Intensities
from napari_defocus.core.progress import Progress, silent
from napari_defocus.likelihood.blur_spectra import label_scales, spectrum_table
from napari_defocus.likelihood.exact_spectra import check_windows
from napari_defocus.likelihood.gabor import gradients, local_power, window_centers, within_picture
from napari_defocus.likelihood.noise import noise_variance_of
from napari_defocus.likelihood.profile_likelihood import profile_log_likelihood
from napari_defocus.psf.families import PSFFamily
from napari_defocus.psf.parsing import psf_text
from napari_defocus.settings import MapSettings

_WINDOWS_APART = 4
"""Windows are a quarter of their side apart. Chosen by hand."""

_LARGEST_LOSS = 10.0
"""Units of log-likelihood that a family loses in a window at most. Chosen by hand."""


@dataclass(frozen=True)
class PSFEvidence:
    """How well one PSF family explains a picture.

    Attributes
    ----------
    psf : PSFFamily
    log_evidence : float
        Mean over windows of the logarithm of its evidence, relative to the best family of each
        window, at most 10 below; 0 would be the best everywhere.
    share : float
        Of the windows for which it is the best.
    median_scale : float
        Median over windows of the most likely scale, in px.
    """

    psf: PSFFamily
    log_evidence: float
    share: float
    median_scale: float


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
    noise_variance: float | None = MapSettings.noise_variance,
    window: int = MapSettings.window,
    linearize: Linearize | None = MapSettings.linearize,
    intensity_range: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> PSFComparison:
    r"""Compare how well PSF families explain a picture.

    The evidence of a family in a window is the mean of p(r) of (9) over its R scales, which is a
    flat prior on them. What a family loses to the best one is the mean over windows of

    .. math:: \min\left(\max_j \log e_j - \log e, \, 10\right), \qquad
        e = \frac{1}{R} \sum_r p(r), \qquad
        p(r) = \max_s \prod_i \frac{1}{v_i} \exp\left(-\frac{|g_i^{\nabla}|^2}{v_i}\right), \qquad
        v_i = s \, \sigma_i^2(r) + \sigma_{ni}^2

    It counts up to a limit, so that the few windows that no family explains do not decide.
    Differences of families are visible from about 2 px of blur on, in texture with little noise.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) or (H, W, 4) array_like
        See `estimate_candidates`.
    families : sequence of PSFFamily or callable
        At least one.
    noise_variance : float, optional
        Of the luminance. By default the smallest that is found with any of the families.
    window : int, optional
        Side N of the analysis window, px.
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
    Annulus(obstruction=0.5, max_radius=8.0)
    """
    try:
        given = list(families)
    except TypeError:
        raise TypeError(f"families is {families!r}; it takes a list, such as [Disc()]") from None
    checked = [check_windows(psf, window) for psf in given]
    if not checked:
        raise ValueError("families is empty; it takes at least one PSF family")
    check_noise_variance(noise_variance)
    picture = prepare_image(image, intensity_range, linearize)
    progress("Measuring the noise", 0.0)
    if noise_variance is None:
        noise_variance = noise_variance_of(picture)
    gradient = gradients(picture.evened, picture.opaque, window)
    rows, columns = (
        np.unique(
            within_picture(window_centers(length, window // _WINDOWS_APART) + pad, full, window)
        )
        for length, pad, full in zip(
            picture.shape,
            gradient.pad,
            (gradient.along_columns.shape[0], gradient.along_rows.shape[1]),
            strict=True,
        )
    )
    power = local_power(gradient, rows, columns, window)
    power = power.reshape(-1, *power.shape[2:])
    power = power[power.any(axis=(1, 2))]
    if not len(power):
        raise ValueError("image has no texture; no PSF family can be told from another")
    least_noise = max(noise_variance, picture.rounding_variance) / picture.intensities.unit**2
    evidence, best_scale = np.empty((2, len(checked), len(power)))
    for index, psf in enumerate(checked):
        progress("Comparing PSF families", index / len(checked))
        table = spectrum_table(psf, window, rows[0] % 1, columns[0] % 1, "exact")
        scales = label_scales(psf)
        curve = profile_log_likelihood(power, table, scales, least_noise)
        evidence[index] = _log_mean_exp(curve)
        best_scale[index] = scales[curve.argmax(axis=1)]
    progress("Comparing PSF families", 1.0)
    found = _comparison(checked, evidence, best_scale, noise_variance)
    return replace(found, intensities=picture.intensities)


def _name(psf: PSFFamily) -> str:
    try:
        return psf_text(psf)
    except ValueError:
        return type(psf).__name__


def _log_mean_exp(curve: NDArray[np.float32]) -> NDArray[np.floating]:
    top = curve.max(axis=1, keepdims=True)
    return top[:, 0] + np.log(np.exp(curve - top).mean(axis=1))


def _comparison(
    families: Sequence[PSFFamily],
    evidence: NDArray[np.floating],
    best_scale: NDArray[np.floating],
    noise_variance: float,
) -> PSFComparison:
    loss = np.minimum(evidence.max(axis=0) - evidence, _LARGEST_LOSS).mean(axis=1)
    wins = np.bincount(evidence.argmax(axis=0), minlength=len(families)) / evidence.shape[1]
    found = [
        PSFEvidence(psf, -float(loss[i]), float(wins[i]), float(np.median(best_scale[i])))
        for i, psf in enumerate(families)
    ]
    found.sort(key=lambda row: -row.log_evidence)
    return PSFComparison(tuple(found), evidence.shape[1], float(noise_variance))
