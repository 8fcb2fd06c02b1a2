"""What of a batch lies where: names of results, and notes of what is finished."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path
from typing import Any

from napari_defocus.batch.table import Row
from napari_defocus.core.writing import NeedsForce, UnwritableResult, write_results

Facts = dict[str, Any]

_PARTS = ".napari-defocus-*.part"
"""What `write_results` leaves behind if it is killed."""

_FINISHED = "finished.json"


@dataclass(frozen=True)
class BatchFolder:
    """The folder of a batch: its table, its results, and, hidden, its notes.

    Its path is absolute, so that workers elsewhere find it.
    """

    path: Path

    @property
    def results(self) -> Path:
        """Where maps and the like are."""
        return self.path / "maps"

    @property
    def thumbnails(self) -> Path:
        """Where the small pictures of the report are."""
        return self.path / "thumbnails"

    @property
    def report(self) -> Path:
        """The page that shows the table and the thumbnails."""
        return self.path / "report.html"

    @property
    def notes(self) -> Path:
        """Where it is noted what is finished."""
        return self.path / ".batch"

    @property
    def plan(self) -> Path:
        """What all of the batch is made with."""
        return self.notes / "plan.json"

    @property
    def tables(self) -> tuple[Path, Path]:
        """The same rows twice."""
        return self.path / "table.csv", self.path / "table.jsonl"

    def thumbnail(self, name: str, index: tuple[int, ...]) -> Path:
        """Return where the thumbnail of a plane is; those of a stack have a folder."""
        if not index:
            return self.thumbnails / f"{name}.jpg"
        return self.thumbnails / name / f"plane{''.join(f'-{at}' for at in index)}.jpg"

    def of_source(self, name: str) -> SourceNotes:
        """Return the notes of a source."""
        return SourceNotes(self.notes / "sources" / name)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Let no other batch in; when this process has ended, however it has, others get in.

        Raises
        ------
        UnwritableResult
            If another batch is at work there.
        """
        from filelock import FileLock, Timeout

        try:
            lock = FileLock(self.notes / "lock").acquire(blocking=False)
        except Timeout as error:
            raise UnwritableResult(
                f"cannot write into {self.path}: another batch is at work there"
            ) from error
        with lock:
            yield

    @contextmanager
    def begun(self, made_with: Facts, *, force: bool) -> Iterator[None]:
        """Make the folders, or go on with those of the same plan; note the plan.

        Meanwhile, no other batch gets in. It does when this process has ended, however it has.

        Raises
        ------
        UnwritableResult
            If something is there that no batch made, or a batch that was made with other
            settings, and `force` is not set; if another batch is at work there.
        """
        before = read_note(self.plan)
        if before is None:
            self._check_unused(force)
        elif before != made_with and not force:
            raise NeedsForce(
                f"cannot go on with {self.path}: {differences(before, made_with)}",
                "give another folder, or {force} to measure all of it again",
            )
        for folder in (self.path, self.notes, self.results):
            try:
                folder.mkdir(exist_ok=True)
            except OSError as error:
                raise UnwritableResult(f"cannot make {folder}: {error.strerror}") from error
        with self.held():
            self._remove_left_over()
            write_note(self.plan, made_with)
            yield

    def _check_unused(self, force: bool) -> None:
        if self.path.exists() and not self.path.is_dir():
            raise UnwritableResult(f"cannot write into {self.path}: it is not a folder")
        if not self.path.parent.is_dir():
            raise UnwritableResult(f"cannot make {self.path}: there is no folder above it")
        held = [path for path in (*self.tables, self.report) if path.exists()]
        held += filter(_is_used, (self.results, self.thumbnails))
        if held and not force:
            raise NeedsForce(
                f"cannot write into {self.path}: {held[0].name} exists, and no batch made it",
                "{force} overwrites what has the same name",
            )

    def _remove_left_over(self) -> None:
        small = (self.thumbnails, *(each for each in self.thumbnails.glob("*") if each.is_dir()))
        places = (self.path, self.results, *small, self.notes, *self.notes.glob("sources/*"))
        for part in chain.from_iterable(folder.glob(_PARTS) for folder in places):
            part.unlink(missing_ok=True)


def _is_used(place: Path) -> bool:
    return place.exists() and (not place.is_dir() or any(place.iterdir()))


