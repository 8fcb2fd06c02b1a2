"""A picture that is taken apart into details of all sizes comes back as it was."""

import numpy as np
import pytest

from napari_defocus.core.threads import in_one_thread
from napari_defocus.stacks.pyramids import assembled, levels_for, noise_of_levels, pyramid


@pytest.mark.parametrize("shape", [(3, 7), (16, 17), (61, 48), (130, 95)])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_pyramid_comes_back_as_the_picture(shape, channels):
    picture = np.random.default_rng(0).random((*shape, channels))
    back = assembled(pyramid(picture, levels_for(shape)))
    np.testing.assert_allclose(back, picture, atol=1e-15)


def test_what_is_even_has_no_details():
    *details, rest = pyramid(np.full((40, 50, 1), 0.3, np.float32), 3)
    for each in details:
        np.testing.assert_allclose(each, 0, atol=1e-7)
    np.testing.assert_allclose(rest, 0.3, atol=1e-7)


def test_white_noise_has_the_variance_that_is_said_in_each_level():
    noise = np.random.default_rng(0).standard_normal((600, 600, 1))
    found = [np.var(level) for level in pyramid(noise, 4)]
    np.testing.assert_allclose(found, noise_of_levels(4), rtol=0.03)


def test_threads_do_not_change_a_bit():
    picture = np.random.default_rng(0).random((150, 90, 3)).astype(np.float32)
    with in_one_thread():
        alone = pyramid(picture, 3)
    for one, other in zip(alone, pyramid(picture, 3), strict=True):
        np.testing.assert_array_equal(one, other)
