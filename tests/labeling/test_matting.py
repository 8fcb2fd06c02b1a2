import sys
from types import SimpleNamespace

import numpy as np
import pytest

from napari_defocus import estimate_candidates, matte_in_focus, segment_in_focus
from napari_defocus.core import extras
from napari_defocus.labeling.matting import trimap


@pytest.fixture
def disc():
    """A mask, and a picture whose opacity is the distance from its border."""
    row, column = np.indices((300, 520)) - np.array([150, 260])[:, None, None]
    away = np.hypot(row, column) - 100
    opacity = np.clip(0.5 - away / 8, 0, 1)
    return (away < 0).astype(np.uint8), opacity, 0.2 + 0.6 * opacity[..., None] * np.ones(3)


@pytest.fixture
def solver(monkeypatch):
    """A stand-in for PyMatting that reads the opacity off the brightness; keeps its trimaps."""
    seen = []

    def estimate_alpha_cf(image, known, preconditioner):
        assert {0, 1} <= {*np.unique(known)}
        seen.append(known)
        return np.where(known == 0.5, (image[..., 0] - 0.2) / 0.6, known)

    module = SimpleNamespace(estimate_alpha_cf=estimate_alpha_cf, ichol=None)
    monkeypatch.setitem(sys.modules, "pymatting", module)
    monkeypatch.setattr(extras, "find_spec", lambda name: module)
    return seen


def test_opacity_is_solved_beside_the_border_only(disc, solver):
    mask, opacity, picture = disc
    alpha = matte_in_focus(picture, mask, width=10)
    assert (alpha.dtype, alpha.shape) == (np.float32, mask.shape)
    np.testing.assert_allclose(alpha, opacity, atol=1e-5)
    pixels = sum(known.size for known in solver)
    assert len(solver) < 6 < pixels / 10_000, "tiles without a border are left out"
    assert all(known.size <= 288**2 for known in solver)


def test_what_is_not_known_beside_what_is_in_focus_is_found_out(disc, solver):
    mask, opacity, picture = disc
    unknown = mask.copy()
    unknown[140:160, 150:200], unknown[140:160, :20] = 2, 2
    alpha = matte_in_focus(picture, unknown, width=10)
    np.testing.assert_allclose(alpha[150, 165:185], opacity[150, 165:185], atol=1e-5)
    assert not alpha[150, :20].any()


def test_mask_of_one_answer_needs_no_solving(disc, solver):
    *_, picture = disc
    for answer in (0, 1):
        whole = np.full(picture.shape[:2], answer, np.uint8)
        np.testing.assert_array_equal(matte_in_focus(picture, whole), answer)
    assert not solver


def test_segmentation_gives_the_opacity_of_its_mask(scene, solver):
    picture, _ = scene(blurred="background")
    candidates = estimate_candidates(picture)
    alpha = segment_in_focus(candidates, picture, alpha=True)
    mask = segment_in_focus(candidates, picture)
    assert alpha.dtype == np.float32
    sure = trimap(mask == 1, 12) != 0.5
    np.testing.assert_array_equal(alpha[sure], mask[sure])


def test_missing_package_is_said_with_what_to_install(disc, monkeypatch):
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"pip install 'napari-defocus\[matting\]'"):
        matte_in_focus(disc[2], disc[0])


@pytest.mark.parametrize(
    ("mask", "width", "error", "saying"),
    [
        (np.zeros((9, 9), np.uint8), None, ValueError, r"mask has shape \(9, 9\)"),
        (np.zeros((300, 520)), None, TypeError, "mask has dtype float64"),
        (np.full((300, 520), 255), None, ValueError, "mask holds 255 to 255; it takes 0 blurred"),
        (np.zeros((300, 520), bool), 0, ValueError, "width is 0; it takes a whole number"),
    ],
)
def test_wrong_masks_are_refused(disc, solver, mask, width, error, saying):
    with pytest.raises(error, match=saying):
        matte_in_focus(disc[2], mask, width=width)


def test_hair_thinner_than_a_pixel_has_its_share():
    rows, columns = np.indices((120, 160))
    opacity = np.clip(60 - rows, 0, 1) + 0.4 * ((rows >= 60) & (rows < 68) & (columns % 8 == 0))
    rng = np.random.default_rng(0)
    light, dark = 0.8 + rng.normal(0, 0.01, (120, 160)), 0.2 + rng.normal(0, 0.01, (120, 160))
    picture = opacity * light + (1 - opacity) * dark
    alpha = matte_in_focus(picture, (rows < 60).astype(np.uint8), width=12)
    assert np.abs(alpha - opacity).mean() < 0.02
    hair = (rows >= 60) & (rows < 66) & (columns % 8 == 0)
    assert alpha[hair].mean() == pytest.approx(0.4, abs=0.1)
