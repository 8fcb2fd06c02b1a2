"""Stacks and large pictures, part by part: the same results, whichever scheduler works on them."""

import pickle

import dask
import dask.array as da
import numpy as np
import pytest
from dask.distributed import Client, LocalCluster
from scipy.ndimage import gaussian_filter
from skimage.data import camera

from napari_defocus import (
    ShotNoise,
    cautious_blur_map,
    confidence_map,
    estimate_blur_map,
    estimate_candidates,
    explain_pixel,
    focus_threshold,
    label_blur_map,
    labeling_energy,
    restore_all_in_focus,
    segment_in_focus,
    simulate_defocus,
)
from napari_defocus.core.progress import Cancelled
from napari_defocus.io.lazy_arrays import Carried
from napari_defocus.io.ome_zarr import read_ome_zarr
from napari_defocus.io.ome_zarr_writer import new_ome_zarr
from napari_defocus.io.tiled_stores import store
from napari_defocus.settings import MapSettings, RestorationSettings
from napari_defocus.tiled.computing import run_tasks
from napari_defocus.tiled.tile_tasks import Wanted

NOISE = 1e-6
HEIGHT, WIDTH = 310, 420
BLOCK = 256


@pytest.fixture(scope="module")
def picture():
    sharp = camera()[80 : 80 + HEIGHT, 60 : 60 + WIDTH] / 255
    radius = np.broadcast_to(np.linspace(0.8, 6, WIDTH), (HEIGHT, WIDTH))
    return simulate_defocus(sharp, radius, noise_variance=NOISE, rng=0).astype(np.float32)


@pytest.fixture(scope="module")
def candidates(picture):
    return estimate_candidates(picture, noise_variance=NOISE)


@pytest.fixture(scope="module")
def whole(picture, candidates):
    return label_blur_map(candidates, picture)


@pytest.fixture(scope="module")
def lazy(picture):
    chunks = da.from_array(picture, chunks=(100, 130))
    return estimate_candidates(chunks, noise_variance=NOISE, block_size=BLOCK)


@pytest.fixture(scope="module")
def in_parts(picture, lazy):
    risk = RestorationSettings.risk
    wanted = Wanted(map=MapSettings(), confidence=True, risk=risk, extrapolated=True)
    return dask.compute(lazy.measure(wanted))[0]


def test_candidates_of_parts_are_exactly_those_of_the_whole(lazy, candidates):
    np.testing.assert_array_equal(lazy.curve.compute(), candidates.curve)
    np.testing.assert_array_equal(lazy.radii.compute(), candidates.radii)


def test_noise_of_parts_grows_towards_the_corners_of_the_whole():
    rows, columns = (np.linspace(-1, 1, length) * length for length in (350, 410))
    outward = np.add.outer(rows**2, columns**2) / (350**2 + 410**2)
    rng = np.random.default_rng(0)
    smooth = 0.5 + gaussian_filter(rng.normal(size=outward.shape), 6)
    shaded = smooth + np.sqrt(1e-4 * (1 + 2 * outward)) * rng.normal(size=outward.shape)
    whole = estimate_candidates(shaded, intensity_range=(0, 1))
    assert whole.noise_growth == pytest.approx(2, rel=0.2)
    for block_size in (BLOCK, 1024):
        plane = da.from_array(shaded, chunks=(100, 130))
        parts = estimate_candidates(plane, intensity_range=(0, 1), block_size=block_size)
        np.testing.assert_array_equal(parts.with_noise().curve.compute(), whole.curve)


def test_map_of_parts_is_that_of_the_whole_and_has_no_seams(in_parts, whole):
    away = np.abs(in_parts["blur_map"] - whole)
    assert away.mean() < 0.02
    seam = [BLOCK - 1, BLOCK]
    steps = np.abs(np.diff(in_parts["blur_map"] - whole, axis=1))
    assert steps[:, seam[0]].mean() <= steps.mean() + 1e-3
    steps = np.abs(np.diff(in_parts["blur_map"] - whole, axis=0))
    assert steps[seam[0]].mean() <= steps.mean() + 1e-3


def test_confidence_of_parts_is_that_of_the_whole(in_parts, candidates, whole):
    sure = confidence_map(candidates, whole)
    assert np.abs(in_parts["confidence"] - sure).mean() < 0.01
    safe = cautious_blur_map(candidates, whole)
    assert np.abs(in_parts["cautious"] - safe).mean() < 0.03


