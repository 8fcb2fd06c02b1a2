"""Stacks whose planes drift, breathe and flicker come out as those that do not."""

import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift
from skimage import data

from benchmarks.moving_stacks import taken
from napari_defocus import StackAlignment, composite_at, sharpest_plane
from napari_defocus.stacks.white import White

SIZE = 400
MARGIN = 30


def tilted(row, column):
    return 2 + 4 * (0.6 * row + 0.4 * column)


@pytest.fixture(scope="module")
def scene():
    return data.gravel()[:SIZE, :SIZE] / 255


@pytest.fixture(scope="module")
def still(scene):
    return taken(scene, tilted, noise_variance=1e-5, margin=MARGIN)


@pytest.fixture(scope="module")
def moving(scene):
    return taken(
        scene, tilted, drift=3, breathing=0.02, flicker=0.25, noise_variance=1e-5, margin=MARGIN
    )


@pytest.fixture(scope="module")
def of_still(still):
    return sharpest_plane(still.planes)


@pytest.fixture(scope="module")
def of_moving(moving):
    return sharpest_plane(moving.planes)


def psnr(stack, picture):
    """In dB, after the one factor of brightness that no stack tells; without its outermost px.

    Of what is not white.
    """
    inner = np.s_[12:-12, 12:-12]
    shown = stack.sharp[inner] < 1
    seen, sharp = picture[inner].astype(float)[shown], stack.sharp[inner][shown]
    seen = seen * (seen * sharp).sum() / (seen**2).sum()
    return -10 * np.log10(np.mean((seen - sharp) ** 2))


def test_planes_that_do_not_move_or_flicker_are_taken_as_they_are(still, of_still):
    assert of_still.alignment is None
    np.testing.assert_array_equal(of_still.gain, 1)
    assert [note.split()[0] for note in of_still.notes] == ["No", "Planes"]
    never = sharpest_plane(still.planes, align=False, match_brightness=False)
    assert never.notes == ()
    np.testing.assert_allclose(of_still.position, never.position, atol=0.05)


def test_moving_planes_are_found_where_they_are(moving, of_moving):
    alignment = of_moving.alignment
    assert alignment.reference == 4
    assert np.abs(alignment.shift - moving.shift).max() < 0.15
    assert np.abs(alignment.magnification / moving.magnification - 1).max() < 1e-3
    np.testing.assert_array_equal(alignment.turn, 0)
    assert "magnification up to 8" in of_moving.notes[0]


def test_flicker_is_found_to_half_a_percent(moving, of_moving):
    np.testing.assert_allclose(of_moving.gain, moving.gain, rtol=0.005)


@pytest.mark.parametrize(("dtype", "white"), [(np.uint8, 255), (np.uint16, 4095)])
def test_clipped_light_stays_white_in_planes_that_flicker(scene, dtype, white):
    """White is 4095 if a camera of 12 bits says so; beside highlights, nothing else is white."""
    lit = scene.copy()
    for row, column in ((110, 120), (210, 260), (290, 150)):
        lit[row : row + 16, column : column + 16] = 12

    def composite(**conditions):
        stack = taken(lit, tilted, clipped=True, noise_variance=1e-6, margin=MARGIN, **conditions)
        planes = np.rint(white * stack.planes).astype(dtype)
        return stack, sharpest_plane(planes).composite / white

    still, of_still = composite()
    flickering, of_flickering = composite(flicker=0.25)
    shown = flickering.sharp >= 1
    assert np.mean(of_flickering[shown] == 1) > 0.98
    assert of_flickering.max() == 1
    assert psnr(flickering, of_flickering) > psnr(still, of_still) - 5


def test_blurred_bright_spot_is_not_taken_for_clipped_light():
    spot = np.hypot(*np.mgrid[-60:60, -60:60])
    white = White(np.dtype(np.uint8))
    white.see(np.rint(40 + 140 * np.exp(-((spot / 25) ** 2))).astype(np.uint8))
    assert white.level == np.inf
    white.see(np.rint(np.minimum(40 + 300 * np.exp(-((spot / 25) ** 2)), 200)).astype(np.uint8))
    assert white.level == 200


