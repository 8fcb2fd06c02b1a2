"""How long-running functions say how far they are, and how they are stopped."""

import math
import time
from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called as ``progress(step, done)``: the step's name in plain words, and the share of the
whole call that is done, from 0 to 1. It runs in the calling thread. An exception that it
raises ends the call and reaches the caller; raise `Cancelled` to stop on a user's wish."""


COMPILING = "Compiling"
"""How the name of a step begins in which numba compiles, once for this machine."""


class Cancelled(Exception):
    """The work was stopped on request, before it had a result."""


def silent(step: str, done: float) -> None:
    """Report nothing."""


def within(progress: Progress, start: float, stop: float, name: str | None = None) -> Progress:
    """Return a callback for a part of the work: its 0 to 1 becomes ``start`` to ``stop``.

    With a name, the part is one step of that name.
    """

    def report(step: str, done: float) -> None:
        progress(name or step, start + (stop - start) * done)

    return report


class CompilationClock:
    """A callback that hands reports on, and adds up the time that was spent compiling.

    Parameters
    ----------
    progress : callable
        What is called with every report.

    Attributes
    ----------
    seconds : float
        From each report of a step that compiles to the next report of another one.
    """

    def __init__(self, progress: Progress, now: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: float = 0.0
        self._progress = progress
        self._now = now
        self._since: float | None = None

    def __call__(self, step: str, done: float) -> None:
        """Take a report, see `Progress`."""
        now = self._now()
        if self._since is not None:
            self.seconds += now - self._since
        self._since = now if step.startswith(COMPILING) else None
        self._progress(step, done)


def duration(seconds: float) -> str:
    """Return a time in the unit that people would say it in, rounded up.

    Examples
    --------
    >>> duration(9.2), duration(200), duration(9000)
    ('10 s', '4 min', '2 h 30 min')
    """
    if seconds <= 60:
        return f"{math.ceil(seconds)} s"
    minutes = math.ceil(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