def test_confidence_of_any_map(lazy, candidates, whole):
    sure = confidence_map(lazy, da.from_array(whole, chunks=200)).compute()
    np.testing.assert_allclose(sure, confidence_map(candidates, whole), atol=1e-5)


def test_evidence_of_parts_is_that_of_the_whole(in_parts, candidates, picture):
    extrapolated = label_blur_map(candidates, picture, return_extrapolated=True)[1]
    assert (in_parts["extrapolated"] != extrapolated).mean() < 1e-3


@pytest.mark.parametrize("seeded", [False, True])
def test_mask_of_parts_is_that_of_the_whole(lazy, candidates, picture, seeded):
    seeds = np.zeros(picture.shape, np.uint8)
    seeds[100:140, 300:330] = 1
    seeds = seeds if seeded else None
    mask = segment_in_focus(lazy, da.from_array(picture), seeds=seeds, unknown="leave")
    assert mask.dtype == np.uint8
    expected = segment_in_focus(candidates, picture, seeds=seeds, unknown="leave")
    assert (expected == 2).any()
    assert 0.05 < expected.mean() < 0.95
    assert (mask.compute() != expected).mean() < 0.005


def test_threshold_of_parts_is_exactly_that_of_the_whole(lazy, candidates, picture):
    within = np.zeros(picture.shape, bool)
    within[30:290, 150:400] = True
    for where in (None, within):
        expected = focus_threshold(candidates, picture, within=where)
        assert focus_threshold(lazy, da.from_array(picture), within=where) == expected
    mask = segment_in_focus(lazy, da.from_array(picture), within=within).compute()
    assert not mask[~within].any()


def test_nothing_is_read_before_it_is_asked_for(picture):
    read = []

    def piece(block_info=None):
        (rows, columns) = block_info[None]["array-location"]
        read.append((rows, columns))
        return picture[slice(*rows), slice(*columns)]

    chunks = ((100,) * 3 + (10,), (210, 210))
    image = da.map_blocks(piece, chunks=chunks, dtype=np.float32, meta=np.empty((0, 0), np.float32))
    blur_map = estimate_blur_map(image, noise_variance=NOISE, block_size=BLOCK)
    assert blur_map.shape == picture.shape
    assert blur_map.dtype == np.float32
    assert not read
    estimate_blur_map(image[:, :100], noise_variance=NOISE).compute()
    assert {columns for _, columns in read} == {(0, 210)}


def test_noise_of_parts_is_that_of_the_whole(picture, whole):
    found = estimate_blur_map(da.from_array(picture, chunks=200), block_size=BLOCK).compute()
    expected = estimate_blur_map(picture)
    assert np.abs(found - expected).mean() < 0.02


def test_shot_noise_of_parts(picture):
    noise = ShotNoise(NOISE, 1e-6)
    lazy = estimate_candidates(da.from_array(picture), noise_variance=noise, block_size=BLOCK)
    curve = estimate_candidates(picture, noise_variance=noise).curve
    np.testing.assert_allclose(lazy.curve.compute(), curve, rtol=1e-3, atol=0.02)


@pytest.fixture(scope="module")
def stack(picture):
    return np.stack([picture[:90, at : at + 100] for at in (0, 110, 220, 320)])


@pytest.fixture(scope="module")
def plane_by_plane(stack):
    return np.stack([estimate_blur_map(plane) for plane in stack])


def test_stack_has_the_maps_of_its_planes(stack, plane_by_plane):
    np.testing.assert_array_equal(estimate_blur_map(stack, axes="zyx"), plane_by_plane)
    lazy = estimate_blur_map(da.from_array(stack.reshape(2, 2, 90, 100)), axes="tzyx")
    np.testing.assert_array_equal(lazy[1, 0].compute(), plane_by_plane[2])


def test_axes_may_have_any_order(stack, plane_by_plane):
    found = estimate_blur_map(stack[:2].transpose(1, 2, 0), axes="yxz")
    np.testing.assert_array_equal(found, plane_by_plane[:2])


def test_colors_may_be_any_axis(stack, plane_by_plane):
    colored = np.repeat(stack[:2, None], 3, axis=1)
    found = estimate_blur_map(colored, axes="tsyx")
    assert np.abs(found - plane_by_plane[:2]).mean() < 0.01
    single = estimate_blur_map(colored[0], axes="syx")
    assert np.abs(single - plane_by_plane[0]).mean() < 0.01
    with pytest.warns(FutureWarning, match="axes='asyx' says the same"):
        np.testing.assert_array_equal(estimate_blur_map(colored, channel_axis=1), found)
    with pytest.warns(FutureWarning, match="axes='syx' says the same"):
        np.testing.assert_array_equal(estimate_blur_map(colored[0], channel_axis=0), single)


