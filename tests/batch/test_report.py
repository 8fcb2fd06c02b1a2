"""The report of a batch: what it shows, what it flags, and that it opens from disk alone."""

import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import PIL.Image
import pytest
from command_line import names_in, run

from napari_defocus import FieldLimits, Settings, UnreadablePicture, measure_batch, write_report
from napari_defocus.batch import planes as batch_planes
from napari_defocus.batch import sources as batch_sources
from napari_defocus.batch.flags import flags_of, judged_rows
from napari_defocus.batch.report import page_of
from napari_defocus.batch.table import BESIDE, COLUMNS
from napari_defocus.batch.thumbnails import radii_in
from napari_defocus.batch.wells import PlateLayout, wells_of
from napari_defocus.core.writing import UnwritableResult
from napari_defocus.settings import MapSettings

QUICK = Settings(map=MapSettings(stride=8))


class Page(HTMLParser):
    """What is on a page: elements with their attributes, and the text."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.text = [], ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_data(self, text):
        self.text += text

    def of(self, wanted, **having):
        return [
            attributes
            for tag, attributes in self.elements
            if tag == wanted and having.items() <= attributes.items()
        ]

    def fields(self):
        """The rows of the fields, as they follow each other."""
        return [row for row in self.of("tr") if row.get("id", "").startswith("field-")]


def save(path, picture):
    path.parent.mkdir(exist_ok=True)
    PIL.Image.fromarray(np.rint(255 * picture.clip(0, 1)).astype(np.uint8)).save(path)


def rows_in(folder):
    lines = (folder / "table.jsonl").read_text("utf-8").splitlines()
    return {row["source"].rpartition("/")[2]: row for row in map(json.loads, lines)}


@pytest.fixture(scope="module")
def measured(tmp_path_factory, grass, gravel, defocused):
    """A plate of which one well is sharp, and one of each: blurred, empty, damaged."""
    fields = tmp_path_factory.mktemp("plate") / "fields"
    save(fields / "A01_s1.png", grass[:128, :128])
    save(fields / "A02_s1.png", defocused(gravel[:128, :128], 4.0))
    save(fields / "B12_s1.png", np.random.default_rng(0).normal(0.3, 0.01, (128, 128)))
    (fields / "H12_s1.png").write_bytes(b"nothing")
    measure_batch(fields, fields.with_name("measured"), settings=QUICK)
    return fields.with_name("measured")


@pytest.fixture(scope="module")
def page(measured):
    return Page((measured / "report.html").read_text("utf-8"))


def test_fields_are_worst_first_and_say_why(measured, page):
    wells = [field["data-well"] for field in page.fields()]
    assert wells == ["H12", "A02", "B12", "A01"]
    flags = {name[:3]: row["flags"] for name, row in rows_in(measured).items()}
    assert flags == {"A01": None, "A02": "out of focus", "B12": "empty", "H12": "failed"}
    assert "the median blur is 4." in page.text
    assert "nothing stands out from the noise" in page.text
    assert "H12_s1.png: it" in page.text, "why it could not be read"


def test_page_needs_nothing_but_the_files_beside_it(measured, page):
    paths = [each["src"] for each in page.of("img")]
    paths += [each["href"] for each in page.of("a") if not each["href"].startswith("#")]
    assert len(page.of("img")) == 3 * 4
    for path in paths:
        assert (measured / unquote(path)).exists(), path
    assert "//" not in "".join(paths)
    assert not page.of("link")
    assert not [each for each in page.of("script") if "src" in each]
    text = (measured / "report.html").read_text("utf-8")
    assert "http" not in text.replace("http-equiv", "")
    assert "url(" not in text


def test_page_is_for_everybody(page):
    assert all("alt" in image for image in page.of("img"))
    assert len(page.of("th", scope="col")) == 3 + 12 + 7
    assert page.of("html", lang="en")
    assert all("aria-label" in image for image in page.of("svg", role="img"))
    # Not by colour alone: the cell has the flag's letter, and says it in words.
    (well,) = page.of("a", **{"data-well": "A02"})
    assert well["aria-label"] == well["title"]
    assert re.fullmatch(r"A02: 1 field, blur 4\.\d px, out of focus", well["title"])
    assert re.search(r"4\.\dO", page.text)


def test_wells_lead_to_their_fields(page):
    fields = {field["id"]: field["data-well"] for field in page.fields()}
    wells = [each for each in page.of("a") if "data-well" in each]
    assert len(wells) == 4
    assert all(fields[each["href"].removeprefix("#")] == each["data-well"] for each in wells)
    assert "Plate of 96 wells" in page.text


def test_thumbnails_are_small_and_have_the_blur(measured):
    files = names_in(measured / "thumbnails")
    assert files[:4] == [
        *("A01_s1-blur.png", "A01_s1-detail.jpg", "A01_s1-outline.png", "A01_s1.jpg")
    ]
    assert all((measured / "thumbnails" / name).stat().st_size < 20_000 for name in files)
    radii = radii_in((measured / "thumbnails" / "A02_s1-blur.png").read_bytes())
    assert radii.shape == (128, 128)
    assert np.nanmedian(radii) == pytest.approx(4.0, abs=0.3)


def test_thumbnails_are_not_taken_for_pictures(measured, tmp_path):
    with pytest.raises(UnreadablePicture, match=r"no picture matches .*4 results"):
        measure_batch(measured / "thumbnails" / "A02*", tmp_path / "out")
    with pytest.raises(UnreadablePicture, match="it is not a picture"):
        measure_batch(measured / "thumbnails" / "A02_s1.jpg", tmp_path / "out")


def test_other_limits_need_no_measurement(measured, tmp_path, monkeypatch):
    monkeypatch.setattr(batch_planes, "measure_map", pytest.fail)
    before = (measured / "report.html").read_bytes()
    outline = measured / "thumbnails" / "A02_s1-outline.png"
    none_in_focus = outline.read_bytes()
    report = write_report(measured, limits=FieldLimits(in_focus_up_to=5.0))
    assert (report.planes, report.flagged, report.failed) == (4, 2, 1)
    assert report.flags == {"failed": 1, "empty": 1}
    row = rows_in(measured)["A02_s1.png"]
    assert (row["flags"], row["share_within_limit"]) == (None, pytest.approx(1.0, abs=0.02))
    assert b"blurred by at most\n5 px" in (measured / "report.html").read_bytes().replace(
        b" 5", b"\n5"
    )
    assert outline.read_bytes() != none_in_focus
    write_report(measured)
    assert (measured / "report.html").read_bytes() == before
    assert outline.read_bytes() == none_in_focus


def test_terminal_writes_the_report_anew_and_names_limits_as_they_are_typed(measured):
    result = run("report", measured, "--in-focus-up-to", 5, "--min-share-known", 0)
    assert result.exit_code == 0, result.output
    # Noise is still told.
    assert result.stdout.startswith("flagged      2 of 4: 1 failed, 1 empty\n")
    result = run("report", measured, "--min-share-known", 2)
    assert (result.exit_code, result.stdout) == (2, "")
    assert "--min-share-known is 2" in result.stderr
    write_report(measured)


def test_report_is_of_a_batch(tmp_path):
    with pytest.raises(UnreadablePicture, match="no batch has written there"):
        write_report(tmp_path)
    with pytest.raises(TypeError, match="limits is 2"):
        write_report(tmp_path, limits=2)
    (tmp_path / ".batch").mkdir()
    (tmp_path / "table.jsonl").write_text('{"source": "a.png"}\n')
    with pytest.raises(UnreadablePicture, match="an early version wrote it"):
        write_report(tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_without_a_report_there_are_flags_and_no_thumbnails(measured, tmp_path):
    save(
        tmp_path / "blurred.png",
        np.asarray(PIL.Image.open(measured.with_name("fields") / "A02_s1.png")) / 255,
    )
    report = measure_batch(tmp_path / "blurred.png", tmp_path / "out", settings=QUICK, report=False)
    assert (report.report, report.flagged) == (None, 1)
    assert names_in(tmp_path / "out") == [".batch", "maps", "table.csv", "table.jsonl"]
    page = Page(write_report(tmp_path / "out").report.read_text("utf-8"))
    assert not page.of("img")
    assert "no thumbnail" in page.text
    assert not page.of("table", **{"class": "plate"}), "no name says a well"


def row_of(**facts):
    known = dict.fromkeys((*COLUMNS, *BESIDE)) | {"status": "done", "source": "a.png"}
    return known | {"width": 9, "height": 9, "share_sure": 0.9, "link": "../a.png"} | facts


def names_of(row, **limits):
    return [flag.name for flag in flags_of(row_of(**row), FieldLimits(**limits))]


def counts(*radii):
    return [sum(radius == bin_ for radius in radii) for bin_ in range(64)]


@pytest.mark.parametrize(
    ("row", "limits", "flags"),
    [
        ({"median_known_radius_px": 1.4}, {}, []),
        ({"median_known_radius_px": 1.6}, {}, ["out of focus"]),
        ({"median_known_radius_px": 1.6}, {"in_focus_up_to": 2.0}, []),
        # The first bins are below 1.5 px, the last ones above.
        ({"median_known_radius_px": 1, "blur_histogram": counts(9, 9, 9, 60)}, {}, []),
        (
            {"median_known_radius_px": 1, "blur_histogram": counts(9, 9, 60)},
            {},
            ["partly out of focus"],
        ),
        ({"share_sure": 0.01, "median_known_radius_px": 9.0}, {}, ["empty"]),
        ({"share_sure": None}, {}, ["empty"]),
        ({"share_sure": 0.01}, {"min_share_known": 0}, []),
        ({"one_direction": 0.97, "median_known_radius_px": 9.0}, {}, ["not defocus"]),
        ({"one_direction": 0.97}, {"max_one_direction": 1}, []),
        (
            {"share_saturated": 0.2, "median_known_radius_px": 9.0},
            {},
            [*("out of focus", "saturated")],
        ),
        ({"status": "failed", "error": "it is cut off"}, {}, ["failed"]),
    ],
)
def test_flags_follow_limits_and_what_says_little_is_not_called_blurred(row, limits, flags):
    assert names_of(row, **limits) == flags


@pytest.mark.parametrize(
    ("limits", "saying"),
    [
        ({"in_focus_up_to": 0}, "in_focus_up_to is 0"),
        ({"in_focus_up_to": "wide"}, "in_focus_up_to is 'wide'"),
        ({"min_share_in_focus": 75}, "min_share_in_focus is 75"),
        ({"max_share_saturated": -0.1}, "max_share_saturated is -0.1"),
        ({"max_one_direction": float("nan")}, "max_one_direction is nan"),
    ],
)
def test_impossible_limits_are_refused(limits, saying):
    with pytest.raises((TypeError, ValueError), match=saying):
        FieldLimits(**limits)


@pytest.mark.parametrize(
    ("names", "wells"),
    [
        (["A1.tif", "A12.tif"], ["A01", "A12"]),
        (["x_a01_c1.tif", "x_a02_c1.tif"], ["A01", "A02"]),
        (["P01_A01_F01.tif", "P01_A02_F01.tif", "P01_A03_F02.tif"], ["A01", "A02", "A03"]),
        (["r01c01f01p01-ch1.tiff", "r16c24f09p01-ch1.tiff"], ["A01", "P24"]),
        (["A01/field1.ome.tif", "A02/field1.ome.tif"], ["A01", "A02"]),
        (["Q01.tif", "A25.tif"], []),
        (["a7_0001.jpg", "a7_0002.jpg"], []),
        (["IMG_1.jpg", "A01.jpg"], []),
        (["B03_F1.tif", "B03_F2.tif", "B03_F3.tif", "C04_F1.tif"], ["B03", "B03", "B03", "C04"]),
        (["B03_F01.tif", "B03_F02.tif", "B03_F03.tif", "B04_F01.tif"], ["B03"] * 3 + ["B04"]),
        (["A1/f1.tif", "A1/f2.tif", "B1/f1.tif"], ["A01", "A01", "B01"]),
        (["r03c03f01.tiff", "r03c04f01.tiff"], ["C03", "C04"]),
        (["C01.tif", "C02.tif"], ["C01", "C02"]),
        (["img_c1.png", "img_c2.png"], []),
        (["C1-cells.tif", "C2-cells.tif"], []),
    ],
)
def test_wells_are_read_from_names(names, wells):
    assert list(wells_of(names).values()) == wells


def test_each_of_several_plates_has_wells_of_its_own():
    radii = {"p1/A01.tif": 1.0, "p1/A02.tif": 1.0, "p2/A01.tif": 5.0, "p2/A02.tif": 1.0}
    rows = [
        row_of(source=source, link=source, median_known_radius_px=radius, share_sure=0.9)
        for source, radius in radii.items()
    ]
    page = Page(page_of(judged_rows(rows, FieldLimits()), FieldLimits(), {}))
    told = [well["title"] for well in page.of("a", **{"data-well": "A01"})]
    assert told == [
        "A01: 1 field, blur 1.0 px, no flag",
        "A01: 1 field, blur 5.0 px, out of focus",
    ]
    assert "p1: plate of 96 wells" in page.text
    assert "p2 A01" in page.text


def test_plate_is_as_small_as_its_wells_allow():
    assert PlateLayout.of(["A01", "H12"]).rows == "ABCDEFGH"
    assert PlateLayout.of(["A01", "A13"]).rows[-1] == "P"


def test_report_beside_the_pictures_has_the_name_of_their_folder():
    page = page_of([row_of(flags=None)], FieldLimits(), {}, Path("holiday", "measured"))
    assert "Focus of 1 field: holiday" in page


def test_names_cannot_break_the_page():
    row = row_of(source='x/<script>alert("1")</script>&.png', status="failed", error="<b>no</b>")
    row |= {"link": "../x/#1 50%.png", "flags": "failed"}
    page = Page(page_of([row], FieldLimits(), {}))
    assert len(page.of("script")) == 1
    assert not page.of("b", id="no")
    assert '<script>alert("1")</script>&.png' not in page.text
    assert page.of("a", href="../x/%231%2050%25.png")


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere, all names are Unicode")
def test_names_that_are_no_unicode_are_measured_and_shown(tmp_path, grass):
    name = b"\xdcbung.png".decode("utf-8", "surrogateescape")
    (tmp_path / "old").mkdir()
    save(tmp_path / "plain.png", grass[:64, :64])
    (tmp_path / "plain.png").rename(tmp_path / "old" / name)
    found = measure_batch(tmp_path / "old", tmp_path / "out", settings=QUICK)
    assert not found.failed
    assert list(rows_in(tmp_path / "out")) == [name]
    page = Page((tmp_path / "out" / "report.html").read_text("utf-8"))
    assert page.of("a", href="../old/%DCbung.png")


@pytest.fixture
def halves(tmp_path, grass, defocused):
    """A picture that is sharp at the left, and masks of its halves."""
    sharp = grass[:128, :160]
    radii = np.where(np.arange(160) < 80, 0.0, 4.0) * np.ones((128, 1))
    save(tmp_path / "fields" / "a.png", defocused(sharp, radii))
    right = (np.arange(160) >= 90) * np.ones((128, 1))
    save(tmp_path / "masks" / "a-mask.png", right / 255 * 7)
    return tmp_path


def test_only_what_masks_mark_counts(halves):
    fields, out = halves / "fields", halves / "out"
    measure_batch(fields, out, settings=QUICK, mask=True, within=halves / "masks")
    row = rows_in(out)["a.png"]
    assert row["flags"] == "out of focus"
    assert row["p5_radius_px"] > 3
    assert row["share_in_focus"] == row["share_within_limit"] == row["share_in_mask"] == 0
    assert not np.asarray(PIL.Image.open(out / row["mask"]))[:, :90].any()
    assert np.isnan(radii_in((out / "thumbnails" / "a-blur.png").read_bytes())[:, :90]).all()
    measure_batch(fields, halves / "all", settings=QUICK)
    assert rows_in(halves / "all")["a.png"]["p5_radius_px"] < 1
    PIL.Image.fromarray(np.ones((128, 160), np.uint8)).save(halves / "masks" / "a-mask.png")
    with pytest.raises(UnwritableResult, match="inputs have changed"):
        measure_batch(fields, out, settings=QUICK, mask=True, within=halves / "masks")


def test_mask_that_marks_nothing_makes_a_field_empty(halves):
    PIL.Image.fromarray(np.zeros((128, 160), np.uint8)).save(halves / "none.png")
    measure_batch(
        halves / "fields", halves / "out", settings=QUICK, mask=True, within=halves / "none.png"
    )
    row = rows_in(halves / "out")["a.png"]
    assert (row["flags"], row["median_radius_px"]) == ("empty", None)
    assert "The mask marks nothing" in row["careful"]


def test_missing_and_ambiguous_masks_are_told_before_the_work(halves):
    fields, masks, out = halves / "fields", halves / "masks", halves / "out"
    for name in ("b", "c"):
        save(fields / f"{name}.png", np.full((60, 60), 0.5))
    with pytest.raises(UnreadablePicture, match=r"no mask for b.png and 1 others"):
        measure_batch(fields, out, within=masks)
    with pytest.raises(UnreadablePicture, match="no such file or folder"):
        measure_batch(fields, out, within=halves / "nowhere")
    (masks / "a.png").write_bytes((masks / "a-mask.png").read_bytes())
    with pytest.raises(UnreadablePicture, match=r"a.png has a.png and a-mask.png"):
        measure_batch(fields / "a.png", out, within=masks)
    (masks / "a.png").unlink()
    save(halves / "more" / "a.png", np.full((60, 60), 0.5))
    with pytest.raises(UnreadablePicture, match=r"it is the mask of .* and of"):
        measure_batch([fields / "a.png", halves / "more"], out, within=masks)
    assert not out.exists()
    result = run("batch", fields, "-o", out, "--within", masks)
    assert (result.exit_code, "no mask for b.png" in result.stderr) == (2, True)


def test_mask_of_another_size_is_the_fault_of_its_picture_alone(halves):
    save(halves / "small.png", np.ones((60, 60)))
    measure_batch(halves / "fields", halves / "out", settings=QUICK, within=halves / "small.png")
    error = rows_in(halves / "out")["a.png"]["error"]
    assert "has 60 x 60 px; it takes one number for each of the 160 x 128 px" in error


def test_large_picture_has_the_thumbnail_and_the_shares_of_a_small_one(halves, monkeypatch):
    fields, wanted = halves / "fields", {"settings": QUICK, "within": halves / "masks"}
    measure_batch(fields, halves / "whole", **wanted)
    monkeypatch.setattr(batch_sources, "LARGEST_AT_ONCE", 1000)
    measure_batch(fields, halves / "parts", block_size=256, **wanted)
    (whole, parts) = (halves / name for name in ("whole", "parts"))
    for name in ("share_sure", "share_within_limit", "share_saturated", "median_known_radius_px"):
        expected = rows_in(whole)["a.png"][name]
        assert rows_in(parts)["a.png"][name] == pytest.approx(expected, abs=0.05), name
    radii = [radii_in((each / "thumbnails" / "a-blur.png").read_bytes()) for each in (whole, parts)]
    np.testing.assert_allclose(*radii, atol=0.3)
    seen = [
        np.asarray(PIL.Image.open(each / "thumbnails" / "a.jpg"), float) for each in (whole, parts)
    ]
    assert np.abs(seen[0] - seen[1]).mean() < 2
