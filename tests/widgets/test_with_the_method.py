"""The widgets with the real method behind them."""

import numpy as np
import pytest
from skimage.data import gravel

from napari_defocus import simulate_defocus
from napari_defocus.widgets.docks.change_focus import ChangeFocusWidget
from napari_defocus.widgets.docks.defocus import DefocusWidget
from napari_defocus.widgets.forms.workers import Run
from napari_defocus.widgets.jobs import estimation

pytestmark = pytest.mark.display


@pytest.fixture
def run(viewer, qtbot):
    def start():
        widget = DefocusWidget(viewer)
        qtbot.addWidget(widget.native)
        return widget, widget.run()

    return start


def half_blurred(height, width):
    true_map = np.where(np.arange(width) < width // 2, 0.5, 4.0) * np.ones((height, 1))
    sharp = np.tile(gravel(), (1 + height // 512, 1 + width // 512))[:height, :width]
    return simulate_defocus(sharp, true_map, noise_variance=1e-6, rng=0)


@pytest.mark.parametrize("dtype", [np.float32, np.uint8, np.uint16])
def test_sharp_half_and_blurred_half_are_told_apart(viewer, run, qtbot, dtype):
    top = {np.float32: 1.0, np.uint8: 255, np.uint16: 4095}[dtype]
    picture = (np.clip(half_blurred(128, 160), 0, 1) * top).astype(dtype)
    viewer.add_image(picture, name="halves", scale=(0.5, 0.5), contrast_limits=(0, top))
    with qtbot.waitSignal(run()[1].finished):
        pass
    blur_map, mask = viewer.layers["halves blur (px)"], viewer.layers["halves in focus"]
    confidence = viewer.layers["halves confidence"].data
    assert 0 <= confidence.min() <= confidence.max() <= 1
    assert np.median(confidence) > 0.5
    assert np.median(blur_map.data[:, 20:60]) < 1.5
    assert np.median(blur_map.data[:, 100:140]) == pytest.approx(4.0, abs=0.4)
    assert mask.data[:, 20:60].mean() > 0.9
    assert mask.data[:, 100:140].mean() < 0.1
    assert tuple(mask.scale) == (0.5, 0.5)


@pytest.mark.parametrize(
    ("step", "large"),
    [
        ("Estimating blur", estimation.LARGE),
        ("Making the map coherent", estimation.LARGE),
        ("Making the map coherent", 400_000),
    ],
)
def test_cancel_ends_every_step_at_its_next_report(viewer, run, qtbot, monkeypatch, step, large):
    """And that is soon: at most a twentieth of the work is done until then."""
    monkeypatch.setattr(estimation, "LARGE", large)
    viewer.add_image(half_blurred(480, 640), name="large")
    report, heard = Run._report, []

    def cancel_at_the_step(self, name, done):
        if name == step or self.is_cancelled:
            heard.append((name, done))
        report(self, name, done)
        if name == step:
            self.cancel()

    monkeypatch.setattr(Run, "_report", cancel_at_the_step)
    with qtbot.waitSignal(run()[1].finished):
        pass
    assert [name for name, _ in heard] == [step] * 2
    assert heard[1][1] - heard[0][1] < 0.05
    assert [layer.name for layer in viewer.layers] == ["large"]


def test_blurred_half_becomes_sharp_and_the_sharp_half_blurred(viewer, qtbot):
    viewer.add_image(half_blurred(96, 128), name="halves")
    defocus, change_focus = DefocusWidget(viewer), ChangeFocusWidget(viewer)
    change_focus.linear_light.value = False
    change_focus.focus.value = 4.0
    for widget, start in ((defocus, defocus.restore), (change_focus, change_focus.run)):
        qtbot.addWidget(widget.native)
        with qtbot.waitSignal(start().finished):
            pass
    before, sharp, refocused = (
        detail(viewer.layers[name].data)
        for name in ("halves", "halves all in focus", "halves refocused")
    )
    assert sharp[1] > 1.5 * before[1]
    assert sharp[0] > 0.9 * before[0]
    assert refocused[1] > 1.5 * before[1]
    assert refocused[0] < 0.7 * before[0]


def detail(picture):
    """Standard deviation of differences between columns: left half, right half."""
    steps = np.diff(picture, axis=1)
    middle = picture.shape[1] // 2
    return [float(half.std()) for half in (steps[:, 10 : middle - 10], steps[:, middle + 10 : -10])]
