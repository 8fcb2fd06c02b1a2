"""Pictures in any container, range and offset have the same map; what is found is told."""

import json

import numpy as np
import pytest
import tifffile
from typer.testing import CliRunner

from napari_defocus import (
    confidence_map,
    estimate_blur_map,
    estimate_candidates,
    estimate_noise_variance,
    explain_pixel,
    label_blur_map,
    measure_batch,
    restore_all_in_focus,
    segment_in_focus,
    sharpest_plane,
    simulate_defocus,
)
from napari_defocus.cli.app import app

da = pytest.importorskip("dask.array")


@pytest.fixture(scope="module")
def picture(clouds):
    """Half sharp, half blurred by 4 px, in [0, 1], with noise of variance 1.6e-5: float64."""
    radius = np.zeros((120, 160))
    radius[:, 80:] = 4
    blurred = simulate_defocus(clouds[:120], radius, noise_variance=1.6e-5, rng=1)
    return np.clip(blurred, 0, 1).astype(np.float64)


def measured(image, **options):
    candidates = estimate_candidates(image, **options)
    blur_map = label_blur_map(candidates, image)
    mask = segment_in_focus(candidates, image)
    return blur_map, mask, confidence_map(candidates, blur_map), candidates


def assert_same(found, expected, *, px=0.02):
    np.testing.assert_allclose(np.abs(found[0] - expected[0]).mean(), 0, atol=px)
    np.testing.assert_allclose(np.abs(found[2] - expected[2]).mean(), 0, atol=0.01)
    both, either = (found[1] & expected[1]).sum(), (found[1] | expected[1]).sum()
    assert both > 0.99 * either > 0, "in focus"


@pytest.fixture(scope="module")
def expected(picture):
    return measured(picture)


@pytest.mark.parametrize(
    ("dtype", "scale", "offset"),
    [
        *((np.float32, 0.3, 0.4), (np.float32, 255, 0), (np.float32, 4095, -1000)),
        *((np.float64, 1, 100), (np.float64, 65535, -1000), (np.float64, 1e-3, 0)),
        *((np.float64, 1e-9, 0), (np.float64, -1, 1), (np.float32, 0.2, -1)),
    ],
)
def test_floats_in_any_range_have_the_same_map(picture, expected, dtype, scale, offset):
    image = (scale * picture + offset).astype(dtype)
    assert_same(measured(image), expected)


@pytest.mark.parametrize(
    ("dtype", "scale", "offset"),
    [
        (np.uint16, 65535, 0),
        (np.uint16, 4095, 0),
        (np.uint16, 4095, 1000),
        (np.int16, 4095, -2000),
        (np.int32, 4095, 0),
        (np.uint32, 65535, 1e9),
        (np.int64, 65535, -1e12),
    ],
)
def test_integers_of_12_bits_and_more_have_the_map_of_floats(
    picture, expected, dtype, scale, offset
):
    assert_same(measured(np.rint(scale * picture + offset).astype(dtype)), expected)


@pytest.fixture(scope="module")
def eight_bits(picture):
    return np.rint(255 * picture).astype(np.uint8)


@pytest.fixture(scope="module")
def of_eight_bits(eight_bits):
    return measured(eight_bits)


@pytest.mark.parametrize(
    ("dtype", "scale"),
    [(np.uint16, 1), (np.uint16, 257), (np.int32, 1), (np.int64, 17), (np.float32, 1)],
)
def test_8_bits_in_any_container_have_the_map_of_8_bits(eight_bits, of_eight_bits, dtype, scale):
    assert_same(measured((eight_bits * np.float64(scale)).astype(dtype)), of_eight_bits)


def test_colours_in_any_range_have_the_same_map_and_mask(astronaut):
    colour = simulate_defocus(astronaut, np.full((160, 160), 2.0), noise_variance=1e-5, rng=0)
    assert_same(measured(3000 * colour - 500), measured(colour))


