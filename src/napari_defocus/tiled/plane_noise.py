"""Noise and intensities of a plane, from all of it or from pieces of a large one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_defocus.core.intensity import IntensityRange, Limits, needs_limits
from napari_defocus.core.known_pixels import known_values, limits_of
from napari_defocus.likelihood.shot_noise import ShotNoise
from napari_defocus.tiled.tile_graph import TileGraph, after, pixels
from napari_defocus.tiled.tile_tasks import Noise, Preparing, join_intensities, look_at_noise

_WHOLE = 4_000_000
"""px: the noise of smaller planes is measured everywhere."""

_PIECES, _PIECE, _EVERY = 8, 512, 3
"""The noise of a larger plane is measured in so many pieces along a side, of so many px, at every
third pixel.
"""

_EVERY_INTENSITY = 25
"""There, every 25th pixel counts for the contrast."""


def noise_of_plane(
    plane: Any, given: float | ShotNoise | None, how: Preparing, intensities: Any = None
) -> Any:
    """Return the noise of a plane as its tiles need it, delayed.

    Parameters
    ----------
    plane : (H, W) or (H, W, C) dask.array.Array
    given : float, ShotNoise or None
        What is known of it.
    how : Preparing
    intensities : dask.delayed.Delayed, optional
        Those of the plane, if they were asked for before.
    """
    if intensities is None:
        intensities = intensities_of_plane(plane, how.intensity_range)
    read = after(plane, intensities)
    whole = plane.shape[:2]
    pieces, every = pieces_of_plane(whole), _every(whole)
    graph = TileGraph("noise", read, intensities, given, how)
    seen = how, intensities, every
    samples = [
        graph.add(number, look_at_noise, pixels(read, piece), *seen, _starts_at(piece), whole)
        for number, piece in enumerate(pieces)
        if given is None or isinstance(given, ShotNoise)
    ]
    return graph.value(graph.add("of samples", Noise.of_samples, given, intensities, samples))


def intensities_of_plane(
    plane: Any, intensity_range: IntensityRange | None, limits: Any = None
) -> Any:
    """Return the intensities of a plane, delayed, as an array of it would have them.

    Of planes above 4 megapixels, the contrast comes from as many pieces as the noise.

    Parameters
    ----------
    plane : (H, W) or (H, W, C) dask.array.Array
    intensity_range : (float, float) or None
        As given.
    limits : dask.delayed.Delayed, optional
        `Limits` to go by instead of the plane's own.
    """
    graph = TileGraph("intensities", plane, limits, intensity_range)
    pieces, every = pieces_of_plane(plane.shape[:2]), _every(plane.shape[:2])
    some = 1 if every == 1 else _EVERY_INTENSITY
    values = [
        graph.add(number, known_values, pixels(plane, piece), some)
        for number, piece in enumerate(pieces)
    ]
    known = [limits]
    if limits is None:
        known = (
            _limits_of_blocks(graph, plane) if needs_limits(plane.dtype, intensity_range) else []
        )
    found = join_intensities, plane.dtype, intensity_range, known, values
    return graph.value(graph.add("of samples", *found))


def limits_of_planes(planes: list[Any]) -> Any:
    """Return the `Limits` of all planes of a stack, delayed: the range that they share."""
    graph = TileGraph("limits", planes)
    blocks = [key for plane in planes for key in _limits_of_blocks(graph, plane)]
    return graph.value(graph.add("of all", Limits.joined, blocks))


def _limits_of_blocks(graph: TileGraph, plane: Any) -> list[Any]:
    """Add the tasks that look for the limits of each block of a plane; return their keys."""
    return [
        graph.add(("limits of", *block.key), limits_of, block)
        for block in plane.to_delayed(optimize_graph=False).flat
    ]


def pieces_of_plane(shape: tuple[int, int]) -> list[tuple[slice, slice]]:
    """Return the pieces of a plane that tell of all of it: all, or squares of a large one."""
    if shape[0] * shape[1] <= _WHOLE:
        return [(slice(0, shape[0]), slice(0, shape[1]))]
    rows, columns = (
        [slice(start, start + _PIECE) for start in _starts(length)] for length in shape
    )
    return [(row, column) for row in rows for column in columns]


def _starts_at(piece: tuple[slice, slice]) -> tuple[int, int]:
    return piece[0].start, piece[1].start


def _every(shape: tuple[int, int]) -> int:
    """Return at every how many pixels the noise is looked at."""
    return 1 if shape[0] * shape[1] <= _WHOLE else _EVERY


def sampled(image: Any) -> NDArray[Any]:
    """Return pixels of a plane that tell of all of it: the plane, or pieces of a large one.

    Parameters
    ----------
    image : (H, W) or (H, W, 3 or 4) array-like
        Of dask, or whatever has a shape and slices.

    Returns
    -------
    ndarray
        Up to 4096 px a side; pieces of 512 px are put together as they lie.
    """
    height, width = image.shape[:2]
    if height * width <= _WHOLE:
        return np.asarray(image)
    rows = [
        [np.asarray(image[row : row + _PIECE, at : at + _PIECE]) for at in _starts(width)]
        for row in _starts(height)
    ]
    return np.concatenate([np.concatenate(row, axis=1) for row in rows])


def _starts(length: int) -> list[int]:
    count = min(_PIECES, max(1, length // _PIECE))
    return [int(start) for start in np.linspace(0, max(length - _PIECE, 0), count)]
