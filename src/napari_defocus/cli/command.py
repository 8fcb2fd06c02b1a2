"""How terminal commands run, and what they say last."""

from __future__ import annotations

import inspect
import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from napari_defocus.cli.console import errors_in_one_line, print_result, progress_in_terminal
from napari_defocus.cli.option_groups import Reporting, with_options
from napari_defocus.cli.option_words import options_of
from napari_defocus.core.progress import CompilationClock, Progress

Facts = Mapping[str, Any]
Lines = Callable[[Facts], Iterator[str]]


def command(
    lines: Lines, text: str = "", *, end: Callable[[Facts], None] | None = None
) -> Callable[[Callable[..., dict[str, Any]]], Callable[..., None]]:
    """Return a decorator that makes a terminal command of a function that returns facts.

    Parameters
    ----------
    lines : callable
        Returns what is said of the facts; --json prints themselves.
    text : str
        What is to be said of the function's parameters, see `with_options`; `progress` is lent.
    end : callable, optional
        Called with the facts when they are printed.
    """

    def made(work: Callable[..., dict[str, Any]]) -> Callable[..., None]:
        taken = dict(inspect.signature(work, eval_str=True).parameters)
        taken["reporting"] = taken.pop("progress").replace(name="reporting", annotation=Reporting)

        def run_with(*, reporting: Reporting, **options: Any) -> None:
            facts = run(
                lambda progress: work(**options, progress=progress), lines, reporting, typed
            )
            if end is not None:
                end(facts)

        shown = with_options(run_with, list(taken.values()), text)
        shown.__doc__ = work.__doc__
        typed = list(options_of(shown))
        return shown

    return made


def run(
    work: Callable[[Progress], dict[str, Any]],
    lines: Lines,
    reporting: Reporting,
    options: Iterable[str] = (),
) -> dict[str, Any]:
    """Do the work of a command, print the facts that it returns, and return them.

    Errors name `options` as they are typed.
    """
    started = time.perf_counter()
    with errors_in_one_line(options):
        with progress_in_terminal(reporting.quiet) as progress:
            clock = CompilationClock(progress)
            facts = work(clock)
        facts["seconds"] = round(time.perf_counter() - started, 2)
        facts["seconds_compiling"] = round(clock.seconds, 2)
        if reporting.as_json:
            print_result(json.dumps(facts))
        elif not reporting.quiet:
            print_result("\n".join(lines(facts)))
    return facts


def last_lines(facts: Facts) -> Iterator[str]:
    """Say how long it took and what was written."""
    compiling = facts["seconds_compiling"]
    once = f", and {compiling:.1f} s to compile the program, once" if compiling >= 0.05 else ""
    yield f"time         {facts['seconds'] - compiling:.1f} s{once}"
    for path in facts["files"]:
        yield f"wrote        {path}"
