"""Make the screenshots of docs/guide.md and the strip of the README.

They are written to docs/images/guide/ and docs/images/strip.png. The widgets are driven as a user
drives them: clicks on their buttons, strokes and hovering with the mouse on the canvas. It needs a
display; without arguments all pictures are made, else those that are named::

    xvfb-run -a -s "-screen 0 1600x1100x24" python docs/make_guide.py
    xvfb-run -a -s "-screen 0 1600x1100x24" python docs/make_guide.py probe regions
"""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

FOLDER = Path(__file__).parent / "images"
GUIDE = FOLDER / "guide"
STRIP = FOLDER / "strip.png"
WINDOW = (1280, 700)
WIDE = (1585, 700)
"""The canvas has the shape of the brushes then, so that the colour bar lies on the map."""
DOCK_WIDTH = 390
CONTOUR = 3
"""Of the outline, in the layer controls."""
WIDEST = 1400
COLORS = 256

OUTLINE = (255, 51, 204)
"""Of the mask, in the layer's colour."""
GROUND = (38, 41, 48)
TEXT = (240, 241, 242)
GAP = 8
CAPTION = 34
STRIP_HEIGHT = 385

BRUSHES = "brushes"
IN_FOCUS = [((60, 40), (150, 60)), ((50, 130), (120, 150))]
BLURRED = [((260, 560), (400, 600))]
"""Strokes that correct the mask of the brushes, from row, column to row, column."""

PLANES, SIDE, TILT = 9, 220, 0.5


