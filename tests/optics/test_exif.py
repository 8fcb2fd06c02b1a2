"""What cameras note about the lens of a photograph."""

import math

import numpy as np
import pytest
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from napari_defocus import ThinLens, depth_from_blur
from napari_defocus.optics.exif import FROM_35_MM, FROM_FOCAL_PLANE, noted_lens

PORTRAIT = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=5)

ORIENTATION = 274


@pytest.fixture
def photograph(tmp_path):
    """Write a photograph of a size (width, height) with EXIF tags, and return its path."""

    def write(size=(600, 400), name="photograph.jpg", orientation=None, **tags):
        exif = Image.Exif()
        if orientation is not None:
            exif[ORIENTATION] = orientation
        exif.get_ifd(ExifTags.IFD.Exif).update({ExifTags.Base[tag]: tags[tag] for tag in tags})
        Image.new("L", size).save(tmp_path / name, exif=exif.tobytes())
        return tmp_path / name

    return write


# A sensor 24 mm wide with 600 photosites: 40 um.
NOTED = {
    "FocalLength": IFDRational(35, 1),
    "FNumber": IFDRational(28, 10),
    "SubjectDistance": IFDRational(25, 10),
    "FocalPlaneXResolution": IFDRational(250, 1),
    "FocalPlaneResolutionUnit": 3,
    "ExifImageWidth": 600,
    "ExifImageHeight": 400,
}


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.webp"])
def test_lens_is_read_from_a_photograph(photograph, name):
    assert ThinLens.from_exif(photograph(name=name, **NOTED)) == ThinLens(
        focal_length_mm=35, f_number=2.8, focus_distance_m=2.5, pixel_pitch_um=40
    )


def test_lens_is_read_from_a_picture_of_a_phone(photograph, tmp_path):
    pillow_heif = pytest.importorskip("pillow_heif")
    exif = Image.open(photograph(**NOTED)).getexif().tobytes()
    path = tmp_path / "photograph.heic"
    pillow_heif.from_pillow(Image.new("RGB", (600, 400))).save(path, exif=exif)
    assert ThinLens.from_exif(path) == ThinLens.from_exif(photograph(**NOTED))


def test_what_is_given_wins(photograph):
    given = {**vars(PORTRAIT)}
    assert ThinLens.from_exif(photograph(**NOTED), **given) == PORTRAIT
    assert ThinLens.from_exif(photograph(), **given) == PORTRAIT
    assert ThinLens.from_exif(photograph(**NOTED), f_number=8).f_number == 8


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("noted", [(600, 400), (400, 600)])
def test_scaled_down_picture_has_a_larger_pitch_whichever_way_up(photograph, orientation, noted):
    width, height = noted
    tags = {**NOTED, "ExifImageWidth": width, "ExifImageHeight": height}
    full = photograph(**tags, orientation=orientation)
    assert ThinLens.from_exif(full).pixel_pitch_um == pytest.approx(40)
    small = photograph((150, 100), **tags, orientation=orientation)
    assert ThinLens.from_exif(small).pixel_pitch_um == pytest.approx(160)
    # Whoever turned the pixels themselves may have left the size as it was.
    turned = photograph((100, 150), **tags)
    assert ThinLens.from_exif(turned).pixel_pitch_um == pytest.approx(160)


@pytest.mark.parametrize("size", [(400, 600), (600, 400), [600, 400], np.array([400, 600])])
def test_pitch_is_that_of_the_analysed_size(photograph, size):
    file = photograph((1200, 800), **{**NOTED, "ExifImageWidth": 1200, "ExifImageHeight": 800})
    assert ThinLens.from_exif(file, image_size=tuple(size)).pixel_pitch_um == pytest.approx(80)
    del (no_size := dict(NOTED))["ExifImageWidth"]
    file = photograph((1200, 800), **no_size)
    assert ThinLens.from_exif(file, image_size=tuple(size)).pixel_pitch_um == pytest.approx(80)


