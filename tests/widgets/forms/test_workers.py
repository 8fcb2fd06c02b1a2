from types import SimpleNamespace

import pytest

from napari_defocus.widgets.forms import workers
from napari_defocus.widgets.forms.workers import Run

pytestmark = pytest.mark.display


def test_every_step_is_shown_however_soon_it_follows_another(qtbot, monkeypatch):
    stopped_clock = SimpleNamespace(monotonic=lambda: 0.0)
    monkeypatch.setattr(workers, "time", stopped_clock)

    def work(progress):
        for done in range(100):
            progress("many reports", done / 200)
        progress("one report, then long work", 0.5)

    run, steps = Run(work, "steps"), []
    run.progressed.connect(lambda step, done: steps.append(step))
    with qtbot.waitSignal(run.finished):
        run.start()
    assert steps == ["many reports", "one report, then long work"]
