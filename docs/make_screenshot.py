"""Make docs/images/napari.png: photograph, blur map and in-focus mask in napari.

Run it under a display, for instance ``xvfb-run -a python docs/make_screenshot.py``.
"""

import time
from pathlib import Path

import napari
from PIL import Image
from qtpy.QtWidgets import QApplication

from napari_defocus.widgets.map_and_mask import MapAndMaskWidget

TARGET = Path(__file__).parent / "images" / "napari.png"
SIZE = (1400, 900)
GAP = 24


def handle_events(seconds: float) -> None:
    """Let the window draw."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        QApplication.processEvents()
        time.sleep(0.01)


def analyse(viewer: napari.Viewer) -> None:
    """Run the widget on the sample, as a user does."""
    viewer.open_sample("napari-defocus", "dandelion")
    widget = MapAndMaskWidget(viewer)
    viewer.window.add_dock_widget(widget, name="Blur map and in focus (Defocus)", area="right")
    ended = []
    widget.run().finished.connect(lambda: ended.append(True))
    while not ended:
        handle_events(0.05)


def arrange(viewer: napari.Viewer) -> None:
    """Put the map below the photograph, and the mask on a copy of it below the map."""
    picture, blur_map = viewer.layers["dandelion"], viewer.layers["dandelion blur (px)"]
    mask = viewer.layers["dandelion in focus"]
    viewer.add_image(picture.data, name="dandelion again")
    viewer.layers.move(len(viewer.layers) - 1, viewer.layers.index(mask))
    height = picture.data.shape[0] + GAP
    blur_map.translate = (height, 0)
    viewer.layers["dandelion again"].translate = mask.translate = (2 * height, 0)
    blur_map.colorbar.size = (25, 250)
    viewer.layers.selection.active = blur_map
    viewer.fit_to_view(margin=0.03)


def save(viewer: napari.Viewer) -> None:
    """Write the whole window."""
    TARGET.parent.mkdir(exist_ok=True)
    picture = Image.fromarray(viewer.window.screenshot(flash=False, canvas_only=False)[..., :3])
    picture.save(TARGET, optimize=True)
    print(f"{TARGET.name}: {picture.size}, {TARGET.stat().st_size / 1e3:.0f} kB")


def main() -> None:
    """Make the picture."""
    viewer = napari.Viewer(show=True)
    viewer.window.resize(*SIZE)
    handle_events(1)
    analyse(viewer)
    arrange(viewer)
    handle_events(3)
    save(viewer)
    viewer.close()


if __name__ == "__main__":
    main()
