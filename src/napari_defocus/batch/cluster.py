"""Workers: a dask client of this machine's own processes, or of a scheduler that is given."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import chain
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from napari_defocus.core.extras import need_large_extra

if TYPE_CHECKING:
    from distributed import Client

ANSWERS_WITHIN = 15
"""Seconds that a scheduler has to answer: it may be busy, and so may the machine it is on."""

HAS_WORKER_WITHIN = 15
"""Seconds that the first worker of a scheduler has to be there."""

TASKS_PER_THREAD = 2
"""Tasks for each thread of the workers that are sent at a time. The others, perhaps ten thousand,
wait here.
"""

_NO_DASHBOARD = "127.0.0.1:0"
"""A port that nobody outside reaches. dask listens at one in any case."""

_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Variables that have to be set before a process starts. dask sets them in this process, too."""

_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(24 << 20)}
"""Gives large arrays back to the system when they are freed: glibc would keep a third more memory.
With a lower threshold, the system would spend twice as long on pages.
"""


@contextmanager
def dask_client(address: str | None = None, *, workers: int | None = None) -> Iterator[Client]:
    """Lend a dask client; what was started for it is ended with it.

    Parameters
    ----------
    address : str, optional
        Of a dask scheduler, such as "tcp://10.0.0.5:8786". Without, worker processes are started
        on this machine, which nothing outside of it can reach. They share its cores, and end
        with this process even if it is killed. A script that starts them needs the line
        ``if __name__ == "__main__":``, because each of them imports it.
    workers : int, optional
        How many processes to start; one a core without. Only without an address.

    Yields
    ------
    distributed.Client

    Raises
    ------
    ConnectionError
        If no scheduler answers at the address within 15 s, or it has no worker then.
    ValueError
        If the address is none, or `workers` is below 1 or given together with an address.
    ImportError
        If the extra "large" is not installed.

    Examples
    --------
    >>> with dask_client(workers=2) as client:              # doctest: +SKIP
    ...     measure_batch("photos", "measured", client=client)
    """
    need_large_extra()
    if address is None:
        count = cores() if workers is None else workers
        if count < 1:
            raise ValueError(f"workers is {count}; it takes a whole number from 1 up")
        with _quiet_logs(), _own_cluster(count) as client:
            yield client
        return
    if workers is not None:
        raise ValueError(f"workers is {workers}, but the scheduler at {address} has its own")
    with _quiet_logs(), _client_of(address) as client:
        yield client


@contextmanager
def in_this_process() -> Iterator[Client]:
    """Lend a dask client whose only worker is a thread of this process."""
    need_large_extra()
    from distributed import Client

    with (
        _quiet_logs(),
        Client(
            processes=False, n_workers=1, threads_per_worker=1, dashboard_address=_NO_DASHBOARD
        ) as lent,
    ):
        yield lent


@dataclass(frozen=True)
class Job:
    """Work for workers: `submit` takes a client and returns futures, several if it is `divided`.

    `done` is called, here, with the result of each, or with the exception if there is none.
    """

    submit: Callable[[Client], list[Any]]
    done: Callable[[Any], None]
    divided: bool = False

    @classmethod
    def call(cls, function: Callable[[Any], Any], item: Any, done: Callable[[Any], None]) -> Job:
        """Return a job that calls a function with one argument."""
        return cls(lambda client: [client.submit(function, item, pure=False)], done)

    @classmethod
    def graph(cls, rows: list[list[Any]], done: Callable[[Any], None]) -> Job:
        """Return a job of delayed tasks, which share what they need.

        Those of a row come before those of the next ones: dask alone would begin everywhere, and
        keep much that waits for what is beside it.
        """

        def submit(client: Client) -> list[Any]:
            futures = (client.compute(row, priority=-number) for number, row in enumerate(rows))
            return [*chain(*futures)]

        return cls(submit, done, divided=True)


