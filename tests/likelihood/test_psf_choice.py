"""The lens that a picture shows, if it can tell: psf="auto"."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from napari_defocus import (
    Annulus,
    AutomaticPSF,
    Disc,
    Gaussian,
    KernelFunction,
    compare_psf,
    estimate_blur_map,
    estimate_candidates,
    psf_from_text,
    sharpest_plane,
    simulate_defocus,
)
from napari_defocus.psf.domain import limited

RAMP = np.broadcast_to(np.linspace(2, 6.5, 160), (160, 160))


def seen(texture, psf, noise_variance=1e-6):
    return simulate_defocus(texture, RAMP, psf=psf, noise_variance=noise_variance, rng=0)


@pytest.mark.parametrize(
    "lens", [Disc(8.0), Gaussian(8.0), Annulus(0.3, 8.0), Annulus(0.5, 8.0)], ids=repr
)
@pytest.mark.parametrize("texture", ["clouds", "grass"])
def test_lens_of_a_textured_picture_is_found(request, texture, lens):
    picture = seen(request.getfixturevalue(texture), lens)
    candidates = estimate_candidates(picture, psf="auto")
    assert candidates.psf == lens
    assert limited(candidates.psf_choice.psf, 8.0) == lens
    assert candidates.psf_choice.found
    assert str(candidates.psf_choice).endswith(", found from the picture")


def test_map_is_that_of_the_chosen_lens_bit_for_bit(clouds):
    picture = seen(clouds, Annulus(0.5, 8.0))
    chosen = estimate_blur_map(picture, psf="auto")
    np.testing.assert_array_equal(chosen, estimate_blur_map(picture, psf=Annulus(0.5, 8.0)))
    assert np.abs(chosen - RAMP).mean() < 0.2
    assert np.abs(estimate_blur_map(picture) - RAMP).mean() > 1


def test_disc_on_a_soft_scene_is_taken_for_no_gaussian(clouds):
    picture = seen(gaussian_filter(clouds, 1.0), Disc(8.0), 1e-7)
    found = compare_psf(picture, [Gaussian(8.0), Disc(8.0)])
    assert found.best == Disc(8.0)
    assert found.rows[0].softness == pytest.approx(1.0)
    assert estimate_candidates(picture, psf="auto").psf == Disc(8.0)


def test_picture_that_cannot_tell_keeps_the_disc(clouds):
    sharp = estimate_candidates(clouds, psf="auto")
    flat = estimate_candidates(np.full((90, 80), 0.5), psf="auto")
    for candidates in (sharp, flat):
        assert candidates.psf == Disc(8.0)
        assert not candidates.psf_choice.found
        assert str(candidates.psf_choice) == "disc; the picture cannot tell"


def test_what_is_not_known_has_no_vote(clouds):
    picture = seen(clouds, Annulus(0.5, 8.0))
    picture[:, 100:] = np.nan
    assert estimate_candidates(picture, psf="auto").psf == Annulus(0.5, 8.0)


def test_largest_radius_is_that_of_the_chosen_lens(clouds):
    picture = seen(clouds, Annulus(0.5, 8.0))
    candidates = estimate_candidates(picture, psf=AutomaticPSF(10.0))
    assert candidates.psf == Annulus(0.5, max_radius=10.0)
    assert psf_from_text("auto", max_scale=10.0) == AutomaticPSF(10.0)


def test_stack_has_one_lens(clouds):
    pytest.importorskip("dask")
    stack = np.stack(
        [clouds, seen(clouds, Annulus(0.5, 8.0)), seen(clouds[::-1], Annulus(0.5, 8.0))]
    )
    candidates = estimate_candidates(stack, psf="auto", axes="zyx")
    assert candidates.psf == Annulus(0.5, 8.0)
    assert candidates.psf_choice.found
    maps = estimate_blur_map(stack, psf="auto", axes="zyx")
    np.testing.assert_array_equal(maps, estimate_blur_map(stack, psf=Annulus(0.5, 8.0), axes="zyx"))


def test_lens_that_is_not_chosen_yet_has_no_kernels(clouds):
    with pytest.raises(ValueError, match="psf is 'auto'"):
        simulate_defocus(clouds, RAMP, psf=AutomaticPSF())
    with pytest.raises(ValueError, match="psf is 'auto'"):
        sharpest_plane(np.stack([clouds] * 3), psf=AutomaticPSF())
    with pytest.raises(TypeError, match="psf is 'automatic'; it takes a PSF family"):
        estimate_candidates(clouds, psf="automatic")


def test_families_of_ones_own_are_compared_too(clouds):
    own = KernelFunction(Annulus(0.5, 8.0).kernel)
    assert compare_psf(seen(clouds, Annulus(0.5, 8.0)), [Disc(8.0), own]).best == own


def test_camera_s_own_softness_counts(clouds):
    picture = gaussian_filter(seen(clouds, Disc(8.0), 0), 1.2)
    row = compare_psf(picture, [Disc(8.0)], camera_softness=1.2).rows[0]
    assert row.softness == 1.2
    assert row.median_scale == pytest.approx(4.2, abs=0.4)
    with pytest.raises(ValueError, match="camera_softness is -1"):
        compare_psf(picture, [Disc(8.0)], camera_softness=-1)