def test_composite_of_a_moving_stack_is_nearly_that_of_a_still_one(
    still, moving, of_still, of_moving
):
    assert psnr(moving, of_moving.composite) > psnr(still, of_still.composite) - 1
    never = sharpest_plane(moving.planes, align=False, match_brightness=False)
    assert psnr(moving, of_moving.composite) > psnr(moving, never.composite) + 10
    assert np.mean(np.abs(of_moving.position - moving.truth) <= 0.5) > 0.98


def test_blending_averages_noise(scene):
    noisy = taken(scene, tilted, noise_variance=1e-3, margin=MARGIN)
    blended = sharpest_plane(noisy.planes, align=False)
    pixels = sharpest_plane(noisy.planes, align=False, blend=False)
    assert psnr(noisy, blended.composite) > psnr(noisy, pixels.composite) + 1.5


def test_blended_composite_of_little_noise_is_as_sharp_as_its_planes(still, of_still):
    pixels = sharpest_plane(still.planes, blend=False)
    assert psnr(still, of_still.composite) > psnr(still, pixels.composite) - 0.2


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
def test_aligned_composite_keeps_the_dtype_and_knows_every_pixel(moving, dtype):
    largest = np.iinfo(dtype).max if np.dtype(dtype).kind == "u" else 1
    planes = (moving.planes[:, :90, :90].clip(0, 1) * largest).astype(dtype)
    for blend in (False, True):
        found = sharpest_plane(planes, px_per_plane=1.0, align=True, blend=blend)
        assert found.composite.dtype == dtype
        assert found.composite.shape == (90, 90)
        assert np.isfinite(found.composite).all()
        assert found.composite.min() > 0


def test_alignment_of_one_channel_serves_another(moving, of_moving, tmp_path):
    path = tmp_path / "alignment.json"
    of_moving.alignment.save(path)
    again = StackAlignment.load(path)
    np.testing.assert_array_equal(again.shift, of_moving.alignment.shift)
    negative = 1 - moving.planes / moving.gain[:, None, None]
    other = composite_at(
        of_moving.position,
        negative,
        alignment=again,
        match_brightness=False,
        px_per_plane=of_moving.px_per_plane,
    )
    inner = np.s_[12:-12, 12:-12]
    assert np.corrcoef(other[inner].ravel(), moving.sharp[inner].ravel())[0, 1] < -0.995
    given = sharpest_plane(moving.planes, align=again)
    np.testing.assert_allclose(given.position, of_moving.position, atol=0.01)


def test_alignment_of_other_planes_is_refused(moving, of_moving):
    with pytest.raises(ValueError, match=r"alignment is of 9 planes .* stack has 8 of"):
        sharpest_plane(moving.planes[1:], align=of_moving.alignment)


def test_file_that_is_no_alignment_is_refused(tmp_path):
    path = tmp_path / "settings.json"
    path.write_text(json.dumps({"planes": [{"shift_rows": 1}]}))
    with pytest.raises(ValueError, match=r"settings.json: it has no 'shift_columns'"):
        StackAlignment.load(path)
    with pytest.raises(FileNotFoundError, match="no such file"):
        StackAlignment.load(tmp_path / "nothing.json")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"align": "yes"}, "align is 'yes'; it takes 'auto', True or False"),
        ({"match_brightness": 1}, "match_brightness is 1; it takes 'auto', True or False"),
        ({"blend": "no"}, "blend is 'no'; it takes True or False"),
    ],
)
def test_choice_that_is_none_is_refused(arguments, words):
    with pytest.raises(TypeError, match=words):
        sharpest_plane(np.zeros((4, 30, 40)), **arguments)


