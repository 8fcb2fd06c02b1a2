"""Lazy arrays read what is asked for, however it is asked for, and nothing before."""

import numpy as np
import pytest

from napari_defocus.io.lazy_arrays import lazy_array


class Noted:
    """A reader that notes which regions it reads."""

    def __init__(self, values):
        self.values, self.shape, self.dtype = values, values.shape, values.dtype
        self.regions = []

    def __getitem__(self, region):
        assert all(part.step is None for part in region)
        self.regions.append(region)
        return self.values[region]


INDICES = [
    np.s_[1],
    np.s_[-1, 3:9],
    np.s_[:, ::-1],
    np.s_[0, 2:20:5, -4:],
    np.s_[:, 5:5],
    np.s_[...],
]


@pytest.mark.parametrize("index", INDICES, ids=str)
def test_any_index_gives_what_numpy_gives(index):
    values = np.arange(2 * 30 * 20).reshape(2, 30, 20)
    lazy = lazy_array(Noted(values), (1, 12, 20))
    np.testing.assert_array_equal(lazy[index].compute(scheduler="synchronous"), values[index])


def test_blocks_are_read_when_they_are_computed_and_no_others():
    reader = Noted(np.zeros((2, 30, 20)))
    part = lazy_array(reader, (1, 12, 20))[1, 13:20]
    assert reader.regions == []
    part.compute(scheduler="synchronous")
    assert len(reader.regions) == 1
    plane, rows, _ = reader.regions[0]
    assert plane == slice(1, 2)
    assert rows.start >= 12
    assert rows.stop <= 24
