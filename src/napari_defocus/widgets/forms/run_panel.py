"""What all widgets that work in a thread share: run, watch, cancel."""

import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar

from magicgui.widgets import Container, Label, ProgressBar, PushButton, Widget
from napari.components import ViewerModel
from napari.utils.notifications import show_error
from qtpy.QtCore import Qt, QTimer
from qtpy.QtWidgets import QBoxLayout, QLabel, QSizePolicy, QWidget

from napari_defocus.core.worker_process import end_idle
from napari_defocus.widgets.forms.accessibility import describe, tab_in_reading_order
from napari_defocus.widgets.forms.qt_lifetime import when_destroyed
from napari_defocus.widgets.forms.scrolling import make_scrolling
from napari_defocus.widgets.forms.tabs import become_a_tab
from napari_defocus.widgets.forms.workers import STEPS, Run
from napari_defocus.widgets.layers.image_layers import Plane

LABEL_PADDING = 16

PAUSE = 15
"""Milliseconds between two steps of what is shown, in which the window draws."""


_panels: list[weakref.ref["RunPanel"]] = []
"""Those that are open: with the last one, the processes end that wait for work."""


class RunPanel(Container[Widget]):
    """A form whose work is done in a worker thread, one piece at a time.

    Parameters
    ----------
    napari_viewer : napari.Viewer or napari.components.ViewerModel
        Where the images come from and the results go.
    action : str
        What the run button says.

    Attributes
    ----------
    run_button, cancel_button, progress_bar, status : magicgui widgets
    rows : QBoxLayout
        What the form's rows lie in.
    """

    SCROLLS: ClassVar[bool] = True
    """Whether the form scrolls where there is no room for all of it."""

    def __init__(self, napari_viewer: ViewerModel, *, action: str) -> None:
        self._viewer = napari_viewer
        self._running: Run | None = None
        self._planes: Sequence[Plane] = ()
        self._closed = False
        self._step = self._last_word = self._verdict = ""
        _panels.append(weakref.ref(self))
        self.run_button = PushButton(text=action)
        self.cancel_button = PushButton(text="Cancel", enabled=False)
        self.progress_bar = ProgressBar(name="progress", label=" ", min=0, max=STEPS, value=0)
        self.status = Label(name="status", label=" ", value="")
        super().__init__()

    def _finish_form(self, fields: list[Widget]) -> None:
        """Put the fields into the form, and what runs them below."""
        buttons = Container(
            widgets=[self.run_button, self.cancel_button], layout="horizontal", labels=False
        )
        buttons.label = " "
        buttons.margins = (0, 0, 0, 0)
        # Only rows that come after the container's own making get labels of equal width.
        self.extend([*fields, buttons, self.progress_bar, self.status])
        self.run_button.clicked.connect(self.run)
        self.cancel_button.clicked.connect(self.cancel)
        self.progress_bar.hide()
        wrap(self.status)
        widen_labels(self.native)
        self.rows: QBoxLayout = self.native.layout()
        if self.SCROLLS:
            make_scrolling(self.native)
        describe(self)
        tab_in_reading_order(self.native)
        become_a_tab(self.native)
        when_destroyed(self.native, self, lambda panel: panel._on_closed())

    def run(self) -> Run | None:
        """Start the work, and return it; None if there is nothing to work on."""
        raise NotImplementedError

    def cancel(self) -> None:
        """Stop what runs; nothing is added to the viewer."""
        if self._running is not None:
            self._running.cancel()
            self._step, self._verdict = "Cancelling", "Cancelled"
            self._tell()

    def say(self, text: str) -> None:
        """Say what was done; while something runs, after it."""
        self._last_word = text
        self._tell()

    def _tell(self, _: Any = None) -> None:
        """Let the status say what is so."""
        text = "" if self._closed else self._text()
        if not self._closed and self.status.value != text:
            self.status.value = text

    def _text(self) -> str:
        """Return what the status says: what runs, else what was done last."""
        return self._step or self._last_word

    def _start(
        self,
        work: Callable[..., Any],
        take: Callable[[Any], Any],
        planes: Sequence[Plane],
        description: str,
        take_preview: Callable[[Any], Any] | None = None,
    ) -> Run:
        """Start `work` on planes; `take` gets its value, in the main thread.

        If `take` returns an iterator, it is gone through between other events: the window does
        not stop, and the run finishes after it. With `take_preview` the work is given a function
        `preview`, and that gets what it is called with.
        """
        run = Run(work, description, owner=self, previews=take_preview is not None)
        # Functions, not methods: PySide6 mixes up the methods of objects that are not Qt's own
        # when one is made at the address of another that has gone, and crashes.
        run.progressed.connect(lambda step, done: self._on_progressed(step, done))
        if take_preview is not None:
            run.previewed.connect(lambda value: self._on_returned(run, take_preview, value))
        run.returned.connect(lambda value: self._on_returned(run, take, value))
        run.refused.connect(lambda reason: self._on_refused(reason))
        run.finished.connect(lambda: self._on_finished())
        self._viewer.layers.events.removed.connect(self._on_layer_removed)
        self._running, self._planes = run, planes
        self._show_running(True)
        run.start()
        return run

    def _show_running(self, running: bool) -> None:
        self.run_button.enabled = not running
        self.cancel_button.enabled = running
        self.progress_bar.native.setValue(0)  # see `_on_progressed`
        self.progress_bar.visible = running
        self._step = "Starting" if running else ""
        self._tell()

    def _on_progressed(self, step: str, done: float) -> None:
        if not self._closed:
            # Its `value` would let Qt handle all events here and now.
            self.progress_bar.native.setValue(round(STEPS * done))
            self._step = step
            self._tell()

    def _on_returned(self, run: Run, take: Callable[[Any], Any], value: Any) -> None:
        if self._closed:
            return
        steps = take(value)
        if isinstance(steps, Iterator):
            run.hold()
            self._go_through(steps, run.release)

    def _go_through(self, steps: Iterator[Any], then: Callable[[], None]) -> None:
        """Take steps between other events, unless the panel is closed."""
        try:
            if not self._closed:
                next(steps)
                QTimer.singleShot(PAUSE, lambda: self._go_through(steps, then))
                return
        except StopIteration:
            pass
        except BaseException:
            then()
            raise
        then()

    def _on_refused(self, reason: str) -> None:
        if not self._closed and self._planes:
            self._verdict = f"Cannot analyse “{self._planes[0].name}”: {reason}"
            show_error(self._verdict)

    def _on_finished(self) -> None:
        self._running = None
        if self._closed:
            self._leave()
            return
        self._viewer.layers.events.removed.disconnect(self._on_layer_removed)
        self._show_running(False)
        verdict, self._verdict = self._verdict, ""
        if verdict:
            self.say(verdict)

    def _on_layer_removed(self, event: Any) -> None:
        if any(plane.layer() in (None, event.value) for plane in self._planes):
            self.cancel()

    def _on_closed(self) -> None:
        self._closed = True
        if self._running is not None:
            self._running.cancel()
        self._leave()

    def _leave(self) -> None:
        """End the processes that wait for work, if no panel is open any more."""
        living = [(each, each()) for each in _panels]
        _panels[:] = [each for each, panel in living if panel is not None and not panel._closed]
        if not _panels:
            end_idle()


def widen_labels(form: QWidget) -> None:
    """Make room for the padding of napari's style, which magicgui does not measure."""
    for row in form.findChildren(QWidget, options=Qt.FindDirectChildrenOnly):
        label = row.layout().itemAt(0).widget() if row.layout() else None
        if isinstance(label, QLabel):
            label.setMinimumWidth(label.minimumWidth() + LABEL_PADDING)


def wrap(label: Label) -> None:
    """Let a text use the width that there is, from the left, in several lines."""
    label.native.setWordWrap(True)
    label.native.setAlignment(Qt.AlignLeft | Qt.AlignVCenter)
    label.native.setSizePolicy(QSizePolicy.Expanding, QSizePolicy.Preferred)
