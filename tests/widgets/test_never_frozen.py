"""No step of the work stops the window: a ticking timer in a real one."""

import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from qtpy.QtCore import QTimer
from skimage.data import retina
from skimage.transform import resize

from napari_defocus.core import worker_process
from napari_defocus.settings import MapSettings, MaskSettings
from napari_defocus.widgets.docks.defocus import DefocusWidget

pytestmark = pytest.mark.display

LATE = 0.1
"""Seconds without a tick that a user would feel."""

MOSTLY = 0.7
"""Share of a step's time in which the window answers, also on a machine that is busy otherwise."""


class Ticking:
    """Notes what is between two ticks: seconds, and how long this process was at work in them.

    The seconds are longer on a busy machine, the work is not: nothing else counts to it. Its
    other threads do: one that holds the GIL stops the window, too.
    """

    def __init__(self, parent):
        self._timer = QTimer(parent)
        self._timer.timeout.connect(lambda: self._tick())
        self.start()
        self._timer.start(5)

    def _tick(self):
        now = time.perf_counter(), time.process_time()
        self._between.append((now[0] - self._last[0], now[1] - self._last[1]))
        self._last = now

    def start(self):
        self._last, self._between = (time.perf_counter(), time.process_time()), []

    @property
    def most_work(self):
        """Most seconds of work between two ticks."""
        return max(work for _, work in self._between)

    @property
    def answering(self):
        """Share of the time in which the last tick was not long ago."""
        waits = [wait for wait, _ in self._between]
        return sum(min(wait, LATE) for wait in waits) / sum(waits)


@pytest.fixture
def dock(window, usual_pauses):
    picture = resize(retina(), (1024, 1024), anti_aliasing=True, order=1)
    window.add_image((255 * picture).astype(np.uint8), name="retina")
    widget = DefocusWidget(window)
    window.window.add_dock_widget(widget)
    return widget, Ticking(widget.native)


@pytest.fixture
def waiting(monkeypatch):
    """The threads that wait for another process: the window's must not."""
    threads = set()
    for name in ("answer", "stop"):
        wait = getattr(worker_process._Worker, name)

        def noted(worker, *args, wait=wait):
            threads.add(threading.current_thread())
            return wait(worker, *args)

        monkeypatch.setattr(worker_process._Worker, name, noted)
    return threads


def settled(widget):
    return widget._running is None and not widget._live_labels.is_busy


def test_nothing_stops_the_window_while_a_megapixel_is_estimated_labelled_and_cut(
    dock, qtbot, waiting
):
    widget, ticking = dock
    # A rough run at first. From then on there are layers, which napari does not have to make
    # anew: the first of each kind cost it 0.1 to 0.3 s, whoever adds them.
    widget.settings.take(MapSettings(stride=16), MaskSettings())
    run = widget.run()
    with qtbot.waitSignal(run.finished):
        pass
    widget.settings.take(MapSettings(stride=8), MaskSettings())
    work = {"a run": [], "the threshold": []}
    for attempt in range(3):
        left = [name for name, seconds in work.items() if not seconds or min(seconds) >= LATE]
        if not left:
            break  # what happened once can only have been the machine
        qtbot.waitUntil(lambda: settled(widget))
        qtbot.wait(500)
        for name in left:
            if name == "a run":
                widget.settings.max_radius.value = 7.0 - attempt / 2
            else:
                widget.settings.threshold.value = 1.5 + attempt
            ticking.start()
            if name == "a run":
                assert widget.run() is not None
            qtbot.waitUntil(lambda: settled(widget))
            qtbot.wait(100)
            work[name].append(ticking.most_work)
            assert ticking.answering > MOSTLY, name
    assert {name: min(seconds) for name, seconds in work.items() if min(seconds) >= LATE} == {}
    assert waiting
    assert threading.main_thread() not in waiting


CLOSED = """
import sys, time
import napari, psutil
import numpy as np
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QApplication

viewer = napari.Viewer(show=False)
viewer.add_image(np.random.default_rng(0).random((520, 520), np.float32))
dock, widget = viewer.window.add_plugin_dock_widget("napari-defocus", "Measure defocus")
run = widget.run()
steps = []
run.progressed.connect(lambda step, done: steps.append(step))
while {step!r} not in steps:
    QApplication.processEvents()
    time.sleep(0.01)  # without it, the thread of the run would hardly have a turn
print("children", len(psutil.Process().children()), flush=True)
viewer.close()
end = time.monotonic() + 60
while psutil.Process().children() and time.monotonic() < end:
    QApplication.processEvents()
    time.sleep(0.01)
print("left", len(psutil.Process().children()), flush=True)
"""


@pytest.mark.parametrize("step", ["Making the map coherent"])
def test_closing_the_viewer_during_a_run_leaves_no_process_and_no_error(step):
    code = CLOSED.format(step=step)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["children", "1", "left", "0"]
    assert "Traceback" not in done.stderr
    assert "Error" not in done.stderr
    assert done.returncode == 0
