"""Kernels on several threads: each works on a band of rows, as numba compiles it for one thread.

A kernel that gets its band, and sums in the order of its source, gives the same bits on any number
of threads. So no kernel of this package has numba's ``parallel=True``, which also takes two to four
times as long to compile. None has ``fastmath``, because it lets the compiler reorder sums. The
order would depend on the processor, on what is inlined where, and on whether the kernel was
compiled in this process or read from numba's cache.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, TypeVar

import numba

Item = TypeVar("Item")
Result = TypeVar("Result")

_BANDS_A_THREAD = 4
"""So that a thread whose rows are quick can take more of them. Results do not depend on it."""

_alone = threading.local()


@contextmanager
def in_one_thread() -> Iterator[None]:
    """Let all kernels that this thread calls run in it, whatever their length."""
    _alone.asked = True
    try:
        yield
    finally:
        _alone.asked = False


def thread_count() -> int:
    """Return how many threads work at once: the environment's NUMBA_NUM_THREADS, or all cores."""
    return int(numba.config.NUMBA_NUM_THREADS)


def in_bands(kernel: Callable[..., None], length: int, *arguments: Any, least: int = 1) -> None:
    """Call ``kernel(start, stop, *arguments)`` for bands that cover all of a range.

    Parameters
    ----------
    kernel : callable
        Compiled with ``nogil=True``. What it writes for one index depends on no other.
    length : int
        The range is 0 to `length`.
    *arguments
        What the kernel reads, and the arrays that it writes to.
    least : int, optional
        No band is shorter: below that, handing it over takes longer than the work. Bands begin
        at multiples of it.
    """
    threads = thread_count()
    steps = -(-length // least)
    if threads == 1 or steps <= 1 or getattr(_alone, "asked", False):
        kernel(0, length, *arguments)
        return
    side = -(-steps // (_BANDS_A_THREAD * threads)) * least
    started = [
        _pool(os.getpid(), threads).submit(kernel, start, min(start + side, length), *arguments)
        for start in range(0, length, side)
    ]
    for band in started:
        band.result()


def in_order(function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """Call a function for each item, on several threads; yield the results in the items' order.

    Parameters
    ----------
    function : callable
        What takes long in it runs without the GIL. Kernels that it calls run in its own thread.
    items : sequence
    """
    threads = thread_count()
    if threads == 1 or len(items) <= 1 or getattr(_alone, "asked", False):
        yield from map(function, items)
        return

    def alone(item: Item) -> Result:
        with in_one_thread():
            return function(item)

    # No more than the threads take at once, as each may need much memory.
    started: deque[Future[Result]] = deque()
    for item in items:
        started.append(_pool(os.getpid(), threads).submit(alone, item))
        if len(started) == threads:
            yield started.popleft().result()
    while started:
        yield started.popleft().result()


@lru_cache(maxsize=1)
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """Return the threads of this process: one that was forked has none of its parent's."""
    return ThreadPoolExecutor(threads, thread_name_prefix="napari-defocus")
