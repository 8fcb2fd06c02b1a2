"""Whatever is given to public functions and to the command ends well, or in a clear error."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import napari_defocus
from benchmarks.fuzz.call import RECIPES, random_call
from benchmarks.fuzz.terminal import terminal_call
from benchmarks.fuzz.verdict import judged

EXAMPLES = 3

SLOW = {"calibrate_psf", "restore_all_in_focus", "fit_report"}
"""What takes tenths of a second a call."""

WITHOUT_A_RECIPE = {
    # What functions return: never made by users.
    *("BatchReport", "BlurCandidates", "DepthSurface", "FitReport", "FocusCurve", "PSFComparison"),
    *("PSFChoice", "PSFEvidence", "PixelExplanation", "RegionTable", "SharpestPlane"),
    "AutomaticPSF",  # it has no kernels
    *("RestorationFit", "TiledRestorationFit"),
    "StackAlignment",
    # They have tests of their own: numbers of a microscope and of a report, and their files.
    *("Microscope", "read_microscope", "FieldLimits", "write_report"),
    # A protocol, exceptions, and a function whose files are fuzzed through the terminal.
    *("PSFFamily", "Cancelled", "UnreadablePicture", "read_picture"),
}

few = settings(
    max_examples=EXAMPLES, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)
randoms = st.randoms(use_true_random=False)


def assert_good(name, call):
    verdict = judged(name, 0, call)
    assert verdict.ended in ("result", "clear error", "slow"), verdict.told


def test_every_public_function_is_called():
    assert set(napari_defocus.__all__) - set(RECIPES) == WITHOUT_A_RECIPE


@pytest.mark.parametrize("name", [name for name in RECIPES if name not in SLOW])
@given(rnd=randoms)
@few
def test_call_ends_in_a_right_result_or_an_error_that_names_the_argument(name, rnd):
    assert_good(name, random_call(name, rnd))


@given(rnd=randoms)
@settings(few, max_examples=6)
def test_command_ends_in_whole_files_or_one_line(rnd):
    assert_good("the terminal command", terminal_call(rnd))
