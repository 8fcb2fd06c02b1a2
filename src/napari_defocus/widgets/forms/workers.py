"""One function in a worker thread, with progress and Cancel in the main thread."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from napari.qt.threading import create_worker
from napari.utils import cancelable_progress
from napari.utils.notifications import notification_manager
from qtpy.QtCore import QObject, QTimer, Signal

from napari_defocus.core.progress import Cancelled

REPORT_INTERVAL = 0.05
"""Seconds between two reports of one step that reach the main thread."""

BAR_INTERVAL = 0.25
"""Seconds between two that reach napari's activity list, which draws the window each time."""

STEPS = 100

_running: set["Run"] = set()
"""Keeps a run alive until its thread has ended, whatever becomes of its widget."""


class _ProgressBar(cancelable_progress):
    """napari's bar calls its cancel_callback only when it is iterated over."""

    def cancel(self) -> None:
        super().cancel()
        self.cancel_callback()


class Run(QObject):
    """A function at work in another thread; all signals reach the main thread.

    Parameters
    ----------
    function : callable
        Called as ``function(progress)`` in the worker thread, or with `previews` as
        ``function(progress, preview=preview)``: it calls `preview` with what it has so far. A
        `ValueError`, `TypeError` or `MemoryError` means that its input cannot be worked on.
    description : str
        What napari's activity list shows; "" for work that is not worth a line there.
    owner : object
        Who waits for it: kept alive until it has finished.
    previews : bool
        Whether `previewed` is sent.
    """

    progressed = Signal(str, float)
    """The step's name, and the share of the whole that is done."""

    previewed = Signal(object)
    """What there is so far; not sent after `cancel`."""

    returned = Signal(object)
    """The function's value; not sent after `cancel`."""

    refused = Signal(str)
    """Why the input cannot be worked on."""

    finished = Signal()
    """Sent once and last, whatever happened."""

    _reported = Signal(str, float)
    _made = Signal(object)

    def __init__(
        self,
        function: Callable[..., Any],
        description: str,
        owner: object = None,
        *,
        previews: bool = False,
    ) -> None:
        super().__init__()
        self._owner = owner
        self._function = partial(function, preview=self._made.emit) if previews else function
        self._description = description
        self.bar: _ProgressBar | None = None
        self._is_updating_bar = False
        self._bar_updated = -BAR_INTERVAL
        self._holds = 0
        self._has_ended = False
        self._last_report = ("", 0.0)
        self._worker = create_worker(
            self._work, _connect={"returned": self._on_returned}, _start_thread=False
        )
        self._worker.finished.connect(self._on_finished)
        self._reported.connect(self._on_reported)
        self._made.connect(self._on_made)

    def start(self) -> None:
        """Start the thread and show the progress bar."""
        _running.add(self)
        if self._description:
            self.bar = _ProgressBar(
                total=STEPS, desc=self._description, cancel_callback=self.cancel
            )
        self._worker.start()

    def hold(self) -> None:
        """Do not finish before `release`: what it returned is not shown yet."""
        self._holds += 1

    def release(self) -> None:
        """Finish, if it has ended and nothing else holds it."""
        self._holds -= 1
        if self._has_ended:
            self._on_finished()

    def cancel(self) -> None:
        """Ask the function to end at its next report; nothing is returned."""
        self._worker.quit()

    @property
    def is_cancelled(self) -> bool:
        """Whether it was asked to end."""
        return bool(self._worker.abort_requested)

    def _work(self) -> tuple[str, Any]:
        """Return how the function has ended, and its value or what has stopped it.

        Nothing in it refers to the run, which must not go in the worker thread.
        """
        try:
            return "done", self._function(self._report)
        except Cancelled:
            return "cancelled", None
        except (ValueError, TypeError) as error:
            return "refused", str(error)
        except MemoryError:
            return "refused", "there is not enough memory for it. Crop it first."
        except Exception as error:  # a defect: napari shows it once, in the main thread
            return "failed", error

    def _report(self, step: str, done: float) -> None:
        if self.is_cancelled:
            raise Cancelled
        now = time.monotonic()
        last_step, reported = self._last_report
        if step != last_step or now - reported >= REPORT_INTERVAL:
            self._last_report = (step, now)
            self._reported.emit(step, done)

    def _on_reported(self, step: str, done: float) -> None:
        if self.is_cancelled:
            return
        self.progressed.emit(step, done)
        now = time.monotonic()
        if self.bar is None or self._is_updating_bar or now - self._bar_updated < BAR_INTERVAL:
            return
        # The bar lets Qt handle events: the next report may come within either call, or the end.
        self._is_updating_bar, self._bar_updated = True, now
        self.bar.set_description(step)
        self.bar.update(round(STEPS * done) - self.bar.n)
        self._is_updating_bar = False

    def _on_made(self, value: object) -> None:
        if not self.is_cancelled:
            self.previewed.emit(value)

    def _on_returned(self, result: tuple[str, Any]) -> None:
        if self.is_cancelled:
            return
        match result:
            case "done", value:
                self.returned.emit(value)
            case "refused", reason:
                self.refused.emit(reason)
            case "failed", error:
                notification_manager.receive_error(type(error), error, error.__traceback__)

    def _on_finished(self) -> None:
        self._has_ended = True
        if self._holds:
            return
        if self.bar is not None:
            self.bar.close()
        self.finished.emit()
        self._owner = None
        # Not at once: nobody else may keep it, and it is still telling that it has finished.
        QTimer.singleShot(0, lambda: _running.discard(self))
