"""The public names, what importing them costs, and the examples in their docstrings."""

import doctest
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import napari_defocus
from napari_defocus import (
    Settings,
    estimate_blur_map,
    estimate_candidates,
    focus_curve,
    label_blur_map,
    measure_batch,
)

PUBLIC = {
    "Annulus",
    "AutomaticPSF",
    "BatchReport",
    "BlurCandidates",
    "Cancelled",
    "DepthSurface",
    "Disc",
    "FitReport",
    "RestorationFit",
    "TiledRestorationFit",
    "FocusCurve",
    "Gaussian",
    "GeneralizedGaussian",
    "KernelFunction",
    "MeasuredPSF",
    "Microscope",
    "PSFChoice",
    "PSFComparison",
    "PSFEvidence",
    "PSFFamily",
    "PixelExplanation",
    "Polygon",
    "RegionTable",
    "Settings",
    "SharpestPlane",
    "ShotNoise",
    "StackAlignment",
    "ThinLens",
    "UnreadablePicture",
    "blur_from_depth",
    "calibrate_psf",
    "cautious_blur_map",
    "change_focus",
    "compare_psf",
    "composite_at",
    "confidence_map",
    "depth_from_blur",
    "depth_surface",
    "draw_explanation",
    "estimate_blur_map",
    "estimate_candidates",
    "estimate_noise_variance",
    "estimate_shot_noise",
    "explain_pixel",
    "fit_report",
    "focus_curve",
    "label_blur_map",
    "labeling_energy",
    "FieldLimits",
    "measure_batch",
    "write_report",
    "measure_regions",
    "psf_from_text",
    "read_microscope",
    "picture_remarks",
    "read_picture",
    "restore_all_in_focus",
    "segment_in_focus",
    "sharpest_plane",
    "simulate_defocus",
    "simulate_layered_defocus",
    "focus_threshold",
    "known_places",
    "matte_in_focus",
}

PACKAGE = Path(napari_defocus.__file__).parent

OLD_PLACES = {"cluster.py", "ome_zarr_writer.py", "sources.py", "tiff_stacks.py"}

MODULES = [
    str(path.relative_to(PACKAGE).with_suffix("")).replace(os.sep, ".")
    for path in sorted(PACKAGE.rglob("*.py"))
    if path.name != "__init__.py"
    and path.relative_to(PACKAGE).parts[0] not in {"widgets", *OLD_PLACES}
]


def run_python(code):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout


def test_public_names_are_there_and_listed():
    assert set(napari_defocus.__all__) == PUBLIC
    assert set(dir(napari_defocus)) >= PUBLIC
    for name in PUBLIC:
        assert getattr(napari_defocus, name).__doc__


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="sharpen"):
        _ = napari_defocus.sharpen


PICTURE = np.random.default_rng(0).random((48, 48))


@pytest.mark.parametrize(
    ("flag", "call"),
    [
        ("return_confidence", lambda given: estimate_blur_map(PICTURE, return_confidence=given)),
        (
            "return_extrapolated",
            lambda given: label_blur_map(
                estimate_candidates(PICTURE), PICTURE, return_extrapolated=given
            ),
        ),
        ("force", lambda given: Settings().save("never.json", force=given)),
        ("force", lambda given: focus_curve(PICTURE[None]).save("never.csv", force=given)),
        ("force", lambda given: measure_batch("nowhere", "never", force=given)),
    ],
)
@pytest.mark.parametrize("given", ["no", 1, None, np.ones(2, bool)], ids=repr)
def test_flag_that_is_neither_true_nor_false_is_named(flag, call, given, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TypeError, match=f"{flag} is .*; it takes True or False"):
        call(given)
    assert not list(tmp_path.iterdir())


def test_importing_the_package_imports_nothing_heavy():
    heavy = {"numba", "maxflow", "napari", "qtpy", "magicgui", "scipy", "skimage", "dask", "numpy"}
    loaded = run_python("import sys, napari_defocus; print(*sys.modules)").split()
    assert not heavy & set(loaded)


def test_method_imports_neither_napari_nor_qt():
    names = ", ".join(sorted(PUBLIC))
    code = f"import sys\nfrom napari_defocus import {names}\nprint(*sys.modules)"
    loaded = {name.partition(".")[0] for name in run_python(code).split()}
    assert "numba" in loaded
    assert not {"napari", "qtpy", "magicgui", "PySide6", "PyQt6", "dask"} & loaded


@pytest.mark.parametrize("module", ["settings", "cli.app", "pipeline", "io.settings_file"])
def test_what_a_command_begins_with_is_light(module):
    """Help and errors come at once: nothing is loaded that only measuring needs."""
    code = f"import sys\nimport napari_defocus.{module}\nprint(*sys.modules)"
    loaded = {name.partition(".")[0] for name in run_python(code).split()}
    assert not {"scipy", "skimage", "numba", "dask", "napari", "qtpy"} & loaded


@pytest.mark.parametrize("module", MODULES)
def test_examples_in_docstrings_are_true(module):
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE)
    for docstring in doctest.DocTestFinder().find(import_module(f"napari_defocus.{module}")):
        # Not those without examples, as testmod does: each of them costs 10 ms.
        if docstring.examples:
            runner.run(docstring)
    assert runner.summarize().failed == 0


RESULTS = {
    "BlurCandidates",
    "Cancelled",
    "DepthSurface",
    "FitReport",
    "RestorationFit",
    "TiledRestorationFit",
    "FocusCurve",
    "PSFChoice",
    "PSFComparison",
    "PSFEvidence",
    "PSFFamily",
    "RegionTable",
    "PixelExplanation",
    "SharpestPlane",
}


@pytest.mark.parametrize("name", sorted(PUBLIC - RESULTS))
def test_public_functions_have_an_example(name):
    assert doctest.DocTestFinder(recurse=False).find(getattr(napari_defocus, name))[0].examples
