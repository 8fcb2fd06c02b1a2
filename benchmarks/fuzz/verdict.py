"""What run.py asks of one call: a right result, or an error that names the argument."""

import hashlib
import re
import time
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import napari_defocus
from benchmarks.fuzz.call import Call, described

LIMIT = 10.0
"""s that a call may take; of the processor, too, as others may keep it busy."""

_PACKAGE = str(Path(napari_defocus.__file__).parent)

_LINES = {str(path): path.read_text("utf-8").splitlines() for path in Path(_PACKAGE).rglob("*.py")}
"""Of the package as it is imported: somebody may edit it while calls are made."""


@dataclass(frozen=True)
class Verdict:
    """How a call ended: "result" or "clear error" are good, all else says what is wrong."""

    name: str
    number: int
    ended: str
    seconds: float
    told: str = ""

    @property
    def good(self) -> bool:
        return self.ended in ("result", "clear error")


def judged(name: str, number: int, call: Call) -> Verdict:
    """Make a call and judge how it ends."""
    before = {key: _print_of(value) for key, value in call.arguments.items()}
    told = f"{ {key: described(value) for key, value in call.arguments.items()} }"
    started, worked = time.perf_counter(), time.process_time()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        ended, why = _ended(call)
    seconds = min(time.perf_counter() - started, time.process_time() - worked)
    ours = [str(w.message) for w in warned if str(w.filename).startswith(_PACKAGE)]
    if any(before[key] != _print_of(value) for key, value in call.arguments.items()):
        ended, why = "argument changed", ""
    elif ours and ended in ("result", "clear error"):
        ended, why = "warning", ours[0]
    elif seconds > LIMIT and ended in ("result", "clear error"):
        ended = "slow"
    return Verdict(name, number, ended, seconds, f"{why} {told}")


def _ended(call: Call) -> tuple[str, str]:
    try:
        result = call.function(**call.arguments)
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        return ("clear error" if _is_clear(error, call) else "unclear error"), f"{why} {_at(error)}"
    try:
        call.check(result, call.arguments)
    except Exception as error:
        return "wrong result", f"{error} {_at(error)}"
    return "result", ""


def _is_clear(error: Exception, call: Call) -> bool:
    """Return whether the package raised it on purpose, and it names an argument."""
    if call.fine or not isinstance(error, ValueError | TypeError | OSError | IndexError):
        return False
    frames = traceback.extract_tb(error.__traceback__)
    lines = _LINES.get(frames[-1].filename, [])
    raised = bool(lines) and "raise" in lines[(frames[-1].lineno or 1) - 1]
    named = any(re.search(rf"(?<!\w){re.escape(n)}(?!\w)", str(error)) for n in call.known_names())
    return raised and named


def _at(error: Exception) -> str:
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"({Path(last.filename).name}:{last.lineno})"


def _print_of(value: Any) -> Any:
    """Return what changes if an array does."""
    array = getattr(value, "array", value)
    if isinstance(array, list):
        return repr(array)[:10_000]
    if not isinstance(array, np.ndarray) or array.dtype.hasobject:
        return None
    return array.shape, array.dtype.str, hashlib.sha1(np.asarray(array).tobytes()).hexdigest()
