"""What a batch returns: where its table and its report are, and how many rows are odd."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from napari_defocus.batch.flags import WORST_FIRST, flag_names
from napari_defocus.batch.table import FAILED, Row

_MOST_FAILURES = 5


@dataclass(frozen=True)
class BatchReport:
    """The results of a batch.

    Attributes
    ----------
    table : Path
        A CSV file. A file with the same rows as JSON lines lies beside it.
    planes, failed : int
        How many rows the table has, and how many of these could not be measured.
    sources : int
        How many pictures and stacks there are; as many as planes, if all are pictures.
    failures : dict of str to str
        Why the first pictures that could not be measured could not, at most 5 of them.
    left_out : dict of str to int
        How many files of the folders and patterns were left out, by their endings, such as ".txt".
        "result" counts results of this package, "folder" folders in a folder.
    doubtful : int
        How many rows say in their column "careful" why the picture tells little of its blur.
    flagged : int
        How many rows have a flag, such as "out of focus".
    report : Path or None
        The page that shows the table, `report.html`, if it was asked for.
    flags : dict of str to int
        How many rows have each flag, the worst first.

    Examples
    --------
    >>> BatchReport(Path("measured", "table.csv"), planes=12, failed=1).failed
    1
    """

    table: Path
    planes: int
    failed: int
    left_out: dict[str, int] = field(default_factory=dict, hash=False)
    doubtful: int = 0
    flagged: int = 0
    report: Path | None = None
    flags: dict[str, int] = field(default_factory=dict, hash=False)
    sources: int = 0
    failures: dict[str, str] = field(default_factory=dict, hash=False)

    @classmethod
    def of_rows(
        cls,
        rows: Sequence[Row],
        table: Path,
        *,
        left_out: dict[str, int] | None = None,
        report: Path | None = None,
    ) -> BatchReport:
        """Count what rows, judged by limits, say."""
        counts = Counter(name for row in rows for name in flag_names(row))
        failed = {row["source"]: row.get("error") or "" for row in rows if row["status"] == FAILED}
        return cls(
            table=table,
            planes=len(rows),
            failed=sum(row["status"] == FAILED for row in rows),
            left_out=left_out or {},
            doubtful=sum(bool(row.get("careful")) for row in rows),
            flagged=sum(bool(row["flags"]) for row in rows),
            report=report,
            flags={name: counts[name] for name in WORST_FIRST if counts[name]},
            sources=len({row["source"] for row in rows}),
            failures=dict(islice(failed.items(), _MOST_FAILURES)),
        )