def test_masks_and_confidence_of_a_stack(stack, plane_by_plane):
    candidates = estimate_candidates(stack, axes="zyx")
    masks, threshold = segment_in_focus(candidates, stack), focus_threshold(candidates, stack)
    assert isinstance(masks, np.ndarray)
    for plane, mask in zip(stack, masks, strict=True):
        alone = segment_in_focus(estimate_candidates(plane), plane, threshold=threshold)
        np.testing.assert_array_equal(mask, alone, "one threshold holds for all planes")
    radius, sure = estimate_blur_map(stack, axes="zyx", return_confidence=True)
    np.testing.assert_array_equal(radius, plane_by_plane)
    np.testing.assert_allclose(sure, confidence_map(candidates, radius), atol=1e-6)


def test_progress_of_a_stack_can_stop_it(stack):
    def stop(step, done):
        if done > 0.2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        estimate_blur_map(stack, axes="zyx", progress=stop)


@pytest.fixture(scope="module")
def cluster():
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs=50
        ) as local,
        Client(local, set_as_default=False) as client,
    ):
        yield client


def test_every_scheduler_has_the_same_result(picture, in_parts, cluster):
    image = da.from_array(picture, chunks=(155, 420))
    blur_map = estimate_blur_map(image, noise_variance=NOISE, block_size=BLOCK)
    for computed in (
        blur_map.compute(scheduler="threads"),
        # Each process loads every kernel; that several are at work at once, the cluster shows.
        blur_map.compute(scheduler="processes", num_workers=1),
        blur_map.compute(scheduler=cluster),
    ):
        # Once in many runs, some pixels had another last bit.
        np.testing.assert_allclose(computed, in_parts["blur_map"], rtol=0, atol=2e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, r"image has shape \(4, 90, 100\); it takes .* axes"),
        ({"axes": "zy"}, "axes is 'zy'; it takes y, x"),
        ({"axes": "yx"}, "axes is 'yx'; image has 3 axes"),
        ({"axes": "zyx", "channel_axis": 0}, "they say the same"),
        ({"channel_axis": 3}, "channel_axis is 3"),
        ({"axes": "zyx", "block_size": 10}, "block_size is 10; it takes"),
    ],
)
def test_impossible_stacks_are_refused(stack, arguments, message):
    with pytest.raises(ValueError, match=message):
        estimate_candidates(stack, **arguments)


def test_planes_of_two_colors_are_refused(stack):
    with pytest.raises(ValueError, match="image has 2 channels"):
        estimate_candidates(stack[:2], axes="syx")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda large: large[large[:, 0] > 0.5], "takes a dask array of known size"),
        (lambda large: large[:0], r"image has shape \(0, 420\)"),
        (lambda large: large[0], r"image has shape \(420,\)"),
    ],
)
def test_impossible_dask_arrays_are_refused(picture, changed, message):
    with pytest.raises(ValueError, match=message):
        estimate_candidates(changed(da.from_array(picture)))


def test_impossible_ranges_and_maps_are_refused_before_anything_is_read(lazy, picture):
    unread = da.from_delayed(dask.delayed(pytest.fail)("was read"), picture.shape, float)
    with pytest.raises(ValueError, match=r"intensity_range is \(1, 0\)"):
        estimate_candidates(unread, intensity_range=(1, 0))
    with pytest.raises(TypeError, match="blur_map has dtype <U1"):
        confidence_map(lazy, np.full(picture.shape, "a"))
    with pytest.raises(TypeError, match="seeds has dtype float64"):
        segment_in_focus(lazy, picture, seeds=np.zeros(picture.shape))


def test_functions_of_one_picture_refuse_parts(lazy, picture):
    with pytest.raises(TypeError, match="those of a stack or a dask array"):
        explain_pixel(lazy, 10, 10)
    with pytest.raises(TypeError, match="those of a stack or a dask array"):
        labeling_energy(np.zeros(picture.shape), lazy, picture)


