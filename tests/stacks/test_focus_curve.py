import csv

import dask.array as da
import numpy as np
import pytest

from napari_defocus import Cancelled, focus_curve
from napari_defocus.core.writing import UnwritableResult

RADII = np.array([6.0, 3.0, 1.0, 2.0, 5.0])
SWEEP = RADII[:, None, None] * np.ones((8, 10))


def test_planes_up_to_the_threshold_are_in_focus():
    curve = focus_curve(SWEEP)
    np.testing.assert_array_equal(curve.share_in_focus, [0, 0, 1, 1, 0])
    np.testing.assert_array_equal(curve.median_radius, RADII)
    assert curve.median_confidence is None
    assert curve.share_sure is None


def test_share_is_that_of_the_pixels():
    tilted = np.broadcast_to(np.arange(10.0), (3, 8, 10)) + np.array([0, 1, 5])[:, None, None]
    np.testing.assert_allclose(focus_curve(tilted, threshold=4).share_in_focus, [0.5, 0.4, 0])


def test_mask_decides_if_there_is_one():
    masks = np.zeros(SWEEP.shape, np.uint8)
    masks[4, :2] = 1
    curve = focus_curve(SWEEP, in_focus=masks)
    np.testing.assert_allclose(curve.share_in_focus, [0, 0, 0, 0, 0.25])
    np.testing.assert_array_equal(
        curve.share_in_focus, focus_curve(SWEEP, in_focus=masks > 0).share_in_focus
    )
    assert curve.best == (4,)


def test_confidence_is_told_and_pixels_without_any_do_not_count():
    confidence = np.full(SWEEP.shape, 0.9)
    confidence[:, :, 5:] = 0.3
    confidence[2, :6] = 0
    maps = SWEEP.copy()
    maps[2, :6] = 7
    curve = focus_curve(maps, confidence=confidence, min_confidence=0.8)
    np.testing.assert_allclose(curve.share_sure, 0.5)
    np.testing.assert_allclose(curve.median_confidence, 0.6)
    assert curve.share_in_focus[2] == 1
    assert curve.median_radius[2] == 1


def test_sharpest_plane_is_that_of_the_bright_objects_not_of_the_dark_background():
    """As in fluorescence: one pixel in eight is an object, and the ground has chance radii."""
    rng = np.random.default_rng(0)
    distance = np.abs(np.arange(7) - 4)
    maps = 2.4 + 0.5 * rng.random((7, 1, 1)) * np.ones((7, 40, 40))
    maps[3] = 2.0
    maps[:, ::2, ::4] = 2.1 + 0.4 * distance[:, None, None]
    sure = np.full(maps.shape, 0.07)
    sure[:, ::2, ::4] = 0.7
    sure[6, :20:4, ::4] = 0.2
    assert focus_curve(maps).best == (3,)
    curve = focus_curve(maps, confidence=sure)
    np.testing.assert_allclose(curve.median_radius, 2.1 + 0.4 * distance)
    assert curve.best == (4,)
    everywhere = np.ones(maps.shape, bool)
    assert focus_curve(maps, in_focus=everywhere, confidence=sure).best == (4,)
    assert "no confidence" in focus_curve(maps).rests_on
    assert curve.rests_on == "the 9 to 12% of each plane that are sure"


def test_more_that_is_sure_is_not_more_in_focus():
    maps, sure = SWEEP.copy(), np.full(SWEEP.shape, 0.2)
    sure[:, :4] = 0.9
    sure[3, :5] = 0.9
    masks = np.ones(SWEEP.shape, bool)
    assert focus_curve(maps, in_focus=masks, confidence=sure).best == (2,)


def test_what_is_not_known_does_not_count_and_a_plane_of_it_is_nan():
    maps = SWEEP.copy()
    maps[1] = np.nan
    maps[2, 0], maps[3, 0] = np.nan, np.inf
    curve = focus_curve(maps, confidence=np.ones_like(maps))
    for values in (curve.share_in_focus, curve.median_radius, curve.median_confidence):
        assert np.isnan(values).tolist() == [False, True, False, False, False]
    np.testing.assert_array_equal(curve.share_in_focus[2:4], 1)
    assert curve.best == (2,)
    assert focus_curve(SWEEP * np.nan).best is None


