"""Which PSF family made a picture."""

import numpy as np
import pytest

from napari_defocus import (
    Annulus,
    Cancelled,
    Disc,
    Gaussian,
    Polygon,
    compare_psf,
    simulate_defocus,
)

FAMILIES = [Disc(8.0), Polygon(6, max_radius=8.0), Annulus(0.5, 8.0), Gaussian(8.0)]


@pytest.mark.parametrize("psf", FAMILIES[:3], ids=lambda psf: type(psf).__name__)
@pytest.mark.parametrize("texture", ["grass", "clouds"])
def test_family_that_made_the_picture_wins(request, psf, texture):
    scales = np.broadcast_to(np.linspace(0.3, 0.8, 160) * psf.max_scale, (160, 160))
    picture = simulate_defocus(
        request.getfixturevalue(texture), scales, psf=psf, noise_variance=1e-6, rng=0
    )
    found = compare_psf(picture, FAMILIES)
    assert found.best == psf
    assert {row.psf for row in found} == set(FAMILIES)
    evidence = [row.log_evidence for row in found]
    assert evidence == sorted(evidence, reverse=True)
    assert sum(row.share for row in found) == pytest.approx(1)


def test_table_names_the_families_best_first(clouds, defocused):
    found = compare_psf(defocused(clouds, 4), [Annulus(0.5, 8.0), Disc(8.0)])
    lines = str(found).splitlines()
    assert lines[1].startswith("disc")
    assert lines[2].startswith("annulus:0.5")
    assert found.windows > 100
    assert abs(found.rows[0].median_scale - 4) < 0.3


def test_function_is_a_family(clouds, defocused):
    found = compare_psf(defocused(clouds, 4), [Disc(8.0).kernel, Gaussian(8.0)])
    assert found.best.max_scale == 8
    assert "px" in str(found)


def test_bad_calls_are_errors_that_name_the_argument(clouds):
    with pytest.raises(ValueError, match="families is empty"):
        compare_psf(clouds, [])
    with pytest.raises(TypeError, match="psf is 'disc'"):
        compare_psf(clouds, ["disc"])
    with pytest.raises(ValueError, match="no texture"):
        compare_psf(np.zeros((60, 60)), FAMILIES)
    with pytest.raises(ValueError, match="noise_variance is -1"):
        compare_psf(clouds, FAMILIES, noise_variance=-1)


def test_exception_from_progress_ends_the_work(clouds):
    def stop(step, done):
        raise Cancelled

    with pytest.raises(Cancelled):
        compare_psf(clouds, FAMILIES, progress=stop)
