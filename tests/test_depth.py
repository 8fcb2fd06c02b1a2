"""Distances from blur: one thin lens, what cameras note about it, and surfaces to look at."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from napari_defocus import (
    Annulus,
    Disc,
    Gaussian,
    GeneralizedGaussian,
    Polygon,
    ThinLens,
    blur_from_depth,
    depth_from_blur,
    depth_surface,
    estimate_blur_map,
    simulate_defocus,
)

PORTRAIT = ThinLens(focal_length_mm=50, f_number=2, focus_distance_m=2, pixel_pitch_um=5)
WIDE = ThinLens(focal_length_mm=25, f_number=4, focus_distance_m=1.6, pixel_pitch_um=5)
LANDSCAPE = ThinLens(focal_length_mm=35, f_number=8, focus_distance_m=math.inf, pixel_pitch_um=4)

ORIENTATION = 274


def lenses():
    return st.builds(
        lambda f, focus_in_f, **rest: ThinLens(
            focal_length_mm=f, focus_distance_m=focus_in_f * f / 1000, **rest
        ),
        f=st.floats(2, 500),
        focus_in_f=st.floats(1.1, 1000) | st.just(math.inf),
        f_number=st.floats(0.9, 45),
        pixel_pitch_um=st.floats(0.5, 30),
    )


# Distances.


@pytest.mark.parametrize("distance", [0.7, 1.5, 2.0, 4.0, 300.0])
def test_blur_is_that_of_the_lens_equation(distance):
    # Worked out behind the lens, in mm: where a point and the plane in focus are imaged, and
    # how wide the cone of light through an aperture of 50 / 2 mm is on the sensor.
    sensor = 1 / (1 / 50 - 1 / 2000)
    point = 1 / (1 / 50 - 1 / (1000 * distance))
    diameter_mm = 50 / 2 * abs(sensor - point) / point
    expected_px = diameter_mm / 2 / 0.005
    assert blur_from_depth(distance, PORTRAIT) == pytest.approx(expected_px, rel=1e-6)


def test_point_at_4_m_in_front_of_a_portrait_lens():
    # By hand: 51.28205 and 50.63291 mm behind the lens, so 25 x 0.64914 / 50.63291 mm wide.
    assert blur_from_depth(4.0, PORTRAIT) == pytest.approx(32.051, abs=1e-3)
    assert depth_from_blur(32.051, PORTRAIT) == pytest.approx(4.0, abs=1e-3)


@given(lens=lenses(), times=st.floats(1.001, 100))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_distance_beyond_the_focus_comes_back(lens, times):
    assume(lens.focus_distance_m < math.inf)
    distance = times * lens.focus_distance_m
    radius = blur_from_depth(distance, lens)
    assert radius < lens.largest_radius
    assert depth_from_blur(radius, lens, side="far") == pytest.approx(distance, rel=1e-4)


@given(lens=lenses(), times=st.floats(0.01, 0.999))
@settings(max_examples=100, deadline=None, derandomize=True)
def test_distance_before_the_focus_comes_back(lens, times):
    distance = times * min(lens.focus_distance_m, 100)
    radius = blur_from_depth(distance, lens)
    assert depth_from_blur(radius, lens, side="near") == pytest.approx(distance, rel=1e-5)


@given(lens=lenses())
@settings(max_examples=50, deadline=None, derandomize=True)
def test_infinity_and_the_focus_come_back(lens):
    assert blur_from_depth(math.inf, lens) == pytest.approx(lens.largest_radius, rel=1e-6)
    if lens.focus_distance_m < math.inf:
        assert depth_from_blur(blur_from_depth(math.inf, lens), lens) == math.inf
        for side in ("far", "near"):
            in_focus = depth_from_blur(0.0, lens, side=side)
            assert in_focus == pytest.approx(lens.focus_distance_m, rel=1e-6)


def test_with_the_focus_at_infinity_blur_falls_with_the_distance():
    assert LANDSCAPE.largest_radius == 0
    # 35 / 8 mm wide at the lens, seen through 35 mm at 10 m: 15.3 um, half of that in px of 4 um.
    assert blur_from_depth(10.0, LANDSCAPE) == pytest.approx(35 / 8 * 35 / 10000 / 2 / 0.004)
    np.testing.assert_allclose(
        depth_from_blur([1.9140625, 0.0], LANDSCAPE, side="near"), [10, math.inf]
    )


def test_twice_the_aperture_or_half_the_pitch_is_twice_the_blur():
    once = blur_from_depth([1.0, 3.0], PORTRAIT)
    for change in ({"f_number": 1}, {"pixel_pitch_um": 2.5}):
        lens = ThinLens(**{**vars(PORTRAIT), **change})
        np.testing.assert_allclose(blur_from_depth([1.0, 3.0], lens), 2 * once)


def test_more_blur_than_at_infinity_is_infinitely_far_or_near():
    radii = [0.99 * PORTRAIT.largest_radius, PORTRAIT.largest_radius, 1000.0]
    far = depth_from_blur(radii, PORTRAIT)
    assert np.isfinite(far[0])
    np.testing.assert_array_equal(far[1:], math.inf)
    near = depth_from_blur(radii, PORTRAIT, side="near")
    assert (np.diff(near) < 0).all()
    assert near[-1] > 0


def test_side_is_chosen_for_each_pixel():
    depth = np.array([[1.0, 1.5], [3.0, 9.0]])
    blur = blur_from_depth(depth, PORTRAIT)
    np.testing.assert_allclose(depth_from_blur(blur, PORTRAIT, side=depth > 2), depth, rtol=1e-5)
    everywhere = np.ones((2, 2), bool)
    for word, beyond in (("far", everywhere), ("near", ~everywhere)):
        np.testing.assert_array_equal(
            depth_from_blur(blur, PORTRAIT, side=word),
            depth_from_blur(blur, PORTRAIT, side=beyond),
        )


@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3), (2, 3, 4)])
@pytest.mark.parametrize("dtype", [np.float16, np.float64, np.int32, np.uint8])
def test_any_shape_and_real_dtype_gives_float32_of_the_same_shape(shape, dtype):
    values = np.full(shape, 3, dtype)
    for result in (depth_from_blur(values, PORTRAIT), blur_from_depth(values, PORTRAIT)):
        assert result.shape == shape
        assert result.dtype == np.float32


def test_what_is_not_known_stays_so():
    blur = np.array([1.0, np.nan, 100.0])
    for side in ("far", "near", np.array([True, True, False])):
        unknown = np.isnan(depth_from_blur(blur, PORTRAIT, side=side))
        np.testing.assert_array_equal(unknown, [False, True, False])
    np.testing.assert_array_equal(np.isnan(blur_from_depth(blur, PORTRAIT)), np.isnan(blur))


@pytest.mark.parametrize(
    ("psf", "radius_of_1_px"),
    [
        (Gaussian(), 2),
        (GeneralizedGaussian(4.0), 2),
        (Disc(), 1),
        (Annulus(0.3), 1),
        (Polygon(6), 1),
    ],
)
def test_standard_deviation_is_half_a_radius(psf, radius_of_1_px):
    depth = depth_from_blur([radius_of_1_px], PORTRAIT)
    np.testing.assert_allclose(depth_from_blur([1.0], PORTRAIT, psf=psf), depth)
    np.testing.assert_allclose(blur_from_depth(depth, PORTRAIT, psf=psf), [1.0], rtol=1e-5)


@pytest.mark.parametrize("texture", ["grass", "clouds"])
@pytest.mark.parametrize(
    ("lens", "side", "nearest", "farthest"),
    [
        (WIDE, "far", 1.8, 4.0),
        (ThinLens(**{**vars(WIDE), "focus_distance_m": 4.0}), "near", 1.6, 3.2),
    ],
)
def test_slanted_wall_is_found_to_3_percent(request, texture, lens, side, nearest, farthest):
    wall = np.broadcast_to(np.linspace(nearest, farthest, 160), (160, 160))
    sharp = request.getfixturevalue(texture)
    picture = simulate_defocus(sharp, blur_from_depth(wall, lens), noise_variance=1e-6, rng=0)
    found = depth_from_blur(estimate_blur_map(picture), lens, side=side)
    error = np.abs(found - wall) / wall
    assert np.median(error) < 0.03
    assert np.mean(error < 0.05) > 0.88


# What distances cannot be made from.


@pytest.mark.parametrize("name", ["focal_length_mm", "f_number", "pixel_pitch_um"])
@pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf])
def test_impossible_lens_is_a_value_error(name, value):
    with pytest.raises(ValueError, match=rf"^{name} is {value}; it takes a finite number above 0"):
        ThinLens(**{**vars(PORTRAIT), name: value})


@pytest.mark.parametrize("value", [0, -1.0, math.nan, 0.03, 0.05, -math.inf])
def test_focus_within_the_focal_length_is_a_value_error(value):
    with pytest.raises(ValueError, match=r"focus_distance_m is .* above the focal length, 0.05 m"):
        ThinLens(**{**vars(PORTRAIT), "focus_distance_m": value})


@pytest.mark.parametrize("name", list(vars(PORTRAIT)))
@pytest.mark.parametrize("value", ["50", None, [50.0], 1j])
def test_lens_of_no_numbers_is_a_type_error(name, value):
    with pytest.raises(TypeError, match=f"^{name} is "):
        ThinLens(**{**vars(PORTRAIT), name: value})


@pytest.mark.parametrize(
    ("blur", "words"),
    [
        ([-0.1, 1], "blur_map has values from -0.1 to 1; it takes finite ones from 0 px up"),
        ([np.nan, np.inf], "blur_map has values from inf to inf"),
        ([[1.0], [1.0, 2.0]], "blur_map is no array"),
    ],
)
def test_impossible_blur_is_a_value_error(blur, words):
    with pytest.raises(ValueError, match=words):
        depth_from_blur(blur, PORTRAIT)


@pytest.mark.parametrize("depth", [0.0, [1.0, -2.0], -math.inf])
def test_distance_not_above_0_is_a_value_error(depth):
    with pytest.raises(ValueError, match=r"depth has values down to .*; it takes ones above 0"):
        blur_from_depth(depth, PORTRAIT)


@pytest.mark.parametrize("values", ["far", [1j], [None], [True]])
def test_what_is_no_real_number_is_a_type_error(values):
    with pytest.raises(TypeError, match=r"^blur_map has dtype .*; it takes real numbers"):
        depth_from_blur(values, PORTRAIT)
    for function in (lambda depth: blur_from_depth(depth, PORTRAIT), depth_surface):
        with pytest.raises(TypeError, match=r"^depth has dtype .*; it takes real numbers"):
            function(values)


@pytest.mark.parametrize(
    ("side", "error", "words"),
    [
        ("behind", ValueError, "side is 'behind'; it takes 'far', 'near' or a bool array"),
        ([1, 0], TypeError, "side has dtype int64; it takes 'far', 'near' or bool"),
        ([[True, False]], ValueError, r"side has shape \(1, 2\); it takes that of blur_map"),
        (None, TypeError, "side has dtype object"),
    ],
)
def test_impossible_side_is_an_error(side, error, words):
    with pytest.raises(error, match=words):
        depth_from_blur([1.0, 2.0], PORTRAIT, side=side)


@pytest.mark.parametrize("side", ["far", [True, False]])
def test_nothing_lies_beyond_infinity(side):
    with pytest.raises(ValueError, match="beyond the focus, but it is at infinity"):
        depth_from_blur([1.0, 2.0], LANDSCAPE, side=side)


def test_other_things_for_a_lens_or_a_family_are_type_errors():
    for function in (depth_from_blur, blur_from_depth):
        with pytest.raises(TypeError, match="lens is 50; it takes a ThinLens"):
            function([1.0], 50)
        with pytest.raises(TypeError, match="psf is 'disc'; it takes a PSF family"):
            function([1.0], PORTRAIT, psf="disc")


# What cameras note.


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


def test_all_that_is_missing_is_named_in_one_line(photograph):
    file = photograph()
    with pytest.raises(ValueError, match="does not note") as caught:
        ThinLens.from_exif(file)
    assert str(caught.value) == (
        f"{file} does not note focal_length_mm, f_number, focus_distance_m and pixel_pitch_um; "
        "give what is missing"
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
        (lambda path: path.write_text("no picture"), "it is no picture"),
        (lambda path: path.write_bytes(b""), "it is no picture"),
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


# Surfaces.


def consistent(surface):
    """Check what holds for every surface, and return it."""
    assert surface.vertices.dtype == np.float32
    assert surface.faces.dtype == np.int32
    assert np.isfinite(surface.vertices).all()
    # Every vertex is used, and no triangle degenerate.
    np.testing.assert_array_equal(np.unique(surface.faces), np.arange(len(surface.vertices)))
    _, y, x = np.moveaxis(surface.vertices[surface.faces], -1, 0)
    # Rows point down: counter-clockwise as it is seen is a negative area here.
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    assert (area < 0).all()
    return surface


def test_flat_map_is_a_whole_grid():
    surface = consistent(depth_surface(np.full((5, 7), 3.0)))
    assert len(surface.vertices) == 35
    assert len(surface.faces) == 2 * 4 * 6
    rows, columns = np.indices((5, 7)).reshape(2, -1)
    np.testing.assert_array_equal(surface.vertices, np.stack([0 * rows, rows, columns], axis=1))
    assert surface.colors is None


def test_no_triangle_spans_a_jump():
    depth = np.where(np.arange(20) < 8, 1.0, 1.06) * np.linspace(1, 1.5, 30)[:, None]
    surface = consistent(depth_surface(depth))
    left = surface.vertices[surface.faces][..., 2] < 8
    assert (left.all(axis=1) | (~left).all(axis=1)).all()
    assert len(surface.faces) == 2 * 29 * (7 + 11)
    assert len(consistent(depth_surface(depth, largest_jump=0.1)).faces) == 2 * 29 * 19


@pytest.mark.parametrize("step", [1, 2, 3])
def test_no_triangle_of_a_rough_map_spans_more_than_was_said(step):
    depth = np.exp(np.random.default_rng(0).normal(0, 0.05, (40, 50)))
    depth[10:20, 10:20] = np.nan
    depth[30:, 5:9] = np.inf
    surface = consistent(depth_surface(depth, step=step, largest_jump=0.05))
    _, row, column = surface.vertices.astype(int).T
    corners = depth[row, column][surface.faces]
    assert (corners.max(axis=1) <= 1.05 * corners.min(axis=1)).all()


@pytest.mark.parametrize("gap", [np.nan, np.inf])
def test_gap_is_a_hole_however_large_jumps_may_be(gap):
    depth = np.ones((6, 6))
    depth[2, 3] = gap
    surface = consistent(depth_surface(depth, largest_jump=math.inf))
    assert len(surface.vertices) == 35
    assert len(surface.faces) == 2 * 25 - 6


def test_nearer_is_towards_you_by_half_of_the_longer_side():
    depth = np.broadcast_to(np.linspace(4, 2, 201), (100, 201))
    z = consistent(depth_surface(depth)).vertices[:, 0].reshape(100, 201)
    assert (np.diff(z, axis=1) > 0).all()
    near, far = np.percentile(z, [99, 1])
    assert near - far == pytest.approx(201 / 2)
    assert far == pytest.approx(0, abs=1e-3)
    doubled = depth_surface(depth, relief=1.0).vertices[:, 0].reshape(100, 201)
    np.testing.assert_allclose(doubled, 2 * z, atol=1e-3)
    # The unit of the distance does not matter.
    np.testing.assert_allclose(
        depth_surface(1000 * depth).vertices, depth_surface(depth).vertices, atol=1e-3
    )


def test_napari_looks_at_a_surface_from_its_near_side():
    components = pytest.importorskip("napari.components")
    z, _, _ = components.ViewerModel(ndisplay=3).scene.camera.view_direction
    assert z < 0


def test_few_wild_distances_do_not_shrink_the_rest():
    depth = np.tile(np.linspace(2, 3, 100), (100, 1))
    depth[50, 50:53] = [1e-3, 1e6, 1e9]
    z = consistent(depth_surface(depth, largest_jump=math.inf)).vertices[:, 0]
    assert np.ptp(z) == pytest.approx(3 * 50, rel=1e-3)


def test_small_subject_stands_before_a_flat_wall():
    depth = np.full((100, 100), 3.0)
    depth[50:55, 50:55] = 2.0
    surface = consistent(depth_surface(depth))
    z, row, column = surface.vertices.T
    subject = (row >= 50) & (row < 55) & (column >= 50) & (column < 55)
    np.testing.assert_array_equal(z, np.where(subject, 50, 0))


@pytest.mark.parametrize("shape", [(600, 800), (501, 503), (100, 3000), (500, 500)])
def test_default_step_leaves_at_most_250000_vertices(shape):
    count = len(consistent(depth_surface(np.ones(shape))).vertices)
    assert 0.2 * 250_000 < count <= 250_000


def test_step_takes_every_nth_pixel_about_the_middle():
    surface = consistent(depth_surface(np.ones((10, 12)), step=4))
    np.testing.assert_array_equal(np.unique(surface.vertices[:, 1]), [0, 4, 8])
    np.testing.assert_array_equal(np.unique(surface.vertices[:, 2]), [1, 5, 9])


@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_colours_are_those_of_the_picture(channels):
    image = np.random.default_rng(0).integers(0, 256, (9, 11, *channels), dtype=np.uint8)
    depth = np.ones((9, 11))
    depth[4, 5] = np.nan
    surface = consistent(depth_surface(depth, image, step=2))
    _, row, column = surface.vertices.astype(int).T
    seen = image[row, column].reshape(len(row), -1)[:, :3] / 255
    assert surface.colors.dtype == np.float32
    np.testing.assert_allclose(surface.colors, np.broadcast_to(seen, (len(row), 3)), rtol=1e-6)


def test_colours_use_the_intensity_range_and_stay_within():
    image = np.arange(16, dtype=np.uint16).reshape(4, 4)
    colors = depth_surface(np.ones((4, 4)), image, intensity_range=(2, 12)).colors
    expected = np.clip((np.arange(16) - 2) / 10, 0, 1)
    np.testing.assert_allclose(colors, np.stack([expected] * 3, axis=1), rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"depth": np.ones(5)}, ValueError, r"depth has shape \(5,\); it takes \(H, W\)"),
        ({"depth": np.ones((1, 5))}, ValueError, r"depth has shape \(1, 5\)"),
        ({"depth": np.zeros((4, 5))}, ValueError, "depth has values down to 0; it takes ones abo"),
        ({"depth": np.full((4, 5), np.nan)}, ValueError, "depth leaves no triangle"),
        ({"depth": np.geomspace(1, 9, 20).reshape(4, 5)}, ValueError, "largest_jump = 0.05"),
        ({"image": np.ones((5, 4))}, ValueError, r"image has height and width \(5, 4\); it takes"),
        ({"image": "picture"}, TypeError, "image has dtype"),
        ({"step": 0}, ValueError, "step is 0; it takes a whole number from 1 to below .* 4 px"),
        ({"step": 4}, ValueError, "step is 4; it takes a whole number from 1 to below .* 4 px"),
        ({"step": 1.5}, TypeError, "step is 1.5; it takes a whole number"),
        ({"largest_jump": 0}, ValueError, "largest_jump is 0; it takes a number above 0"),
        ({"largest_jump": math.nan}, ValueError, "largest_jump is nan"),
        ({"largest_jump": "5 %"}, TypeError, "largest_jump is '5 %'"),
        ({"relief": -1}, ValueError, "relief is -1; it takes a finite number above 0"),
        ({"relief": math.inf}, ValueError, "relief is inf"),
        ({"relief": None}, TypeError, "relief is None"),
    ],
)
def test_impossible_surface_is_an_error(arguments, error, words):
    with pytest.raises(error, match=words):
        depth_surface(**{"depth": np.ones((4, 5)), **arguments})
