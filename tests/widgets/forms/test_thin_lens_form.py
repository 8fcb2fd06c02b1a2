import math
import re

import PIL.Image
import pytest

from napari_defocus import ThinLens
from napari_defocus.widgets.forms.thin_lens_form import ThinLensForm

pytestmark = pytest.mark.display

F_NUMBER, FOCAL_LENGTH, SUBJECT_DISTANCE = 0x829D, 0x920A, 0x9206
IN_35_MM, X_RESOLUTION, RESOLUTION_UNIT = 0xA405, 0xA20E, 0xA210


@pytest.fixture
def form(qapp):
    return ThinLensForm()


@pytest.fixture
def photograph(tmp_path):
    def save(noted, size=(600, 400)):
        exif = PIL.Image.Exif()
        exif.get_ifd(0x8769).update(noted)
        file = tmp_path / "photograph.jpg"
        PIL.Image.new("L", size).save(file, exif=exif)
        return file

    return save


def fill(form, *texts):
    fields = form.focal_length, form.f_number, form.focus_distance, form.pixel_pitch
    for field, text in zip(fields, texts, strict=True):
        field.value = text


def texts(form):
    return [
        field.value
        for field in (form.focal_length, form.f_number, form.focus_distance, form.pixel_pitch)
    ]


@pytest.mark.parametrize("far", ["inf", "Infinity", "∞"])
def test_fields_make_a_lens(form, far):
    fill(form, "50", " 2.8", "1.5", "4.3")
    assert form.lens() == ThinLens(
        focal_length_mm=50, f_number=2.8, focus_distance_m=1.5, pixel_pitch_um=4.3
    )
    form.focus_distance.value = far
    assert form.lens().focus_distance_m == math.inf


def test_every_field_explains_itself(form):
    assert all(len(field.tooltip) > 40 for field in form.fields())


def test_nothing_is_made_up(form):
    assert texts(form) == [""] * 4
    with pytest.raises(ValueError, match="focal length, f-number, focus distance and pixel pitch"):
        form.lens()
    fill(form, "50", "2", "1", "")
    rule = "Pixel pitch in µm = 1000 x sensor width in mm / picture width in px"
    with pytest.raises(ValueError, match=rule):
        form.lens()
    with pytest.raises(ValueError, match=r"for 900 px that is 40 with 36 mm \(full frame\)"):
        form.lens((600, 900))
    fill(form, "50", "2", "", "4")
    with pytest.raises(ValueError, match="Fill in the focus distance of the lens"):
        form.lens()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("f/2", "2", "1", "4"), "The focal length is “f/2”. Type a number above 0 in mm"),
        (("50", "-2", "1", "4"), "The f-number is “-2”. Type a number above 0, such as 2.8."),
        (("50", "2", "1 m", "4"), "The focus distance is “1 m”. Type a number above 0 in m, such"),
        (("50", "2", "1", "inf"), "The pixel pitch is “inf”. Type a number above 0 in µm"),
        (("50", "2", "0.05", "4"), "0.05 m, which is not beyond the focal length, 0.05 m"),
    ],
)
def test_what_cannot_be_is_said_in_plain_words(form, given, said):
    fill(form, *given)
    with pytest.raises(ValueError, match=re.escape(said)):
        form.lens()


def test_photograph_fills_in_what_it_notes(form, photograph):
    fill(form, "", "", "3", "")
    form.file.value = photograph({F_NUMBER: 2.8, FOCAL_LENGTH: 35.0, IN_35_MM: 52})
    said = form.read(None)
    assert texts(form)[:3] == ["35", "2.8", "3"], "what it lacks stays as it was"
    assert form.lens().pixel_pitch_um == pytest.approx(40.4, abs=0.05)
    assert said.splitlines() == [
        "photograph.jpg notes focal length, f-number and pixel pitch.",
        "The pixel pitch is worked out from its focal length on 35 mm film, which is rounded.",
        "Not noted: focus distance. Please fill in.",
    ]


def test_pitch_is_that_of_the_picture_that_is_analysed(form, photograph):
    form.file.value = photograph({FOCAL_LENGTH: 35.0, IN_35_MM: 52})
    form.read((200, 300))
    assert float(form.pixel_pitch.value) == pytest.approx(80.8, abs=0.1)
    form.pixel_pitch.value = ""
    assert "pixel pitch. Please" in form.read((200, 200)), "it was cropped"


def test_focus_at_infinity_is_noted(form, photograph):
    infinity = PIL.TiffImagePlugin.IFDRational(0xFFFFFFFF, 1)
    form.file.value = photograph({SUBJECT_DISTANCE: infinity})
    form.read(None)
    assert form.focus_distance.value == "inf"


def test_pitch_of_the_photosites_needs_no_focal_length(form, photograph):
    form.file.value = photograph({X_RESOLUTION: 2000.0, RESOLUTION_UNIT: 3})
    form.read(None)
    assert texts(form) == ["", "", "", "5"]
    form.file.value = photograph({X_RESOLUTION: 2000.0, RESOLUTION_UNIT: 3})
    assert "The pixel pitch is from the resolution of its focal plane." in form.read(None)
    form.file.value = photograph({IN_35_MM: 52})
    form.pixel_pitch.value = ""
    form.read(None)
    assert form.pixel_pitch.value == "", "it would follow from the focal length"
    form.focal_length.value = "35"
    form.read(None)
    assert float(form.pixel_pitch.value) == pytest.approx(40.4, abs=0.05)


def test_photograph_that_notes_nothing_is_said_so(form, photograph):
    form.file.value = photograph({})
    said = form.read(None)
    assert said.startswith("photograph.jpg notes nothing.")
    assert "for 600 px that is 60 with 36 mm (full frame)" in said


def test_file_that_is_missing_is_said_in_plain_words(form, tmp_path):
    with pytest.raises(ValueError, match="Choose the photograph's file first"):
        form.read(None)
    form.file.value = tmp_path / "none.jpg"
    with pytest.raises(ValueError, match="there is no such file"):
        form.read(None)
    (tmp_path / "text.jpg").write_text("no picture")
    form.file.value = tmp_path / "text.jpg"
    with pytest.raises(ValueError, match="no EXIF is read from this kind of file"):
        form.read(None)
