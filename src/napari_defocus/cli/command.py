"""How terminal commands run, and what they say last."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from napari_defocus.cli.console import errors_in_one_line, print_result, progress_in_terminal
from napari_defocus.cli.option_groups import Reporting
from napari_defocus.core.progress import CompilationClock, Progress


def run(
    work: Callable[[Progress], dict[str, Any]],
    lines: Callable[[Mapping[str, Any]], Iterator[str]],
    reporting: Reporting,
) -> None:
    """Do the work of a command and print the facts that it returns."""
    started = time.perf_counter()
    with errors_in_one_line():
        with progress_in_terminal(reporting.quiet) as progress:
            clock = CompilationClock(progress)
            facts = work(clock)
        facts["seconds"] = round(time.perf_counter() - started, 2)
        facts["seconds_compiling"] = round(clock.seconds, 2)
        if reporting.as_json:
            print_result(json.dumps(facts))
        elif not reporting.quiet:
            print_result("\n".join(lines(facts)))


def last_lines(facts: Mapping[str, Any]) -> Iterator[str]:
    """Say how long it took and what was written."""
    compiling = facts["seconds_compiling"]
    once = f", and {compiling:.1f} s to compile the program, once" if compiling >= 0.05 else ""
    yield f"time         {facts['seconds'] - compiling:.1f} s{once}"
    for path in facts["files"]:
        yield f"wrote        {path}"


def check_endings(outputs: list[Path], *endings: str) -> None:
    """Check what the names of results end in."""
    for path in outputs:
        if path.suffix.lower() not in endings:
            raise ValueError(f"cannot write {path}: its name must end in {' or '.join(endings)}")