class Session:
    """A viewer with the Defocus dock, and a mouse."""

    def __init__(self, size: tuple[int, int] = WINDOW) -> None:
        import napari

        self.viewer = napari.Viewer(show=True)
        self.window = self.viewer.window._qt_window
        self.window.move(0, 0)
        self.window.resize(*size)
        self.wait(0.8)
        self.panel: Any = None

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *_: object) -> None:
        self.viewer.close()
        self.wait(0.3)

    @staticmethod
    def wait(seconds: float) -> None:
        """Let the window handle events."""
        from qtpy.QtWidgets import QApplication

        end = time.monotonic() + seconds
        while time.monotonic() < end:
            QApplication.processEvents()
            time.sleep(0.005)

    def until(self, true: Callable[[], bool], seconds: float = 120) -> None:
        """Wait until something is true."""
        end = time.monotonic() + seconds
        while not true():
            if time.monotonic() > end:
                raise TimeoutError
            self.wait(0.02)

    # -- what a user does ------------------------------------------------------------------

    def sample(self, key: str) -> None:
        """Choose File > Open Sample > Defocus > key."""
        self.viewer.open_sample("napari-defocus", key)
        self.wait(0.5)

    def defocus(self) -> None:
        """Choose Layers > Measure > Measure defocus."""
        self.panel = self.dock("defocus")

    def dock(self, command: str) -> Any:
        """Choose a command of the plugin in a menu, or find the dock that it has opened."""
        from napari._app_model import get_app_model
        from npe2 import PluginManager

        wanted = f"napari-defocus.{command}"
        manifest = PluginManager.instance().get_manifest("napari-defocus")
        widgets = manifest.contributions.widgets or ()
        [name] = [each.display_name for each in widgets if each.command == wanted]
        docks = self.viewer.window.dock_widgets
        if f"{name} (Defocus)" not in docks:
            get_app_model().commands.execute_command(wanted).result()
        widget = docks[f"{name} (Defocus)"]
        self.widen(widget.native.parent())
        return widget

    def widen(self, dock: Any, width: int = DOCK_WIDTH) -> None:
        """Draw the border of a dock to a width, and press the house."""
        from qtpy.QtCore import Qt

        self.wait(0.3)
        self.window.resizeDocks([dock], [width], Qt.Horizontal)
        self.wait(0.3)
        self.home()

    def home(self) -> None:
        """Press the house."""
        self.viewer.fit_to_view(margin=0.02)
        self.wait(0.2)

    def press(self, button: Any) -> None:
        """Click on a button."""
        from qtpy.QtCore import Qt
        from qtpy.QtTest import QTest

        QTest.mouseClick(getattr(button, "native", button), Qt.LeftButton)
        self.wait(0.1)

    def rest(self) -> None:
        """Wait for whatever runs, and for what follows the sliders."""
        panel = self.panel
        self.until(lambda: panel._running is None and not panel._live_labels.is_busy)
        self.wait(0.8)

    def measure(self) -> None:
        """Press Measure, wait, and make the outline wide enough for a small canvas."""
        self.press(self.panel.run_button)
        # Whoever moves a slider before the fine results are there gets the map with the mask.
        layers = self.viewer.layers
        self.until(lambda: any(layer.name.endswith("not trusted") for layer in layers))
        self.rest()
        for layer in self.viewer.layers:
            if layer.name.endswith("in focus"):
                layer.contour = CONTOUR
        self.wait(0.3)

    def page(self, title: str) -> None:
        """Open a section, and close the others."""
        for other, section in self.panel.pages.sections.items():
            section.open(other == title)
        self.panel.pages.show(title)
        self.wait(0.3)

    def slide(self, field: Any, value: float) -> None:
        """Move a slider, and let it rest."""
        field.slider.value = field._place(value)
        self.wait(0.1)
        self.rest()

    @property
    def canvas(self) -> Any:
        """The canvas' own widget."""
        return self.viewer.window._qt_viewer.canvas.native

    def on_canvas(self, row: float, column: float) -> Any:
        """Return where a pixel of the picture is on the canvas."""
        from qtpy.QtCore import QPointF

        camera, canvas = self.viewer.scene.camera, self.canvas
        y = (row - camera.center[-2]) * camera.zoom + canvas.height() / 2
        x = (column - camera.center[-1]) * camera.zoom + canvas.width() / 2
        return QPointF(x, y)

    def mouse(self, kind: str, place: Any, *, down: bool = False) -> None:
        """Send an event of the mouse to the canvas."""
        from qtpy.QtCore import QEvent, Qt
        from qtpy.QtGui import QMouseEvent
        from qtpy.QtWidgets import QApplication

        moving = kind == "MouseMove"
        button = Qt.NoButton if moving else Qt.LeftButton
        buttons = Qt.LeftButton if down else Qt.NoButton
        there = self.canvas.mapToGlobal(place)
        event = QMouseEvent(getattr(QEvent, kind), place, there, button, buttons, Qt.NoModifier)
        QApplication.sendEvent(self.canvas, event)
        self.wait(0.03)

    def hover(self, row: float, column: float) -> None:
        """Move the mouse over a pixel of the picture."""
        from qtpy.QtGui import QCursor

        place = self.on_canvas(row, column)
        QCursor.setPos(self.canvas.mapToGlobal(place).toPoint())
        for step in (12, 6, 0):
            self.mouse("MouseMove", place + type(place)(step, step))
        self.wait(1.0)

    def stroke(self, begin: tuple[float, float], end: tuple[float, float], steps: int = 12) -> None:
        """Draw with the mouse from one pixel of the picture to another."""
        places = [
            self.on_canvas(*(np.array(begin) + t * (np.array(end) - begin)))
            for t in np.linspace(0, 1, steps)
        ]
        self.mouse("MouseMove", places[0])
        self.mouse("MouseButtonPress", places[0], down=True)
        for place in places[1:]:
            self.mouse("MouseMove", place, down=True)
        self.mouse("MouseButtonRelease", places[-1])

    def show_only(self, *names: str) -> None:
        """Switch the eyes of the layers on or off."""
        for layer in self.viewer.layers:
            if layer.visible != (layer.name in names):
                layer.visible = layer.name in names
        self.wait(0.3)

    def close_messages(self) -> None:
        """Click on the cross of every message."""
        from napari._qt.dialogs.qt_notification import NapariQtNotification

        for message in self.window.findChildren(NapariQtNotification):
            message.close()
        self.wait(0.5)

    def select(self, name: str) -> None:
        """Click on a layer's name."""
        self.viewer.layers.selection.active = self.viewer.layers[name]
        self.wait(0.2)

    # -- pictures of it --------------------------------------------------------------------

    def whole(self) -> Image.Image:
        """Return the window."""
        self.wait(0.5)
        return _as_image(self.viewer.window.screenshot(flash=False, canvas_only=False))

    def picture(self, name: str) -> Image.Image:
        """Return the part of the canvas that an image takes."""
        height, width = self.viewer.layers[name].data.shape[:2]
        return self.part((0, 0), (height, width))

    def part(self, begin: tuple[float, float], end: tuple[float, float]) -> Image.Image:
        """Return the part of the canvas between two places of a picture: row, column."""
        corners = [self.on_canvas(*(np.array(at) - 0.5)) for at in (begin, end)]
        box = [round(at) for corner in corners for at in (corner.x(), corner.y())]
        return self.of(self.canvas).crop(box)

    def look_at(self, row: float, column: float, zoom: float) -> None:
        """Zoom in on a place with the mouse wheel."""
        camera = self.viewer.scene.camera
        camera.center, camera.zoom = (row, column), zoom
        self.wait(0.3)

    def of(self, widget: Any) -> Image.Image:
        """Return the part of the window that a widget takes."""
        from qtpy.QtCore import QPoint

        native = getattr(widget, "native", widget)
        corner = native.mapTo(self.window, QPoint(0, 0))
        x, y = corner.x(), corner.y()
        return self.whole().crop((x, y, x + native.width(), y + native.height()))

    def screen(self, box: tuple[int, int, int, int]) -> Image.Image:
        """Return a part of the screen: menus are no part of the window."""
        from qtpy.QtGui import QGuiApplication

        self.wait(0.3)
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder, "screen.png"))
            QGuiApplication.primaryScreen().grabWindow(0).save(path)
            return Image.open(path).convert("RGB").crop(box)


