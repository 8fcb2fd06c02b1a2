"""The names of options in messages, as they are typed in a terminal."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any


def options_of(command: Callable[..., Any]) -> Iterator[str]:
    """Yield the long options of a command that is made for typer, such as "--focal-length"."""
    for parameter in inspect.signature(command).parameters.values():
        for told in getattr(parameter.annotation, "__metadata__", ()):
            # Inside of Annotated, typer keeps the first name of an option where its default was.
            names = (getattr(told, "default", None), *(getattr(told, "param_decls", None) or ()))
            yield from (each for each in names if str(each).startswith("--"))


def in_option_words(message: str, options: Iterable[str]) -> str:
    """Return a message that names options in place of the arguments that they become.

    A unit at the end of an argument is no part of its option. An argument of one word is only
    taken for a name where a message begins with it. What cannot be read or written is told of
    files, which have names of their own.

    Parameters
    ----------
    message : str
        Of a function that the command called, such as "focal_length_mm is 0".
    options : iterable of str
        The options of the command, such as "--focal-length".

    Examples
    --------
    >>> in_option_words("focal_length_mm is 0; it takes more", ["--focal-length", "--psf"])
    '--focal-length is 0; it takes more'
    """
    if message.startswith("cannot "):
        return message
    for option in options:
        name = option.removeprefix("--").replace("-", "_")
        start = r"(?<![\w/\\.'-])" if "_" in name else r"^"
        end = r"(?![\w/\\'-])" if "_" in name else r"(?= is )"
        message = re.sub(rf"{start}{name}(?:_mm|_um|_m)?{end}", option, message)
    return message
