import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from skimage import data

from napari_defocus import (
    Annulus,
    Cancelled,
    Disc,
    Polygon,
    cautious_blur_map,
    confidence_map,
    estimate_candidates,
    estimate_noise_variance,
    label_blur_map,
    restore_all_in_focus,
    simulate_defocus,
)
from napari_defocus.restoration import all_in_focus
from napari_defocus.restoration.all_in_focus import usual_tv_weight

INNER = np.s_[10:-10, 10:-10]


def psnr(picture, truth):
    return -10 * np.log10(np.mean((picture - truth)[INNER] ** 2))


@pytest.fixture(scope="module")
def coffee():
    """A colour picture, sharp at its pixels: (60, 72, 3), [0, 1]."""
    picture = data.coffee()[60:180, 100:244] / 255
    return picture.reshape(60, 2, 72, 2, 3).mean(axis=(1, 3)).astype(np.float32)


@pytest.fixture(scope="module")
def radii():
    row, column = np.indices((60, 72))
    return 1.0 + 2.5 * column / 72 + 1.0 * row / 60


@pytest.fixture(scope="module")
def blurred(coffee, radii):
    return simulate_defocus(coffee, radii, noise_variance=1e-6, rng=0)


@pytest.fixture(scope="module")
def restored(blurred, radii):
    return restore_all_in_focus(blurred, radii)


def test_true_map_brings_the_sharp_picture_back(coffee, blurred, restored):
    assert restored.shape == coffee.shape
    assert restored.dtype == np.float32
    assert restored.min() >= 0
    assert restored.max() <= 1
    assert psnr(restored, coffee) > psnr(blurred, coffee) + 7


def test_estimated_map_is_nearly_as_good(coffee, blurred):
    candidates = estimate_candidates(blurred)
    blur_map = label_blur_map(candidates, blurred)
    sharp = restore_all_in_focus(
        blurred,
        cautious_blur_map(candidates, blur_map),
        confidence=confidence_map(candidates, blur_map),
    )
    assert psnr(sharp, coffee) > psnr(blurred, coffee) + 4


def test_no_ringing_at_the_border(coffee, blurred, restored):
    """The picture beyond the border is not known: errors there must not be much larger."""
    error = np.abs(restored - coffee).mean(axis=2)
    border = np.ones(error.shape, bool)
    border[5:-5, 5:-5] = False
    before = np.abs(blurred - coffee).mean(axis=2)
    assert error[border].mean() < before[border].mean()
    assert error[border].mean() < 3 * error[~border].mean()


def test_more_noise_is_smoothed_more(coffee, radii):
    noisy = simulate_defocus(coffee, radii, noise_variance=1e-4, rng=0)
    sharp = restore_all_in_focus(noisy, radii)
    assert psnr(sharp, coffee) > psnr(noisy, coffee) + 1.5
    rough = restore_all_in_focus(noisy, radii, tv_weight=1e-5)
    assert psnr(sharp, coffee) > psnr(rough, coffee) + 3


def test_sharp_picture_stays_as_it_is(coffee):
    sharp = restore_all_in_focus(coffee, np.zeros(coffee.shape[:2]), noise_variance=1e-7)
    assert np.abs(sharp - coffee).max() < 0.01


def test_grey_is_restored_like_the_channels_of_grey_colour(blurred, radii):
    grey = blurred[..., 1]
    alone = restore_all_in_focus(grey, radii, noise_variance=1e-6, tv_weight=1e-4)
    assert alone.shape == grey.shape
    same = np.repeat(grey[..., None], 3, axis=2)
    # Of three equal channels the joint variation is sqrt(3) that of one, the data three times.
    weight = 3**0.5 * 1e-4
    colour = restore_all_in_focus(same, radii, noise_variance=1e-6, tv_weight=weight)
    assert np.abs(colour[..., 0] - alone)[INNER].mean() < 0.003


def test_integers_are_restored_like_floats(blurred, radii):
    deep = np.rint(65535 * blurred.clip(0, 1)).astype(np.uint16)
    of_floats = restore_all_in_focus(deep / np.float32(65535), radii, noise_variance=1e-6)
    of_integers = restore_all_in_focus(deep, radii, noise_variance=1e-6)
    np.testing.assert_allclose(of_integers, of_floats, atol=1e-3)


def test_intensity_range_says_what_is_white(blurred, radii):
    wide = restore_all_in_focus(
        4000 * blurred, radii, intensity_range=(0, 4000), noise_variance=1e-6
    )
    narrow = restore_all_in_focus(blurred, radii, noise_variance=1e-6)
    np.testing.assert_allclose(wide, narrow, atol=1e-3)


