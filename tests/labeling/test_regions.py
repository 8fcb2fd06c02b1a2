"""Regions in focus: numbered by area, measured, written as a table."""

import csv

import numpy as np
import pytest

from napari_defocus import measure_regions
from napari_defocus.labeling.regions import measure_focus


@pytest.fixture
def mask():
    """Two squares of 400 and 900 px, and a speck of 4 px, of 60 x 80 px."""
    in_focus = np.zeros((60, 80), np.uint8)
    in_focus[5:25, 5:25] = 1
    in_focus[20:50, 40:70] = 1
    in_focus[55:57, 5:7] = 1
    return in_focus


def column(table, name):
    return table.columns[name].tolist()


def test_regions_are_numbered_from_the_largest_on(mask):
    labels, table = measure_regions(mask)
    assert labels.dtype == np.int32
    assert labels[30, 50] == 1
    assert labels[10, 10] == 2
    assert column(table, "index") == [0, 1, 2]
    assert column(table, "part") == ["blurred", "in focus", "in focus"]
    assert column(table, "area_px") == [60 * 80 - 1304, 900, 400]
    assert table.columns["share_percent"][1] == pytest.approx(100 * 900 / 4800)


def test_specks_are_left_out_unless_asked_for(mask):
    labels, table = measure_regions(mask)
    assert labels[55, 5] == 0
    assert sum(column(table, "area_px")) == mask.size - 4, "they are not counted as blurred"
    labels, table = measure_regions(mask, min_area=4)
    assert labels[55, 5] == 3
    assert sum(column(table, "area_px")) == mask.size


def test_regions_say_where_they_are(mask):
    _, table = measure_regions(mask)
    box = [column(table, side)[1] for side in ("top", "left", "bottom", "right")]
    assert box == [20, 40, 50, 70]
    assert (mask[20:50, 40:70] == 1).all()
    assert (column(table, "row")[1], column(table, "column")[1]) == (34.5, 54.5)


def test_pixels_that_touch_at_a_corner_are_one_region():
    mask = np.zeros((20, 20), bool)
    mask[2:8, 2:8] = mask[8:14, 8:14] = True
    labels, table = measure_regions(mask)
    assert labels[13, 13] == labels[2, 2] == 1
    assert len(table) == 2


def test_blur_and_confidence_are_those_of_the_region(mask):
    blur_map = np.where(mask, 1.0, 5.0)
    blur_map[5:25, 5:25] = np.linspace(0, 2, 400).reshape(20, 20)
    confidence = np.full(mask.shape, 0.25)
    confidence[20:35, 40:70] = 0.75
    _, table = measure_regions(mask, blur_map, confidence)
    assert column(table, "blur_median_px") == pytest.approx([5, 1, 1])
    assert column(table, "blur_p5_px") == pytest.approx([5, 1, 0.1])
    assert column(table, "blur_p95_px") == pytest.approx([5, 1, 1.9])
    assert column(table, "confidence_mean") == pytest.approx([0.25, 0.5, 0.25])
    assert column(table, "confident_percent") == pytest.approx([0, 50, 0])


def test_what_the_map_does_not_know_is_not_counted(mask):
    blur_map = np.where(mask, 1.0, 5.0)
    blur_map[30:50, 40:70] = np.nan
    blur_map[5:25, 5:25] = np.nan
    _, table = measure_regions(mask, blur_map)
    np.testing.assert_array_equal(table.columns["blur_median_px"], [5, 1, np.nan])


@pytest.mark.parametrize(("size", "area"), [(0.5, 0.25), ((2.0, 0.5), 1.0)])
def test_areas_have_units_where_pixels_have_a_size(mask, size, area):
    _, table = measure_regions(mask, pixel_size=size, unit="µm")
    assert column(table, "area_um2")[1:] == pytest.approx([900 * area, 400 * area])


@pytest.mark.parametrize(("value", "areas"), [(0, [4800]), (1, [0, 4800])])
def test_all_blurred_and_all_in_focus_are_no_errors(value, areas):
    mask = np.full((60, 80), value, np.uint8)
    labels, table = measure_regions(mask, np.ones(mask.shape), np.ones(mask.shape))
    assert (labels == value).all()
    assert column(table, "area_px") == areas
    assert np.isnan(column(table, "blur_median_px")[0]) == (value == 1)


def test_blurred_and_in_focus_as_a_whole(mask):
    table = measure_focus(mask, np.where(mask, 1.5, 4.0))
    assert column(table, "part") == ["blurred", "in focus"]
    assert column(table, "area_px") == [4800 - 1304, 1304]
    assert column(table, "blur_median_px") == [4.0, 1.5]


def test_flipped_mask_has_the_same_regions_flipped(mask):
    labels, table = measure_regions(mask)
    flipped, same = measure_regions(mask[:, ::-1])
    np.testing.assert_array_equal(flipped[:, ::-1], labels)
    np.testing.assert_allclose(79 - same.columns["column"], table.columns["column"])


def test_table_is_written_as_csv_whole_and_not_over_another(tmp_path, mask):
    _, table = measure_regions(np.ones_like(mask), np.full(mask.shape, 1.25))
    table.save(tmp_path / "regions.csv")
    with (tmp_path / "regions.csv").open(newline="", encoding="utf-8") as file:
        blurred, focused = csv.DictReader(file)
    assert list(focused) == list(table.columns)
    assert (focused["index"], focused["part"], focused["area_px"]) == ("1", "in focus", "4800")
    assert (focused["blur_median_px"], blurred["blur_median_px"]) == ("1.25", "")
    with pytest.raises(OSError, match="it exists already"):
        table.save(tmp_path / "regions.csv")
    table.save(tmp_path / "regions.csv", force=True)
    assert [path.name for path in tmp_path.iterdir()] == ["regions.csv"]


@pytest.mark.parametrize(
    ("arguments", "error", "saying"),
    [
        ((np.ones((4, 4)),), TypeError, "in_focus has dtype float64"),
        ((np.ones((2, 4, 4), int),), ValueError, r"in_focus has shape \(2, 4, 4\)"),
        ((np.ones((4, 4), int), np.ones((4, 5))), ValueError, r"blur_map has shape \(4, 5\)"),
        ((np.ones((4, 4), int), -np.ones((4, 4))), ValueError, "blur_map has values from -1"),
        ((np.ones((4, 4), int), np.full((4, 4), np.inf)), ValueError, "finite scales"),
        ((np.ones((4, 4), int), None, np.full((4, 4), 2)), ValueError, "confidence has values"),
        ((np.ones((4, 4), int), np.full((4, 4), "a")), TypeError, "blur_map has dtype"),
    ],
)
def test_what_cannot_be_measured_is_told(arguments, error, saying):
    with pytest.raises(error, match=saying):
        measure_regions(*arguments)


@pytest.mark.parametrize(
    ("options", "saying"),
    [
        ({"min_area": 0}, "min_area is 0"),
        ({"min_area": 2.5}, "min_area is 2.5"),
        ({"pixel_size": -1.0}, "pixel_size is -1.0"),
        ({"pixel_size": (1.0, 1.0, 1.0)}, "pixel_size is"),
    ],
)
def test_options_that_cannot_be_are_told(options, saying):
    with pytest.raises(ValueError, match=saying):
        measure_regions(np.ones((4, 4), int), **options)
