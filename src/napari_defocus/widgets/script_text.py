"""Python as text: values, calls and imports, laid out as ruff lays them out."""

from __future__ import annotations

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


def call(function: str, *arguments: str, **keywords: str) -> list[str]:
    """Return a call as lines; one an argument if there are keywords.

    Examples
    --------
    >>> call("label_blur_map", "candidates", "image", smoothness="3.0")
    ['label_blur_map(', '    candidates,', '    image,', '    smoothness=3.0,', ')']
    """
    if not keywords:
        return [f"{function}({', '.join(arguments)})"]
    named = (f"{name}={value}" for name, value in keywords.items())
    return [f"{function}(", *(f"    {argument}," for argument in (*arguments, *named)), ")"]


def assigned(target: str, lines: list[str]) -> list[str]:
    """Return the lines of an expression with its result given a name."""
    return [f"{target} = {lines[0]}", *lines[1:]]


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
        From what modules what names are imported, one a line.
    """
    grouped = {line: [line] for line in imports}
    for module, wanted in names.items():
        few = [f"    {name}," for name in sorted(set(wanted))]
        grouped[f"from {module} import ("] = [f"from {module} import (", *few, ")"]
    ordered = sorted(grouped, key=lambda line: (line.startswith("from"), line.split()[1]))
    ours = [line for line in ordered if _top_module(line) not in _STANDARD]
    theirs = [line for line in ordered if line not in ours]
    blocks = [[text for line in part for text in grouped[line]] for part in (theirs, ours)]
    return [*blocks[0], "", *blocks[1]]


_STANDARD = ("base64", "hashlib", "importlib", "pathlib", "sys", "zlib")


def _top_module(line: str) -> str:
    return line.split()[1].partition(".")[0]
