import dask.array as da
import numpy as np
import pytest
from skimage.data import camera

from napari_defocus import restore_all_in_focus, simulate_defocus
from napari_defocus.restoration import all_in_focus
from napari_defocus.restoration.damage import unexplained_share, unrestored_share


@pytest.fixture(scope="module")
def sharp(grass):
    return 0.2 + 0.6 * grass[:128, :128]


def error(restored, sharp):
    return np.sqrt(np.mean((restored - sharp) ** 2))


def test_what_a_wrong_map_would_ruin_is_left_as_it_was(sharp, monkeypatch):
    seen = simulate_defocus(sharp, np.full(sharp.shape, 3.0), noise_variance=1e-6, rng=0)
    wrong = np.full(sharp.shape, 7.0)
    restored, fit = restore_all_in_focus(seen, wrong, return_fit=True, tv_weight=3e-5)
    assert fit.unrestored > 0.4
    untouched = fit.left_as_it_was > 0.95
    assert untouched.any()
    changed = np.abs(restored - seen)
    assert changed[untouched].mean() < 0.1 * changed[fit.left_as_it_was < 0.3].mean()
    monkeypatch.setattr(all_in_focus, "unrestored_share", lambda picture, *_: 0 * picture[..., 0])
    ruined = restore_all_in_focus(seen, wrong, tv_weight=3e-5)
    assert error(restored, sharp) < 0.8 * error(ruined, sharp)


def test_a_stack_and_tiles_say_what_was_left_of_each_plane(sharp):
    seen = simulate_defocus(sharp, np.full(sharp.shape, 3.0), noise_variance=1e-6, rng=0)
    planes, radii = np.stack([seen, seen]), np.empty((2, 128, 128))
    radii[0], radii[1] = 3, 7
    _, fit = restore_all_in_focus(planes, radii, axes="zyx", tv_weight=3e-5, return_fit=True)
    right, wrong = fit.unrestored
    assert (right < 0.01, wrong > 0.4) == (True, True)
    _, whole = restore_all_in_focus(seen, radii[1], tv_weight=3e-5, return_fit=True)
    np.testing.assert_allclose(fit.left_as_it_was[1], whole.left_as_it_was, atol=1e-6)
    wide, sevens = np.tile(seen, (1, 3)), np.full((128, 384), 7.0)
    options = {"tv_weight": 3e-5, "return_fit": True}
    _, whole = restore_all_in_focus(wide, sevens, **options)
    lazy = da.from_array(wide, chunks=128)
    _, of_tiles = restore_all_in_focus(lazy, sevens, block_size=256, **options)
    assert of_tiles.left_as_it_was.numblocks == (1, 2)
    assert float(of_tiles.unrestored) == pytest.approx(whole.unrestored, abs=0.08)


def test_a_right_map_leaves_nothing(sharp):
    seen = simulate_defocus(sharp, np.full(sharp.shape, 3.0), noise_variance=1e-6, rng=0)
    restored, fit = restore_all_in_focus(seen, np.full(sharp.shape, 3.0), return_fit=True)
    assert fit.unrestored < 0.01
    assert error(restored, sharp) < error(seen, sharp)


def test_only_the_surroundings_of_impossible_values_are_left():
    restored = np.full((200, 200, 1), 0.5, np.float32)
    restored[40:60:2, 40:60] = 1.4
    left = unrestored_share(restored, np.full((200, 200), 3.0, np.float32), 1.0)
    assert left[50, 50] > 0.95
    assert left[100:].max() < 0.01


def test_where_ripples_say_that_the_radius_is_wrong_is_left_and_the_rest_is_restored():
    """A sharp half that passes for blurred, under noise that would hide a misfit."""
    sharp = camera()[60:220, 150:330].astype(np.float32) / 255
    radii = np.full(sharp.shape, 8.0)
    radii[:, 90:] = 2.0
    seen = simulate_defocus(sharp, radii, noise_variance=3e-5, rng=0)
    wrong, sure = np.full(sharp.shape, 8.0), np.full(sharp.shape, 0.9)
    _, fit = restore_all_in_focus(seen, wrong, confidence=sure, return_fit=True)
    assert fit.left_as_it_was[:, 110:].mean() > 0.6
    assert fit.left_as_it_was[:, :60].mean() < 0.01
    _, fit = restore_all_in_focus(seen, radii, confidence=sure, return_fit=True)
    assert fit.unrestored < 0.01


def test_noise_is_no_ripple():
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.02, (100, 100, 3)).astype(np.float32)
    left = unexplained_share(noise, 0.5 + noise, 4e-4, 1.0)
    assert left.mean() < 0.05
    waves = 0.5 + 0.1 * np.sin(np.arange(100, dtype=np.float32) / 2)[:, None, None] + noise
    rings = np.float32(0.5) * (waves - 0.5)
    assert unexplained_share(rings, waves, 4e-4, 1.0).mean() > 0.9
