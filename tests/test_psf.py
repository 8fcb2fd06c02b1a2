import numpy as np
import pytest

from napari_defocus import Disc, PSFFamily

RADII = [0.0, 0.3, 0.5, 0.51, 0.7, 1.0, 1.5, 2.37, 3.0, 4.5, 6.66, 8.0]


def supersampled(radius, reach, finer=200):
    """The disc's share of every pixel, by counting finer x finer points a pixel."""
    points = (np.arange((2 * reach + 1) * finer) + 0.5) / finer - reach - 0.5
    inside = points[:, None] ** 2 + points**2 <= radius**2
    side = 2 * reach + 1
    return inside.reshape(side, finer, side, finer).mean(axis=(1, 3))


@pytest.mark.parametrize("radius", RADII)
def test_kernel_sums_to_one_and_is_nowhere_negative(radius):
    kernel = Disc().kernel(radius)
    assert kernel.shape[0] == kernel.shape[1]
    assert kernel.shape[0] % 2 == 1
    np.testing.assert_allclose(kernel.sum(), 1, rtol=1e-12)
    assert kernel.min() > -1e-15  # rounding


@pytest.mark.parametrize("radius", RADII)
def test_kernel_is_the_same_after_flips_and_transposition(radius):
    kernel = Disc().kernel(radius)
    for turned in (kernel[::-1], kernel[:, ::-1], kernel.T):
        np.testing.assert_allclose(turned, kernel, atol=1e-14)


@pytest.mark.parametrize("radius", [0.51, 0.7, 1.0, 1.5, 2.37, 4.5, 8.0])
def test_kernel_holds_the_area_that_a_disc_covers(radius):
    kernel = Disc().kernel(radius)
    area = supersampled(radius, kernel.shape[0] // 2)
    # The disc's whole area is 1; counting 200 x 200 points a pixel is good to 1e-3 of it.
    assert np.abs(kernel - area / (np.pi * radius**2)).sum() < 1e-3


@pytest.mark.parametrize("radius", [0.0, 0.1, 0.49, 0.5])
def test_radius_up_to_half_a_pixel_is_a_point(radius):
    np.testing.assert_allclose(Disc().kernel(radius), [[1]])


def test_kernel_changes_smoothly_with_the_radius():
    # No pixel's weight moves by more than the area of the ring that was added.
    for radius in np.arange(1.0, 7.9, 0.1):
        near, far = Disc().kernel(radius), Disc().kernel(radius + 1e-4)
        edge = (len(far) - len(near)) // 2
        assert np.abs(np.pad(near, edge) - far).sum() < 1e-4 * 4.5 / radius


@pytest.mark.parametrize("radius", [0.99, 0, -3, np.nan, np.inf])
def test_largest_radius_is_a_finite_number_from_1_px_up(radius):
    with pytest.raises(ValueError, match=r"max_radius is .* takes a number from 1 px up"):
        Disc(max_radius=radius)


def test_discs_are_equal_and_hashed_by_value():
    assert Disc() == Disc(max_radius=8.0)
    assert Disc(5.0) != Disc(6.0)
    assert len({Disc(), Disc(8.0), Disc(5.0)}) == 2


def test_disc_is_a_family_and_its_domain_ends_at_the_largest_radius():
    assert isinstance(Disc(), PSFFamily)
    assert Disc(6.5).max_scale == 6.5
