"""What a terminal shows while a command works, and what it says of the time that it took."""

import io
import json
import re
import sys

import pytest

from napari_defocus.cli import command as commands
from napari_defocus.cli.console import progress_in_terminal
from napari_defocus.cli.option_groups import Reporting
from napari_defocus.core.progress import CompilationClock

COMPILING = "Compiling the kernels, once"
STEPS = [(COMPILING, 0.07), ("Estimating blur [1]", 0.5), ("Putting pixels together", 1.0)]


class Terminal(io.StringIO):
    """Standard error as a terminal of 100 columns."""

    def isatty(self):
        return True

    def shown(self):
        """Return all that was written, without colours."""
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self.getvalue())


def test_each_step_is_named_at_once_behind_its_percentage_and_the_time(monkeypatch):
    terminal = Terminal()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress_in_terminal(quiet=False) as progress:
        assert re.search(r" 0% 0:00:00 Starting", terminal.shown())
        for step, done in STEPS:
            progress(step, done)
            assert re.search(rf" {done:.0%} \d:\d\d:\d\d {re.escape(step)}", terminal.shown())


@pytest.mark.parametrize(("quiet", "stream"), [(True, Terminal()), (False, io.StringIO())])
def test_quiet_commands_and_files_get_no_bar(quiet, stream, monkeypatch):
    monkeypatch.setattr(sys, "stderr", stream)
    with progress_in_terminal(quiet) as progress:
        progress(*STEPS[0])
    assert stream.getvalue() == ""


@pytest.fixture
def clock():
    """Seconds that pass as a test says."""
    passed = [0.0]

    def now():
        return passed[0]

    def wait(seconds):
        passed[0] += seconds

    now.wait = wait
    return now


def test_time_spent_compiling_is_that_between_its_reports_and_the_next_step(clock):
    heard = []
    report = CompilationClock(lambda *report: heard.append(report), now=clock)
    told = [("Reading", 5.0), (COMPILING, 20.0), (COMPILING, 30.0), ("Estimating blur", 7.0)]
    for step, seconds in [*told, (COMPILING, 3.0), ("Done", 1.0)]:
        report(step, 0.5)
        clock.wait(seconds)
    assert report.seconds == 53.0
    assert heard[0] == ("Reading", 0.5)
    assert len(heard) == 6


@pytest.mark.parametrize(
    ("compiling", "line"),
    [
        (63.6, "time         4.9 s, and 63.6 s to compile the program, once"),
        (0.0, "time         68.5 s"),
    ],
)
def test_time_of_compiling_is_told_apart(compiling, line):
    facts = {"seconds": 68.5, "seconds_compiling": compiling, "files": []}
    assert list(commands.last_lines(facts)) == [line]


def test_report_says_how_long_it_compiled(capsys):
    def work(progress):
        progress(COMPILING, 0.0)
        progress("Estimating blur", 0.1)
        return {"files": []}

    commands.run(work, lambda _: iter(()), Reporting(as_json=True))
    facts = json.loads(capsys.readouterr().out)
    assert 0 <= facts["seconds_compiling"] <= facts["seconds"]
