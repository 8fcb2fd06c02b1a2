"""Blur of any size: levels of averaged pixels, joined to one curve."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve
from skimage import data

from napari_defocus import (
    Disc,
    Gaussian,
    KernelFunction,
    confidence_map,
    estimate_candidates,
    explain_pixel,
    label_blur_map,
)
from napari_defocus.core.image import prepare_image
from napari_defocus.likelihood.averaged_pixels import halved_without, level_count
from napari_defocus.likelihood.scale_space import joined_scales

SIDE = 680
NOISE = 1e-6


@pytest.fixture(scope="module")
def mosaic():
    """A sharp picture that is large enough for four levels: (680, 680)."""
    picture = np.asarray(data.camera(), np.float64) / 255
    whole = np.block([[picture, picture[:, ::-1]], [picture[::-1], picture[::-1, ::-1]]])
    return whole[150 : 150 + SIDE, 150 : 150 + SIDE]


def blurred(picture, kernel):
    reach = len(kernel) // 2
    return fftconvolve(np.pad(picture, reach, mode="reflect"), kernel, mode="valid")


def seen(picture):
    noise = np.random.default_rng(0).normal(0, NOISE**0.5, picture.shape)
    return (picture + noise).astype(np.float32)


@pytest.mark.parametrize("radius", [5.0, 12.0, 20.0, 40.0])
def test_wide_blur_is_measured_in_px(mosaic, radius):
    picture = seen(blurred(mosaic, Disc().kernel(radius)))
    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture)
    assert np.median(np.abs(blur_map - radius)) < 0.05 * radius
    assert np.median(np.abs(candidates.radii[..., 0] - radius)) < 0.05 * radius
    assert np.median(confidence_map(candidates, blur_map)) > 0.4


def test_other_lenses_have_levels_too(mosaic):
    picture = seen(blurred(mosaic, Gaussian().kernel(20.0)))
    candidates = estimate_candidates(picture, psf=Gaussian())
    assert np.median(label_blur_map(candidates, picture)) == pytest.approx(20, rel=0.1)

    def kernel(radius):
        return Disc().kernel(radius)

    picture = seen(blurred(mosaic, Disc().kernel(14.0)))
    candidates = estimate_candidates(picture, psf=KernelFunction(kernel, 24.0), search="lattice")
    assert np.median(label_blur_map(candidates, picture)) == pytest.approx(14, rel=0.06)


def test_a_sharp_thing_before_a_wide_blur_is_kept(mosaic):
    rows, columns = np.indices(mosaic.shape)
    thing = (rows - 300) ** 2 + (columns - 350) ** 2 < 60**2
    ground = blurred(np.roll(mosaic, 200, axis=1), Disc().kernel(20.0))
    picture = seen(np.where(thing, mosaic, ground))
    blur_map = label_blur_map(estimate_candidates(picture), picture)
    inside = (rows - 300) ** 2 + (columns - 350) ** 2 < 50**2
    assert np.mean(blur_map[inside] < 3) > 0.97
    assert np.mean(blur_map[thing] < 3) > 0.97
    away = np.hypot(rows - 300, columns - 350) - 60
    assert np.median(blur_map[away > 80]) == pytest.approx(20, rel=0.1)
    for low, high in ((0, 10), (10, 40)):
        beside = (away > low) & (away <= high)
        assert np.abs(blur_map[beside] - 20).mean() < 0.6


@pytest.mark.parametrize(
    ("widths", "radius", "beside"), [((6, 12), 12.0, 1.7), ((10, 20), 20.0, 7)]
)
def test_thin_things_before_a_wide_blur_are_shown(mosaic, widths, radius, beside):
    rows, columns = np.indices((340, 340))
    bars = [
        np.abs(columns - at - 0.1 * rows) < width / 2
        for at, width in zip((100, 220), widths, strict=True)
    ]
    thing = np.any(bars, axis=0)
    ground = blurred(np.roll(mosaic, 200, axis=1), Disc().kernel(radius))[:340, :340]
    picture = seen(np.where(thing, mosaic[200:540, 200:540], ground))
    blur_map = label_blur_map(estimate_candidates(picture), picture)
    for bar in bars:
        assert np.mean(blur_map[bar] < 2) > 0.9
    assert np.abs(blur_map[~thing] - radius).mean() < beside


def test_noise_that_is_no_white_noise_is_not_taken_for_details(mosaic):
    noise = gaussian_filter(np.random.default_rng(0).normal(size=mosaic.shape), 1.5)
    light = blurred(mosaic, Disc().kernel(20.0)) + 3e-5**0.5 / noise.std() * noise
    picture = light.astype(np.float32)
    blur_map = label_blur_map(estimate_candidates(picture, noise_variance=3e-5), picture)
    assert np.mean(np.abs(blur_map - 20) > 5) < 0.05


def test_noise_with_grains_of_many_pixels_is_not_taken_for_details(mosaic):
    coarse = gaussian_filter(np.random.default_rng(0).normal(size=mosaic.shape), 4)
    noise = coarse / coarse.std() + np.random.default_rng(1).normal(size=mosaic.shape)
    light = blurred(mosaic, Disc().kernel(20.0)) + 1e-5**0.5 * noise
    picture = light.astype(np.float32)
    blur_map = label_blur_map(estimate_candidates(picture, noise_variance=2e-5), picture)
    assert np.mean(np.abs(blur_map - 20) > 5) < 0.05


def test_what_is_sharp_has_no_part_in_what_coarser_levels_see(mosaic):
    picture = prepare_image(mosaic[:200, :200].astype(np.float32), (0, 1))
    hidden = np.zeros((200, 200), bool)
    hidden[60:100, 80:120] = True
    painted = picture.luminance.copy()
    painted[hidden] = np.random.default_rng(0).uniform(size=hidden.sum())
    (one, there), (other, _) = (
        halved_without(each, hidden) for each in (picture, replace(picture, luminance=painted))
    )
    np.testing.assert_array_equal(there, hidden[::2, ::2])
    assert one.weight[there].max() == 0
    assert one.weight[:10].min() == 1
    np.testing.assert_array_equal(one.luminance[~there], other.luminance[~there])


def test_small_blur_is_what_one_level_says(mosaic):
    picture = seen(blurred(mosaic, Disc().kernel(2.0))[:400, :400])
    one, all_ = (
        label_blur_map(estimate_candidates(picture, psf=psf), picture)
        for psf in (Disc(8.0), Disc())
    )
    assert np.abs(one - all_).mean() < 0.02


@dataclass(frozen=True)
class Largest:
    """How much a picture of a side tells."""

    side: int
    radius: float


@pytest.mark.parametrize(
    "case", [Largest(163, 8), Largest(164, 16), Largest(328, 32), Largest(656, 64)], ids=repr
)
def test_the_largest_radius_that_is_looked_for_follows_the_picture(case):
    picture = np.random.default_rng(0).uniform(size=(case.side, 660)).astype(np.float32)
    candidates = estimate_candidates(picture, stride=16)
    assert candidates.psf == Disc(case.radius)
    assert candidates.scales[-1] == pytest.approx(case.radius)
    assert candidates.curve.shape[2] == len(candidates.scales)


def test_a_limit_by_hand_holds(mosaic):
    picture = seen(blurred(mosaic, Disc().kernel(20.0)))
    candidates = estimate_candidates(picture, psf=Disc(24.0))
    assert candidates.scales[-1] == pytest.approx(24, abs=0.4)
    assert np.median(label_blur_map(candidates, picture)) == pytest.approx(20, rel=0.06)


def test_scales_are_finer_where_radii_are_small():
    scales = joined_scales(64.0, 41, 4)
    steps = np.diff(scales)
    np.testing.assert_allclose(scales[[0, 80, 120, 160, 200]], [0, 8, 16, 32, 64])
    assert (np.diff(steps) > -1e-9).all()
    assert steps[-1] == pytest.approx(0.8)
    assert level_count((2000, 100), 41, 64.0) == 1


def test_one_pixel_is_explained_by_all_levels(mosaic):
    picture = seen(blurred(mosaic, Disc().kernel(20.0)))
    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture)
    told = explain_pixel(candidates, 300, 340, blur_map=blur_map, image=picture)
    assert told.scales[-1] == 64
    assert told.best == pytest.approx(20, rel=0.15)


def test_what_is_not_known_has_no_say_at_any_level(mosaic):
    picture = seen(blurred(mosaic, Disc().kernel(12.0)))[:400, :400].astype(np.float32)
    picture[100:300, 100:300] = np.nan
    candidates = estimate_candidates(picture)
    blur_map = label_blur_map(candidates, picture)
    around = np.isfinite(picture)
    assert np.median(np.abs(blur_map - 12)[around]) < 1
    sure = confidence_map(candidates, blur_map)
    assert sure[180:220, 180:220].max() < 0.2
