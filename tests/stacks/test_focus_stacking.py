import dask.array as da
import numpy as np
import pytest
from scipy.ndimage import laplace, uniform_filter

from napari_defocus import Cancelled, Disc, sharpest_plane, simulate_defocus

PLANES = 9
SIZE = (120, 140)


def swept(picture, focus, px_per_plane=1.0, variance=1e-6):
    """Planes of a picture whose places are in focus at these positions."""
    rng = np.random.default_rng(0)
    return np.stack(
        [
            simulate_defocus(
                picture,
                px_per_plane * np.abs(plane - focus),
                psf=Disc(16.0),
                noise_variance=variance,
                rng=rng,
            )
            for plane in range(PLANES)
        ]
    )


def psnr(picture, sharp):
    return -10 * np.log10(np.mean((picture - sharp) ** 2))


@pytest.fixture(scope="module")
def tilted():
    """In focus from plane 1 at the top left to plane 7 at the bottom right."""
    row, column = np.indices(SIZE)
    return 1 + 6 * (row / SIZE[0] + column / SIZE[1]) / 2


@pytest.fixture(scope="module")
def sharp(grass):
    return grass[: SIZE[0], : SIZE[1]]


@pytest.fixture(scope="module")
def stack(sharp, tilted):
    planes = swept(sharp, tilted)
    planes.setflags(write=False)
    return planes


@pytest.fixture(scope="module")
def found(stack):
    return sharpest_plane(stack)


def test_position_is_found_between_planes(found, tilted):
    error = np.abs(found.position - tilted)
    assert np.mean(error <= 0.5) > 0.99
    assert np.median(error) < 0.08
    np.testing.assert_array_equal(found.plane, np.rint(found.position))
    assert found.position.dtype == np.float32


def test_composite_is_nearly_as_good_as_the_true_planes(found, stack, sharp, tilted):
    true = np.take_along_axis(stack, np.rint(tilted).astype(int)[None], 0)[0]
    assert psnr(found.composite, sharp) > psnr(true, sharp) - 1
    assert psnr(found.composite, sharp) > max(psnr(plane, sharp) for plane in stack) + 15


def test_pixels_of_the_composite_are_those_of_their_planes_if_not_blended(found, stack):
    rows, columns = np.indices(SIZE)
    pixels = sharpest_plane(stack, blend=False)
    np.testing.assert_array_equal(pixels.plane, found.plane)
    np.testing.assert_array_equal(pixels.composite, stack[found.plane, rows, columns])


def test_px_from_plane_to_plane_are_found_to_a_tenth(found, sharp, tilted):
    assert found.px_per_plane == pytest.approx(1, rel=0.1)
    half = sharpest_plane(swept(sharp[:80, :80], tilted[:80, :80], 0.5))
    assert half.px_per_plane == pytest.approx(0.5, rel=0.15)


def test_px_that_are_given_are_used(stack, found, tilted):
    given = sharpest_plane(stack, px_per_plane=1.0)
    assert given.px_per_plane == 1.0
    assert np.mean(np.abs(given.position - tilted) <= 0.5) > 0.99
    assert not np.array_equal(given.position, found.position)


def test_step_across_the_picture_is_followed_better_than_by_the_laplacian(sharp):
    row, column = np.indices(SIZE)
    focus = np.where((row - 60) ** 2 + (column - 70) ** 2 < 35**2, 6.3, 2.2)
    stack = swept(sharp, focus)
    found = sharpest_plane(stack)
    assert np.mean(np.abs(found.position - focus) <= 0.5) > 0.98

    def by_laplacian(side):
        bent = np.stack([laplace(plane) for plane in stack])
        size = (0, side, side)
        variance = uniform_filter(bent**2, size) - uniform_filter(bent, size) ** 2
        return np.take_along_axis(stack, variance.argmax(axis=0)[None], 0)[0]

    best = max(psnr(by_laplacian(side), sharp) for side in (3, 5, 9, 15))
    assert psnr(found.composite, sharp) > best + 1


