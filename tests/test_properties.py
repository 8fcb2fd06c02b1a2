"""What no picture may change: exposure, offset, turns, and grey given as colour."""

from typing import NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from napari_defocus import estimate_candidates, simulate_defocus

NOISE = 1e-5

few_examples = settings(max_examples=12, deadline=None, derandomize=True)


class Texture(NamedTuple):
    """What a picture is made from: its sides, its blur in px, and what is on it."""

    height: int
    width: int
    radius: float
    kind: str
    seed: int

    def picture(self):
        """Draw it, blurred, with noise of variance 1e-5: (H, W) float32 around [0, 1]."""
        rng = np.random.default_rng(self.seed)
        shape = self.height, self.width
        sharp = {
            "fractal": lambda: _fractal(rng.standard_normal(shape)),
            "spots": lambda: gaussian_filter((rng.random(shape) < 0.05).astype(float), 0.7),
            "patches": lambda: np.sign(_fractal(rng.standard_normal(shape))),
        }[self.kind]()
        sharp = 0.5 + 0.15 * (sharp - sharp.mean()) / sharp.std()
        radii = np.full(shape, self.radius)
        return simulate_defocus(sharp, radii, noise_variance=NOISE, rng=self.seed)


def _fractal(white):
    frequency = np.hypot(*np.meshgrid(*map(np.fft.fftfreq, white.shape), indexing="ij"))
    frequency[0, 0] = 1
    return np.fft.ifft2(np.fft.fft2(white) / frequency).real


def _transposed(values):
    return values.swapaxes(0, 1)


def _turned_back(values):
    return np.rot90(values, 3)


textures = st.builds(
    Texture,
    height=st.integers(60, 90),
    width=st.integers(60, 90),
    radius=st.floats(1, 7),
    kind=st.sampled_from(["fractal", "spots", "patches"]),
    seed=st.integers(0, 2**32 - 1),
)


def candidates(picture, noise_variance=NOISE, **options):
    return estimate_candidates(picture, noise_variance=noise_variance, **options)


def assert_alike(found, expected, turn=lambda values: values):
    """Curves but for a constant, and radii within 0.01 px, are the same in nearly all windows.

    Where two scales are equally likely, rounding may swap them, and with them the dispersion.
    """
    relative, expected_relative = (
        curve - curve.max(axis=2, keepdims=True) for curve in (found.curve, turn(expected.curve))
    )
    same_curve = (np.abs(relative - expected_relative) < 0.05).all(axis=2)
    same = np.isclose(found.radii, turn(expected.radii), rtol=0, atol=0.01, equal_nan=True)
    # Places along the border share their window, which counts once.
    share = 1 / found.places_of_window()
    assert np.average(same_curve, weights=share) > 0.96
    assert np.average(same[..., 0], weights=share) > 0.96
    assert np.average(same.all(axis=2), weights=share) > 0.92


@given(textures, st.floats(0.05, 20))
@few_examples
def test_exposure_changes_no_radius(texture, exposure):
    picture = texture.picture()
    exposed = candidates(np.float32(exposure) * picture, intensity_range=(0, exposure))
    assert_alike(exposed, candidates(picture))


@given(textures, st.floats(-0.5, 2))
@few_examples
def test_offset_changes_nothing(texture, offset):
    picture = texture.picture()
    # Single precision rounds gradients to 1e-7: more noise keeps that out of sight.
    noise = 1e-4
    span = offset, offset + 1
    moved = candidates(picture + np.float32(offset), noise, intensity_range=span)
    assert_alike(moved, candidates(picture, noise))


@given(textures)
@few_examples
def test_turned_pictures_have_the_turned_candidates(texture):
    picture = texture.picture()
    upright = candidates(picture)
    for turn in (np.flipud, np.fliplr, _transposed, np.rot90, _turned_back):
        assert_alike(candidates(turn(picture)), upright, turn)


@given(textures)
@few_examples
def test_grey_given_as_colour_has_the_same_candidates(texture):
    grey = texture.picture()
    expected = candidates(grey)
    for channels in ([grey] * 3, [*[grey] * 3, np.ones_like(grey)]):
        assert_alike(candidates(np.dstack(channels)), expected)


@given(textures)
@few_examples
def test_eight_bits_of_grey_and_of_opaque_colour_are_the_same(texture):
    grey = np.clip(np.rint(255 * texture.picture()), 0, 255).astype(np.uint8)
    expected = candidates(grey)
    rgba = np.dstack([grey, grey, grey, np.full_like(grey, 255)])
    assert_alike(candidates(rgba), expected)
    assert_alike(candidates((grey / 255).astype(np.float32)), expected)