@pytest.mark.parametrize(
    ("dtype", "scale", "offset", "low", "high", "origin"),
    [
        (np.uint8, 200, 0, 0, 255, "number type"),
        (np.uint16, 4095, 0, 0, 65535, "number type"),
        (np.int16, 4095, 0, -32768, 32767, "number type"),
        (np.float32, 0.5, 0.1, 0, 1, "number type"),
        (np.float64, 1.1, 0, 0, 1, "number type"),
        (np.int64, 255, 0, 0, 255, "picture"),
        (np.uint32, 4095, 0, 0, 65535, "picture"),
        (np.int32, 100, -50, -50, 50, "picture"),
        (np.int64, 1000, 2**40, 2**40, 2**40 + 1000, "picture"),
    ],
)
def test_range_is_found_and_told(dtype, scale, offset, low, high, origin):
    steps = np.linspace(0, 1, 40 * 50).reshape(40, 50)
    image = scale * steps + offset
    image = (np.rint(image) if np.dtype(dtype).kind != "f" else image).astype(dtype)
    found = estimate_candidates(image).intensities
    assert (found.low, found.high, found.origin) == (low, high, origin)
    reach = np.ptp(image.astype(np.float64)) / (high - low)
    assert found.contrast == pytest.approx(reach, rel=1e-3)


def test_whole_floats_are_8_or_16_bits_and_others_go_from_end_to_end(picture):
    whole = np.rint(255 * picture)
    ranges = {"0 to 255": whole, "0 to 65535": 16 * whole}
    for told, image in ranges.items():
        assert str(estimate_candidates(image).intensities).startswith(f"{told} (from the picture)")
    found = estimate_candidates(whole + 0.5).intensities
    assert (found.low, found.high) == (whole.min() + 0.5, whole.max() + 0.5)


def test_given_range_is_told_and_is_the_contrast(picture):
    found = estimate_candidates(0.1 * picture, intensity_range=(-1, 3)).intensities
    assert (found.low, found.high, found.origin, found.contrast) == (-1, 3, "given", 1)


def test_few_hot_pixels_are_no_contrast(picture, expected):
    hot = np.rint(4000 * picture).astype(np.uint16)
    hot[[10, 50, 90], [20, 60, 100]] = 65535
    found = measured(hot)[3].intensities
    assert found.contrast == pytest.approx(4000 / 65535 * 1.1, rel=0.15)


def test_noise_is_never_more_than_a_thirtieth_of_the_contrast():
    noise = np.random.default_rng(0).normal(100, 1, (80, 80))
    candidates = estimate_candidates(noise)
    found = candidates.intensities
    assert found.contrast == pytest.approx(30 * candidates.noise_variance**0.5)


def test_noise_and_the_steps_of_jpeg_scale_with_the_picture(encoded_as_jpeg):
    noise = estimate_noise_variance(encoded_as_jpeg)
    for scale, offset in ((0.3 / 255, 0.4), (1, 0.5), (16, 0)):
        image = scale * encoded_as_jpeg.astype(np.float64) + offset
        found = estimate_candidates(image)
        sigma = found.noise_variance**0.5 * found.intensities.span / scale
        assert sigma == pytest.approx(255 * noise**0.5, rel=0.02), "in levels of 8 bits"


@pytest.fixture(scope="module")
def encoded_as_jpeg(picture):
    import io

    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(np.rint(255 * picture).astype(np.uint8)).save(buffer, "JPEG", quality=70)
    return np.asarray(Image.open(buffer))


def test_parts_take_the_intensities_of_the_candidates(picture):
    """What labels them cannot disagree about what is bright."""
    image = 4095 * picture
    candidates = estimate_candidates(image, intensity_range=(0, 1e6))
    given, taken = (
        label_blur_map(candidates, image, intensity_range=span) for span in ((0, 1e6), None)
    )
    np.testing.assert_array_equal(given, taken)
    told = explain_pixel(candidates, 60, 76, image=image)
    again = explain_pixel(candidates, 60, 76, image=image, intensity_range=(0, 1e6))
    assert told.own_window == again.own_window


HOLE = np.s_[30:75, 40:110]


def masked(picture):
    mask = np.zeros(picture.shape, bool)
    mask[HOLE] = True
    wild = np.where(mask, 1e6, picture)
    return np.ma.array(wild, mask=mask)


def with_nan(picture):
    return masked(picture).filled(np.nan)


