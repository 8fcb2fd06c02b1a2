"""Two sharp planes at one place, as in something transparent, are said, and one is chosen."""

import numpy as np
import pytest

from napari_defocus import Disc, sharpest_plane, simulate_defocus


@pytest.fixture(scope="module")
def transparent(grass, gravel):
    """Grass, in focus at plane 2, seen through gravel that is in focus at plane 9."""
    rng = np.random.default_rng(0)
    shape = (100, 100)
    planes = []
    for z in range(13):
        seen = [
            simulate_defocus(
                picture[:100, :100], np.full(shape, 1.2 * abs(z - focus)), psf=Disc(16.0),
                noise_variance=0,
            )
            for picture, focus in ((grass, 2), (gravel, 9))
        ]  # fmt: skip
        planes.append(np.mean(seen, axis=0) + rng.normal(0, 2e-3, shape))
    return np.stack(planes)


@pytest.mark.parametrize(("peak", "focus"), [("first", 2), ("last", 9)])
def test_peak_that_is_chosen_is_found(transparent, peak, focus):
    found = sharpest_plane(transparent, peak=peak)
    assert np.mean(np.abs(found.position - focus) <= 0.5) > 0.9
    assert found.two_peaks.mean() > 0.9
    assert f"the {peak} was taken there" in found.notes[-1]


def test_no_plane_between_two_peaks_is_taken_unless_asked_for(transparent):
    position = sharpest_plane(transparent).position
    assert np.mean((position > 3.5) & (position < 7.5)) < 0.1


def test_opaque_things_have_one_peak(grass):
    focus = np.broadcast_to(np.linspace(1, 6, 100), (100, 100))
    stack = [
        simulate_defocus(grass[:100, :100], np.abs(z - focus), noise_variance=1e-5, rng=z)
        for z in range(8)
    ]
    found = sharpest_plane(stack)
    assert found.two_peaks.mean() < 0.01
    assert found.two_peaks.shape == (100, 100)
    assert not any("Two planes" in note for note in found.notes)


def test_peak_that_is_none_is_refused():
    with pytest.raises(ValueError, match="peak is 'both'; it takes one of"):
        sharpest_plane(np.zeros((4, 30, 40)), peak="both")
