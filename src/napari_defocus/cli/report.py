"""The terminal command that writes the report of a batch anew, by other limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import napari_defocus
from napari_defocus.cli.command import Facts, command
from napari_defocus.cli.option_groups import LimitOptions
from napari_defocus.core.progress import Progress

_OUT_OF_FOCUS = "out of focus"
"""As `batch.flags` has it, which would be long to import for a message."""


def flagged_line(facts: Facts) -> str:
    """Say how many rows of a table have a flag, how many each, and which limit can be changed."""
    hint = f" (median above {facts['limits']['in_focus_up_to']:g} px, see --in-focus-up-to)"
    flags = ", ".join(
        f"{count} {name}{hint if name == _OUT_OF_FOCUS else ''}"
        for name, count in facts["flags"].items()
    )
    return f"flagged      {facts['flagged']} of {facts['planes']}{': ' * bool(flags)}{flags}"


def _lines(facts: Facts) -> Iterator[str]:
    yield flagged_line(facts)
    yield f"time         {facts['seconds']:.1f} s"
    yield f"wrote        {facts['report']}"


@command(
    _lines,
    """
    folder FOLDER
        What batch wrote into. Its report.html, and the flags in its tables, are written anew.
    """,
)
def report(folder: Path, *, flagging: LimitOptions, progress: Progress) -> dict[str, Any]:
    """Write the report of a batch anew, by other limits."""
    limits = flagging.limits()
    written = napari_defocus.write_report(folder, limits=limits)
    return {
        "report": str(written.report),
        "planes": written.planes,
        "flagged": written.flagged,
        "flags": written.flags,
        "limits": asdict(limits),
    }
