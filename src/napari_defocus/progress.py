"""How long-running functions say how far they are, and how they are stopped."""

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called as ``progress(step, done)``: the step's name in plain words, and the share of the
whole call that is done, from 0 to 1. It runs in the calling thread. An exception that it
raises ends the call and reaches the caller; raise `Cancelled` to stop on a user's wish."""


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
