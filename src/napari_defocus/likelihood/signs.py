"""What the powers of a window say beside its likelihood curve: how strong they are, and where from.

Defocus blurs in all directions alike. Motion does not, and leaves all windows of a picture with
their power in the same directions. So for each window the logarithms of its powers, relative to the
noise, are compared around rings of frequencies of equal length; their second harmonic,

    d = 2 / F sum_i (log(1 + q_i) - mean of its ring) exp(2 j theta_i),

is near 0 where no direction is preferred. Both gradients are added: the preference of each for its
own direction cancels.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from napari_defocus.likelihood.blur_spectra import SpectrumTable
from napari_defocus.likelihood.gabor import frequencies
from napari_defocus.likelihood.profile_likelihood import noise_power

Float32 = NDArray[np.float32]

_RINGS = 6
"""Rings of frequencies, from 0 to the highest, each as wide. Chosen by hand."""

_LOW = 0.35
"""Frequencies up to this share of the highest say how strong a window is. By hand."""

_WEAK, _MOST = 1.7, 0.9
"""If the strength of most windows is below this, nothing is seen. Noise alone has 0.9. Texture
blurred by 8 px behind a noise of 1e-3 has 2.6 or more, photographs and fluorescence 6.7 or more
(docs/decisions.md).
"""

_STRONG = 5.0
"""Only windows that are at least so strong say anything about directions."""

_ONE_WAY, _EXCEPTIONS = 1.0, 0.2
"""d of the strong windows along their mean direction: after motion above 1 for all but a fifth;
0.2 on a dune and 0.5 on a meadow; 1.7 on a part of the dune that is all ripples (decisions.md)."""

NOTHING_SEEN = (
    "This does not look like defocus: nothing in it stands out from noise, so the radii say "
    "nothing."
)
ONE_DIRECTION = (
    "This does not look like defocus: nearly all details lie in one direction, as after motion or "
    "where there are only ripples, so the radii say little."
)


def signs_of(power: Float32, table: SpectrumTable, noise_variance: float, window: int) -> Float32:
    """Return how strong windows are and which direction they prefer.

    Parameters
    ----------
    power : (P, 2, F) float32 ndarray
        |g_i|^2.
    table : SpectrumTable
    noise_variance : float
    window : int
        N, in px.

    Returns
    -------
    (P, 3) float32 ndarray
        log(1 + mean power of low frequencies, relative to the noise's); real and imaginary part of
        d above.
    """
    relative = power * (1 / noise_power(table, noise_variance)).astype(np.float32)
    low, harmonic = _weights(window)
    strength = np.log1p(np.einsum("pgf,f->p", relative, low))
    relative += 1
    rise = np.log(relative[:, 0] * relative[:, 1])
    direction = np.einsum("pf,fk->pk", rise, harmonic)
    return np.column_stack([strength, direction])


@lru_cache(maxsize=8)
def _weights(window: int) -> tuple[Float32, Float32]:
    """Return the weights of low frequencies, (F,), and those of the second harmonic, (F, 2)."""
    row, column = frequencies(window).T
    length = np.hypot(row, column)
    # Small windows have no other frequencies than high ones: the lowest of these.
    low = length <= max(_LOW * length.max(), length.min() + 1e-9)
    ring = np.minimum((_RINGS * length / length.max()).astype(int), _RINGS - 1)
    same = (ring[:, None] == ring).astype(np.float64)
    angle = 2 * np.arctan2(row, column)
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    harmonic = (
        2
        / len(ring)
        * (waves - np.einsum("ij,jk->ik", same, waves) / same.sum(axis=1, keepdims=True))
    )
    return (low / (2 * low.sum())).astype(np.float32), harmonic.astype(np.float32)


def doubt_of(strength: Float32 | None, direction: Float32 | None) -> str | None:
    """Return a sentence that says why a picture does not look like defocus; None if it may.

    Parameters
    ----------
    strength : (R, C) float32 ndarray or None
    direction : (R, C, 2) float32 ndarray or None
        See `BlurCandidates`; None tells nothing.
    """
    if strength is None or direction is None:
        return None
    if np.quantile(strength, _MOST) < _WEAK:
        return NOTHING_SEEN
    strong = direction[strength >= _STRONG].astype(np.float64)
    if not len(strong):
        return None
    mean = strong.mean(axis=0)
    along = strong @ mean / max(float(np.hypot(*mean)), 1e-9)
    return ONE_DIRECTION if np.quantile(along, _EXCEPTIONS) > _ONE_WAY else None


def one_direction(strength: Float32 | None, direction: Float32 | None) -> float | None:
    """Return how far the windows of a picture agree in one direction: |mean d| / mean |d|.

    It is from 0 to 1. Cells and tissue have 0.02 to 0.5, and 0.7 to 0.98 after motion of 20 px;
    photographs have 0.2 to 0.6, but up to 0.9 where things lie side by side, such as stalks,
    bricks and brushes. None where no window is strong.

    Parameters
    ----------
    strength : (R, C) float32 ndarray or None
    direction : (R, C, 2) float32 ndarray or None
        See `BlurCandidates`; None tells nothing.
    """
    if strength is None or direction is None:
        return None
    strong = direction[strength >= _STRONG].astype(np.float64)
    if not len(strong):
        return None
    together, apart = np.hypot(*strong.mean(axis=0)), np.hypot(*strong.T).mean()
    return float(together / max(apart, 1e-9))
