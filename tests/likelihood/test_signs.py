"""Pictures that do not look like defocus are told; defocus, sharp or wide, is never doubted."""

import numpy as np
import pytest
from scipy.ndimage import convolve1d, rotate

from napari_defocus import estimate_candidates
from napari_defocus.likelihood.signs import one_direction


def moved(picture, length, angle):
    """Blur by motion along rows, in a picture that is turned."""
    turned = rotate(np.pad(picture, 60, mode="symmetric"), angle, reshape=False, mode="mirror")
    moving = convolve1d(turned, np.full(length, 1 / length), axis=1, mode="mirror")
    back = rotate(moving, -angle, reshape=False, mode="mirror")[60:-60, 60:-60]
    return back + np.random.default_rng(0).normal(0, 1e-3, back.shape)


@pytest.mark.parametrize("texture", ["clouds", "grass", "gravel"])
@pytest.mark.parametrize(("length", "angle"), [(7, 0), (13, 0), (13, 50), (21, 90)])
def test_motion_is_no_defocus_in_any_direction(request, texture, length, angle):
    doubt = estimate_candidates(moved(request.getfixturevalue(texture), length, angle)).doubt
    assert doubt is not None
    assert "one direction, as after motion" in doubt


@pytest.mark.parametrize("texture", ["clouds", "grass", "gravel", "astronaut"])
@pytest.mark.parametrize("radius", [0, 1, 3, 8])
@pytest.mark.parametrize("noise", [1e-6, 1e-3])
def test_defocus_is_not_doubted(request, defocused, texture, radius, noise):
    picture = defocused(request.getfixturevalue(texture), radius, noise)
    assert estimate_candidates(picture).doubt is None


@pytest.mark.parametrize("picture", ["constant", "noise", "loud noise"])
def test_nothing_to_see_is_said(picture):
    rng = np.random.default_rng(0)
    seen = {
        "constant": np.full((160, 160), 0.5),
        "noise": 0.5 + rng.normal(0, 0.02, (160, 160)),
        "loud noise": 0.5 + rng.normal(0, 0.2, (160, 160)),
    }[picture]
    doubt = estimate_candidates(seen).doubt
    assert doubt is not None
    assert "nothing in it stands out" in doubt


def test_windows_are_measured_the_same_after_a_turn(clouds, defocused):
    picture = moved(clouds, 13, 0)
    upright = estimate_candidates(picture, noise_variance=1e-6)
    turned = estimate_candidates(picture.T, noise_variance=1e-6)
    np.testing.assert_allclose(turned.strength.T, upright.strength, rtol=1e-4)
    opposite = -turned.direction[..., 0].T, turned.direction[..., 1].T
    np.testing.assert_allclose(np.stack(opposite, -1), upright.direction, atol=1e-3)


def test_pictures_are_doubted_in_the_mode_of_the_paper_too(clouds):
    candidates = estimate_candidates(moved(clouds, 13, 0), mode="paper")
    assert candidates.doubt is not None


@pytest.mark.parametrize("noise", [1e-6, 1e-4])
def test_places_agree_in_one_direction_after_motion_alone_whatever_the_noise(
    clouds, gravel, defocused, noise
):
    for texture in (clouds, gravel):
        still, moving = defocused(texture, 3, noise), moved(texture, 15, 30)
        moving += np.random.default_rng(0).normal(0, np.sqrt(noise), moving.shape)
        found = [estimate_candidates(picture, stride=8) for picture in (still, moving)]
        low, high = (one_direction(each.strength, each.direction) for each in found)
        assert low < 0.5
        assert high > 0.7
