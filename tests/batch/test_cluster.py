"""Workers: processes of this machine's own, or of a scheduler that is given."""

import os
import signal

import psutil
import pytest
from distributed import LocalCluster

from napari_defocus.batch import cluster
from napari_defocus.batch.cluster import (
    Job,
    cores,
    dask_client,
    in_this_process,
    outcomes,
    threads_of,
)


@pytest.fixture(scope="module")
def client():
    with dask_client(workers=2) as lent:
        yield lent


def environment(_):
    return os.environ["NUMBA_NUM_THREADS"], os.environ["OMP_NUM_THREADS"]


def doubled(number):
    return 2 * number


def failing(number):
    raise ValueError(f"no {number}")


def ending_its_worker_once(marker):
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def ending_its_worker(_):
    os.kill(os.getpid(), signal.SIGKILL)


def worked_off(client, jobs, **limits):
    waiting = iter(jobs)
    return list(outcomes(client, lambda: next(waiting, None), **limits))


def job(function, item):
    return Job.call(function, item, print)


def test_own_workers_share_the_cores_and_nobody_outside_reaches_them(client):
    assert threads_of(client) == 2
    assert client.scheduler.address.startswith("tcp://127.0.0.1:")
    share = str(max(1, cores() // 2))
    assert set(client.run(environment, 0).values()) == {(share, share)}
    this = psutil.Process()
    listening = [
        one.laddr.ip
        for process in (this, *this.children(recursive=True))
        for one in process.net_connections()
        if one.status == psutil.CONN_LISTEN
    ]
    assert set(listening) == {"127.0.0.1"}


def test_jobs_are_asked_for_as_workers_have_room_and_errors_are_results(client):
    numbers, asked, results = iter(range(40)), [], []

    def next_job():
        number = next(numbers, None)
        if number is None:
            return None
        asked.append(number)
        return job(failing if number == 5 else doubled, number)

    for _, result in outcomes(client, next_job):
        results.append(result)
        assert len(asked) - len(results) <= 2 * threads_of(client)
    errors = [result for result in results if isinstance(result, ValueError)]
    assert [str(error) for error in errors] == ["no 5"]
    assert sorted(set(results) - set(errors)) == [2 * n for n in range(40) if n != 5]


def test_killed_worker_costs_nothing_but_time(client, tmp_path):
    jobs = [job(ending_its_worker_once, tmp_path / "ended"), *(job(doubled, n) for n in range(6))]
    results = [result for _, result in worked_off(client, jobs)]
    assert sorted(map(str, results)) == sorted(["done", *(str(2 * n) for n in range(6))])


def test_job_that_outlives_no_worker_is_an_error(client, monkeypatch):
    monkeypatch.setattr(client.cluster.scheduler, "allowed_failures", 0)
    ((_, error),) = worked_off(client, [job(ending_its_worker, 0)])
    assert "worker processes that tried it ended" in str(error)
    client.wait_for_workers(2)


def test_given_scheduler_is_used_and_left_running(client):
    address = client.scheduler.address
    with dask_client(address) as other:
        assert other.submit(doubled, 4).result() == 8
    assert client.submit(doubled, 5).result() == 10


def test_scheduler_that_is_not_there_or_has_no_workers_is_told(monkeypatch):
    with monkeypatch.context() as impatient:
        impatient.setattr(cluster, "ANSWERS_WITHIN", 0.3)
        with pytest.raises(ConnectionError, match="no dask scheduler answers at tcp://"):
            dask_client("tcp://127.0.0.1:9").__enter__()
    monkeypatch.setattr(cluster, "HAS_WORKER_WITHIN", 0.3)
    quiet = {"processes": False, "dashboard_address": ":0", "protocol": "tcp"}
    with (
        LocalCluster(n_workers=0, **quiet) as empty,
        pytest.raises(ConnectionError, match="has no workers"),
    ):
        dask_client(empty.scheduler_address).__enter__()


@pytest.mark.parametrize(
    ("address", "workers", "saying"),
    [
        ("nonsense", None, "scheduler is 'nonsense'"),
        (None, 0, "workers is 0"),
        ("tcp://127.0.0.1:9", 2, "workers is 2, but the scheduler"),
    ],
)
def test_what_cannot_be_is_said_first(address, workers, saying):
    with pytest.raises(ValueError, match=saying):
        dask_client(address, workers=workers).__enter__()


def test_work_in_this_process_starts_no_other():
    with in_this_process() as lent:
        assert lent.submit(os.getpid).result() == os.getpid()
        assert threads_of(lent) == 1


def test_own_workers_leave_this_process_as_it_was():
    before = dict(os.environ)
    with dask_client(workers=1) as client:
        assert os.environ.get("NUMBA_NUM_THREADS") == before.get("NUMBA_NUM_THREADS")
        (found,) = client.run(environment, None).values()
        assert int(found[0]) >= 1
    assert dict(os.environ) == before
