"""Graphs of what is done to the tiles of a picture, written down task by task.

With dask's own slices and delayed functions, each tile would have the whole graph looked through
again: minutes, for a hundred megapixels. Here, a tile's task takes the blocks of the picture that
it sees, and cuts out its pixels itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import dask
import dask.array as da
import numpy as np
from dask.core import flatten
from dask.delayed import Delayed, delayed
from dask.highlevelgraph import HighLevelGraph
from numpy.typing import DTypeLike, NDArray

from napari_defocus.core.known_pixels import joined_pieces
from napari_defocus.tiled.tiles import Tile

Tiles = list[list[Tile]]
Region = tuple[Any, ...]
Key = tuple[Any, ...]


def cut_out(
    blocks: list[list[NDArray[Any]]], rows: list[slice], columns: list[slice]
) -> NDArray[Any]:
    """Put pixels of neighbouring blocks together.

    Parameters
    ----------
    blocks : list of list of (h, w) or (h, w, C) ndarray
    rows, columns : list of slice
        What is wanted of each row, and of each column, of blocks.
    """
    lines = [
        [block[row, column] for block, column in zip(line, columns, strict=True)]
        for line, row in zip(blocks, rows, strict=True)
    ]
    if len(rows) == len(columns) == 1:
        return lines[0][0]
    return joined_pieces([joined_pieces(line, axis=1) for line in lines], axis=0)


def _covering(lengths: tuple[int, ...], tile: slice) -> tuple[list[int], list[slice]]:
    """Return which blocks of an axis hold a stretch of it, and what of each is wanted."""
    stops = np.cumsum(lengths)
    first, last = np.searchsorted(stops, [tile.start, tile.stop - 1], side="right")
    numbers = list(range(int(first), int(last) + 1))
    starts = [int(stops[number]) - lengths[number] for number in numbers]
    slices = [
        slice(max(tile.start - start, 0), min(tile.stop - start, lengths[number]))
        for number, start in zip(numbers, starts, strict=True)
    ]
    return numbers, slices


def pixels(plane: Any, region: tuple[slice, slice]) -> tuple[Any, ...]:
    """Return a task that has the pixels of a region of a dask array, (H, W) or (H, W, C)."""
    (rows, of_rows), (columns, of_columns) = map(_covering, plane.chunks[:2], region)
    colors = (0,) * (plane.ndim - 2)
    keys = [[(plane.name, row, column, *colors) for column in columns] for row in rows]
    return cut_out, keys, of_rows, of_columns


@dataclass(frozen=True)
class TileGraph:
    """What is done to the tiles of one plane.

    Attributes
    ----------
    name : str
        Of its tasks; as long as it is the same, so are they.
    sources : list of dask collections
        Whose blocks, or values, tasks take.
    tasks : dict
        By key; a key is a tuple that begins with `name`.
    """

    name: str
    sources: list[Any]
    tasks: dict[Key, tuple[Any, ...]] = field(default_factory=dict)

    @classmethod
    def of(cls, kind: str, sources: list[Any], *made_with: Any) -> TileGraph:
        """Begin a graph that is known by what it is made of; sources may be no collections."""
        lazy = [source for source in sources if dask.is_dask_collection(source)]
        return cls(f"{kind}-{dask.base.tokenize(sources, *made_with)}", lazy)

    @staticmethod
    def key_of(value: Any) -> Any:
        """Return what stands for a delayed value in a task; of any other, itself."""
        return value.key if isinstance(value, Delayed) else value

    def add(self, what: Any, function: Callable[..., Any], *arguments: Any) -> Key:
        """Add a task; return its key."""
        key = (self.name, what) if not isinstance(what, tuple) else (self.name, *what)
        self.tasks[key] = (function, *arguments)
        return key

    def value(self, key: Key) -> Any:
        """Return what a task has, as a dask collection."""
        return Delayed(key, HighLevelGraph(*self._layers()), layer=self.name)

    def array(
        self,
        name: str,
        tiles: Tiles,
        task_of: Callable[[int, int], tuple[Any, ...]],
        dtype: DTypeLike = np.float32,
        shape_of: Callable[[Tile], tuple[int, ...]] = lambda tile: tile.core_shape,
    ) -> Any:
        """Return a dask array with a block for each tile, at its row and column."""
        own = f"{name}-{self.name}"
        shapes = [[shape_of(tile) for tile in row] for row in tiles]
        more = shapes[0][0][2:]
        places = np.ndindex(len(tiles), len(tiles[0]))
        blocks = {(own, *place, *(0 for _ in more)): task_of(*place) for place in places}
        layers, dependencies = self._layers()
        graph = HighLevelGraph(layers | {own: blocks}, dependencies | {own: {self.name}})
        chunks = (
            tuple(row[0][0] for row in shapes),
            tuple(shape[1] for shape in shapes[0]),
            *((length,) for length in more),
        )
        return da.Array(graph, own, chunks, meta=np.empty((0,) * len(chunks), dtype))

    def _layers(self) -> tuple[dict[str, Any], dict[str, set[str]]]:
        layers: dict[str, Any] = {}
        dependencies: dict[str, set[str]] = {}
        for source in self.sources:
            layers |= source.dask.layers
            dependencies |= source.dask.dependencies
        needed = set(chain(*(source.__dask_layers__() for source in self.sources)))
        return layers | {self.name: self.tasks}, dependencies | {self.name: needed}


def after(plane: Any, value: Delayed) -> Any:
    """Return a dask array whose blocks are read, once more, when a value is there.

    Else those that are read for what comes before it would be kept for what comes after. (The
    `bind` of dask leaves the tasks of rechunked and indexed arrays as they are.)
    """
    (plane,) = dask.optimize(plane)
    nodes = dict(plane.__dask_graph__())
    # Values that are in the graph itself need no second reading.
    values = {key for key, node in nodes.items() if type(node).__name__ == "DataNode"}
    held = values - set(flatten(plane.__dask_keys__()))
    later = {key: _later(key, value.key) for key in nodes.keys() - held}
    tasks = {
        later[key]: nodes[key].substitute(later, key=later[key])
        if nodes[key].dependencies - held
        else (when_there, nodes[key].substitute({}, key=f"{later[key]} itself"), value.key)
        for key in later
    }
    name = _later(plane.name, value.key)
    literals = f"{name}, held"
    layers = value.dask.layers | {literals: {key: nodes[key] for key in held}, name: tasks}
    needed = {literals: set(), name: {literals, *value.__dask_layers__()}}
    graph = HighLevelGraph(layers, value.dask.dependencies | needed)
    return da.Array(graph, name, plane.chunks, meta=plane._meta)


def _later(key: Any, value_key: Any) -> Any:
    if isinstance(key, tuple):
        return (_later(key[0], value_key), *key[1:])
    return f"{key} after {value_key}"


def when_there(result: Any, _: Any) -> Any:
    """Return the first: a task that waits for the second, too."""
    return result


def placed(tiles: Tiles) -> Iterator[tuple[Tile, tuple[int, int]]]:
    """Return each tile, and its row and column."""
    for row, line in enumerate(tiles):
        for column, tile in enumerate(line):
            yield tile, (row, column)


def cut_together(arrays: dict[str, Any], regions: Iterable[Region]) -> list[dict[str, Any]]:
    """Cut dask arrays, (..., H, W) or with colours, into regions, delayed, that share one graph.

    What several regions need is computed once.

    Parameters
    ----------
    arrays : dict of str to dask.array.Array
        (..., H, W); all with the same number of axes before these.
    regions : iterable of tuple of int and slice
        Numbers of a plane, then rows and columns.

    Returns
    -------
    list of dict of str to dask.delayed.Delayed
        An array each, of each region.
    """
    (together,) = dask.optimize(arrays)
    blocks = {name: array.to_delayed(optimize_graph=False) for name, array in together.items()}
    cut = delayed(_cut_region, pure=True)

    def piece(name: str, region: Region) -> Any:
        *index, rows, columns = region
        lengths = together[name].chunks
        at, inside = zip(*map(_block_of, lengths, index), strict=True) if index else ((), ())
        of_rows, of_columns = lengths[len(index) : len(index) + 2]
        (row_numbers, row_slices), (column_numbers, column_slices) = (
            _covering(of_rows, rows),
            _covering(of_columns, columns),
        )
        found = blocks[name][at].reshape(len(of_rows), len(of_columns))
        nested = [[found[row, column] for column in column_numbers] for row in row_numbers]
        return cut(nested, inside, row_slices, column_slices)

    return [{name: piece(name, region) for name in arrays} for region in regions]


def _block_of(lengths: tuple[int, ...], place: int) -> tuple[int, int]:
    """Return which block of an axis holds a place, and where in it."""
    (number,), (inside,) = _covering(lengths, slice(place, place + 1))
    return number, inside.start


def _cut_region(
    blocks: list[list[NDArray[Any]]],
    plane: tuple[int, ...],
    rows: list[slice],
    columns: list[slice],
) -> NDArray[Any]:
    return cut_out([[block[plane] for block in line] for line in blocks], rows, columns)