def test_other_images_than_that_of_the_candidates_are_refused(lazy, picture):
    with pytest.raises(ValueError, match=r"image has shape \(10, 10\)"):
        label_blur_map(lazy, np.zeros((10, 10)))
    with pytest.raises(ValueError, match=r"blur_map has shape \(10, 10\)"):
        confidence_map(lazy, np.zeros((10, 10)))
    with pytest.raises(ValueError, match=r"seeds has shape \(10, 10\)"):
        segment_in_focus(lazy, picture, seeds=np.zeros((10, 10), int))
    with pytest.raises(TypeError, match="candidates is ndarray"):
        label_blur_map(picture, picture)
    with pytest.raises(TypeError, match="dtype complex"):
        estimate_candidates(da.zeros((50, 50), dtype=complex))


def test_results_are_stored_part_by_part_and_gone_on_with(tmp_path, picture, lazy, in_parts):
    computed = []

    def stop_at_the_half(step, done):
        computed.append(done)
        if done > 0.6 and len(list(tmp_path.glob("*.ome.zarr"))) == 0 and not stopped:
            stopped.append(True)
            raise Cancelled

    stopped = []
    settings = {
        "shape": picture.shape,
        "dtype": "float32",
        "axes": "yx",
        "attributes": {},
        "tile": 256,
    }
    found = {"blur_map": lazy.measure(Wanted(map=MapSettings()))["blur_map"]}
    for attempt in range(2):
        writer = new_ome_zarr(tmp_path / "map.ome.zarr", **settings, resume=True)
        if not attempt:
            with pytest.raises(Cancelled):
                store(found, {"blur_map": writer}, stop_at_the_half)
            assert not (tmp_path / "map.ome.zarr").exists()
        else:
            store(found, {"blur_map": writer}, stop_at_the_half)
    levels = read_ome_zarr(tmp_path / "map.ome.zarr").levels
    np.testing.assert_array_equal(levels[0].compute(), in_parts["blur_map"])


def test_large_picture_is_restored_part_by_part(picture):
    part = picture[:280, :90]
    radius = np.full(part.shape, 1.5, np.float32)
    whole = restore_all_in_focus(part, radius, noise_variance=NOISE)
    lazy = restore_all_in_focus(
        da.from_array(part, chunks=100), radius, noise_variance=NOISE, block_size=BLOCK
    )
    assert np.mean((lazy.compute() - whole) ** 2) < 1e-5


def test_stack_is_restored_plane_by_plane(stack):
    radius = np.full((2, 90, 100), 1.5, np.float32)
    colored = np.repeat(stack[:2, :, :, None], 3, axis=3)
    found = restore_all_in_focus(colored, radius, axes="zyxs")
    np.testing.assert_allclose(found[1], restore_all_in_focus(colored[1], radius[1]), atol=1e-6)


def test_progress_of_parts_is_one_of_time(picture):
    seen = []
    lazy = estimate_candidates(da.from_array(picture[:90]), noise_variance=NOISE, block_size=BLOCK)
    found = lazy.measure(Wanted(map=MapSettings(), confidence=True))
    run_tasks(found, lambda step, done: seen.append(done))
    assert seen == sorted(seen)
    assert seen[-1] == 1
    # Two surveys and two measurements are nearly all of it.
    steps = sorted(np.diff(seen))
    np.testing.assert_allclose(steps[-4:], [0.13, 0.13, 0.32, 0.32], atol=0.03)


def test_noise_that_was_found_is_used_and_told(stack, picture):
    lazy = estimate_candidates(da.from_array(stack[:2]), axes="zyx").with_noise()
    each = [estimate_candidates(plane).noise_variance for plane in stack[:2]]
    np.testing.assert_allclose(lazy.variances, each)
    found = lazy.measure(Wanted(map=MapSettings()))["blur_map"][1].compute()
    np.testing.assert_array_equal(found, estimate_blur_map(stack[1]))
    given = estimate_candidates(da.from_array(picture), noise_variance=NOISE, block_size=BLOCK)
    assert given.with_noise().variances == NOISE
    parts = estimate_candidates(da.from_array(picture), block_size=BLOCK).with_noise()
    np.testing.assert_allclose(parts.variances, estimate_candidates(picture).noise_variance)


def test_lazy_array_reaches_other_processes_whatever_reads_it(picture):
    lazy = da.from_array(picture, chunks=100).map_blocks(lambda block: block * 2)
    with pytest.raises((pickle.PicklingError, AttributeError)):
        pickle.dumps(lazy)
    arrived = pickle.loads(pickle.dumps(Carried(lazy), protocol=5)).array
    np.testing.assert_array_equal(arrived.compute(), 2 * picture)
