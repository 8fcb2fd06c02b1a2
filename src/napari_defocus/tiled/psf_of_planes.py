"""The PSF family of a stack, or of a picture larger than memory: from pieces of some planes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from napari_defocus.likelihood.estimation import Estimation
from napari_defocus.likelihood.psf_choice import PSFChoice, choose_psf
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.tiled.plane_noise import pieces_of_plane

MOST_PLANES = 5
"""Planes that are looked at, evenly spaced. Chosen by hand."""

_PIECES = 15
"""Pieces of all these planes together, if they are large. Chosen by hand."""


def psf_of_planes(
    planes: Sequence[Any], how: Estimation, noise: float | ShotNoise | None
) -> PSFChoice:
    """Choose one family for all planes, see `choose_psf`; pixels of some are read at once.

    Parameters
    ----------
    planes : sequence of (H, W) or (H, W, 3 or 4) array_like
        All of them, of numpy or dask.
    how : Estimation
        How their candidates are estimated, but for the family; its largest scale counts.
    noise : float, ShotNoise or None
        As `estimate_candidates` takes it.
    """
    asked = [planes[at] for at in evenly_spaced(len(planes), MOST_PLANES)]
    pictures = []
    for plane in asked:
        pieces = pieces_of_plane(plane.shape[:2])
        some = evenly_spaced(len(pieces), max(1, _PIECES // len(asked)))
        pictures += [how.prepared(np.asarray(plane[pieces[at]])) for at in some]
    return choose_psf(
        pictures,
        how.psf,
        noise=noise,
        window=how.window,
        camera_softness=how.camera_softness,
    )


def evenly_spaced(count: int, most: int) -> list[int]:
    """Return up to `most` numbers from 0 to `count` - 1, evenly spaced."""
    return [int(at) for at in np.unique(np.linspace(0, count - 1, min(count, most)).round())]
