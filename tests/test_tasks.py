"""What tasks.py says while it installs: that it works, and why it failed."""

import sys

import pytest

import tasks

SAID = [
    "Collecting numba>=0.61 (from napari-defocus==0.1.0)",
    "  Downloading numba-0.68.1-cp311-cp311-manylinux_2_28_x86_64.whl (3.8 MB)",
    "Requirement already satisfied: wheel",
    "Installing collected packages: numba, scipy, numpy",
]


STEPS = ["looking at numba", "downloading numba (3.8 MB)", "installing 3 packages"]


def without_seconds(lines):
    """Return the steps of lines; one that stayed for a second is there again."""
    return list(dict.fromkeys(line.strip().partition(" s: ")[2] for line in lines))


def pip_that_says(*lines, code):
    printed = f"import sys; print({chr(10).join(lines)!r}); sys.exit({code})"
    return [sys.executable, "-c", printed]


@pytest.mark.parametrize(
    ("line", "step"),
    [
        *zip(
            SAID,
            [*STEPS[:2], None, STEPS[2]],
            strict=True,
        ),
        ("Processing /wheels/scikit_image-0.26.0-cp311.whl (from x)", "looking at scikit_image"),
        (r"Processing c:\wheels\scipy-1.17.1-cp311.whl", "looking at scipy"),
        ("Obtaining file:///home/me/napari-defocus", "looking at napari-defocus"),
        ("  Using cached rich-15.0.0-py3-none-any.whl (310 kB)", "downloading rich (310 kB)"),
        ("  Preparing editable metadata (pyproject.toml): started", "building"),
        ("WARNING: a location is ignored", None),
        ("", None),
    ],
)
def test_a_line_of_pip_becomes_a_few_words(line, step):
    assert tasks.step_of_pip(line) == step


def test_without_a_terminal_there_are_a_few_short_lines(capsys, monkeypatch):
    for apart, shown in [(60.0, STEPS[:1]), (0.0, STEPS)]:
        monkeypatch.setattr(tasks, "LINES_APART", apart)
        assert tasks.show_steps(pip_that_says(*SAID, code=0)) == 0
        assert without_seconds(capsys.readouterr().out.splitlines()) == shown


def test_in_a_terminal_one_line_changes_and_is_gone_in_the_end(capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "60")
    assert tasks.show_steps(pip_that_says(*SAID, code=0)) == 0
    out = capsys.readouterr().out
    states = out.split("\r")
    assert without_seconds(states[1:-2]) == STEPS
    assert {len(state) for state in states[1:-1]} == {59}, "each covers the one before"
    assert states[-2:] == [" " * 59, ""]
    assert "\n" not in out


def test_seconds_go_on_where_pip_says_nothing(capsys, monkeypatch):
    monkeypatch.setattr(tasks, "LINES_APART", 0.0)
    with tasks.Steps() as steps:
        steps.show("installing 34 packages")
        steps.started -= 50
        steps.write()
    assert capsys.readouterr().out.splitlines()[:2] == [
        "  0 s: installing 34 packages",
        "  50 s: installing 34 packages",
    ]


def test_all_that_pip_said_is_shown_if_it_fails(capsys, monkeypatch):
    complaint = "ERROR: No matching distribution found for numba>=99"
    monkeypatch.setattr(tasks, "show_steps", _ends_with(tasks.show_steps, SAID[0], complaint))
    with pytest.raises(SystemExit, match="pip failed, see above"):
        tasks.pip("install", "numba>=99")
    assert f"{SAID[0]}\n{complaint}\n" in capsys.readouterr().out


def _ends_with(show_steps, *lines):
    return lambda _command: show_steps(pip_that_says(*lines, code=1))
