"""Python as text: values, calls and imports, laid out as ruff lays them out."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from numbers import Integral
from typing import Any

LONGEST_LINE = 88
"""In letters; what ruff and Black allow by default."""

_LONGEST_NAME = 30


def literal(value: Any) -> str:
    """Return a text, a number, a bool or None as Python writes it; numbers to the last digit."""
    if isinstance(value, str):
        return text_literal(value)
    if value is None or isinstance(value, bool):
        return repr(value)
    if isinstance(value, Integral):
        return repr(int(value))
    number = repr(float(value))
    return number if number[-1].isdigit() else f'float("{number}")'


def text_literal(text: str) -> str:
    """Return a text as Python writes it, on one line, whatever letters it has."""
    quote = "'" if text.count('"') > text.count("'") else '"'
    letters = (_escaped(letter, quote) for letter in text)
    return f"{quote}{''.join(letters)}{quote}"


def _escaped(letter: str, quote: str) -> str:
    if letter == quote:
        return f"\\{letter}"
    if letter == "\\" or not letter.isprintable():
        return repr(letter)[1:-1]
    return letter


def shortened(name: str) -> str:
    """Return the beginning of a name, for comments."""
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"


def longer_than_a_line(line: str) -> bool:
    """Tell whether a line would have to be broken."""
    return len(line) > LONGEST_LINE


def call(
    function: str,
    arguments: Iterable[str],
    keywords: Mapping[str, str] | None = None,
    *,
    target: str = "",
    indent: int = 0,
) -> list[str]:
    """Return a call as lines: one if it fits, else one an argument.

    Parameters
    ----------
    function : str
    arguments : iterable of str
    keywords : mapping of str to str, optional
    target : str
        The variable that gets the result, if one does.
    indent : int
        How many spaces are before the first line.

    Examples
    --------
    >>> call("label_blur_map", ["candidates", "image"], {"smoothness": "3.0"}, target="blur_map")
    ['blur_map = label_blur_map(candidates, image, smoothness=3.0)']
    """
    before = " " * indent
    head = f"{before}{target} = {function}(" if target else f"{before}{function}("
    said = [*arguments, *(f"{name}={value}" for name, value in (keywords or {}).items())]
    return _in_brackets(head, said, before)


def _in_brackets(head: str, items: list[str], before: str = "") -> list[str]:
    line = f"{head}{', '.join(items)})"
    if not longer_than_a_line(line):
        return [line]
    # The comma after the last one keeps ruff from joining them, however long its lines are.
    return [head, *(f"{before}    {item}," for item in items), f"{before})"]


def differing(settings: Any, names: Iterable[str]) -> dict[str, str]:
    """Return those settings that are not as their class has them, as keywords of a call."""
    values = {name: getattr(settings, name) for name in names}
    return {
        name: literal(value)
        for name, value in values.items()
        if value != getattr(type(settings), name)
    }


def import_block(imports: Iterable[str], names: Mapping[str, Iterable[str]]) -> list[str]:
    """Return imports in order: the standard library's, then all others.

    Parameters
    ----------
    imports : iterable of str
        Whole lines, each of one name.
    names : mapping of str to iterable of str
        From what modules what names are imported.
    """
    grouped = {line: [line] for line in imports}
    for module, wanted in names.items():
        found = sorted(set(wanted))
        line = f"from {module} import {', '.join(found)}"
        grouped[line] = (
            _in_brackets(f"from {module} import (", found) if longer_than_a_line(line) else [line]
        )
    ordered = sorted(grouped, key=lambda line: (line.startswith("from"), line.split()[1]))
    ours = [line for line in ordered if _top_module(line) not in sys.stdlib_module_names]
    theirs = [line for line in ordered if line not in ours]
    blocks = [[text for line in part for text in grouped[line]] for part in (theirs, ours)]
    return [*blocks[0], "", *blocks[1]]


def _top_module(line: str) -> str:
    return line.split()[1].partition(".")[0]