def test_brightness_that_drifts_and_flickers_changes_little(stack, found):
    lamp = np.linspace(0.8, 1.1, PLANES) + 0.05 * (-1) ** np.arange(PLANES)
    drifting = sharpest_plane((stack * lamp[:, None, None]).astype(np.float32))
    assert np.quantile(np.abs(drifting.position - found.position), 0.99) < 0.25


def test_shares_of_planes_are_those_of_the_pixels(found):
    assert found.share_of_plane.shape == (PLANES,)
    assert found.share_of_plane.sum() == pytest.approx(1)
    assert found.share_of_plane[3] == np.mean(found.plane == 3)
    assert found.best == found.share_of_plane.argmax()


def test_confidence_is_high_where_positions_are_right(found, tilted):
    right = np.abs(found.position - tilted) <= 0.5
    assert found.confidence.mean() == pytest.approx(right.mean(), abs=0.1)
    assert 0 <= found.confidence.min() <= found.confidence.max() <= 1


def test_where_there_is_no_texture_the_confidence_says_so(stack, tilted):
    half = np.array(stack)
    half[:, :, 75:] = 0.5
    half[:, :, 75:] += np.random.default_rng(1).normal(0, 1e-3, half[:, :, 75:].shape)
    found = sharpest_plane(half)
    assert np.median(found.confidence[:, :55]) > 0.9
    assert np.median(found.confidence[:, 95:]) < 0.4


def test_constant_stack_has_no_evidence():
    flat = sharpest_plane(np.full((5, 40, 50), 0.3))
    assert np.isnan(flat.px_per_plane)
    assert flat.confidence.max() < 0.35
    np.testing.assert_allclose(flat.composite, 0.3, rtol=1e-6)


def test_noise_alone_has_no_evidence():
    noise = np.random.default_rng(0).normal(0.5, 0.01, (12, 100, 100))
    alone = sharpest_plane(noise)
    assert np.isnan(alone.px_per_plane)
    assert np.median(alone.confidence) < 0.3


def test_result_is_the_same_each_time(stack, found):
    again = sharpest_plane(stack)
    np.testing.assert_array_equal(again.position, found.position)
    np.testing.assert_array_equal(again.confidence, found.confidence)


@pytest.fixture(scope="module")
def colored(astronaut):
    sharp = astronaut[:60, :70]
    focus = np.broadcast_to(np.linspace(2, 6, 70), (60, 70))
    return np.rint(255 * swept(sharp, focus).clip(0, 1)).astype(np.uint8)


@pytest.fixture(scope="module")
def of_colored(colored):
    return sharpest_plane(colored, px_per_plane=1.0)


@pytest.fixture(scope="module")
def of_grey(colored):
    return sharpest_plane(colored[..., 1], px_per_plane=1.0)


def test_colours_and_dtype_are_kept(of_colored):
    found = of_colored
    assert found.composite.dtype == np.uint8
    assert found.composite.shape == (60, 70, 3)
    assert found.position.shape == (60, 70)


@pytest.mark.parametrize(
    ("order", "arguments"),
    [
        ((1, 0, 2, 3), {"axes": "yzxs"}),
        ((3, 1, 2, 0), {"axes": "SYXT"}),
        ((0, 3, 1, 2), {"axes": "zsyx"}),
    ],
)
def test_axes_may_come_in_any_order(colored, of_colored, order, arguments):
    turned = sharpest_plane(colored.transpose(order), px_per_plane=1.0, **arguments)
    np.testing.assert_array_equal(turned.position, of_colored.position)
    np.testing.assert_array_equal(turned.composite, of_colored.composite)


def test_old_name_of_the_axis_of_colours_works_and_warns(colored, of_colored):
    with pytest.warns(FutureWarning, match="channel_axis will go"):
        turned = sharpest_plane(colored.transpose(0, 3, 1, 2), channel_axis=1, px_per_plane=1.0)
    np.testing.assert_array_equal(turned.position, of_colored.position)


