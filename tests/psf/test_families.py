import io
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import convolve

from napari_defocus import Disc, PSFFamily
from napari_defocus.psf.families import (
    Annulus,
    Gaussian,
    GeneralizedGaussian,
    KernelFunction,
    Polygon,
    as_family,
)
from napari_defocus.psf.measured import MeasuredPSF
from napari_defocus.psf.parsing import psf_from_text, psf_text

RADII = [0.0, 0.3, 0.5, 0.51, 0.7, 1.0, 1.5, 2.37, 3.0, 4.5, 6.66, 8.0]


def measured_discs(scales, side=19, **settings):
    kernels = [framed(Disc(9.0).kernel(scale), side) for scale in scales]
    return MeasuredPSF(scales, kernels, **settings)


def framed(kernel, side):
    return np.pad(kernel, (side - len(kernel)) // 2)


def from_function(scale):
    return np.exp(-np.add.outer(np.arange(-9, 10) ** 2, np.arange(-9, 10) ** 2) / scale**2)


FAMILIES = [
    Disc(),
    Gaussian(),
    GeneralizedGaussian(1.0),
    GeneralizedGaussian(6.0),
    Polygon(6),
    Polygon(5, rotation=10.0),
    Annulus(0.5),
    KernelFunction(from_function),
    measured_discs([0, 1, 2, 4, 8]),
    measured_discs([0.8, 3.0, 5.0], max_scale=8.0),
]
EVERY_FAMILY = pytest.mark.parametrize("psf", FAMILIES, ids=lambda psf: type(psf).__name__)


def supersampled(light, reach, finer=200):
    """The light on every pixel, from its density at finer x finer points a pixel."""
    points = (np.arange((2 * reach + 1) * finer) + 0.5) / finer - reach - 0.5
    side = 2 * reach + 1
    density = light(-points[:, None], points).astype(float)
    share = density.reshape(side, finer, side, finer).mean(axis=(1, 3))
    return share / share.sum()


def disc(radius):
    return lambda y, x: x**2 + y**2 <= radius**2


def ring(radius, obstruction):
    return lambda y, x: disc(radius)(y, x) & ~disc(obstruction * radius)(y, x)


def profile(radius, exponent):
    """exp(-(rho / alpha)^exponent), scaled to a standard deviation of radius / 2 by brute force."""
    rho = np.linspace(0, 40, 400_001)
    density = np.exp(-(rho**exponent))
    alpha = radius / 2 * np.sqrt(2 * np.sum(density * rho) / np.sum(density * rho**3))
    return lambda y, x: np.exp(-((np.hypot(y, x) / alpha) ** exponent))


def polygon(corner, blades, rotation):
    """The points on the inner side of every edge; y grows upwards."""
    turn = 2 * np.pi / blades
    inscribed = corner * np.cos(turn / 2)
    normals = np.deg2rad(rotation) + turn * (np.arange(blades) + 0.5)
    return lambda y, x: np.all(
        [x * np.cos(angle) + y * np.sin(angle) <= inscribed for angle in normals], axis=0
    )


@EVERY_FAMILY
@pytest.mark.parametrize("scale", [0.0, 0.3, 0.51, 0.7, 1.0, 2.37, 4.0])
def test_kernel_sums_to_one_and_is_nowhere_negative(psf, scale):
    kernel = psf.kernel(scale)
    assert kernel.dtype == np.float64
    assert kernel.shape[0] == kernel.shape[1]
    assert kernel.shape[0] % 2 == 1
    np.testing.assert_allclose(kernel.sum(), 1, rtol=1e-12)
    assert kernel.min() >= 0


@EVERY_FAMILY
def test_scale_zero_is_a_point(psf):
    np.testing.assert_array_equal(psf.kernel(0.0), [[1]])


@EVERY_FAMILY
def test_kernel_changes_continuously_with_the_scale(psf):
    lowest = 0.2 if isinstance(psf, KernelFunction) else 0.0
    for scale in np.arange(lowest, min(psf.max_scale, 8.0), 0.0313):
        near, far = psf.kernel(scale), psf.kernel(scale + 1e-4)
        side = max(len(near), len(far))
        # A steep edge moves by 1e-4 px; the Gaussian's cut lets a few 1e-5 jump.
        assert np.abs(framed(near, side) - framed(far, side)).sum() < 1e-3


@EVERY_FAMILY
def test_family_is_one_says_what_its_scale_is_and_survives_pickling(psf):
    assert isinstance(psf, PSFFamily)
    assert psf.scale_name.endswith("(px)")
    assert psf.max_scale >= 4
    assert as_family(psf) is psf
    again = pickle.loads(pickle.dumps(psf))
    assert again == psf
    assert hash(again) == hash(psf)


@pytest.mark.parametrize("radius", RADII)
def test_disc_is_the_same_after_flips_and_transposition(radius):
    kernel = Disc().kernel(radius)
    for turned in (kernel[::-1], kernel[:, ::-1], kernel.T):
        np.testing.assert_allclose(turned, kernel, atol=1e-14)


@pytest.mark.parametrize("scale", [0.51, 0.7, 1.0, 2.37, 4.0])
@pytest.mark.parametrize(
    ("psf", "light"),
    [
        (Disc(), disc),
        (Annulus(0.5), lambda scale: ring(scale / np.sqrt(1.25), 0.5)),
        (Annulus(0.9), lambda scale: ring(scale / np.sqrt(1.81), 0.9)),
        (Polygon(3, rotation=90.0), lambda scale: polygon(scale * np.sqrt(2), 3, 90.0)),
        (Polygon(4, rotation=10.0), lambda scale: polygon(scale * np.sqrt(1.5), 4, 10.0)),
        (Polygon(6), lambda scale: polygon(scale * np.sqrt(1.2), 6, 0.0)),
        (GeneralizedGaussian(6.0), lambda scale: profile(scale, 6.0)),
    ],
)
def test_kernel_holds_the_light_that_falls_on_each_pixel(psf, light, scale):
    kernel = psf.kernel(scale)
    # Counting 200 x 200 points a pixel is good to some 1e-3 of the light; edges along rows less.
    assert np.abs(kernel - supersampled(light(scale), len(kernel) // 2)).sum() < 5e-3


@pytest.mark.parametrize("psf", [Gaussian(), GeneralizedGaussian(2.0), GeneralizedGaussian(1.0)])
@pytest.mark.parametrize("radius", [0.6, 1.4, 3.0, 6.0])
def test_soft_kernel_holds_the_light_that_falls_on_each_pixel(psf, radius):
    kernel = psf.kernel(radius)
    light = profile(radius, getattr(psf, "exponent", 2.0))
    expected = supersampled(light, len(kernel) // 2 + 5, finer=30)
    # 1e-4 of the light are cut off.
    assert np.abs(framed(kernel, len(expected)) - expected).sum() < 1e-3


@pytest.mark.parametrize("scale", [0.4, 1.0, 2.5, 4.0])
def test_families_meet_where_their_shapes_do(scale):
    pairs = [
        (Gaussian().kernel(scale), GeneralizedGaussian(2.0).kernel(scale), 5e-4),
        (Disc().kernel(scale), GeneralizedGaussian(np.inf).kernel(scale), 1e-12),
        (Disc().kernel(scale), Polygon(200).kernel(scale), 1e-3),
        (Disc().kernel(scale), Annulus(0.0).kernel(scale), 1e-12),
        (Disc().kernel(scale), Annulus(5e-324).kernel(scale), 1e-12),
        (Polygon(4).kernel(scale), Polygon(4, rotation=-90.0).kernel(scale), 1e-9),
    ]
    for one, other, tolerance in pairs:
        side = max(len(one), len(other))
        assert np.abs(framed(one, side) - framed(other, side)).sum() < tolerance


@pytest.mark.parametrize(
    "psf",
    [
        *(Disc(), Annulus(0.6), Polygon(3, rotation=20), Polygon(4), Polygon(6)),
        *(Gaussian(), GeneralizedGaussian(1.0), GeneralizedGaussian(10.0)),
    ],
    ids=repr,
)
@pytest.mark.parametrize("scale", [4.0, 8.0])
def test_scale_of_every_family_is_twice_the_standard_deviation(psf, scale):
    assert psf.scale_name == "blur radius (px)"
    kernel = psf.kernel(scale)
    place = np.arange(len(kernel)) - len(kernel) // 2
    for weights in (kernel.sum(axis=0), kernel.sum(axis=1)):
        # The pixels' own extent adds 1/12 px^2.
        found = np.sum(weights * place**2) - 1 / 12
        np.testing.assert_allclose(2 * np.sqrt(found), scale, rtol=0.01)


def test_scales_of_their_own_are_still_known():
    radii = np.array([0.0, 4.0])
    np.testing.assert_array_equal(Gaussian().sigma(radii), [0, 2])
    assert GeneralizedGaussian(6.0).sigma(3.0) == 1.5
    assert Annulus(0.75).outer_radius(5.0) == 4.0
    area = 2 * (3.0 * np.sqrt(1.5)) ** 2  # of a square whose corners are that far out
    assert Polygon(4).equal_area_radius(3.0) == pytest.approx(np.sqrt(area / np.pi))
    np.testing.assert_allclose(Polygon(200).equal_area_radius(radii), radii, rtol=1e-4)


def test_disc_up_to_half_a_pixel_is_a_point():
    for radius in (0.0, 0.1, 0.49, 0.5):
        np.testing.assert_array_equal(Disc().kernel(radius), [[1]])


def test_polygon_turns_counter_clockwise_and_is_not_mirrored():
    up = Polygon(3, rotation=90.0).kernel(4.4)
    np.testing.assert_allclose(up[:, ::-1], up, atol=1e-12)
    assert np.argmax(up.sum(axis=1)) > len(up) // 2
    # A corner at 45 degrees is on the upper right.
    right = Polygon(3, rotation=45.0).kernel(4.4)
    middle = len(right) // 2
    assert right[middle - 4, middle + 4] > 0.01
    assert right[middle + 4, middle - 4] < 1e-12


@pytest.mark.parametrize(
    ("family", "arguments", "message"),
    [
        (Disc, {"max_radius": 0.99}, "max_radius is 0.99; it takes a number from 1 px up"),
        (Disc, {"max_radius": np.nan}, "max_radius is nan; it takes a number from 1 px up"),
        (Annulus, {"max_radius": np.inf}, "max_radius is inf; it takes a number from 1 px up"),
        (Annulus, {"obstruction": 1.0}, "obstruction is 1.0; it takes a number from 0 to below 1"),
        (Annulus, {"obstruction": -0.1}, "obstruction is -0.1; it takes"),
        (Polygon, {"blades": 2}, "blades is 2; it takes a whole number from 3 up"),
        (Polygon, {"rotation": np.inf}, "rotation is inf; it takes a finite number of degrees"),
        (Polygon, {"max_radius": -3}, "max_radius is -3; it takes a number from 1 px up"),
        (Gaussian, {"max_radius": 0}, "max_radius is 0; it takes a number from 1 px up"),
        (GeneralizedGaussian, {"exponent": 0.9}, "exponent is 0.9; it takes a number from 1 up"),
        (GeneralizedGaussian, {"exponent": np.nan}, "exponent is nan; it takes"),
        (GeneralizedGaussian, {"max_radius": np.nan}, "max_radius is nan; it takes"),
        (KernelFunction, {"function": from_function, "max_scale": 0.5}, "max_scale is 0.5; it"),
    ],
)
def test_impossible_parameters_are_refused(family, arguments, message):
    with pytest.raises(ValueError, match=message):
        family(**arguments)


@pytest.mark.parametrize(
    ("family", "arguments", "message"),
    [
        (Disc, {"max_radius": "8"}, "max_radius is '8'; it takes a number from 1 px up"),
        (Polygon, {"blades": 6.0}, "blades is 6.0; it takes a whole number from 3 up"),
        (KernelFunction, {"function": 3}, "function is 3; it takes a function of the scale"),
    ],
)
def test_parameters_of_another_type_are_refused(family, arguments, message):
    with pytest.raises(TypeError, match=message):
        family(**arguments)


def test_families_are_equal_and_hashed_by_value():
    assert Disc() == Disc(max_radius=64.0)
    assert Disc(5.0) != Disc(6.0)
    assert Polygon(6) != Polygon(6, rotation=15.0)
    assert GeneralizedGaussian(2.0) != Gaussian()
    assert len({Disc(), Disc(64.0), Disc(5.0), Annulus(0.5), Annulus(0.5)}) == 3


def test_function_is_asked_for_its_kernel_and_normalised():
    psf = KernelFunction(lambda scale: scale * np.ones((3, 3), int), 5.0, "side (px)")
    np.testing.assert_allclose(psf.kernel(2.0), np.full((3, 3), 1 / 9))
    assert (psf.max_scale, psf.scale_name) == (5.0, "side (px)")


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (np.ones((3, 4)), r"at 2 px an array of shape \(3, 4\); it takes a kernel, \(K, K\)"),
        (np.ones((4, 4)), r"at 2 px an array of shape \(4, 4\); .* K odd"),
        (np.ones(3), r"an array of shape \(3,\)"),
        (-np.ones((3, 3)), "at 2 px values from -1.0 to -1.0; it takes finite ones from 0 up"),
        (np.full((3, 3), np.nan), "values from nan to nan; it takes finite ones"),
        (np.zeros((3, 3)), "at 2 px only zeros; it takes a positive sum"),
        ([[1.0], [1.0, 2.0]], "at 2 px no array"),
    ],
)
def test_what_a_function_returns_is_checked(returned, message):
    with pytest.raises(ValueError, match=f"function returned {message}|{message}"):
        KernelFunction(lambda _: returned).kernel(2.0)


def test_function_that_returns_no_numbers_is_a_type_error():
    with pytest.raises(TypeError, match="function returned at 2 px object values"):
        KernelFunction(lambda _: None).kernel(2.0)


def test_plain_function_becomes_a_family():
    psf = as_family(from_function)
    assert psf == KernelFunction(from_function)
    assert psf.max_scale == 8.0


@pytest.mark.parametrize("psf", [Disc, 3.0, None, "disc", np.ones((3, 3))])
def test_what_is_no_family_is_a_type_error(psf):
    with pytest.raises(TypeError, match=r"(?s)psf is .*; it takes a PSF family such as Disc\(\)"):
        as_family(psf)


@pytest.mark.parametrize(
    ("text", "psf"),
    [
        ("disc", Disc()),
        ("gaussian", Gaussian()),
        ("generalized-gaussian:1.5", GeneralizedGaussian(1.5)),
        ("generalized-gaussian:inf", GeneralizedGaussian(np.inf)),
        ("polygon:6:0", Polygon(6)),
        ("polygon:5:-7.25", Polygon(5, rotation=-7.25)),
        ("annulus:0.5", Annulus(0.5)),
    ],
)
def test_families_are_written_and_read_as_text(text, psf):
    assert psf_from_text(text) == psf
    assert psf_text(psf) == text
    larger = psf_from_text(text, max_scale=12.0)
    assert larger.max_scale == 12.0
    assert psf_text(larger) == text


def test_text_may_leave_parameters_out():
    assert psf_from_text("polygon:7") == Polygon(7)
    assert psf_from_text(" Annulus ") == Annulus()


@pytest.mark.parametrize("text", ["", "disk", "disc:3", "polygon:six", "polygon:6:1:2", "lens.np"])
def test_text_that_says_no_family_is_answered_with_what_does(text):
    with pytest.raises(ValueError, match=r"psf is .*; it takes disc, gaussian, .*, or the path"):
        psf_from_text(text)


def test_text_with_an_impossible_parameter_says_which():
    with pytest.raises(ValueError, match=r"obstruction is 1\.5; it takes a number from 0"):
        psf_from_text("annulus:1.5")


def test_family_without_a_text_form_says_so():
    with pytest.raises(ValueError, match=r"KernelFunction.* has no text form"):
        psf_text(KernelFunction(from_function))


class TestMeasuredPSF:
    def test_measured_kernels_come_out_as_they_went_in(self):
        scales = [0.7, 1.5, 2.0, 4.2, 7.0]
        shapes = (Disc(), Polygon(5), Disc(), Annulus(), Disc())
        kernels = [
            framed(shape.kernel(scale), 21) for shape, scale in zip(shapes, scales, strict=True)
        ]
        lens = MeasuredPSF(scales, kernels)
        for scale, kernel in zip(scales, kernels, strict=True):
            found = lens.kernel(scale)
            side = max(len(found), 21)
            np.testing.assert_allclose(framed(found, side), framed(kernel, side), atol=1e-6)

    @pytest.mark.parametrize("shape", [Disc(), Polygon(5, rotation=20.0), Annulus(0.4)])
    def test_kernels_between_are_those_of_the_aperture(self, shape):
        scales = np.arange(1, 9)
        lens = MeasuredPSF(scales, [framed(shape.kernel(scale), 19) for scale in scales])
        for scale in np.arange(0.75, 8, 0.5):
            found, expected = lens.kernel(scale), shape.kernel(scale)
            side = max(len(found), len(expected))
            # A share of the light in the wrong place; edges are as sharp as the pixels.
            assert np.abs(framed(found, side) - framed(expected, side)).sum() < 0.12

    def test_lens_that_is_soft_in_focus_stays_so_below_the_smallest_blur(self):
        def soft_disc(radius):
            return convolve(framed(Disc().kernel(radius), 13), Gaussian().kernel(1.2))

        scales = [0, 2, 4]
        lens = MeasuredPSF(scales, [framed(soft_disc(scale), 19) for scale in scales])
        for scale in (0.0, 0.5, 1.0, 1.5):
            found, expected = lens.kernel(scale), soft_disc(scale)
            side = max(len(found), len(expected))
            assert np.abs(framed(found, side) - framed(expected, side)).sum() < 0.12

    def test_kernel_grows_above_the_largest_measured_scale(self):
        lens = measured_discs([2, 4], max_scale=6.0)
        found, expected = lens.kernel(5.5), Disc().kernel(5.5)
        side = max(len(found), len(expected))
        assert np.abs(framed(found, side) - framed(expected, side)).sum() < 0.15

    def test_equality_and_hash_are_those_of_the_content(self):
        one, same = measured_discs([1, 2], provenance={"lens": "A"}), measured_discs([1, 2])
        assert one == same
        assert hash(one) == hash(same)
        for other in (
            measured_discs([1, 3]),
            measured_discs([1, 2], max_scale=3.0),
            measured_discs([1, 2], side=21),
            Disc(),
        ):
            assert one != other

    def test_content_cannot_be_changed(self):
        lens = measured_discs([1, 2])
        with pytest.raises(ValueError, match="read-only"):
            lens.kernels[0] = 0
        with pytest.raises(AttributeError):
            lens.max_scale = 3.0
        assert replace(lens, max_scale=3.0).max_scale == 3.0

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (([1, 2], np.ones((3, 3, 3))), "kernels hold 3 kernels; it takes one for each of 2"),
            (([1, 1], np.ones((2, 3, 3))), r"scales are \[1.0, 1.0\]; it takes increasing px"),
            (([-1, 1], np.ones((2, 3, 3))), "scales are .*; it takes increasing px from 0 up"),
            (([np.nan, 1], np.ones((2, 3, 3))), "scales are .*; it takes increasing px from 0 up"),
            (([[1, 2]], np.ones((2, 3, 3))), r"scales have shape \(1, 2\); it takes \(M,\)"),
            (([], np.ones((0, 3, 3))), r"scales have shape \(0,\)"),
            (([1, 2], np.ones((2, 3, 4))), r"kernels hold an array of shape \(2, 3, 4\)"),
            (([1, 2], -np.ones((2, 3, 3))), "kernels hold values from -1.0"),
            (([1, 2], np.zeros((2, 3, 3))), "kernels hold only zeros"),
            (([0.2, 0.9], np.ones((2, 3, 3))), "max_scale is 0.9; it takes a number from 1 px up"),
        ],
    )
    def test_tables_that_are_none_are_refused(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            MeasuredPSF(*arguments)

    def test_provenance_is_what_json_can_hold(self):
        with pytest.raises(TypeError, match="provenance does not fit into JSON"):
            measured_discs([1, 2], provenance={"pictures": np.ones(3)})

    def test_file_holds_all_of_it(self, tmp_path):
        lens = measured_discs([0, 1, 2.5], max_scale=4.0, provenance={"pictures": ["a", "b"]})
        lens.save(tmp_path / "lens.npz")
        assert [path.name for path in tmp_path.iterdir()] == ["lens.npz"]
        again = MeasuredPSF.load(tmp_path / "lens.npz")
        assert again == lens
        assert again.provenance == {"pictures": ["a", "b"]}
        assert psf_from_text(str(tmp_path / "lens.npz")) == lens
        assert psf_from_text(str(tmp_path / "lens.npz"), 3.0).max_scale == 3.0

    def test_saving_replaces_an_old_file_but_makes_no_folder(self, tmp_path):
        path = tmp_path / "lens.npz"
        path.write_text("old")
        measured_discs([1, 2]).save(path)
        assert MeasuredPSF.load(path) == measured_discs([1, 2])
        with pytest.raises(OSError, match="there is no folder"):
            measured_discs([1, 2]).save(tmp_path / "no" / "lens.npz")

    def test_missing_file_says_so(self, tmp_path):
        with pytest.raises(ValueError, match=r"cannot read .*lens\.npz: there is no such file"):
            MeasuredPSF.load(tmp_path / "lens.npz")

    def test_every_damaged_or_foreign_file_is_refused(self, tmp_path):
        path = tmp_path / "lens.npz"
        measured_discs([1, 2]).save(path)
        whole = path.read_bytes()
        foreign = io.BytesIO()
        np.savez(foreign, scales=[1, 2])
        pickled = io.BytesIO()
        np.savez(pickled, format=np.array([{}], object))
        array = io.BytesIO()
        np.save(array, np.ones(3))
        flipped = bytearray(whole)
        flipped[len(whole) // 2] ^= 0xFF
        contents = [whole[: len(whole) // 2], b"", b"text", bytes(flipped), pickle.dumps({})]
        contents += [file.getvalue() for file in (foreign, pickled, array)]
        for content in contents:
            path.write_bytes(content)
            with pytest.raises(ValueError, match=r"cannot read .*: it is not a measured PSF, or"):
                MeasuredPSF.load(path)