def test_opacity_comes_back_and_transparent_pixels_are_no_data(coffee, blurred, radii):
    opacity = np.ones((60, 72, 1), np.float32)
    opacity[25:45, 30:50] = 0
    opacity[0, 0] = 0.25
    spoilt = np.where(opacity == 0, 1.0, blurred)
    sharp = restore_all_in_focus(
        np.concatenate([spoilt, opacity], axis=2), radii, noise_variance=1e-6
    )
    assert sharp.shape == (60, 72, 4)
    np.testing.assert_array_equal(sharp[..., 3:], opacity)
    around = np.s_[47:55, 52:60]
    assert np.abs(sharp[around][..., :3] - coffee[around]).mean() < 0.05


def test_picture_is_restored_in_linear_light(coffee, radii):
    from napari_defocus.core.image import decode_srgb, encode_srgb

    light = simulate_defocus(decode_srgb(coffee), radii, noise_variance=1e-6, rng=0)
    seen = encode_srgb(light.clip(0, 1))
    linear = restore_all_in_focus(seen, radii, linearize="srgb", noise_variance=1e-6)
    as_it_is = restore_all_in_focus(seen, radii, noise_variance=1e-6)
    assert psnr(linear, coffee) > psnr(as_it_is, coffee) + 0.5


def test_other_lenses_are_taken_away(coffee, radii):
    blades = Polygon(5)
    seen = simulate_defocus(coffee, radii, psf=blades, noise_variance=1e-6, rng=0)
    right = restore_all_in_focus(seen, radii, psf=blades, noise_variance=1e-6)
    wrong = restore_all_in_focus(seen, radii, psf=Disc(), noise_variance=1e-6)
    assert psnr(right, coffee) > psnr(seen, coffee) + 7
    assert psnr(right, coffee) > psnr(wrong, coffee) + 2


def test_wide_blur_fits_into_the_tiles(clouds):
    """A kernel of 43 px, more than half of the usual tile."""
    picture, radius = clouds[:64, :70], np.full((64, 70), 21.0)
    seen = simulate_defocus(picture, radius, psf=Disc(22.0), noise_variance=1e-7, rng=0)
    sharp = restore_all_in_focus(seen, radius, psf=Disc(22.0), noise_variance=1e-7)
    assert psnr(sharp, picture) > psnr(seen, picture) + 1


def test_clipped_highlight_makes_no_ring(clouds):
    light = 0.3 * clouds[40:104, 40:104]
    light[30:34, 30:34] = 5.0
    radius = np.full(light.shape, 4.0)
    seen = simulate_defocus(light, radius, noise_variance=1e-6, rng=0).clip(0, 1)
    sharp = restore_all_in_focus(seen, radius, noise_variance=1e-6)
    ring = np.zeros(light.shape, bool)
    ring[18:46, 18:46] = True
    ring[25:39, 25:39] = False
    assert np.abs(sharp - light)[ring].mean() < 0.02


def test_confidence_protects_where_the_map_is_wrong(coffee, monkeypatch):
    """Twice the radius on one half, with no confidence there, and no other protection."""
    monkeypatch.setattr(all_in_focus, "unrestored_share", lambda sharp, *_: 0 * sharp[..., 0])
    true = np.full(coffee.shape[:2], 2.5)
    seen = simulate_defocus(coffee, true, noise_variance=1e-6, rng=0)
    wrong, sure = true.copy(), np.full(true.shape, 0.95)
    wrong[:, 36:], sure[:, 36:] = 5.0, 0.2
    trusting = restore_all_in_focus(seen, wrong, noise_variance=1e-6)
    careful = restore_all_in_focus(seen, wrong, noise_variance=1e-6, confidence=sure)
    half = np.s_[10:-10, 44:-10]
    errors = [np.mean((picture - coffee)[half] ** 2) for picture in (trusting, careful)]
    assert errors[1] < 0.6 * errors[0]


@pytest.fixture(scope="module")
def photograph(astronaut):
    """What a soft lens with a hole in its pupil makes of a portrait, at 3 px."""
    soft = gaussian_filter(astronaut, (0.6, 0.6, 0))
    uniform = np.full(astronaut.shape[:2], 3.0)
    return simulate_defocus(soft, uniform, psf=Annulus(0.5), noise_variance=1e-6, rng=0)


@pytest.mark.parametrize("wrong", [0.85, 1.0, 1.15])
def test_another_lens_and_a_wrong_map_do_no_harm(astronaut, photograph, wrong):
    """Soft by 0.6 px, another PSF, a map off by 15 %: not worse than the input."""
    radius = np.full(astronaut.shape[:2], 3.0 * wrong)
    sure = np.full(radius.shape, 0.7)
    sharp, fit = restore_all_in_focus(photograph, radius, confidence=sure, return_fit=True)
    assert fit.misfit > 0
    assert psnr(sharp, astronaut) > psnr(photograph, astronaut) + 0.2


