import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import ModuleType

import errands
import numpy as np
import psutil
import pytest

from napari_defocus import (
    Cancelled,
    KernelFunction,
    estimate_candidates,
    label_blur_map,
    segment_in_focus,
)
from napari_defocus.core import worker_process as other_process
from napari_defocus.core.worker_process import run_elsewhere

OWN_STEPS = other_process.STARTING, other_process.HANDING_OVER, other_process.LOADING


@pytest.fixture(scope="module", autouse=True)
def _none_is_left_over():
    yield
    other_process._end_all()


@pytest.fixture
def _none_is_kept():
    other_process._end_all()


@pytest.fixture(scope="module")
def picture(ramp_picture):
    return ramp_picture[:64, :80]


@pytest.fixture(scope="module")
def candidates(picture):
    return estimate_candidates(picture)


def is_running(pid):
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def has_ended(pid):
    """Whether a process ends in the next minutes; nothing but a mistake takes it so long."""
    give_up = time.monotonic() + 300
    while is_running(pid) and time.monotonic() < give_up:
        time.sleep(0.01)
    return not is_running(pid)


@pytest.mark.parametrize("function", [label_blur_map, segment_in_focus])
def test_result_and_reports_are_those_of_the_direct_call(function, candidates, picture):
    direct, elsewhere = [], []
    expected = function(candidates, picture, progress=lambda *report: direct.append(report))
    found = run_elsewhere(
        function, candidates, picture, progress=lambda *report: elsewhere.append(report)
    )
    np.testing.assert_array_equal(found, expected)
    assert found.dtype == expected.dtype
    assert found.flags.writeable
    heard = dict.fromkeys(report for report in elsewhere if report[0] not in OWN_STEPS)
    assert list(heard) == list(dict.fromkeys(direct))


@pytest.mark.usefixtures("_none_is_kept")
def test_steps_say_that_a_process_is_started_and_loaded_and_only_the_first_time():
    for expected in (OWN_STEPS, (other_process.HANDING_OVER,)):
        heard = []
        run_elsewhere(errands.process_id, progress=lambda *report: heard.append(report))  # noqa: B023
        assert [step for step, _ in dict.fromkeys(heard)] == list(expected)
        assert {done for _, done in heard} == {0.0}


def test_arrays_of_any_layout_arrive_and_may_be_changed_there():
    whole = np.arange(300_000.0).reshape(500, 600)
    for array in (whole, whole.T, whole[::2, ::-1], whole[:0], np.array(3.0)):
        before = array.copy()
        np.testing.assert_array_equal(run_elsewhere(errands.doubled, array), 2 * before)
        np.testing.assert_array_equal(array, before)


def test_next_call_is_answered_by_the_same_process_without_napari_and_qt(candidates, picture):
    first = run_elsewhere(errands.process_id)
    assert first != os.getpid()
    run_elsewhere(label_blur_map, candidates, picture)
    loaded = {name.partition(".")[0] for name in run_elsewhere(errands.names_of_modules)}
    assert "numba" in loaded
    assert not {"napari", "qtpy", "magicgui", "PySide6", "PyQt6"} & loaded
    assert run_elsewhere(errands.process_id) == first


def test_errors_come_back_with_type_message_and_origin(candidates, picture):
    with pytest.raises(ValueError, match="image is 63 x 80 px; these candidates") as raised:
        run_elsewhere(label_blur_map, candidates, picture[1:])
    assert any("in label_blur_map" in note for note in raised.value.__notes__)
    with pytest.raises(RuntimeError, match="OddError: it fails because it can"):
        run_elsewhere(errands.failing_oddly)


@pytest.mark.parametrize("step", [other_process.HANDING_OVER, "at work"])
def test_cancelling_ends_a_process_that_says_nothing(step):
    pid = run_elsewhere(errands.process_id)
    seen = []

    def cancel_later(name, done):
        seen.append(name)
        if name == step and (step == other_process.HANDING_OVER or len(seen) > 10):
            raise Cancelled

    with pytest.raises(Cancelled):
        run_elsewhere(errands.endless, progress=cancel_later)
    assert not is_running(pid), "its errand takes an hour"
    assert run_elsewhere(errands.process_id) != pid


def test_cancelling_leaves_a_process_that_reports_for_the_next_call(monkeypatch):
    monkeypatch.setattr(other_process, "_GRACE", 600)  # on a busy machine, a report may be late
    pid = run_elsewhere(errands.process_id)
    seen = []

    def cancel_later(name, done):
        seen.append(name)
        if len(seen) > 10:
            raise Cancelled

    with pytest.raises(Cancelled):
        run_elsewhere(errands.reporting, progress=cancel_later)
    assert run_elsewhere(errands.process_id) == pid
    np.testing.assert_array_equal(run_elsewhere(errands.doubled, np.ones(3)), [2, 2, 2])


