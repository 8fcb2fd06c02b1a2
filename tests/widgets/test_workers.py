import pytest

from napari_defocus.widgets.workers import Run

pytestmark = pytest.mark.display


def test_every_step_is_shown_however_soon_it_follows_another(qtbot):
    def work(progress):
        for done in range(100):
            progress("many reports", done / 200)
        progress("one report, then long work", 0.5)

    run, steps = Run(work, "steps"), []
    run.progressed.connect(lambda step, done: steps.append(step))
    with qtbot.waitSignal(run.finished, timeout=10_000):
        run.start()
    assert list(dict.fromkeys(steps)) == ["many reports", "one report, then long work"]
    assert len(steps) < 10
