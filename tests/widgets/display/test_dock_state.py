"""What the dock says is true at every moment."""

from dataclasses import replace
from itertools import product

import pytest

from napari_defocus.widgets.display.dock_state import DockState, Measured, Notice, Stage

LINES = "Noise variance 3.0e-05 (found)\nTrusted on 87% (confidence 0.5 or more)"
NOTHING = DockState()
LEAF = DockState(picture="leaf")
DONE = replace(LEAF, measured=Measured(LINES, run=1), results=frozenset({1, 2}))
STACK = DockState(picture="stack", count=9, plane=(3,))


@pytest.mark.parametrize(
    ("state", "stage", "said"),
    [
        (NOTHING, Stage.NO_PICTURE, "Open a picture"),
        (replace(NOTHING, others=True), Stage.NO_PICTURE, "Only image layers can be measured"),
        (LEAF, Stage.CHOSEN, "Press “Measure”: how blurred is “leaf”"),
        (STACK, Stage.CHOSEN, "9 planes; plane 3 is shown"),
        (replace(STACK, all_planes=True), Stage.CHOSEN, "all 9 planes"),
        (replace(LEAF, step="Estimating blur"), Stage.RUNNING, "Estimating blur"),
        (DONE, Stage.MEASURED, LINES),
        (replace(DONE, updating=True), Stage.UPDATING, "Updating"),
        (replace(DONE, changed=True), Stage.CHANGED, "was changed after it was measured"),
        (replace(DONE, relief=True), Stage.MEASURED, "Turn the relief"),
    ],
)
def test_each_situation_has_its_words(state, stage, said):
    assert state.stage is stage
    assert said in state.text


def test_results_that_are_gone_are_not_spoken_of_and_nothing_is_updating():
    gone = replace(DONE, measured=replace(DONE.measured, there=False), updating=True)
    assert gone.stage is Stage.GONE
    assert "were removed" in gone.text
    assert "Noise" not in gone.text
    assert "Updating" not in gone.text


def test_nothing_is_said_of_a_picture_that_is_gone():
    notice = Notice("Saved leaf-blur.tif", DONE.situation)
    assert "Noise" not in replace(DONE, picture=None, notice=notice).text
    assert "leaf" not in replace(DONE, picture=None, notice=notice).text


def test_another_plane_is_not_taken_for_the_measured_one():
    one = replace(STACK, measured=Measured(LINES, plane=(3,)))
    assert one.text == LINES
    other = replace(one, plane=(4,))
    assert "Plane 3 was measured; plane 4 is shown" in other.text
    assert "Noise" not in other.text
    assert replace(other, measured=Measured(LINES, plane=None)).text == LINES, "all were"


def test_settings_that_are_not_applied_are_said_above_what_is_shown():
    outdated = replace(DONE, measured=replace(DONE.measured, outdated=True))
    assert outdated.text.startswith("Press “Measure” to apply")
    assert LINES in outdated.text


def test_a_renamed_picture_has_its_new_name():
    gone = replace(DONE, picture="oak", measured=replace(DONE.measured, there=False))
    assert "“oak”" in gone.text


@pytest.mark.parametrize(
    "then",
    [
        {"picture": "other"},
        {"plane": (1,)},
        {"measured": Measured(LINES, run=2)},
        {"relief": True},
        {"changed": True},
        {"results": frozenset({1})},
    ],
)
def test_a_notice_lasts_as_long_as_what_it_is_about(then):
    said = replace(DONE, notice=Notice("2 regions are in focus.", DONE.situation))
    assert said.text == "2 regions are in focus."
    assert replace(said, **then).text != said.text


def test_a_run_speaks_before_a_notice_and_leaves_it():
    said = replace(DONE, notice=Notice("Saved leaf-blur.tif", DONE.situation))
    assert replace(said, step="Reading the picture").text == "Reading the picture"
    assert replace(said, step="").text == "Saved leaf-blur.tif"


def test_every_combination_of_facts_has_words():
    facts = product((None, "leaf"), ("", "Reading"), (False, True), (None, Measured(LINES)))
    for picture, step, flag, measured in facts:
        state = DockState(
            picture, step=step, updating=flag, changed=flag, relief=flag, measured=measured
        )
        assert state.text