def test_scaled_picture_gives_the_same_distances_as_the_full_one(photograph):
    full = ThinLens.from_exif(photograph(**NOTED))
    half = ThinLens.from_exif(photograph((300, 200), **NOTED))
    np.testing.assert_allclose(depth_from_blur(2.0, full), depth_from_blur(1.0, half))


@pytest.mark.parametrize(
    ("unit", "per_unit"), [(2, 635), (3, 250), (4, 25), (5, IFDRational(25, 1000)), (None, 635)]
)
def test_units_of_the_focal_plane(photograph, unit, per_unit):
    tags = {**NOTED, "FocalPlaneXResolution": per_unit, "FocalPlaneResolutionUnit": unit}
    if unit is None:
        del tags["FocalPlaneResolutionUnit"]
    assert ThinLens.from_exif(photograph(**tags)).pixel_pitch_um == pytest.approx(40)


def test_where_a_pitch_comes_from_is_known(photograph):
    focal_plane = photograph(name="a.jpg", **NOTED, FocalLengthIn35mmFilm=70)
    film = photograph(name="b.jpg", FocalLength=IFDRational(35, 1), FocalLengthIn35mmFilm=70)
    assert noted_lens(focal_plane).pitch_from == FROM_FOCAL_PLANE
    assert noted_lens(film).pitch_from == FROM_35_MM
    assert noted_lens(photograph(name="c.jpg")).pitch_from is None


@pytest.mark.parametrize("size", [(600, 400), (300, 200), (400, 600)])
def test_pitch_from_the_focal_length_on_35_mm_film(photograph, size):
    # 35 mm on a sensor that makes it 70: half as large as film, 18 x 12 mm.
    file = photograph(size, FocalLength=IFDRational(35, 1), FocalLengthIn35mmFilm=70)
    lens = ThinLens.from_exif(file, f_number=2, focus_distance_m=3)
    assert lens.pixel_pitch_um == pytest.approx(18000 / max(size), rel=1e-3)


def test_focal_length_that_is_given_makes_up_for_a_missing_one(photograph):
    file = photograph(FocalLengthIn35mmFilm=70)
    lens = ThinLens.from_exif(file, focal_length_mm=35, f_number=2, focus_distance_m=3)
    assert lens.pixel_pitch_um == pytest.approx(30, rel=1e-3)


def test_picture_of_another_shape_was_cropped_and_has_no_pitch(photograph):
    for extra in ({}, {"FocalLengthIn35mmFilm": 70}):
        with pytest.raises(ValueError, match="does not note pixel_pitch_um;"):
            ThinLens.from_exif(photograph((400, 400), **NOTED, **extra))
    # Rounded sides are no crop.
    assert ThinLens.from_exif(photograph((100, 67), **NOTED)).pixel_pitch_um == pytest.approx(240)


def test_aperture_value_stands_in_for_the_f_number(photograph):
    tags = {**NOTED, "FNumber": IFDRational(0, 1), "ApertureValue": IFDRational(6, 1)}
    assert ThinLens.from_exif(photograph(**tags)).f_number == pytest.approx(8)


def test_distance_to_infinity_is_read(photograph):
    tags = {**NOTED, "SubjectDistance": IFDRational(0xFFFFFFFF, 1)}
    assert ThinLens.from_exif(photograph(**tags)).focus_distance_m == math.inf


def test_values_that_make_no_lens_are_said_to_be_those_of_the_photograph(photograph):
    file = photograph(**{**NOTED, "FocalLength": IFDRational(5000, 1)})
    with pytest.raises(ValueError, match=r"above the focal length, 5 m .*notes focal_length_mm"):
        ThinLens.from_exif(file, focus_distance_m=2.0)


