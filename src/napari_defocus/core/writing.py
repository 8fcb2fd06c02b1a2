"""Files that appear whole or not at all, and never by accident in place of others."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from napari_defocus.core.checks import check_flag


class UnwritableResult(OSError):
    """A result cannot be written; the message is one line with the path and the reason."""


class NeedsForce(UnwritableResult):
    """Something may only be overwritten if the caller says so.

    Parameters
    ----------
    problem : str
        What is in the way.
    remedy : str
        What saying so does; `{force}` stands for how it is said.

    Examples
    --------
    >>> refused = NeedsForce("cannot write a.tif: it exists already", "{force} overwrites it")
    >>> str(refused)
    'cannot write a.tif: it exists already (force=True overwrites it)'
    >>> refused.told("--force")
    'cannot write a.tif: it exists already (--force overwrites it)'
    """

    def __init__(self, problem: str, remedy: str) -> None:
        self.problem, self.remedy = problem, remedy
        super().__init__(self.told("force=True"))

    def __reduce__(self) -> tuple[Any, ...]:
        """Let it come back from another process."""
        return type(self), (self.problem, self.remedy)

    def told(self, force: str) -> str:
        """Return the message as those read it who say `force` in their own way."""
        return f"{self.problem} ({self.remedy.format(force=force)})"


def check_results(
    paths: Iterable[Path], *, force: bool = False, source: Path | None = None
) -> None:
    """Make sure, before any long work, that results can be written.

    Parameters
    ----------
    paths : iterable of Path
        The files to come.
    force : bool
        Whether a file that exists may be overwritten.
    source : Path, optional
        A file that is read; it is never overwritten.

    Raises
    ------
    TypeError
        If `force` is neither True nor False.
    UnwritableResult
        If the folder of a result is missing or takes no new file, it is a folder, a device or
        `source`, or two results are one file.
    NeedsForce
        If a result exists and `force` is not set.
    """
    check_flag("force", force)
    seen: set[Path] = set()
    for path in paths:
        target = path.resolve()
        refusal = "it is given twice" if target in seen else _refusal(target, source)
        if refusal:
            raise UnwritableResult(f"cannot write {path}: {refusal}")
        if target.exists() and not force:
            raise NeedsForce(f"cannot write {path}: it exists already", "{force} overwrites it")
        seen.add(target)


def _refusal(target: Path, source: Path | None) -> str | None:
    if not target.parent.is_dir():
        return f"there is no folder {target.parent}"
    if target.is_dir():
        return "it is a folder"
    if target.exists():
        if not target.is_file():
            return "it is not a regular file"
        if source is not None and source.exists() and target.samefile(source):
            return "it is a file that is read"
    return _creation_failure(target.parent)


def _creation_failure(folder: Path) -> str | None:
    probe = unused_name(folder)
    try:
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        return in_one_line(error)
    return None


def unused_name(folder: Path) -> Path:
    """Return a temporary name for a file to come, which no other process takes."""
    return folder / f".napari-defocus-{secrets.token_hex(8)}.part"


def write_results(contents: Mapping[Path, bytes], *, force: bool = False) -> None:
    """Write files that belong together: all of them whole, or none.

    Every file is written and synchronised under a temporary name in its own folder first, and
    what it replaces is kept there, too; then all get their names.

    Parameters
    ----------
    contents : mapping of Path to bytes
        What goes into which file.
    force : bool
        Whether files that exist are overwritten.

    Raises
    ------
    UnwritableResult
        For the reasons of `check_results`, or if writing or renaming fails, for instance because
        the disk is full. No temporary file stays behind, and files that existed are as they
        were. So it is after an interruption, too.
    """
    check_results(contents, force=force)
    swaps = [_Swap.at(path) for path in contents]
    try:
        for swap in swaps:
            _write_through(swap.part, contents[swap.path])
        for swap in swaps:
            swap.keep_old()
        for swap in swaps:
            swap.part.replace(swap.target)
    except BaseException as error:
        stuck = [each for each in swaps if not each.undo()]
        if isinstance(error, OSError):
            told = [in_one_line(error), *(f"{each.path} was {each.old}" for each in stuck)]
            raise UnwritableResult(f"cannot write {swap.path}: {'; '.join(told)}") from error
        raise
    else:
        for swap in swaps:
            swap.old.unlink(missing_ok=True)
    finally:
        for swap in swaps:
            swap.part.unlink(missing_ok=True)


@dataclass
class _Swap:
    """A file that gets a new content, and can get the old one back.

    `old` is another name of what was there; where a file system has no second names, a copy.
    """

    path: Path
    target: Path
    part: Path
    old: Path
    ready: bool = False

    @classmethod
    def at(cls, path: Path) -> _Swap:
        target = path.resolve()
        return cls(path, target, unused_name(target.parent), unused_name(target.parent))

    def keep_old(self) -> None:
        if self.target.exists():
            try:
                os.link(self.target, self.old)
            except OSError:
                shutil.copy2(self.target, self.old)
        self.ready = True

    def undo(self) -> bool:
        """Put back what was there; return whether that went well."""
        try:
            if not self.ready or self.part.exists():
                self.old.unlink(missing_ok=True)
            elif self.old.exists():
                self.old.replace(self.target)
            else:
                self.target.unlink(missing_ok=True)
        except OSError:
            return False
        return True


def _write_through(path: Path, content: bytes) -> None:
    with path.open("xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def in_one_line(error: Exception) -> str:
    """Return what an error says, without line breaks."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(text.split())