def _as_image(pixels: Any) -> Image.Image:
    return Image.fromarray(np.asarray(pixels)[..., :3])


def beside(*pictures: Image.Image) -> Image.Image:
    """Return pictures in a row, all as high as the lowest."""
    height = min(picture.height for picture in pictures)
    row = [_of_height(picture, height) for picture in pictures]
    width = sum(picture.width for picture in row) + GAP * (len(row) - 1)
    whole, x = Image.new("RGB", (width, height), "white"), 0
    for picture in row:
        whole.paste(picture, (x, 0))
        x += picture.width + GAP
    return whole


def _of_height(picture: Image.Image, height: int) -> Image.Image:
    if picture.height == height:
        return picture
    return picture.resize((round(picture.width * height / picture.height), height), Image.LANCZOS)


def captioned(picture: Image.Image, text: str) -> Image.Image:
    """Return a picture with a line of text above it."""
    whole = Image.new("RGB", (picture.width, picture.height + CAPTION), GROUND)
    whole.paste(picture.convert("RGB"), (0, CAPTION))
    font = ImageFont.load_default(size=19)
    ImageDraw.Draw(whole).text((10, CAPTION // 2), text, TEXT, font, anchor="lm")
    return whole


def lit(picture: Image.Image) -> Image.Image:
    """Return a picture of the canvas without the black around what is shown."""
    bright = np.asarray(picture).max(axis=2) > 12
    rows, columns = (np.flatnonzero(bright.any(axis=axis)) for axis in (1, 0))
    return picture.crop((columns[0], rows[0], columns[-1] + 1, rows[-1] + 1))


def few_colors(picture: Image.Image, colors: int = COLORS) -> Image.Image:
    """Return a picture in the colours that suit it best: it is stored in half the space."""
    return picture.quantize(colors, kmeans=2, dither=Image.Dither.NONE)


def guide(name: str, picture: Image.Image, colors: int = COLORS) -> None:
    """Write a picture of the guide."""
    GUIDE.mkdir(parents=True, exist_ok=True)
    if picture.width > WIDEST:
        picture = picture.resize((WIDEST, round(picture.height * WIDEST / picture.width)))
    path = GUIDE / f"{name}.png"
    few_colors(picture, colors).save(path, optimize=True)
    print(f"{path.name}: {picture.size}, {path.stat().st_size / 1e3:.0f} kB", flush=True)


# -- the pictures, in the order of the guide ---------------------------------------------------


def menu() -> None:
    """Show where the dock is in the menus."""
    with Session() as session:
        session.sample("dandelion")
        bar = session.window.menuBar()
        place, names = None, ("Layers", "Measure", "Measure defocus (Defocus)")
        level, opened = bar, []
        for name in names:
            action = next(a for a in level.actions() if a.text().replace("&", "") == name)
            level.setActiveAction(action)
            session.wait(0.1)
            below = level is bar
            if action.menu() is None:
                break
            corner = level.actionGeometry(action)
            place = level.mapToGlobal(corner.bottomLeft() if below else corner.topRight())
            if below:
                action.menu().aboutToShow.emit()
            level = action.menu()
            level.popup(place)
            session.wait(0.2)
            opened.append(level)
        guide("menu", session.screen((0, 0, 850, 490)))
        for each in reversed(opened):
            each.close()


def measured() -> None:
    """Show the results of Measure, and the status bar."""
    with Session() as session:
        session.sample("dandelion")
        session.defocus()
        session.measure()
        session.select("dandelion blur (px)")
        session.hover(180, 285)
        guide("measured", session.whole())
        session.show_only("dandelion", "dandelion blur (px)", "dandelion not trusted")
        veil = session.picture("dandelion")
        session.show_only("dandelion", "dandelion confidence")
        confidence = session.picture("dandelion")
        guide(
            "confidence",
            beside(
                captioned(veil, "the map, veiled where it is not trusted"),
                captioned(confidence, "the confidence: 0 black, 1 white"),
            ),
        )


def _measured_brushes(session: Session) -> None:
    session.sample(BRUSHES)
    session.defocus()
    session.measure()
    session.page("In focus")


def _paint_seeds(session: Session) -> None:
    """Include more than is in focus, press New seeds layer, and paint both labels."""
    session.slide(session.panel.settings.threshold, 3.0)
    session.press(session.panel.seeds_button)
    session.rest()
    seeds = session.viewer.layers["brushes seeds"]
    for label, strokes in ((1, IN_FOCUS), (2, BLURRED)):
        seeds.selected_label = label
        for begin, end in strokes:
            session.stroke(begin, end)
        session.rest()


def mask() -> None:
    """Correct the mask of the brushes: by a slider, then by seeds."""
    with Session() as session:
        _measured_brushes(session)
        session.show_only(BRUSHES, "brushes in focus")
        threshold = session.panel.settings.threshold
        first = session.picture(BRUSHES)
        session.slide(threshold, 3.0)
        wider = session.picture(BRUSHES)
        session.slide(threshold, 1.2)
        narrower = session.picture(BRUSHES)
        shown = zip(("1.2", "2", "3"), (narrower, first, wider), strict=True)
        guide(
            "threshold",
            beside(*(captioned(each, f"in focus up to {limit} px") for limit, each in shown)),
            colors=96,
        )
        _paint_seeds(session)
        guide("seeds", session.whole())


def probe() -> None:
    """Show why the map says what it says at the edge of the dandelion."""
    with Session(WIDE) as session:
        session.sample("dandelion")
        session.defocus()
        session.measure()
        session.press(session.panel.tools.probe)
        session.wait(0.5)
        probe = session.dock("probe")
        session.widen(probe.native.parent(), 560)
        session.look_at(180, 165, 1.55)
        session.hover(180, 116)
        session.wait(1.5)
        guide("probe", beside(session.part((0, 0), (400, 330)), session.of(probe)))


def region() -> None:
    """Measure what a rectangle encloses."""
    with Session() as session:
        session.sample("dandelion")
        session.defocus()
        shapes = session.viewer.add_shapes(name="Shapes")
        shapes.mode = "add_rectangle"
        session.wait(0.3)
        session.stroke((30, 60), (390, 560))
        session.panel.reset_choices()
        session.panel.region.value = shapes
        session.measure()
        parts = "dandelion (Shapes) blur (px)", "dandelion (Shapes) in focus"
        session.show_only("dandelion", *parts, "Shapes")
        guide("region", session.whole())


def z_stack() -> np.ndarray:
    """Return a simulated stack: a tilted piece of gravel, (9, 220, 220), that goes out of focus."""
    from skimage.data import gravel
    from skimage.transform import resize

    from napari_defocus import simulate_defocus

    sharp = resize(gravel() / 255.0, (SIDE, SIDE), anti_aliasing=True)
    across = np.linspace(-1, 1, SIDE)[None, :] * np.ones((SIDE, 1))
    middle = PLANES // 2
    return np.stack(
        [
            simulate_defocus(
                sharp,
                0.6 + 1.1 * np.abs(plane - middle + TILT * across),
                noise_variance=1e-6,
                rng=plane,
            )
            for plane in range(PLANES)
        ]
    )


def curve() -> None:
    """Show the focus curve of a stack."""
    with Session() as session:
        session.viewer.add_image(z_stack(), name="gravel", axis_labels=("z", "y", "x"))
        session.defocus()
        session.panel.image.value = session.viewer.layers["gravel"]
        session.panel.planes.value = "all"
        session.measure()
        session.page("Stack")
        session.press(session.panel.tools.curve)
        curve = session.dock("focus_curve")
        session.until(lambda: curve.curve is not None and curve._running is None)
        session.show_only("gravel")
        session.home()
        shown = []
        for plane in (0, 4):
            session.viewer.dims.set_current_step(0, plane)
            row = session.part((0, 0), (SIDE, SIDE)).resize((400, 400))
            shown.append(captioned(row, f"plane {plane}"))
        guide("focus-curve", beside(*shown, session.of(curve)), colors=48)


def regions() -> None:
    """Show the table of the regions in focus."""
    with Session() as session:
        _measured_brushes(session)
        session.slide(session.panel.settings.threshold, 3.0)
        session.press(session.panel.tools.regions)
        session.rest()
        session.show_only(BRUSHES, "brushes regions")
        session.close_messages()
        session.home()
        shown = session.picture(BRUSHES)
        table = session.viewer.window.dock_widgets["Features table widget (napari)"]
        dock = table.parent()
        session.widen(dock, 900)
        rows = session.of(dock)
        guide("regions", beside(shown, rows.crop((0, 0, rows.width, shown.height))))


def restored() -> None:
    """Show what was restored of the brushes."""
    with Session() as session:
        _measured_brushes(session)
        session.page("Restore")
        session.press(session.panel.restore_button)
        session.rest()
        session.look_at(230, 640, 1.6)
        shown = {}
        for title, layer in (("as it was", BRUSHES), ("all in focus", "brushes all in focus")):
            session.show_only(layer)
            shown[title] = session.part((60, 500), (390, 780))
        guide("restored", beside(*(captioned(each, title) for title, each in shown.items())))


def relief() -> None:
    """Show the dandelion as a relief of its blur."""
    with Session() as session:
        session.sample("dandelion")
        session.defocus()
        session.measure()
        session.press(session.panel.tools.relief)
        session.rest()
        session.wait(1)
        guide("relief", lit(session.of(session.canvas)))


def settings() -> None:
    """Show what few people need."""
    with Session() as session:
        session.sample("dandelion")
        session.defocus()
        session.page("More")
        guide("more", session.of(session.panel))


def strip() -> None:
    """Make the README's strip: the main job in four frames."""
    with Session(WIDE) as session:
        session.sample(BRUSHES)
        session.defocus()
        opened = session.picture(BRUSHES)
        session.measure()
        measured = session.picture(BRUSHES)
        session.page("In focus")
        _paint_seeds(session)
        session.show_only(BRUSHES, "brushes in focus", "brushes seeds")
        mask = session.viewer.layers["brushes in focus"]
        mask.contour, mask.opacity = 0, 0.5
        corrected = session.picture(BRUSHES)
        session.page("Restore")
        session.press(session.panel.restore_button)
        session.rest()
        session.show_only("brushes all in focus")
        frames = {
            "1  Open a picture": opened,
            "2  Measure: blur in px, in focus": measured,
            "3  Correct the mask by strokes": corrected,
            "4  Take the blur away": session.picture(BRUSHES),
        }
        small = {text: _of_height(each, STRIP_HEIGHT) for text, each in frames.items()}
        row = beside(*(captioned(frame, text) for text, frame in small.items()))
        row.quantize(palette=_palette(row), dither=Image.Dither.NONE).save(STRIP, optimize=True)
        print(f"{STRIP.name}: {row.size}, {STRIP.stat().st_size / 1e3:.0f} kB")


def _palette(picture: Image.Image) -> Image.Image:
    """Return the colours that suit a picture best, with some for the thin outline."""
    larger = Image.new("RGB", (picture.width, picture.height + 2 * CAPTION), OUTLINE)
    larger.paste(picture, (0, 0))
    return few_colors(larger)


def main() -> None:
    """Make all pictures, or those that are named."""
    pictures: Iterable[Callable[[], None]] = (
        *(menu, measured, mask, probe, region, curve),
        *(regions, restored, relief, settings, strip),
    )
    wanted = sys.argv[1:]
    for make in pictures:
        if not wanted or make.__name__ in wanted:
            make()


if __name__ == "__main__":
    # Without the Preferences of whoever runs this, and without the tour.
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NAPARI_CONFIG"] = str(Path(folder, "settings.yaml"))
        Path(folder, "napari-defocus.yaml").write_text("tour:\n  shown: false\n")
        main()