def test_all_that_is_missing_is_named_in_one_line(photograph):
    file = photograph()
    with pytest.raises(ValueError, match="does not note") as caught:
        ThinLens.from_exif(file)
    assert str(caught.value) == (
        f"the EXIF of {file} does not note focal_length_mm, f_number, focus_distance_m and "
        "pixel_pitch_um; give what is missing. Pixel pitch in um = 1000 x sensor width in mm / "
        "picture width in px, if nothing was cropped; for 600 px that is 60 with 36 mm "
        "(full frame), 39.2 with 23.5 mm (APS-C), 28.8 with 17.3 mm (Four Thirds), "
        "12.5 with 7.5 mm (a phone's)"
    )
    with pytest.raises(ValueError, match="does not note focus_distance_m; give"):
        ThinLens.from_exif(photograph(**{**NOTED, "SubjectDistance": IFDRational(0, 1)}))


@pytest.mark.parametrize(
    ("tag", "value", "missing"),
    [
        ("FocalLength", IFDRational(35, 0), "focal_length_mm"),
        ("FocalLength", IFDRational(0, 0), "focal_length_mm"),
        ("FNumber", IFDRational(0, 1), "f_number"),
        ("SubjectDistance", IFDRational(0, 1), "focus_distance_m"),
        ("SubjectDistance", IFDRational(1, 0), "focus_distance_m"),
        ("FocalPlaneXResolution", IFDRational(1, 0), "pixel_pitch_um"),
        ("FocalPlaneResolutionUnit", 1, "pixel_pitch_um"),
        ("FocalPlaneResolutionUnit", 77, "pixel_pitch_um"),
    ],
)
def test_malformed_values_are_missing(photograph, tag, value, missing):
    with pytest.raises(ValueError, match=f"does not note {missing}; give"):
        ThinLens.from_exif(photograph(**{**NOTED, tag: value}))


@pytest.mark.parametrize("value", ["f/2.8", b"\0\1", (2.8, 4.0), float("nan"), None])
def test_values_of_other_types_are_missing(photograph, monkeypatch, value):
    file = photograph(**NOTED)
    exif = {ExifTags.Base[tag]: NOTED[tag] for tag in NOTED}
    for tag in ("FNumber", "FocalPlaneResolutionUnit", "SubjectDistance", "ExifImageWidth"):
        exif[ExifTags.Base[tag]] = value
    exif[ExifTags.Base.ApertureValue] = IFDRational(0xFFFFFFFF, 1)
    monkeypatch.setattr(Image.Exif, "get_ifd", lambda *_: exif)
    with pytest.raises(ValueError, match="note f_number, focus_distance_m and pixel_pitch_um;"):
        ThinLens.from_exif(file)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    "exif", [b"", b"garbage", b"Exif\0\0II*\0\xff\xff\xff\xff", b"Exif\0\0MM\0*\0\0\0\x08\0\7\x87"]
)
def test_damaged_exif_is_missing(tmp_path, exif):
    file = tmp_path / "damaged.jpg"
    Image.new("L", (6, 4)).save(file, exif=exif)
    with pytest.raises(ValueError, match="does not note focal_length_mm, f_number,"):
        ThinLens.from_exif(file)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda path: None, "there is no such file"),
        (lambda path: path.mkdir(), "it is a folder"),
        (lambda path: path.write_text("no picture"), "no EXIF is read from this kind of file"),
        (lambda path: path.write_bytes(b""), "no EXIF is read from this kind of file"),
    ],
)
def test_unreadable_file_is_a_value_error_with_the_reason(tmp_path, make, reason):
    path = tmp_path / "picture.jpg"
    make(path)
    with pytest.raises(ValueError, match=f"^cannot read .*picture.jpg: {reason}"):
        ThinLens.from_exif(path)


@pytest.mark.parametrize(
    ("size", "error"),
    [
        (600, TypeError),
        ((600,), TypeError),
        ((600.0, 400), TypeError),
        ((1, 2, 3), TypeError),
        ((0, 4), ValueError),
    ],
)
def test_impossible_size_is_an_error(photograph, size, error):
    with pytest.raises(error, match=r"image_size is .*; it takes two whole numbers from 1 up"):
        ThinLens.from_exif(photograph(**NOTED), image_size=size)
