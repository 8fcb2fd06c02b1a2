"""Check the language of README, manual and changelog: ``python docs/check_prose.py``.

It runs proselint and looks for what CONTRIBUTING.md asks for: short sentences and the common word.
Code, equations, tables and targets of links are left out. Prints a line for each fault; the exit
code is 1 if there are any.
"""

import re
import sys
from pathlib import Path

from proselint.config import DEFAULT
from proselint.tools import LintFile

ROOT = Path(__file__).parents[1]

LEFT_OUT = {"decisions.md", "imports.md", "peers.md", "ablation.md"}
"""A log for developers, and pages that scripts write."""

LONGEST = 30
"""Words of a sentence."""

WORDS = {
    r"is no (picture|file|folder|number|array)\b": "say 'is not a ...'",
    r"never otherwise|clearly otherwise": "say what it is instead",
    r"\bis anything\b": "say what it can be",
    r"\b(hence|thus|thereby|whereby|therein|thereof|hitherto|wherein)\b": "use the common word",
    r"\b(utili[sz]e|leverage|facilitate|in order to)\b": "use the common word",
    r"\bto the letter\b": "say 'exactly'",
    r"\bso(me)? many (of|px|times)\b": "say how many",
    r"\bshall\b": "say 'should', 'will' or 'must'",
    r"\bamong them\b": "begin a new sentence",
}
"""Patterns of what a reader stumbles over, and what to do."""

CHECKS = {**DEFAULT["checks"], "typography": False, "lexical_illusions": False}
"""Straight quotes and three dots are meant, as in code; doubled words are often names."""


def main():
    """Print all faults; return 1 if there are any."""
    paths = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md"]
    paths += sorted(path for path in (ROOT / "docs").rglob("*.md") if is_prose(path))
    paths += sorted((ROOT / "docs" / "gallery").rglob("plot_*.py"))
    faults = [
        f"{path.relative_to(ROOT)}:{line}: {fault}"
        for path in paths
        for line, fault in faults_of(prose_of(path))
    ]
    print("\n".join(faults) or f"{len(paths)} pages: no fault of language")
    return 1 if faults else 0


def is_prose(path):
    """Tell whether a page is written by hand for users."""
    made = {"_build", "examples", "generated"}
    return path.name not in LEFT_OUT and not made & set(path.parts)


def prose_of(path):
    """Return the text of a page, line for line, with nothing where it is not prose."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        text = comments_of(text)
    text = blank(r"^(`{3,}|:{3,}).*?^\1 *$", text)
    text = blank(r"^\$\$.*?^\$\$.*?$", text)
    text = blank(r"^( *\||[(#:]|[=-]+$| {4}).*?$", text)
    text = re.sub(r"``?[^`\n]+``?|\$[^$\n]+\$", "X", text)
    return re.sub(r"!?\[([^\]]*)\]\([^)\s]*\)", r"\1", text)


def comments_of(text):
    """Return what a script of the gallery says: its docstring and its comments."""
    docstring, _, rest = text.removeprefix('"""').partition('"""')
    said = re.compile(r"# (?!%%)")
    lines = [line[2:] if said.match(line) else "" for line in rest.splitlines()]
    return docstring + "\n".join(lines)


def blank(pattern, text):
    """Return a text without its matches; the numbers of lines stay."""
    return re.sub(pattern, lambda found: "\n" * found[0].count("\n"), text, flags=re.M | re.S)


def faults_of(text):
    """Yield the line and the words of each fault."""
    for result in LintFile("page", text).lint({**DEFAULT, "checks": CHECKS}):
        yield result.pos[0] - 1, result.check_result.message
    for pattern, advice in WORDS.items():
        for found in re.finditer(pattern, text, re.I):
            yield text.count("\n", 0, found.start()) + 1, f"'{found[0]}': {advice}"
    for line, sentence in sentences(text):
        count = len(sentence.split())
        if count > LONGEST:
            start = " ".join(sentence.split()[:6])
            yield line, f"a sentence of {count} words: '{start} ...'"


def sentences(text):
    """Yield the line and the text of each sentence; paragraphs and items of lists end one."""
    for first, block in blocks(text):
        at = 0
        for piece in re.split(r"(?<=[.:;?!])\s+(?=[A-Z*\"X])", block):
            at = block.index(piece, at)
            yield first + block.count("\n", 0, at), piece


def blocks(text):
    """Yield the first line and the text of each paragraph and each item of a list."""
    held, first = [], 1
    for number, line in enumerate([*text.splitlines(), ""], 1):
        if held and (not line.strip() or re.match(r"\s*([-*]|\d+\.) ", line)):
            yield first, "\n".join(held)
            held = []
        if line.strip():
            first = first if held else number
            held.append(line)


if __name__ == "__main__":
    sys.exit(main())
