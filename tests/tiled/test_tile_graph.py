"""Graphs of tiles: what is read, how often, and that it is what was asked for."""

import dask
import dask.array as da
import numpy as np
import pytest

from napari_defocus.tiled.tile_graph import after, cut_together

EVENTS = []


def read_block(channels, block_info=None):
    EVENTS.append("read")
    return channels + np.uint8(block_info[0]["chunk-location"][1])


def note(value):
    EVENTS.append("value")
    return value


@pytest.mark.parametrize(
    "arranged",
    [
        lambda stack: stack[0],
        lambda stack: da.stack([stack[0], stack[2]])[1],
        lambda stack: da.moveaxis(stack, 0, -1).rechunk({-1: 3}),
        lambda stack: stack[1].rechunk((20, 20)),
        lambda stack: stack[1] + da.ones((40, 60), chunks=30, dtype=np.uint8),
    ],
)
def test_pixels_are_read_again_after_a_value_and_not_kept(arranged):
    stack = da.zeros((3, 40, 60), chunks=(1, 20, 20), dtype=np.uint8)
    plane = arranged(stack.map_blocks(read_block, dtype=np.uint8))
    EVENTS.clear()
    expected = plane.compute(scheduler="sync")
    once = EVENTS.copy()
    EVENTS.clear()
    later = after(plane, dask.delayed(note)(plane.sum()))
    assert (later.chunks, later.dtype) == (plane.chunks, plane.dtype)
    np.testing.assert_array_equal(later.compute(scheduler="sync"), expected)
    assert [*once, "value", *once] == EVENTS
    EVENTS.clear()


@pytest.mark.parametrize(
    "region",
    [
        np.s_[1, 3:35, 15:55],
        np.s_[0, 20:40, 0:20],
        np.s_[2, 39:40, 59:60],
    ],
)
@pytest.mark.parametrize("colors", [(), (3,)])
def test_regions_across_blocks_are_those_of_the_whole(region, colors):
    shape = (3, 40, 60, *colors)
    values = np.arange(np.prod(shape)).reshape(shape)
    lazy = da.from_array(values, chunks=(2, 20, 17, *colors))
    (piece,) = cut_together({"values": lazy}, [region])
    np.testing.assert_array_equal(piece["values"].compute(), values[region])


def test_what_regions_share_is_computed_once():
    stack = da.zeros((2, 40, 60), chunks=(1, 20, 20), dtype=np.uint8)
    plane = stack.map_blocks(read_block, dtype=np.uint8)
    regions = [(1, slice(top, top + 30), slice(0, 60)) for top in (0, 5, 10)]
    EVENTS.clear()
    dask.compute(cut_together({"values": plane}, regions), scheduler="sync")
    assert EVENTS == ["read"] * 6
    EVENTS.clear()


def test_masked_pixels_are_masked_in_regions():
    def masked_in_the_first(block, block_info=None):
        first = block_info[0]["chunk-location"] == (0, 0)
        return np.ma.masked_less(block, 2) if first else block

    values = np.arange(16.0).reshape(4, 4)
    lazy = da.from_array(values, chunks=2).map_blocks(masked_in_the_first, dtype=float)
    (piece,) = cut_together({"values": lazy}, [np.s_[0:3, 1:4]])
    found = piece["values"].compute()
    np.testing.assert_array_equal(np.ma.getmaskarray(found), values[0:3, 1:4] < 2)
    np.testing.assert_array_equal(found.filled(-1), np.where(values < 2, -1, values)[0:3, 1:4])
