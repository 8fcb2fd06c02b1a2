import numpy as np
import pytest
from scipy.ndimage import convolve, gaussian_filter

from napari_defocus import Annulus, Disc, Gaussian, MeasuredPSF, Polygon
from napari_defocus.forward.blur_operator import BlurOperator, half_variance_slope

FAMILIES = [
    Disc(),
    Gaussian(),
    Polygon(3, rotation=20),
    Annulus(0.6),
    MeasuredPSF([2.0, 5.0], [Polygon(5).kernel(5.0)] * 2),
]


@pytest.fixture
def drawn():
    return np.random.default_rng(0)


@pytest.mark.parametrize("psf", FAMILIES, ids=lambda psf: type(psf).__name__)
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("wide_from", [None, 0.5, 4.0])
def test_adjoint_has_the_same_weights(psf, channels, wide_from, drawn):
    largest = min(psf.max_scale, 12.0)  # kernels of 64 px take half a minute
    scales = drawn.uniform(0, largest, (37, 50)).astype(np.float32)
    blur = BlurOperator(scales, psf, channels, wide_from)
    f = drawn.standard_normal((*blur.domain, channels), np.float32)
    y = drawn.standard_normal((*blur.shape, channels), np.float32)
    there = np.vdot(blur.apply(f).astype(float), y)
    back = np.vdot(f.astype(float), blur.adjoint(y))
    norms = np.linalg.norm(blur.apply(f)) * np.linalg.norm(y)
    assert abs(there - back) < 1e-6 * norms


@pytest.mark.parametrize("psf", FAMILIES, ids=lambda psf: type(psf).__name__)
@pytest.mark.parametrize("scale", [0.0, 1.3, 3.0])
@pytest.mark.parametrize("channels", [1, 3])
def test_constant_scale_is_a_convolution(psf, scale, channels, drawn):
    picture = drawn.random((30, 41, channels), np.float32)
    blur = BlurOperator(np.full((30, 41), scale, np.float32), psf, channels)
    kernel = psf.kernel(scale)[..., None]
    expected = convolve(picture.astype(float), kernel, mode="reflect")
    np.testing.assert_allclose(blur.apply(blur.extend(picture)), expected, atol=1e-5)


def test_domain_holds_all_that_is_gathered():
    blur = BlurOperator(np.full((20, 30), 6.0, np.float32), Disc(), 1)
    weight = blur.adjoint(np.ones((20, 30, 1), np.float32))
    assert weight.sum() == pytest.approx(600, rel=1e-5)
    rows, columns = blur.inner
    assert (rows.stop - rows.start, columns.stop - columns.start) == (20, 30)
    assert rows.start >= 6 <= blur.domain[0] - rows.stop


def test_spreading_in_bands_misses_no_row():
    """More rows than a band has, as wide as several blocks."""
    blur = BlurOperator(np.full((100, 61), 2.0, np.float32), Disc(), 3)
    weight = blur.adjoint(np.ones((100, 61, 3), np.float32))[blur.inner]
    np.testing.assert_allclose(weight[5:-5, 5:-5], 1, atol=1e-5)


@pytest.mark.parametrize("psf", FAMILIES, ids=lambda psf: type(psf).__name__)
@pytest.mark.parametrize("channels", [1, 3])
def test_wide_blur_is_that_of_the_sums(psf, channels, drawn):
    """More tiles than one, narrow blur beside wide, and a scale beyond the last node."""
    picture = gaussian_filter(drawn.random((80, 140, channels)), (1, 1, 0)).astype(np.float32)
    largest = min(psf.max_scale, 14.0)
    scales = np.linspace(0.3, 1, 140) * np.linspace(0.6, 1, 80)[:, None] * largest
    scales[20:30, 40:60] = 0.5
    exact = BlurOperator(scales.astype(np.float32), psf, channels)
    wide = BlurOperator(scales.astype(np.float32), psf, channels, 3.0)
    seen = exact.apply(exact.extend(picture))
    np.testing.assert_allclose(wide.apply(wide.extend(picture)), seen, atol=2e-3)
    narrow = scales < 3
    assert narrow.any()
    found = wide.apply(wide.extend(picture))[narrow]
    np.testing.assert_allclose(found, seen[narrow], atol=1e-6)


def test_wide_blur_of_one_scale_loses_no_light():
    scales = np.full((70, 90), 17.0, np.float32)
    blur = BlurOperator(scales, Disc(), 1, 12.0)
    np.testing.assert_allclose(
        blur.apply(blur.extend(np.ones((70, 90, 1), np.float32))), 1, atol=1e-5
    )
    assert blur.adjoint(np.ones((70, 90, 1), np.float32)).sum() == pytest.approx(70 * 90, rel=1e-5)


@pytest.mark.parametrize("psf", [Disc(), Gaussian(), Polygon(3, rotation=20)])
def test_growth_of_half_the_variance_is_the_radius_over_4(psf):
    radii = np.array([[2.0, 4.0, 7.5, 30.0]], np.float32)
    np.testing.assert_allclose(half_variance_slope(psf, radii), radii / 4, rtol=0.1)