@pytest.mark.parametrize(
    ("position", "words"),
    [
        (np.zeros((30, 41)), "position has shape"),
        (np.full((30, 40), 3.5), "it takes planes from 0 to 3"),
        (np.full((30, 40), np.nan), "it takes planes from 0 to 3"),
    ],
)
def test_positions_beyond_the_stack_are_refused(position, words):
    with pytest.raises(ValueError, match=words):
        composite_at(position, np.zeros((4, 30, 40)))


def test_planes_without_texture_are_not_aligned_and_it_is_said():
    flat = np.full((4, 64, 64), 0.5)
    found = sharpest_plane(flat, align=True)
    assert found.alignment is None
    assert "too little in common" in found.notes[0]


def test_planes_with_unknown_corners_are_aligned_all_the_same():
    picture = np.asarray(data.camera()[:200, :220], np.float32) / 255
    planes = np.stack([np.roll(picture, 2 * number, axis=0) for number in range(3)])
    planes[:, :20, :20] = np.nan
    found = sharpest_plane(planes)
    np.testing.assert_allclose(found.alignment.shift[:, 0], [-2, 0, 2], atol=0.1)
    assert np.isnan(found.composite[:16, :16]).all()
    assert np.isfinite(found.composite[30:-10, 30:-10]).all()


def test_alignment_takes_lists_and_names_what_is_no_number():
    numbers = {"magnification": [1.0], "turn": [0.0], "uncertainty": [0.0]}
    made = StackAlignment(shape=(5, 5), reference=0, shift=[[0.0, 0.0]], **numbers)
    assert made.is_still
    with pytest.raises(TypeError, match="shift has dtype"):
        StackAlignment(shape=(5, 5), reference=0, shift=[["a", "b"]], **numbers)


def cells_on_dark_ground(drift, planes=9):
    """Take three small cells with a camera of much noise, and a stage that drifts by px a plane."""
    rng = np.random.default_rng(0)
    scene = np.zeros((160, 160))
    round_ = gaussian_filter((np.hypot(*np.mgrid[-12:12, -12:12]) < 10).astype(float), 2)
    for row, column in ((40, 60), (55, 75), (100, 90)):
        around = np.s_[row - 12 : row + 12, column - 12 : column + 12]
        scene[around] += 3000 * rng.random((24, 24)) ** 3 * round_
    taken_planes = []
    for away in np.arange(planes) - planes // 2:
        blurred = gaussian_filter(scene, 0.7 + 0.6 * abs(away))
        moved = shift(blurred, (drift * away, -drift * away), mode="nearest")
        taken_planes.append(100 + moved + rng.normal(0, 8, moved.shape))
    return np.stack(taken_planes)


@pytest.mark.parametrize("drift", [0.0, 1.5])
def test_a_few_cells_on_dark_ground_tell_the_drift_but_no_turn(drift):
    found = sharpest_plane(cells_on_dark_ground(drift), px_per_plane=1.0, stride=8)
    if drift == 0:
        assert found.alignment is None
        assert found.notes[0].startswith("No plane moves")
        return
    true = drift * np.arange(-4, 5)
    np.testing.assert_allclose(found.alignment.shift.T, [true, -true], atol=0.5)
    np.testing.assert_array_equal(found.alignment.magnification, 1)
    np.testing.assert_array_equal(found.alignment.turn, 0)


def test_one_plane_that_alone_shows_detail_is_told():
    rng = np.random.default_rng(1)
    sharp = gaussian_filter(rng.random((64, 64)), 0.7)
    planes = np.stack([gaussian_filter(sharp, 9)] * 7)
    planes[3] = sharp
    planes += rng.normal(0, 0.002, planes.shape)
    settings = {"stride": 8, "align": False, "match_brightness": False}
    assert "Only single planes show detail" in sharpest_plane(planes, **settings).notes[0]
    assert sharpest_plane(planes, px_per_plane=3.0, **settings).notes == ()
