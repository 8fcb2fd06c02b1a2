"""Functions of this package run in a worker process, so that no thread here waits for them.

Some steps of the work hold the GIL for a part of a second: in a thread, they stop all others, a
window's too. The worker process is a plain Python that imports this package and nothing of the
caller's. It is kept for the next call, and ends when its parent does: at once, or after the step
that it is in if the parent was killed.

Work that is no longer wanted ends at its next report; if it makes none for a while, its process
ends. Calls of different *channels* have a process each.

A message that begins a call is (function, args, keywords); the answers are pairs of a word and what
it is about. In between, the caller may send the word that stops the call.
"""

from __future__ import annotations

import atexit
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import IO, Any, TypeVar, cast

from napari_defocus.core.progress import Cancelled, Progress, silent
from napari_defocus.core.worker_messages import (
    Message,
    packed,
    pieces,
    read_message,
    unpacked,
    write_piece,
)

Result = TypeVar("Result")

POLL_INTERVAL = 0.05
"""Seconds between two questions whether the result is still wanted."""

STARTING = "Starting another process"
HANDING_OVER = "Handing over the work"
LOADING = "Loading the program"
"""Steps before those of the function. Each is reported only if it takes time."""


_PIPE = 2**20
"""Bytes that may wait to be read. With the 64 KiB of Linux, 250 MB take up to 1.6 s; so, 0.2 s."""

_GRACE = 0.3
"""Seconds that a call has to end at one of its reports when nobody wants it any more."""

_NICENESS = 5
"""Lowers the priority, so that a window that shows results has the processor first."""

_NO_MEMORY = 112
"""Exit code of a process that has no memory for what it receives."""

_KILLED = getattr(signal, "SIGKILL", 9)

_READY = b"ready"
_STOP = b"stop"
_START = """
import sys
sys.path[:] = {path!r}
from napari_defocus.core.worker_process import serve
serve()
"""


def run_elsewhere(
    function: Callable[..., Result],
    *args: Any,
    progress: Progress = silent,
    channel: str = "",
    **keywords: Any,
) -> Result:
    """Return ``function(*args, progress=progress, **keywords)``, worked out in a worker process.

    Where there can be none, or it cannot be told what to do (some argument cannot be pickled), the
    calling thread does the work.

    Parameters
    ----------
    function : callable
        Of a module that can be imported, by its name.
    *args, **keywords
        Its other arguments.
    progress : callable, optional
        Called as ``progress(step, done)`` in the calling thread: with every report, and with the
        last one again at least every 0.1 s. An exception from it ends the work: at its next
        report, or with its process if there is none within 0.3 s.
    channel : str, optional
        A worker process is kept for each: short calls need not wait for long ones, and find what
        they left there.

    Returns
    -------
    object
        Equal to what `function` returns.

    Raises
    ------
    Exception
        Whatever `function` raises, with a note of where it was raised.
    MemoryError
        If the system ended the worker process, which it does when memory runs out.
    RuntimeError
        If the worker process ended for another reason.
    """
    try:
        request = packed((function, args, keywords))
    except Exception:  # pickling calls methods of the arguments: it may be any
        return function(*args, progress=progress, **keywords)
    worker = _idle_or_new(channel)
    if worker is None:
        return function(*args, progress=progress, **keywords)
    try:
        word, about = worker.answer(request, progress)
    except BaseException:
        if worker.stop():
            _keep_one(worker, channel)
        else:
            worker.end()
        raise
    _keep_one(worker, channel)
    if word == "refused":
        return function(*args, progress=progress, **keywords)
    if word == "raised":
        error, where = about
        error.add_note(f"In another process:\n{where}")
        raise error
    return cast(Result, about)


