"""How a command behaves in a terminal: progress, errors in one line, exit codes."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import typer

from napari_defocus.cli.option_words import in_option_words
from napari_defocus.core.progress import Progress, silent

FAILED, INTERRUPTED = 2, 130
_ENDED_BY_SIGNAL = 128


class Ended(KeyboardInterrupt):
    """Somebody ends this process, politely: what is half-written goes, as after Ctrl-C."""

    def __init__(self, signal_number: int) -> None:
        super().__init__()
        self.code = _ENDED_BY_SIGNAL + signal_number


def end_as_after_ctrl_c() -> None:
    """Let SIGTERM and a closed terminal, too, leave nothing half-written.

    What is ignored, as `nohup` has it, stays so.
    """
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _end)


def _end(number: int, frame: object) -> None:
    # Once: what cleans up is not interrupted by the next one.
    signal.signal(number, signal.SIG_IGN)
    raise Ended(number)


@contextmanager
def errors_in_one_line(options: Iterable[str] = ()) -> Iterator[None]:
    """End a command with one line on standard error and exit code 2, or 130 if interrupted.

    After a signal such as SIGTERM it is 128 and its number. The line names `options` as they are
    typed.
    """
    try:
        yield
    except Ended as error:
        complain("ended")
        raise typer.Exit(error.code) from None
    except KeyboardInterrupt as error:
        for told in ("interrupted", *getattr(error, "__notes__", ())):
            complain(told)
        raise typer.Exit(INTERRUPTED) from None
    except Exception as error:
        complain(_told(error, options))
        raise typer.Exit(FAILED) from None


def _told(error: Exception, options: Iterable[str]) -> str:
    """Return a message in the words of the terminal."""
    from napari_defocus.core.writing import NeedsForce

    if isinstance(error, MemoryError):
        return "there is not enough memory for this picture"
    if isinstance(error, NeedsForce):
        return error.told("--force")
    if isinstance(error, OSError | TypeError | ValueError):
        return in_option_words(str(error), options)
    return f"{type(error).__name__}: {error}"


def complain(message: str) -> None:
    """Say what went wrong, in one line on standard error."""
    typer.echo(f"napari-defocus: {' '.join(message.split())}", err=True)


@contextmanager
def progress_in_terminal(quiet: bool) -> Iterator[Progress]:
    """Lend a callback that draws a bar on standard error if that is a terminal, else nothing.

    The step's name is last: long and short ones do not move the bar. The seconds go on where a step
    says nothing for long.
    """
    if quiet or not sys.stderr.isatty():
        yield silent
        return
    from rich import progress
    from rich.console import Console

    bar = progress.Progress(
        progress.BarColumn(),
        progress.TaskProgressColumn(),
        progress.TimeElapsedColumn(),
        progress.TextColumn("{task.description}", markup=False),
        console=Console(stderr=True),
        transient=True,
    )
    with bar:
        task = bar.add_task("Starting", total=1.0)
        bar.refresh()

        def report(step: str, done: float) -> None:
            # A new step is drawn at once: its work may let nothing else run.
            is_new = step != bar.tasks[0].description
            bar.update(task, description=step, completed=done, refresh=is_new)

        yield report


def print_result(text: str) -> None:
    """Print to standard output; a full disk or a closed pipe is an `OSError` with words."""
    try:
        print(text, flush=True)
    except OSError as error:
        # Or the interpreter would try to flush the same text again when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OSError(f"cannot print the result: {error.strerror}") from error