def test_of_planes_equally_in_focus_the_least_blurred_is_best():
    assert focus_curve(SWEEP).best == (2,)
    assert focus_curve(SWEEP + 20).best == (2,)


def test_shape_of_the_curve_is_what_comes_before_height_and_width():
    movie = np.stack([SWEEP, SWEEP[::-1] - 0.5])
    curve = focus_curve(movie)
    assert curve.share_in_focus.shape == (2, 5)
    np.testing.assert_array_equal(curve.median_radius[1], RADII[::-1] - 0.5)
    assert curve.best == (1, 2)
    single = focus_curve(SWEEP[2])
    assert single.share_in_focus.shape == ()
    assert single.best == ()


def test_planes_of_a_dask_stack_are_computed_one_at_a_time():
    computed = []

    def plane(block_info):
        computed.append(block_info[None]["chunk-location"][0])
        return np.full((1, 8, 10), RADII[computed[-1]])

    lazy = da.map_blocks(
        plane, chunks=((1,) * 5, (8,), (10,)), dtype=float, meta=np.empty((0, 0, 0))
    )
    seen = []
    curve = focus_curve(lazy, progress=lambda step, done: seen.append(len(computed)))
    assert seen == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(curve.median_radius, RADII)


def test_progress_may_end_it():
    def cancel(step, done):
        raise Cancelled

    with pytest.raises(Cancelled):
        focus_curve(SWEEP, progress=cancel)


def test_table_has_a_row_a_plane_and_leaves_out_what_is_not_known(tmp_path):
    maps = SWEEP.copy()
    maps[1] = np.nan
    file = tmp_path / "curve.csv"
    focus_curve(maps).save(file)
    rows = list(csv.DictReader(file.read_text().splitlines()))
    assert [row["plane"] for row in rows] == ["0", "1", "2", "3", "4"]
    assert [row["median_radius_px"] for row in rows] == ["6", "", "1", "2", "5"]
    assert [row["share_in_focus"] for row in rows] == ["0", "", "1", "1", "0"]
    assert {row["share_sure"] for row in rows} == {""}


def test_table_of_two_axes_says_where_along_both(tmp_path):
    file = tmp_path / "curve.csv"
    focus_curve(np.stack([SWEEP, SWEEP]), confidence=np.full((2, *SWEEP.shape), 0.25)).save(file)
    rows = list(csv.DictReader(file.read_text().splitlines()))
    assert [(row["plane_0"], row["plane_1"]) for row in rows[4:6]] == [("0", "4"), ("1", "0")]
    assert {row["median_confidence"] for row in rows} == {"0.25"}


def test_table_replaces_a_file_only_if_it_is_told_to(tmp_path):
    file = tmp_path / "curve.csv"
    file.write_text("mine")
    curve = focus_curve(SWEEP)
    with pytest.raises(UnwritableResult, match="exists already"):
        curve.save(file)
    assert file.read_text() == "mine"
    curve.save(file, force=True)
    assert file.read_text().startswith("plane,share_in_focus")
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"blur_maps": SWEEP.astype(complex)}, TypeError, "blur_maps has dtype complex128"),
        ({"blur_maps": np.ones(5)}, ValueError, r"blur_maps has shape \(5,\); it takes"),
        ({"blur_maps": SWEEP[:0]}, ValueError, "none of them 0"),
        ({"in_focus": SWEEP[:3]}, ValueError, r"in_focus has shape \(3, 8, 10\)"),
        ({"confidence": SWEEP[0]}, ValueError, r"confidence has shape \(8, 10\)"),
        ({"threshold": -1.0}, ValueError, "threshold is -1.0"),
        ({"threshold": np.nan}, ValueError, "threshold is nan"),
        ({"min_confidence": 1.5}, ValueError, "min_confidence is 1.5"),
    ],
)
def test_what_cannot_be_is_refused_in_words(arguments, error, words):
    with pytest.raises(error, match=words):
        focus_curve(**{"blur_maps": SWEEP, **arguments})


def test_curve_of_which_nothing_is_known_does_not_rest_on_all_pixels():
    maps = np.ones((2, 8, 10))
    for curve in (focus_curve(maps, confidence=0 * maps), focus_curve(maps, within=maps[0] > 1)):
        assert curve.best is None
        assert curve.rests_on == "nothing: no plane is known"
