"""How a command behaves in a terminal: progress, errors in one line, exit codes."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import typer

from napari_defocus.progress import Progress, silent

FAILED, INTERRUPTED = 2, 130


@contextmanager
def errors_in_one_line() -> Iterator[None]:
    """End a command with one line on standard error and exit code 2, or 130 if interrupted."""
    try:
        yield
    except KeyboardInterrupt:
        _complain("interrupted")
        raise typer.Exit(INTERRUPTED) from None
    except MemoryError:
        _complain("there is not enough memory for this picture")
        raise typer.Exit(FAILED) from None
    except (OSError, TypeError, ValueError) as error:
        _complain(str(error))
        raise typer.Exit(FAILED) from None
    except Exception as error:
        _complain(f"{type(error).__name__}: {error}")
        raise typer.Exit(FAILED) from None


def _complain(message: str) -> None:
    typer.echo(f"napari-defocus: {' '.join(message.split())}", err=True)


@contextmanager
def progress_in_terminal(quiet: bool) -> Iterator[Progress]:
    """Lend a callback that draws a bar on standard error if that is a terminal, else nothing."""
    if quiet or not sys.stderr.isatty():
        yield silent
        return
    from rich import progress
    from rich.console import Console

    columns = progress.TextColumn("{task.description}"), progress.BarColumn()
    bar = progress.Progress(
        *columns, progress.TaskProgressColumn(), console=Console(stderr=True), transient=True
    )
    with bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda step, done: bar.update(task, description=step, completed=done)


def print_result(text: str) -> None:
    """Print to standard output; a full disk or a closed pipe is an `OSError` with words."""
    try:
        print(text, flush=True)
    except OSError as error:
        # Or the interpreter would try to flush the same text again when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise OSError(f"cannot print the result: {error.strerror}") from error