def test_nan_and_masked_and_transparent_pixels_are_all_the_same(picture):
    color = np.dstack([picture, 0.5 * picture, picture])
    opaque = np.ones(picture.shape)
    opaque[HOLE] = 0
    transparent = np.dstack([np.where(opaque[..., None], color, 0.7), opaque])
    holed = np.where(opaque[..., None], color, np.nan)
    found = [measured(image) for image in (holed, np.ma.masked_invalid(holed), transparent)]
    for other in found[1:]:
        for ours, expected in zip(found[0][:3], other[:3], strict=True):
            np.testing.assert_array_equal(ours, expected)
    blur_map, _, confidence, candidates = found[0]
    assert confidence[50:55, 70:80].max() < 0.5 * np.median(confidence)
    assert np.isfinite(blur_map).all()
    clean = measured(color)
    away = np.abs(blur_map - clean[0])[opaque == 1].mean()
    assert away < 0.2, "a hole is no edge"
    assert candidates.noise_variance == pytest.approx(clean[3].noise_variance, rel=0.1)
    assert candidates.intensities.contrast == pytest.approx(np.ptp(color), rel=0.05)


def test_integers_may_be_masked_and_infinity_behind_a_mask_is_not_known(picture):
    image = masked(picture)
    counts = np.ma.array(np.rint(4095 * image.data.clip(0, 1)), mask=image.mask, dtype=np.uint16)
    assert_same(measured(counts), measured(with_nan(picture)))
    image.data[50, 70] = np.inf
    assert np.isfinite(measured(image)[0]).all()
    with pytest.raises(ValueError, match="image has infinite values"):
        estimate_candidates(image.data)


@pytest.mark.parametrize("nothing", [np.nan, np.ma.masked])
def test_picture_of_which_nothing_is_known_has_a_map_without_confidence(nothing):
    image = np.ma.zeros((40, 50)) if nothing is np.ma.masked else np.zeros((40, 50))
    image[:] = nothing
    blur_map, _, confidence, _ = measured(image)
    clear = measured(np.zeros((40, 50, 4)))
    np.testing.assert_array_equal(blur_map, clear[0])
    np.testing.assert_array_equal(confidence, clear[2])


def test_what_is_not_known_stays_nan_when_it_is_restored(picture):
    radius = np.full(picture.shape, 1.5)
    restored = restore_all_in_focus(with_nan(picture), radius)
    hole = np.zeros(picture.shape, bool)
    hole[HOLE] = True
    np.testing.assert_array_equal(np.isnan(restored), hole)
    of_masked = restore_all_in_focus(masked(picture), radius)
    np.testing.assert_array_equal(of_masked, restored)


def test_restored_picture_is_the_same_in_any_range(picture):
    radius = np.full(picture.shape, 1.5)
    image = np.rint(4095 * (0.3 + 0.4 * picture)).astype(np.uint16)
    dim = 65535 / 4095 * restore_all_in_focus(image, radius)
    full = restore_all_in_focus(image / 4095, radius)
    assert np.abs(dim - full).mean() < 2e-3


@pytest.fixture(scope="module")
def stack(picture):
    """Three float planes, each of another brightness and contrast."""
    return np.stack([1000 * picture, 3000 * picture + 50, 200 - 100 * picture])


def test_plane_of_a_stack_has_the_map_of_its_array(stack):
    found = estimate_blur_map(da.from_array(stack, chunks=(1, 70, 80)), axes="zyx")
    for plane, blur_map in zip(stack, found.compute(), strict=True):
        np.testing.assert_array_equal(blur_map, estimate_blur_map(plane))


def test_planes_of_nan_and_masks_are_measured_in_stacks(picture):
    holed = np.ma.stack([masked(picture), masked(picture)])
    found = estimate_blur_map(holed, axes="zyx")
    alone = estimate_blur_map(with_nan(picture))
    np.testing.assert_array_equal(found, [alone] * 2)
    lazy = da.from_array(holed.filled(np.nan), chunks=(1, 50, 50))
    np.testing.assert_array_equal(estimate_blur_map(lazy, axes="zyx").compute(), [alone] * 2)