class _Worker:
    """A worker process and the pipes to it; used by one thread at a time."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._process = process
        self._requests = process.stdin
        self._messages: queue.SimpleQueue[Message | None] = queue.SimpleQueue()
        self._has_started = False
        self._is_working = False
        self._answer_fits = True
        threading.Thread(target=self._listen, args=(process.stdout,), daemon=True).start()

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def answer(self, request: Message, progress: Progress) -> tuple[str, Any]:
        """Send a request and return the answer that is no report."""
        if not self._has_started:
            report = partial(progress, STARTING, 0.0)
            report()
            if self._next(report) is None:
                self.end()
                return "refused", None
            self._has_started = True
        report = partial(progress, HANDING_OVER, 0.0)
        report()
        self._send(request, report)
        self._is_working = True
        while (message := self._next(report)) is not None:
            word, about = unpacked(message)
            if word != "report":
                self._is_working = False
                return word, about
            report = partial(progress, *about)
            report()
        raise self._reason_of_end()

    def stop(self) -> bool:
        """Ask the call to end at its next report, and return whether it has."""
        if not self._is_working:
            return False
        try:
            for piece in pieces([memoryview(_STOP)]):
                write_piece(self._requests, piece)
        except OSError:
            return False
        give_up = time.monotonic() + _GRACE
        while (left := give_up - time.monotonic()) > 0:
            try:
                message = self._messages.get(timeout=left)
            except queue.Empty:
                return False
            if message is None:
                return False
            if unpacked(message)[0] != "report":
                self._is_working = False
                return True
        return False

    def end(self) -> None:
        """End the process at once."""
        self._process.kill()
        self._process.wait()
        self._requests.close()
        _all.discard(self)

    def _next(self, ask: Callable[[], None]) -> Message | None:
        while True:
            try:
                return self._messages.get(timeout=POLL_INTERVAL)
            except queue.Empty:
                ask()

    def _send(self, request: Message, ask: Callable[[], None]) -> None:
        for piece in pieces(request):
            try:
                write_piece(self._requests, piece)
            except OSError:
                raise self._reason_of_end() from None
            ask()

    def _listen(self, answers: IO[bytes]) -> None:
        try:
            with answers:
                while (message := read_message(answers)) is not None:
                    self._messages.put(message)
        except MemoryError:
            self._answer_fits = False
        self._messages.put(None)

    def _reason_of_end(self) -> Exception:
        # A process that has closed its pipe is about to end, however long that takes.
        code = self._process.wait() if self._answer_fits else _NO_MEMORY
        if code in (_NO_MEMORY, -_KILLED):
            return MemoryError("memory ran out, and the process that did the work ended")
        return RuntimeError(f"the process that did the work ended with exit code {code}")


_all: set[_Worker] = set()
_idle: dict[str, _Worker] = {}
_lock = threading.Lock()


def _idle_or_new(channel: str) -> _Worker | None:
    with _lock:
        idle = _idle.pop(channel, None)
        if idle is not None:
            if idle.is_alive:
                return idle
            idle.end()
        process = _start()
        if process is None:
            return None
        worker = _Worker(process)
        _all.add(worker)
        return worker


def _start() -> subprocess.Popen[bytes] | None:
    # In a frozen application, `sys.executable` is the application.
    if not sys.executable or getattr(sys, "frozen", False):
        return None
    code = _START.format(path=[str(folder) for folder in sys.path])
    for size in (_PIPE, -1):  # not every system grants pipes of this size
        with suppress(OSError, ValueError):
            return subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                bufsize=0,
                pipesize=size,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0)
                | getattr(subprocess, "BELOW_NORMAL_PRIORITY_CLASS", 0),
            )
    return None


def _keep_one(worker: _Worker, channel: str) -> None:
    """Keep a worker for a channel's next call; calls at the same time have had one each."""
    with _lock:
        if worker.is_alive and channel not in _idle:
            _idle[channel] = worker
        else:
            worker.end()


def end_idle() -> None:
    """End the processes that wait for the next call."""
    with _lock:
        while _idle:
            _idle.popitem()[1].end()


@atexit.register
def _end_all() -> None:
    with _lock:
        _idle.clear()
        for worker in list(_all):
            worker.end()


def serve() -> None:
    """Be the worker process: do what comes in on the standard input until that ends."""
    # What anyone prints must not get between the messages, or onto a terminal.
    requests, answers = (
        os.fdopen(os.dup(stream), mode, 0) for stream, mode in ((0, "rb"), (1, "wb"))
    )
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nowhere, stream)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C in a terminal is the parent's matter
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    received: queue.SimpleQueue[Message] = queue.SimpleQueue()
    stopped = threading.Event()

    def listen() -> None:
        try:
            while (message := read_message(requests)) is not None:
                if message == [_STOP]:
                    stopped.set()
                else:
                    stopped.clear()
                    received.put(message)
        except MemoryError:
            os._exit(_NO_MEMORY)
        os._exit(0)  # the parent has ended, whatever is being done here

    threading.Thread(target=listen, daemon=True).start()

    def tell(message: Message) -> None:
        try:
            for piece in pieces(message):
                write_piece(answers, piece)
        except OSError:
            os._exit(0)

    def report(step: str, done: float) -> None:
        if stopped.is_set():
            raise Cancelled
        tell(packed(("report", (step, done))))

    tell([memoryview(_READY)])
    first = received.get()
    tell(packed(("report", (LOADING, 0.0))))  # a name of a function imports its module
    tell(_result(first, report))
    while True:
        tell(_result(received.get(), report))


def _result(request: Message, progress: Progress) -> Message:
    try:
        function, args, keywords = unpacked(request)
    except Exception:  # such as a function of the parent's __main__
        return packed(("refused", None))
    try:
        return packed(("returned", function(*args, progress=progress, **keywords)))
    except Exception as error:
        return packed(("raised", (_portable(error), traceback.format_exc())))


def _portable(error: Exception) -> Exception:
    """Return an error that survives pickling, the same if it does."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error