def test_what_fits_its_map_is_said_to_fit(blurred, radii, restored):
    sharp, fit = restore_all_in_focus(blurred, radii, return_fit=True)
    np.testing.assert_array_equal(sharp, restored)
    assert fit.misfit == 0
    assert fit.noise_variance == estimate_noise_variance(blurred)
    assert fit.tv_weight == pytest.approx(usual_tv_weight(fit.noise_variance, 3), rel=1e-4)


def test_misfit_smooths_more_unless_the_smoothing_is_given(photograph):
    radius, sure = np.full((2, 160, 160), [[[2.55]], [[0.7]]])
    found = restore_all_in_focus(photograph, radius, confidence=sure, return_fit=True)[1]
    assert found.tv_weight > 10 * usual_tv_weight(found.noise_variance, 3)
    given = restore_all_in_focus(
        photograph, radius, confidence=sure, tv_weight=1e-4, return_fit=True
    )[1]
    assert given.misfit > 0
    assert given.tv_weight == pytest.approx(1e-4)


def test_noise_that_would_hide_a_misfit_counts_as_one(coffee, radii):
    seen = simulate_defocus(coffee, radii, noise_variance=1e-4, rng=0)
    assert restore_all_in_focus(seen, radii, return_fit=True)[1].misfit > 0


def test_full_confidence_changes_little(blurred, radii, restored):
    sure = restore_all_in_focus(blurred, radii, confidence=np.ones(radii.shape))
    assert np.abs(sure - restored).mean() < 1e-3


def test_same_input_gives_the_same_result(blurred, radii, restored):
    np.testing.assert_array_equal(restore_all_in_focus(blurred, radii), restored)


def test_constant_picture_stays_constant():
    flat = restore_all_in_focus(np.full((30, 40, 3), 0.5), np.full((30, 40), 3.0))
    np.testing.assert_allclose(flat, 0.5, atol=1e-3)


def test_progress_grows_and_cancels(blurred, radii):
    seen = []
    restore_all_in_focus(blurred, radii, progress=lambda step, done: seen.append(done))
    assert len(seen) > 10
    assert seen == sorted(seen)
    assert seen[-1] <= 1

    def cancel(step, done):
        if done > 0.2:
            raise Cancelled

    with pytest.raises(Cancelled):
        restore_all_in_focus(blurred, radii, progress=cancel)


PICTURE, MAP = np.zeros((8, 9)), np.ones((8, 9))


@pytest.mark.parametrize(
    ("arguments", "keywords", "error", "named"),
    [
        (("text", MAP), {}, TypeError, "image"),
        ((PICTURE, MAP[:4]), {}, ValueError, "blur_map has shape"),
        ((PICTURE, MAP + 1j), {}, TypeError, "blur_map"),
        ((PICTURE, 90 * MAP), {}, ValueError, "blur_map has scales"),
        ((PICTURE, np.nan * MAP), {}, ValueError, "blur_map"),
        ((PICTURE, MAP), {"psf": 3}, TypeError, "psf"),
        ((PICTURE, MAP), {"noise_variance": -1.0}, ValueError, "noise_variance"),
        ((PICTURE, MAP), {"tv_weight": 0.0}, ValueError, "tv_weight"),
        ((PICTURE, MAP), {"tv_weight": np.inf}, ValueError, "tv_weight"),
        ((PICTURE, MAP), {"linearize": "gamma"}, ValueError, "linearize"),
        ((PICTURE, MAP), {"confidence": MAP[:4]}, ValueError, "confidence has shape"),
        ((PICTURE, MAP), {"confidence": 2 * MAP}, ValueError, "confidence has values"),
        ((PICTURE, MAP), {"confidence": np.full((8, 9), "a")}, TypeError, "confidence"),
    ],
)
def test_bad_input_is_named(arguments, keywords, error, named):
    with pytest.raises(error, match=named):
        restore_all_in_focus(*arguments, **keywords)


@pytest.mark.parametrize("noise_variance", [1e-4, 3e-5, 1e-6])
def test_half_the_exposure_is_restored_to_half_the_light(noise_variance):
    sharp = 0.8 * np.asarray(data.camera()[100:220, 100:230], float) / 255
    truth = np.full(sharp.shape, 3.0)
    seen = simulate_defocus(sharp, truth, noise_variance=noise_variance, rng=0)
    full, fit = restore_all_in_focus(seen, truth + 0.3, return_fit=True)
    half, fit_of_half = restore_all_in_focus(0.5 * seen, truth + 0.3, return_fit=True)
    np.testing.assert_allclose(2 * half, full, atol=1e-4)
    assert 4 * fit_of_half.misfit == pytest.approx(fit.misfit, rel=1e-3)