def test_channel_of_one_is_kept(colored, of_grey):
    found = sharpest_plane(colored[..., 1:2], axes="zyxs", px_per_plane=1.0)
    assert found.composite.shape == (60, 70, 1)
    np.testing.assert_array_equal(found.position, of_grey.position)


def test_transparent_pixels_are_no_evidence(colored):
    opacity = np.full((*colored.shape[:3], 1), 255, np.uint8)
    opacity[:, :, 35:] = 0
    found = sharpest_plane(np.concatenate([colored, opacity], axis=-1), px_per_plane=1.0)
    assert found.composite.shape == (60, 70, 4)
    assert np.median(found.confidence[:, 55:]) < 0.4


def test_planes_of_a_dask_stack_are_read_one_at_a_time(colored, of_grey):
    grey = colored[..., 1]
    reads = []

    def plane(block_info):
        number = block_info[None]["chunk-location"][0]
        reads.append(number)
        return grey[number : number + 1]

    lazy = da.map_blocks(
        plane, chunks=((1,) * PLANES, (60,), (70,)), dtype=np.uint8, meta=np.empty((0, 0, 0))
    )
    before_each = []
    found = sharpest_plane(
        lazy,
        px_per_plane=1.0,
        progress=lambda step, done: (
            before_each.append(len(reads)) if step == "Reading the planes" else None
        ),
    )
    assert before_each == list(range(PLANES, 2 * PLANES))
    assert len(reads) <= 4 * PLANES
    np.testing.assert_array_equal(found.position, of_grey.position)


@pytest.fixture(scope="module")
def small(stack):
    """A stack that takes little time, and where it is in focus."""
    planes = np.ascontiguousarray(stack[:, :50, :60])
    return planes, sharpest_plane(planes, px_per_plane=1.0).plane


@pytest.mark.parametrize("axes", ["tczyx", "zctyx", "yxzct", "cytzx", "ptzcyx", "szyxt", "zyxsc"])
def test_axes_of_length_one_do_not_count(small, axes):
    planes, expected = small
    order = [*"zyx", *(axis for axis in axes if axis not in "zyx")]
    whole = planes.reshape(planes.shape + (1,) * (len(axes) - 3))
    whole = whole.transpose([order.index(axis) for axis in axes])
    found = sharpest_plane(whole, axes=axes, px_per_plane=1.0)
    np.testing.assert_array_equal(found.plane, expected)


def test_leading_axes_of_length_one_need_no_letters(small):
    planes, expected = small
    found = sharpest_plane(planes[None, None], px_per_plane=1.0)
    np.testing.assert_array_equal(found.plane, expected)


@pytest.mark.parametrize("axes", ["tczyx", "zyxct"])
@pytest.mark.parametrize("kind", [np.asarray, da.from_array])
def test_channel_and_time_are_chosen(small, axes, kind):
    planes, expected = small
    whole = np.zeros((3, 2, *planes.shape), planes.dtype)
    whole[2, 1] = planes
    whole = whole.transpose(["tczyx".index(axis) for axis in axes])
    found = sharpest_plane(kind(whole), axes=axes, channel=1, time=2, px_per_plane=1.0)
    np.testing.assert_array_equal(found.plane, expected)


def test_times_are_planes_if_there_are_no_others(small):
    planes, expected = small
    both = np.stack([planes * 0, planes], axis=1)
    found = sharpest_plane(both, axes="tcyx", channel=1, px_per_plane=1.0)
    np.testing.assert_array_equal(found.plane, expected)


def test_progress_grows_to_the_end_and_may_stop_the_work(colored):
    reports = []
    sharpest_plane(colored[..., 1], progress=lambda step, done: reports.append(done))
    assert reports == sorted(reports)
    assert reports[-1] == pytest.approx(1)

    def cancel(step, done):
        if done > 0.5:
            raise Cancelled

    with pytest.raises(Cancelled):
        sharpest_plane(colored[..., 1], progress=cancel)