def test_parts_of_a_large_picture_share_its_intensities(clouds):
    blurred = simulate_defocus(np.tile(clouds, (1, 4)), np.full((160, 640), 2.0), rng=0)
    blurred[:, 320:] *= 0.2
    image = (3000 * blurred - 700.25).astype(np.float32)
    lazy = da.from_array(image, chunks=(64, 100))
    candidates = estimate_candidates(lazy, block_size=256).with_noise()
    whole = estimate_candidates(image)
    assert candidates.intensities == [whole.intensities]
    assert candidates.variances == pytest.approx(whole.noise_variance, rel=1e-6)
    found = label_blur_map(candidates, lazy).compute()
    assert np.abs(found - label_blur_map(whole, image)).mean() < 0.02


def test_restored_planes_of_a_stack_do_not_flicker(stack):
    radius = np.zeros(stack.shape)
    restored = restore_all_in_focus(stack, radius, axes="zyx", noise_variance=1e-9)
    low, high = stack.min(), stack.max()
    np.testing.assert_allclose(restored, (stack - low) / (high - low), atol=5e-3)


def test_sharpest_plane_does_not_depend_on_the_range(clouds):
    focus = np.broadcast_to(np.linspace(1, 3, 160), (160, 160))
    planes = [
        simulate_defocus(clouds, 1.5 * abs(z - focus), noise_variance=1e-6, rng=z) for z in range(5)
    ]
    first = sharpest_plane(np.stack(planes))
    for scale, offset in ((0.2, 0.5), (4095, -300), (1e-6, 0)):
        found = sharpest_plane(scale * np.stack(planes).astype(np.float64) + offset)
        assert np.abs(found.position - first.position).mean() < 0.02
    assert found.intensities.contrast == pytest.approx(1e-6 * first.intensities.contrast, rel=0.01)


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_terminal_tells_the_range_and_the_noise_in_grey_levels_of_it(picture, tmp_path):
    image = np.rint(4095 * picture).astype(np.int32)
    tifffile.imwrite(tmp_path / "p.tif", image)
    output = run("map", tmp_path / "p.tif").output
    assert "intensities  0 to 65535 (from the picture), contrast " in output
    assert "of 65535 grey levels)" in output
    told = run("segment", tmp_path / "p.tif", "--json", "--intensity-range", "0", "4095")
    facts = json.loads(told.stdout)
    assert facts["intensities"] == "0 to 4095 (given), contrast 100 %"
    assert (facts["intensity_low"], facts["intensity_high"]) == (0, 4095)
    assert facts["noise_sigma_grey_levels"] == pytest.approx(4095 * facts["noise_variance"] ** 0.5)
    assert facts["noise_sigma_grey_levels"] == pytest.approx(16, rel=0.15)


def test_terminal_measures_and_restores_tiff_with_nan(picture, tmp_path):
    tifffile.imwrite(tmp_path / "p.tif", (2000 * with_nan(picture)).astype(np.float32))
    assert run("map", tmp_path / "p.tif").exit_code == 0
    restored = run(
        "restore", tmp_path / "p.tif", "-o", tmp_path / "r.png", "-o", tmp_path / "r.tif"
    )
    assert restored.exit_code == 0, restored.output
    assert np.isnan(tifffile.imread(tmp_path / "r.tif"))[HOLE].all()
    from imagecodecs import imread

    shown = imread(tmp_path / "r.png")
    assert shown.shape == (*picture.shape, 2)
    assert not shown[HOLE][..., 1].any()


def test_batch_tells_ranges_and_restores_planes_in_one(stack, tmp_path):
    import zarr

    tifffile.imwrite(
        tmp_path / "s.ome.tif", stack.astype(np.float32), metadata={"axes": "ZYX"}, ome=True
    )
    report = measure_batch(tmp_path / "s.ome.tif", tmp_path / "out", restore=True)
    assert report.failed == 0
    rows = [json.loads(line) for line in (tmp_path / "out/table.jsonl").read_text().splitlines()]
    assert [row["intensity_high"] for row in rows] == [
        pytest.approx(plane.max(), rel=1e-5) for plane in stack
    ]
    (store,) = (tmp_path / "out/maps").glob("*in-focus*")
    restored = np.asarray(zarr.open(store)["0"])
    means = [plane.mean() for plane in (stack - stack.min()) / np.ptp(stack)]
    np.testing.assert_allclose(restored.mean(axis=(1, 2)), means, atol=0.01)
