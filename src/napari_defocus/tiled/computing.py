"""Dask graphs of tiles computed, and how much of them is done."""

from __future__ import annotations

import os
from typing import Any

import dask
from dask.callbacks import Callback

from napari_defocus.core.progress import Progress

_THREADS = min(4, os.cpu_count() or 1)
"""Threads of dask. Each tile uses all of our own threads and its share of the memory."""

_STEP = "Measuring part by part"

_TIMES = {"measured-": 1.0, "coarse-": 0.4, "blur-": 0.35, "noise-": 0.02, "intensities-": 0.01}
_SHORT = 0.002
"""Seconds that all other tasks take. The share that is done is one of time, so that the rest can be
predicted.
"""


def run_tasks(tasks: Any, progress: Progress, step: str = _STEP) -> Any:
    """Compute dask collections together, by whichever scheduler is set, and report.

    Parameters
    ----------
    tasks : nested lists and dicts of dask collections
    progress : callable
        An exception from it ends the work.

    Returns
    -------
    The same with what they have.
    """
    progress(step, 0.0)
    with _Reports(progress, step):
        (done,) = dask.compute(tasks, num_workers=_THREADS)
    progress(step, 1.0)
    return done


class _Reports(Callback):
    """Reports how much dask's own schedulers have done; a cluster's tells nothing."""

    def __init__(self, progress: Progress, step: str) -> None:
        self._progress, self._step = progress, step
        self._done = self._all = 0.0
        super().__init__(start_state=self._begin, posttask=self._count)

    def _begin(self, tasks: Any, state: Any) -> None:
        self._all += sum(map(_time_of, state["dependencies"]))

    def _count(self, key: Any, result: Any, tasks: Any, state: Any, worker: Any) -> None:
        self._done += _time_of(key)
        self._progress(self._step, min(1.0, self._done / self._all))


def _time_of(key: Any) -> float:
    """Return about how long a task takes, as a share of what measuring a tile takes."""
    name, *place = key if isinstance(key, tuple) else (key,)
    if place[:1] == ["row"]:
        return _SHORT
    return next((time for begin, time in _TIMES.items() if str(name).startswith(begin)), _SHORT)
