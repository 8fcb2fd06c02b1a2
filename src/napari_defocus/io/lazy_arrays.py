"""Arrays that are read when they are computed: part by part, in whichever process computes them."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from itertools import product
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import dask.array as da

LEAST_SIDE = 1024
"""px: the least side of a block, if the file has smaller tiles or strips."""


class RegionReader(Protocol):
    """What reads regions of a file that it opens by its path; it can be sent to other processes."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the whole."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of what is read."""

    def __getitem__(self, region: tuple[slice, ...]) -> NDArray[Any]:
        """Read a region, one slice of step 1 an axis."""


class _Indexed:
    """A reader for any basic index: what dask asks for when it has fused an index with a read."""

    def __init__(self, reader: RegionReader) -> None:
        self.reader = reader
        self.shape, self.dtype, self.ndim = reader.shape, reader.dtype, len(reader.shape)

    def __getitem__(self, key: Any) -> NDArray[Any]:
        keys = key if isinstance(key, tuple) else (key,)
        keys += (slice(None),) * (self.ndim - len(keys))
        parts = [_covering(one, size) for one, size in zip(keys, self.shape, strict=True)]
        covering, rest = zip(*parts, strict=True)
        if any(part.stop <= part.start for part in covering):
            return np.empty(self.shape, self.dtype)[keys]
        return self.reader[covering][rest]


def _covering(key: Any, size: int) -> tuple[slice, Any]:
    """Return a slice of step 1 that holds what an index asks for, and what is left to index."""
    if not isinstance(key, slice):
        start = int(key) % size
        return slice(start, start + 1), 0
    asked = range(*key.indices(size))
    if not asked:
        return slice(0, 0), slice(None)
    first, last = sorted((asked[0], asked[-1]))
    return slice(first, last + 1), slice(None, None, asked.step)


def lazy_array(reader: RegionReader, blocks: tuple[int, ...]) -> da.Array:
    """Return a dask array whose blocks, so long along each axis, are read when they are computed.

    Of a block, only what is asked for is read.
    """
    import dask.array as da

    meta = np.empty((0,) * len(reader.shape), reader.dtype)
    return da.from_array(
        _Indexed(reader), chunks=blocks, meta=meta, fancy=False, asarray=False, name=False
    )


class Carried:
    """A lazy array that can be sent to another process, whatever functions read its blocks.

    `pickle` alone refuses functions without a name, such as those that many readers use.
    """

    def __init__(self, array: Any) -> None:
        self.array = array

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the functions by what they do; arrays in memory are not copied."""
        import cloudpickle  # type: ignore[import-untyped]

        buffers: list[pickle.PickleBuffer] = []
        pickled = cloudpickle.dumps(self.array, protocol=5, buffer_callback=buffers.append)
        return _arrived, (pickled, buffers)


def _arrived(pickled: bytes, buffers: list[Any]) -> Carried:
    return Carried(pickle.loads(pickled, buffers=buffers))


def regions(shape: tuple[int, ...], sides: tuple[int, ...]) -> Iterator[tuple[slice, ...]]:
    """Yield the parts that make up an array, so long along each axis but at its end.

    Examples
    --------
    >>> [(rows.stop, columns.start) for rows, columns in regions((2, 7), (5, 4))]
    [(2, 0), (2, 4)]
    """
    starts = (range(0, size, side) for size, side in zip(shape, sides, strict=True))
    for corner in product(*starts):
        bounds = zip(corner, sides, shape, strict=True)
        yield tuple(slice(at, min(at + side, size)) for at, side, size in bounds)


def block_side(tile: int, size: int) -> int:
    """Return how long a block is along an axis that a file keeps in tiles: whole tiles.

    Examples
    --------
    >>> block_side(tile=256, size=40_000), block_side(tile=4096, size=40_000), block_side(1, 100)
    (1024, 4096, 100)
    """
    return min(tile * -(-LEAST_SIDE // tile), size)
