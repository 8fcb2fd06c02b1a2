"""Families measured from simulated pictures of a lens, whose kernels are known."""

import json

import numpy as np
import pytest

from napari_defocus import Cancelled, Disc, estimate_candidates, simulate_defocus
from napari_defocus.psf.calibration import calibrate_psf, disc_radius
from napari_defocus.psf.families import Annulus, Gaussian, Polygon
from napari_defocus.psf.measured import MeasuredPSF

LENS = Polygon(5, rotation=10.0)


def lamps(radius, places=((30, 30),), size=(61, 61), lens=LENS, noise=0.0, seed=0):
    """Lamps before a dark background, at places that need not be pixels; brightest value 0.8."""
    picture = np.zeros(size)
    for row, column in places:
        i, j = int(row), int(column)
        share_down, share_right = row - i, column - j
        for down, right in np.ndindex(2, 2):
            weight = abs(1 - down - share_down) * abs(1 - right - share_right)
            if weight > 0:
                picture[i + down, j + right] = weight
    blurred = simulate_defocus(picture, np.full(size, radius), psf=lens)
    noisy = blurred / blurred.max() + noise * np.random.default_rng(seed).standard_normal(size)
    return 0.02 + 0.78 * noisy


def distance(one, other):
    """The share of the light that lies elsewhere, from 0 to 2."""
    side = max(len(one), len(other))
    one, other = (np.pad(kernel, (side - len(kernel)) // 2) for kernel in (one, other))
    return np.abs(one - other).sum()


@pytest.mark.parametrize("radius", [0.8, 1.0, 2.5, 6.0])
def test_radius_is_that_of_the_disc_with_the_same_second_moment(radius):
    assert disc_radius(Disc().kernel(radius)) == pytest.approx(radius, abs=1e-6)
    assert disc_radius(Polygon(6).kernel(radius)) == pytest.approx(radius, rel=0.02)
    if radius > 1:
        assert disc_radius(Gaussian().kernel(radius)) == pytest.approx(radius, rel=0.03)


def test_point_is_as_wide_as_nothing():
    assert disc_radius([[0, 0, 0], [0, 1, 0], [0, 0, 0]]) == 0


RADII = (1, 4, 7)


@pytest.fixture(scope="module")
def pictures(gravel):
    return [
        simulate_defocus(gravel, np.full((160, 160), r), psf=LENS, noise_variance=1e-6, rng=r)
        for r in RADII
    ]


class TestPointSources:
    def test_kernels_and_scales_are_found_in_any_order(self):
        radii = [5, 1, 3]
        lens = calibrate_psf([lamps(radius) for radius in radii])
        np.testing.assert_allclose(lens.scales, [1, 3, 5], rtol=0.03)
        for scale, radius in zip(lens.scales, sorted(radii), strict=True):
            assert distance(lens.kernel(scale), LENS.kernel(radius)) < 0.01
        assert lens.max_scale == lens.scales[-1]

    def test_noise_of_2_percent_of_the_peak_moves_2_percent_of_the_light(self):
        radii = (1, 3, 5, 8)
        pictures = [lamps(radius, noise=0.02, seed=radius) for radius in radii]
        lens = calibrate_psf(pictures)
        np.testing.assert_allclose(lens.scales, radii, atol=0.1)
        for kernel, radius in zip(lens.kernels, radii, strict=True):
            assert distance(kernel, LENS.kernel(radius)) < 0.06

    def test_sources_between_pixels_are_brought_together(self):
        rng = np.random.default_rng(0)
        places = [np.array([i, j]) + rng.uniform(0, 1, 2) for i in (30, 90) for j in (30, 90)]
        pictures = [lamps(radius, places, (121, 121)) for radius in (2, 5)]
        lens = calibrate_psf(pictures)
        for kernel, radius in zip(lens.kernels, (2, 5), strict=True):
            assert distance(kernel, LENS.kernel(radius)) < 0.2
            center = np.array(np.unravel_index(np.arange(kernel.size), kernel.shape))
            offset = (center * kernel.ravel()).sum(axis=1) - len(kernel) // 2
            assert np.abs(offset).max() < 0.1

    def test_unusable_sources_are_left_out(self):
        good = [(60, 60)]
        for spoilt in ([(3, 90)], [(100, 100), (100, 108)], [(60, 100), (66, 107)]):
            pictures = [lamps(radius, good + spoilt, (121, 121)) for radius in (2, 4)]
            lens = calibrate_psf(pictures)
            assert distance(lens.kernels[1], LENS.kernel(4)) < 0.02

    def test_saturated_and_faint_sources_are_left_out(self):
        pictures = []
        for radius in (2, 4):
            picture = lamps(radius, [(60, 60), (60, 100)], (121, 121))
            picture[40:81, 80:121] = np.minimum(3 * picture[40:81, 80:121], 1)
            picture[100, 20] = 0.8
            pictures.append(picture)
        lens = calibrate_psf(pictures)
        assert distance(lens.kernels[1], LENS.kernel(4)) < 0.02

    def test_integers_and_colour_are_taken(self):
        pictures = [
            np.repeat(np.rint(65535 * lamps(radius))[..., None], 3, axis=2).astype(np.uint16)
            for radius in (2, 4)
        ]
        assert distance(calibrate_psf(pictures).kernels[1], LENS.kernel(4)) < 0.02

    @pytest.mark.parametrize(
        ("picture", "found"),
        [
            (np.zeros((61, 61)), "nothing stands out"),
            (np.minimum(2 * lamps(4), 1), "1 saturated"),
            (lamps(4, [(4, 30)]), "1 at the border"),
            (lamps(2, [(30, 25), (30, 36)]), "2 too close to another"),
        ],
    )
    def test_picture_without_a_usable_source_is_named(self, picture, found):
        with pytest.raises(ValueError, match=rf"pictures\[1\] shows no usable point .*\({found}"):
            calibrate_psf([lamps(2), picture])


class TestPairs:
    def test_kernels_and_scales_are_found(self, gravel, pictures):
        lens = calibrate_psf(pictures, sharp=gravel)
        np.testing.assert_allclose(lens.scales, RADII, rtol=0.03)
        for kernel, radius in zip(lens.kernels, RADII, strict=True):
            assert distance(kernel, LENS.kernel(radius)) < 0.1

    def test_brightness_and_whole_pixels_between_the_pictures_do_not_matter(self, gravel, pictures):
        moved = [0.1 + 0.7 * picture[5:150, 2:147] for picture in pictures]
        lens = calibrate_psf(moved, sharp=[gravel[:145, 8:153]] * 3, scales=RADII)
        np.testing.assert_array_equal(lens.scales, RADII)
        for kernel, radius in zip(lens.kernels, RADII, strict=True):
            assert distance(kernel, LENS.kernel(radius)) < 0.12

    def test_pictures_that_do_not_belong_together_are_named(self, gravel, grass, pictures):
        for name, wrong in (("0", [grass, *pictures]), ("1", [pictures[0], 0 * grass + 0.5])):
            message = rf"pictures\[{name}\] does not show what its sharp picture shows"
            with pytest.raises(ValueError, match=message):
                calibrate_psf(wrong, sharp=gravel)
        with pytest.raises(ValueError, match=r"pictures\[0\] has 160 x 160 px; it takes those"):
            calibrate_psf(pictures, sharp=gravel[:100])
        with pytest.raises(ValueError, match="sharp has 2 entries; it takes one a picture, 3"):
            calibrate_psf(pictures, sharp=[gravel, gravel])


def test_same_setting_twice_is_averaged():
    pictures = [lamps(radius, noise=0.02, seed=seed) for seed, radius in enumerate((2, 4, 4))]
    lens = calibrate_psf(pictures, scales=[2, 4, 4.01])
    np.testing.assert_allclose(lens.scales, [2, 4.005])
    alone = calibrate_psf(pictures[:2], scales=[2, 4])
    truth = LENS.kernel(4)
    assert distance(lens.kernels[1], truth) < distance(alone.kernels[1], truth)


@pytest.mark.parametrize("radii", [[], [3], [3, 3, 3]])
def test_fewer_than_two_settings_are_refused(radii):
    with pytest.raises(ValueError, match=r"pictures show \d setting.* px; it takes at least 2"):
        calibrate_psf([lamps(radius) for radius in radii])


def test_arguments_are_as_many_as_pictures():
    for arguments in ({"scales": [1]}, {"names": ["a", "b", "c"]}):
        with pytest.raises(ValueError, match=r"has \d entries; it takes one a picture, 2"):
            calibrate_psf([lamps(1), lamps(2)], **arguments)


def test_picture_that_is_none_is_named():
    with pytest.raises(TypeError, match=r"pictures\[1\]: image has dtype object"):
        calibrate_psf([lamps(1), None])
    with pytest.raises(ValueError, match=r"pictures\[0\]: image has infinite"):
        calibrate_psf([np.full((61, 61), np.inf), lamps(1)])
    with pytest.raises(ValueError, match=r"scales are .*; it takes increasing px from 0 up"):
        calibrate_psf([lamps(1), lamps(2)], scales=[-1, 2])
    for scales in ([[1, 2, 3], [4, 5]], [[1], [2]]):
        with pytest.raises(ValueError, match=r"scales (are|have) "):
            calibrate_psf([lamps(1), lamps(2)], scales=scales)


def test_family_says_what_it_was_made_from(tmp_path):
    pictures = [lamps(2), lamps(4)]
    lens = calibrate_psf(pictures, names=["near.png", "far.png"], max_scale=6.0)
    assert lens.max_scale == 6.0
    said = lens.provenance
    assert (said["made_from"], said["pictures"]) == ("point sources", 2)
    assert said["names"] == ["near.png", "far.png"]
    assert said["scales_were"] == "measured"
    np.testing.assert_allclose(said["scales"], lens.scales)
    assert {"date", "version"} <= set(said)
    lens.save(tmp_path / "lens.npz")
    assert json.dumps(MeasuredPSF.load(tmp_path / "lens.npz").provenance) == json.dumps(said)


def test_progress_is_reported_and_can_cancel():
    steps = []
    calibrate_psf([lamps(2), lamps(4)], progress=lambda step, done: steps.append(done))
    assert steps == [0.0, 0.5, 1.0]

    def cancel(step, done):
        raise Cancelled

    with pytest.raises(Cancelled):
        calibrate_psf([lamps(2), lamps(4)], progress=cancel)


@pytest.mark.parametrize("lens", [Polygon(6), Annulus(0.5)])
def test_calibrated_family_finds_a_uniform_blur_of_its_lens(lens, grass):
    blurred = simulate_defocus(grass, np.full((160, 160), 4.5), psf=lens, noise_variance=1e-6)
    settings = (1, 2, 3, 4, 5, 6, 7)
    pictures = [lamps(scale, lens=lens, noise=0.02, seed=scale) for scale in settings]
    measured = calibrate_psf(pictures, scales=settings)
    radii = estimate_candidates(blurred, psf=measured).radii[..., 0]
    assert np.median(radii) == pytest.approx(4.5, abs=0.06)
