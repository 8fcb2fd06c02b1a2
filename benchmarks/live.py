"""How soon map and mask follow a slider, and how long the window ever waits, on a megapixel.

Run it under a display, for instance ``xvfb-run -a python benchmarks/live.py``. The picture is
scikit-image's `retina`, scaled to 1024 x 1024 px, or one of yours (``--picture FILE``).

A timer ticks every 5 ms in the window's thread; the longest time between two ticks is how long the
window has not answered. What else the machine does adds to it: run it on a quiet one.
"""

import argparse
import time

import imageio.v3 as imageio
import napari
import numpy as np
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QApplication
from skimage.data import retina
from skimage.transform import resize

from napari_defocus.widgets.docks.defocus import DefocusWidget

SIDE = 1024
THRESHOLDS = (1.5, 2.5, 3.0, 1.0, 2.2)


class Ticks:
    """The longest time between two ticks since the start."""

    def __init__(self) -> None:
        self.longest = 0.0
        self._last = time.perf_counter()
        self._timer = QTimer()
        self._timer.timeout.connect(lambda: self._tick())
        self._timer.start(5)

    def _tick(self) -> None:
        now = time.perf_counter()
        self.longest, self._last = max(self.longest, now - self._last), now

    def start(self) -> None:
        self.longest, self._last = 0.0, time.perf_counter()


def wait(seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        QApplication.processEvents()
        time.sleep(0.001)


def wait_for(widget: DefocusWidget) -> None:
    wait(0.05)
    while widget._running is not None or widget._live_labels.is_busy:
        wait(0.005)
    wait(0.2)


def updates(layer: napari.layers.Layer, change, widget: DefocusWidget) -> list[float]:
    """Return after how many seconds a layer is drawn anew when something is changed."""
    seen: list[float] = []
    start = time.perf_counter()
    note = layer.events.set_data.connect(lambda _: seen.append(time.perf_counter() - start))
    change()
    wait_for(widget)
    layer.events.set_data.disconnect(note)
    return seen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", help="a picture of yours")
    path = parser.parse_args().picture
    picture = imageio.imread(path) if path else retina()
    picture = (255 * resize(picture, (SIDE, SIDE), anti_aliasing=True)).astype(np.uint8)
    viewer = napari.Viewer(show=True)
    viewer.window.resize(1400, 900)
    viewer.add_image(picture, name="picture")
    widget = DefocusWidget(viewer)
    viewer.window.add_dock_widget(widget)
    wait(3)
    ticks = Ticks()
    rows = []

    def measured(name: str, change) -> None:
        ticks.start()
        start = time.perf_counter()
        change()
        wait_for(widget)
        rows.append((name, time.perf_counter() - start - 0.2, ticks.longest))

    measured("first run (napari makes its layers)", widget.run)
    widget.settings.max_radius.value = 7.5
    measured("second run, everything estimated again", widget.run)
    mask, blur_map = viewer.layers["picture in focus"], viewer.layers["picture blur (px)"]
    wait(2)
    ticks.start()
    threshold, smoothness = widget.settings.threshold, widget.settings.map_smoothness
    masks = [updates(mask, lambda v=v: setattr(threshold, "value", v), widget) for v in THRESHOLDS]
    moved = ticks.longest
    ticks.start()
    maps = [
        updates(blur_map, lambda v=v: setattr(smoothness, "value", v), widget) for v in (10, 40, 25)
    ]
    print("| | seconds | longest wait of the window |")
    print("|---|---|---|")
    for name, seconds, longest in rows:
        print(f"| {name} | {seconds:.1f} | {longest:.3f} |")
    for name, found, longest in (("threshold", masks, moved), ("smoothness", maps, ticks.longest)):
        first = np.median([times[0] for times in found])
        last = np.median([times[-1] for times in found])
        print(
            f"| {name} moved: rough after, fine after | {first:.2f}, {last:.1f} | {longest:.3f} |"
        )
    viewer.close()


if __name__ == "__main__":
    main()
