"""Which PSF family a picture shows, if it can tell: what `psf="auto"` takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from napari_defocus.core.image import PreparedImage
from napari_defocus.likelihood.exact_spectra import domain_of_window
from napari_defocus.likelihood.local_noise import LocalNoise
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.likelihood.specimen_choice import specimen_margin
from napari_defocus.likelihood.window_evidence import LARGEST_LOSS, Windows, family_fit, spacing
from napari_defocus.psf import AUTO
from napari_defocus.psf.families import Annulus, AutomaticPSF, Disc, Gaussian, PSFFamily
from napari_defocus.psf.microscope import Microscope
from napari_defocus.psf.parsing import psf_text

_OTHERS = (Gaussian(), Annulus(0.3), Annulus(0.5))
"""The families that may be chosen instead of a disc. Polygons, and real irises, are measured as
well with discs.
"""

_LIMIT = 1.5
"""Units of log-likelihood, in the mean of windows, by which a family must be better than the disc.
On simulations and photographs (docs/decisions.md)."""

_SPECIMEN_LIMIT = 2.0
"""Units by which points or texture must be better to count as found: on simulated beads and tissue
2.5 to 10, and below it where noise hides nearly everything (docs/decisions.md)."""

_WIDEST, _NARROWEST = 0.875, 1.5
"""Windows vote if their likeliest radius is between 1.5 px and 7 of 8 px: all families are alike
below, and beyond the domain anything may fit. By hand."""

_TEXTURED = 20.0
"""Units of log-likelihood that the likeliest radius of a textured window is above the least likely
one: flat places have less. By hand."""

_LEAST_SHARE, _LEAST_WINDOWS = 1 / 3, 30
"""Of textured windows, so many have to vote, and so many of all: the few blurred places of a sharp
picture are mostly lone edges, which fit rings. On simulations and photographs (decisions.md)."""


@dataclass(frozen=True)
class PSFChoice:
    """The PSF family that a picture shows, or the disc where it cannot tell; `str` is a line.

    Attributes
    ----------
    psf : PSFFamily
    found : bool
        Whether the picture tells it.
    margin : float
        By how much it is better than the disc, or the disc than the next one, in units of
        log-likelihood: the mean over the windows that voted. Below 0, another one is better, but
        not clearly. 0 if too few windows voted.
    windows : int
        How many voted.
    """

    psf: PSFFamily
    found: bool
    margin: float
    windows: int

    def __str__(self) -> str:
        """Return what users are told."""
        if self.found:
            return f"{psf_text(self.psf)}, found from the picture"
        return f"{psf_text(self.psf)}; the picture cannot tell"

    def facts(self) -> dict[str, Any]:
        """Return it as JSON holds it."""
        return {
            "psf": psf_text(self.psf),
            "found": self.found,
            "margin": self.margin,
            "windows": self.windows,
        }


def is_to_choose(psf: PSFFamily) -> bool:
    """Return whether a family leaves something for `choose_psf` to find."""
    return isinstance(psf, AutomaticPSF) or (isinstance(psf, Microscope) and psf.specimen == AUTO)


def choose_psf(
    pictures: Sequence[PreparedImage],
    psf: PSFFamily,
    *,
    noise: float | ShotNoise | LocalNoise | None,
    window: int,
    camera_softness: float,
) -> PSFChoice:
    """Choose what a family leaves open: see `choose_family` and `specimen_margin`.

    Parameters
    ----------
    pictures : sequence of PreparedImage
        Samples that one lens made.
    psf : PSFFamily
        One that `is_to_choose`. Up to 8 px of its domain are looked at, with windows of 41 px.
    noise : float, ShotNoise, LocalNoise or None
        As `estimate_candidates` takes it, or of one picture as it was found.
    window : int
        Side N of the analysis window, in px.
    camera_softness : float
        px, see `napari_defocus.compare_psf`.
    """
    if isinstance(psf, Microscope):
        margin, windows = specimen_margin(pictures, psf, noise, window, camera_softness)
        chosen = replace(psf, specimen="points" if margin > 0 else "texture")
        return PSFChoice(chosen, abs(margin) > _SPECIMEN_LIMIT, abs(margin), windows)
    samples = [
        Windows.of(picture, noise, window, spacing(picture, window, len(pictures)))
        for picture in pictures
    ]
    return choose_family(samples, psf.max_scale, camera_softness)


def choose_family(
    samples: Sequence[Windows], max_radius: float, camera_softness: float
) -> PSFChoice:
    """Choose the family that made pictures: disc, Gaussian, ring of obstruction 0.3 or 0.5.

    Textured windows with a blur from 1.5 px to 7/8 of the domain vote. If they are a third of the
    textured ones, 30 at least, and one family is better than the disc by 1.5 in the mean
    log-likelihood of a window, it is taken; else the disc stays.

    `max_radius` is the largest blur radius of the chosen family, in px.
    """
    largest = min(max_radius, domain_of_window(samples[0].window))
    families = [replace(psf, max_radius=largest) for psf in (Disc(), *_OTHERS)]
    fits = [family_fit(samples, psf, camera_softness) for psf in families]
    evidence = np.array([fit.evidence for fit in fits])
    best = evidence.argmax(axis=0), np.arange(evidence.shape[1])
    scale = np.array([fit.scale for fit in fits])[best]
    textured = np.array([fit.depth for fit in fits])[best] > _TEXTURED
    votes = textured & (scale > _NARROWEST) & (scale < _WIDEST * largest)
    disc, count = Disc(max_radius), int(votes.sum())
    if count < max(_LEAST_WINDOWS, _LEAST_SHARE * textured.sum()):
        return PSFChoice(disc, found=False, margin=0.0, windows=count)
    voting = evidence[:, votes]
    height = -np.minimum(voting.max(axis=0) - voting, LARGEST_LOSS).mean(axis=1)
    other = 1 + int(height[1:].argmax())
    margin = float(height[other] - height[0])
    if margin > _LIMIT:
        chosen = replace(_OTHERS[other - 1], max_radius=max_radius)
        return PSFChoice(chosen, found=True, margin=margin, windows=count)
    return PSFChoice(disc, found=-margin > _LIMIT, margin=-margin, windows=count)