def outcomes(
    client: Client, next_job: Callable[[], Job | None], *, at_a_time: int | None = None
) -> Iterator[tuple[Job, Any]]:
    """Yield jobs with their results as workers finish them, or with what was raised.

    Workers that end are none of that, unless a job outlives none: what they had goes to others. If
    the scheduler is gone, ConnectionError is raised. `next_job` is asked for one job after another,
    but for few ahead; it returns None if there is none for now. There are `at_a_time` futures, but
    for divided jobs; without, two a thread of the workers.
    """
    from distributed import as_completed

    finished = as_completed()
    jobs: dict[Any, Job] = {}
    try:
        while True:
            room = (at_a_time or TASKS_PER_THREAD * threads_of(client)) - len(jobs)
            while room > 0 and (job := next_job()) is not None:
                futures = job.submit(client)
                jobs |= dict.fromkeys(futures, job)
                finished.update(futures)
                room -= len(futures)
            if not jobs:
                return
            future = next(finished)
            yield jobs.pop(future), _outcome(future)
    finally:
        client.cancel(list(jobs))


def _outcome(future: Any) -> Any:
    if future.status in ("cancelled", "lost"):
        raise ConnectionError("the dask scheduler is gone; what is finished stays")
    if future.status == "finished":
        return future.result()
    error = future.exception()
    if type(error).__name__ == "KilledWorker":
        return RuntimeError(
            "the worker processes that tried it ended, perhaps because memory was short"
        )
    return error


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def threads_of(client: Client) -> int:
    """Return how many tasks the workers of a client do at a time; 1 while there is no worker."""
    return max(1, sum(client.nthreads().values()))


@contextmanager
def _own_cluster(workers: int) -> Iterator[Client]:
    import dask
    from distributed import Client, LocalCluster

    threads = str(max(1, cores() // workers))
    started_with = dict.fromkeys(_THREADS, threads) | _MEMORY
    before = {name: os.environ[name] for name in started_with.keys() & os.environ.keys()}
    # In this process, numba would refuse to work with another number than it began with.
    told = {"NUMBA_NUM_THREADS": threads}
    with ExitStack() as started:
        with (
            _without_interrupts(),
            dask.config.set(
                {
                    "distributed.nanny.pre-spawn-environ": started_with,
                    "distributed.nanny.environ": told,
                }
            ),
        ):
            cluster = started.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    host="127.0.0.1",
                    dashboard_address=_NO_DASHBOARD,
                    worker_dashboard_address=_NO_DASHBOARD,
                    silence_logs=logging.CRITICAL,
                )
            )
            client = started.enter_context(Client(cluster))
            client.register_plugin(_quiet_libraries())
        try:
            yield client
        finally:
            with _without_interrupts():
                started.close()
            for name in started_with.keys() - before.keys():
                os.environ.pop(name, None)
            os.environ.update(before)


def _quiet_libraries() -> Any:
    """Return what keeps workers from writing to this program's standard error, also new ones."""
    from distributed import WorkerPlugin

    class QuietLibraries(WorkerPlugin):
        name = "napari-defocus-quiet-libraries"

        def setup(self, worker: Any) -> None:
            import logging
            import warnings

            warnings.simplefilter("ignore")
            for library in ("tifffile", "PIL"):
                logging.getLogger(library).addHandler(logging.NullHandler())

    return QuietLibraries()


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let Ctrl-C wait in this process, and never reach processes that are started meanwhile.

    A terminal sends it to workers, too, but this process ends them. dask would not clean up if it
    was interrupted while it starts or ends them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Started with the first process, it would let interrupts through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _client_of(address: str) -> Iterator[Client]:
    from distributed import Client

    try:
        # A client that finds nobody would go on trying when the program ends.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, _knock(address)).result()
        client = Client(address, timeout=ANSWERS_WITHIN)
    except OSError as error:
        raise ConnectionError(
            f"no dask scheduler answers at {address} within {ANSWERS_WITHIN} s"
        ) from error
    # A text that is no address is found out in several ways.
    except Exception as error:
        raise ValueError(
            f"scheduler is {address!r}; it takes the address of a dask scheduler, such as "
            f"tcp://10.0.0.5:8786 ({error})"
        ) from error
    with client:
        _need_worker(client, address)
        yield client


async def _knock(address: str) -> None:
    """Raise OSError if nobody at an address speaks dask's language."""
    from distributed.comm import connect

    await (await connect(address, timeout=ANSWERS_WITHIN)).close()


def _need_worker(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=HAS_WORKER_WITHIN)
    except TimeoutError as error:
        raise ConnectionError(f"the dask scheduler at {address} has no workers") from error


@contextmanager
def _quiet_logs() -> Iterator[None]:
    """Leave standard error to this program: workers that end are seen in the results."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