def test_plane_with_infinity_is_named(stack):
    broken = np.array(stack)
    broken[4, 3, 3] = np.inf
    with pytest.raises(ValueError, match="infinite values in plane 4"):
        sharpest_plane(broken)


STACK = np.zeros((4, 30, 40))
PLATE = np.zeros((2, 4, 30, 40))


@pytest.mark.parametrize(
    ("stack", "arguments", "error", "words"),
    [
        (STACK.astype(complex), {}, TypeError, "stack has dtype complex128"),
        (STACK[0], {}, ValueError, r"stack has shape \(30, 40\); it takes"),
        (STACK[:, :, :3], {}, ValueError, r"stack has shape \(4, 30, 3\); it takes"),
        (STACK[:1], {}, ValueError, "a single plane; it takes two or more"),
        (STACK[:, :2], {}, ValueError, "planes of 2 x 40 px"),
        (STACK[..., None].repeat(2, 3), {"axes": "zyxs"}, ValueError, "2 channels; it takes 1, 3"),
        (STACK, {"axes": "zy"}, ValueError, "axes is 'zy'; it takes y, x"),
        (STACK, {"axes": "zyxs"}, ValueError, "axes is 'zyxs'; stack has 3 axes"),
        (STACK, {"axes": "tzyx"}, ValueError, "axes is 'tzyx'; stack has 3 axes"),
        (PLATE, {}, ValueError, r"stack has shape \(2, 4, 30, 40\); it takes"),
        (PLATE, {"axes": "tzyx"}, ValueError, "2 along t and 4 along z; time chooses one"),
        (PLATE, {"axes": "czyx"}, ValueError, "2 along c and 4 along z; channel chooses one"),
        (PLATE, {"axes": "tcyx"}, ValueError, "2 along t and 4 along c; channel chooses one"),
        (PLATE, {"axes": "pzyx"}, ValueError, "planes, 2 along p and 4 along z; it takes planes"),
        (PLATE[None].repeat(2, 0), {"axes": "tczyx"}, ValueError, "time and channel choose one of"),
        (PLATE, {"axes": "czyx", "channel": 2}, ValueError, "channel is 2; stack has 2 along c"),
        (PLATE, {"axes": "czyx", "channel": -1}, ValueError, "channel is -1; stack has 2 along c"),
        (PLATE, {"axes": "czyx", "channel": 0.5}, TypeError, "channel is 0.5; it takes a whole"),
        (STACK, {"channel": 0}, ValueError, "channel is 0; stack has no axis c"),
        (STACK, {"axes": "tyx", "time": 0}, ValueError, "a single plane"),
        (STACK, {"axes": "cyx"}, ValueError, "channels are not planes through focus"),
        (STACK, {"axes": 3}, TypeError, "axes is 3; it takes a string"),
        (STACK[:3], {"axes": "syx"}, ValueError, "stack has a single plane"),
        (STACK, {"channel_axis": 1.5}, TypeError, "channel_axis is 1.5"),
        (STACK, {"axes": "zyx", "channel_axis": 0}, ValueError, "it takes one"),
        (STACK, {"px_per_plane": 0.0}, ValueError, "px_per_plane is 0.0"),
        (STACK, {"px_per_plane": np.nan}, ValueError, "px_per_plane is nan"),
        (STACK, {"noise_variance": -1.0}, ValueError, "noise_variance is -1.0"),
        (STACK, {"window": 16}, ValueError, "window is 16"),
        (STACK, {"stride": 0}, ValueError, "stride is 0"),
        (STACK, {"smoothness": -1.0}, ValueError, "smoothness is -1.0"),
        (STACK, {"linearize": "gamma"}, ValueError, "linearize is 'gamma'"),
    ],
)
def test_what_cannot_be_is_refused_in_words(stack, arguments, error, words):
    with pytest.raises(error, match=words):
        sharpest_plane(stack, **arguments)
