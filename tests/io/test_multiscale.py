"""Levels of a pyramid keep what counts: means of what is known, masks that do not thin out."""

import numpy as np
import pytest

from napari_defocus.io.multiscale import halve_into, halved, level_shapes


def test_mean_leaves_out_what_is_not_known_and_masks_keep_what_is_thin():
    nan = np.nan
    known = np.array([[1, nan, nan], [3, nan, nan], [5, 7, 9]], np.float32)
    np.testing.assert_array_equal(halved(known), np.float32([[2, nan], [6, 9]]))
    line = np.zeros((6, 6), np.uint8)
    line[3] = 1
    assert halved(line, labels=True)[1].tolist() == [1, 1, 1]
    assert halved(line > 0)[1].all()
    assert halved(np.uint8([[255, 255], [255, 254]])).tolist() == [[255]]
    assert halved(np.float16([[1, 2], [3, 4]])).dtype == np.float16


@pytest.mark.parametrize("dtype", ["bool", "uint8", "int16", "float32"])
@pytest.mark.parametrize("labels", [False, True])
def test_pieces_make_the_same_level_as_the_whole(dtype, labels):
    fine = np.random.default_rng(1).uniform(0, 99, (2, 37, 51)).astype(dtype)
    whole = halved(fine, labels=labels)
    assert whole.shape == (2, 19, 26)
    pieces = np.zeros_like(whole)
    halve_into(fine, pieces, (1, 8, 8), labels=labels)
    np.testing.assert_array_equal(pieces, whole)


def test_pyramid_ends_at_512_px():
    assert level_shapes((512, 512), 0) == [(512, 512)]
    assert level_shapes((2, 1025, 3, 4), 1) == [(2, 1025, 3, 4), (2, 513, 2, 4), (2, 257, 1, 4)]