@pytest.mark.usefixtures("_none_is_kept")
def test_idle_process_can_be_ended():
    pid = run_elsewhere(errands.process_id)
    other_process.end_idle()
    assert not is_running(pid)


def test_caller_is_asked_often_while_the_other_process_says_nothing():
    """A third as often, at least, as a clock beside it ticks that goes at 0.05 s."""
    asked, ticks, is_over = [], [], threading.Event()

    def tick():
        while not is_over.wait(0.05):
            ticks.append(len(asked))

    def report(name, done):
        if name == "at work":
            asked.append(name)
        if len(asked) == 1:
            clock.start()
        if len(asked) > 20:
            raise Cancelled

    clock = threading.Thread(target=tick)
    with pytest.raises(Cancelled):
        run_elsewhere(errands.endless, progress=report)
    is_over.set()
    clock.join()
    assert len(asked) > len(ticks) / 3


def test_what_cannot_be_sent_is_done_here(monkeypatch):
    family = KernelFunction(lambda scale: np.ones((1, 1)))
    assert run_elsewhere(errands.process_id, family) == os.getpid()
    nowhere_else = ModuleType("nowhere_else")
    exec("def here(*, progress): return __name__", vars(nowhere_else))
    monkeypatch.setitem(sys.modules, "nowhere_else", nowhere_else)
    assert run_elsewhere(nowhere_else.here) == "nowhere_else"


@pytest.mark.usefixtures("_none_is_kept")
def test_work_is_done_here_where_no_process_can_be_started(monkeypatch):
    monkeypatch.setattr(other_process, "_START", "raise SystemExit({path!r} and 1)")
    assert run_elsewhere(errands.process_id) == os.getpid()
    for executable in ("", "no such program"):
        monkeypatch.setattr(sys, "executable", executable)
        assert run_elsewhere(errands.process_id) == os.getpid()


@pytest.mark.usefixtures("_none_is_kept")
def test_frozen_application_does_not_start_itself_again(monkeypatch):
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    assert run_elsewhere(errands.process_id) == os.getpid()


def test_death_of_the_process_is_said_and_the_next_call_gets_a_new_one():
    with pytest.raises(RuntimeError, match="ended with exit code 3"):
        run_elsewhere(errands.dying, errands.ended_with_code_3)
    if hasattr(signal, "SIGKILL"):
        with pytest.raises(MemoryError, match="memory ran out"):
            run_elsewhere(errands.dying, errands.ended_by_the_system)
    kept = psutil.Process(run_elsewhere(errands.process_id))
    kept.kill()
    kept.wait()
    assert run_elsewhere(errands.process_id) not in (kept.pid, os.getpid())


@pytest.mark.usefixtures("_none_is_kept")
def test_calls_at_the_same_time_have_a_process_each_and_one_is_kept():
    together = threading.Barrier(2)
    pids = []

    def call():
        waited = []

        def report(name, done):
            if not waited:
                waited.append(together.wait())

        pids.append(run_elsewhere(errands.process_id, progress=report))

    threads = [threading.Thread(target=call) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({*pids, os.getpid()}) == 3
    assert sum(map(is_running, pids)) == 1


@pytest.mark.usefixtures("_none_is_kept")
def test_each_channel_has_a_process_of_its_own_which_is_kept():
    pids = {name: run_elsewhere(errands.process_id, channel=name) for name in ("", "quick")}
    assert pids[""] != pids["quick"]
    for name in ("quick", ""):
        assert run_elsewhere(errands.process_id, channel=name) == pids[name]


def test_nothing_is_printed_and_nobody_is_asked(capfd):
    assert run_elsewhere(errands.chatter) == ""
    assert capfd.readouterr() == ("", "")


SCRIPT = """
import os, signal, sys, threading
sys.path.insert(0, {tests!r})
from napari_defocus.core.worker_process import run_elsewhere
import errands

print(os.getpid(), flush=True)
print(run_elsewhere(errands.process_id), flush=True)
if {busy}:
    at_work = threading.Event()
    report = lambda name, done: name == "at work" and at_work.set()
    work = lambda: run_elsewhere(errands.endless, progress=report)
    threading.Thread(target=work, daemon=True).start()
    at_work.wait()
{end}
"""


@pytest.mark.parametrize(
    ("busy", "end"),
    [(False, ""), (True, "os._exit(0)"), (True, "os.kill(os.getpid(), signal.SIGTERM)")],
)
def test_process_ends_with_its_parent_however_that_ends(busy, end):
    code = SCRIPT.format(tests=str(Path(errands.__file__).parent), busy=busy, end=end)
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True)
    parent, child = map(int, done.stdout.split())
    assert parent != child
    assert done.stderr == ""
    assert has_ended(child), "its errand takes an hour"