@dataclass(frozen=True)
class SourceNotes:
    """What is noted of a source: what it was when it was begun, its rows, and that it is whole."""

    folder: Path

    def begun_with(self) -> Facts | None:
        """Return what the source was, and what it is worked on with; None if it is new."""
        return read_note(self.folder / "source.json")

    def begin(self, facts: Facts) -> None:
        """Forget what is noted, and note the source."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        write_note(self.folder / "source.json", facts)

    def row_path(self, index: tuple[int, ...]) -> Path:
        """Return where the row of a plane is, if it is finished."""
        return self.folder / f"plane{''.join(f'-{at}' for at in index)}.json"

    def row(self, index: tuple[int, ...]) -> Row | None:
        """Return the row of a finished plane."""
        return read_note(self.row_path(index))

    def finish(self, rows: Sequence[Row]) -> None:
        """Note that all results are in their places, and the rows of all planes."""
        write_note(self.folder / _FINISHED, {"rows": rows})

    def finished(self) -> list[Row] | None:
        """Return the rows of all planes, if the results are in their places."""
        noted = read_note(self.folder / _FINISHED)
        return None if noted is None else list(noted["rows"])

    def resume(self) -> None:
        """Take back that all results are in their places."""
        (self.folder / _FINISHED).unlink(missing_ok=True)

    def store(self, kind: str) -> Path:
        """Return where regions wait that become a file of another format at the end."""
        return self.folder / f"{kind}.ome.zarr"


def path_from(folder: Path, path: Path) -> str:
    """Return the path of something as links of a page in a folder have it.

    Examples
    --------
    >>> path_from(Path("/data/measured"), Path("/data/fields/A01.tif"))
    '../fields/A01.tif'
    """
    try:
        return Path(os.path.relpath(path.absolute(), folder)).as_posix()
    except ValueError:  # on another drive
        return path.absolute().as_uri()


def read_note(path: Path) -> Facts | None:
    """Return what is noted in a file; None if there is none."""
    try:
        found: Facts = json.loads(path.read_text("utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValueError as error:
        raise ValueError(f"cannot read {path}: it is damaged; remove it") from error
    return found


def write_note(path: Path, facts: Mapping[str, Any]) -> None:
    """Note something, whole or not at all."""
    content = json.dumps(facts, ensure_ascii=False, indent=1)
    write_results({path: f"{content}\n".encode(errors="backslashreplace")}, force=True)


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Return in words in what two notes differ.

    What only one of them has follows from another difference, if there is one that both have.

    Examples
    --------
    >>> differences({"map": {"window": 41}}, {"map": {"window": 31}})
    'window was 41 and is 31'
    """
    old, new = dict(_flat(before)), dict(_flat(now))
    names = [name for name in {**old, **new} if old.get(name) != new.get(name)]
    names = [name for name in names if name in old and name in new] or names
    return ", ".join(
        f"{name.rpartition('.')[2]} was {_told(old.get(name))} and is {_told(new.get(name))}"
        for name in names
    )


def _flat(facts: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in facts.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}.")
        else:
            yield above + name, value


def _told(value: Any) -> str:
    return "not given" if value is None else json.dumps(value, ensure_ascii=False).strip('"')


# Sources.


def identity(path: Path) -> Facts:
    """Return what tells whether a source is still the same: path, bytes, time of change.

    Of a folder, such as an OME-Zarr store, all files count.
    """
    files = list(_files(path)) if path.is_dir() else [path.stat()]
    return {
        "path": str(path.resolve()),
        "files": len(files),
        "bytes": sum(file.st_size for file in files),
        "time of change": _told_time(max((file.st_mtime_ns for file in files), default=0)),
    }


def _told_time(nanoseconds: int) -> str:
    seconds, rest = divmod(nanoseconds, 10**9)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S}.{rest:09d} UTC"


def _files(folder: Path) -> Iterator[os.stat_result]:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir():
                yield from _files(Path(entry.path))
            else:
                yield entry.stat()


def distinct_names(sources: Iterable[Path]) -> list[str]:
    """Return a name a source for its results, all different, also if capitals do not count.

    It is the file's name without its ending. Of several of one name, the first keeps it; others
    get their ending, their folder or a number.

    Examples
    --------
    >>> distinct_names([Path("x/a.png"), Path("x/a.tif"), Path("y/A.png"), Path("b.ome.zarr")])
    ['a', 'a-tif', 'A-png', 'b']
    """
    taken: set[str] = set()
    names = []
    for source in sources:
        name = next(name for name in _possible_names(source) if name.casefold() not in taken)
        taken.add(name.casefold())
        names.append(name)
    return names


def _possible_names(source: Path) -> Iterator[str]:
    stem, folder = source.stem.removesuffix(".ome"), source.absolute().parent.name
    ending = source.suffix.lower().replace(".", "-")
    yield from dict.fromkeys((stem, stem + ending))
    if folder:
        yield from dict.fromkeys((f"{folder}-{stem}", f"{folder}-{stem}{ending}"))
    yield from (f"{stem}-{number}" for number in count(2))
