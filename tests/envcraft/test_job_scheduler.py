"""Parallel jobs: which worker serves which job, and what remains at the end."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from envcraft_protocol.jobs import Job

from envcraft.errors import WorkerLost
from envcraft.judging.driver import Limits, Player, Recorder, Worker
from envcraft.judging.job_scheduler import JobScheduler, Placement, Task
from envcraft.model.job import JobResult

_SOON = 20.0


class StubWorker(Worker):
    def __init__(self, hash_seed: int) -> None:
        self.about = {}
        self.hash_seed = hash_seed
        self.ended = threading.Event()

    def preload(self, modules: list[str]) -> list[str]:
        return modules

    def find(self, modules: list[str]) -> tuple[list[str], list[str]]:
        return [], []

    def run(self, job: Job, recorder: Recorder, limits: Limits, player: Player | None = None) -> JobResult:
        raise NotImplementedError

    def close(self) -> None:
        self.ended.set()


class Launched(list[StubWorker]):
    """Launches workers, and remembers them."""

    def __call__(self, placement: Placement) -> StubWorker:
        self.append(StubWorker(placement.hash_seed))
        return self[-1]


@contextmanager
def scheduler_of(count: int, launch: Callable[[Placement], Worker]) -> Iterator[JobScheduler]:
    scheduler = JobScheduler(launch, count)
    try:
        yield scheduler
    finally:
        scheduler.close()


def itself(worker: Worker) -> Worker:
    return worker


def noting(ran: list[int], number: int) -> Callable[[Worker], None]:
    return lambda worker: ran.append(number)


def held(scheduler: JobScheduler, count: int) -> tuple[threading.Event, list[Task]]:
    """Keep `count` threads busy until the event is set."""
    go, begun = threading.Event(), threading.Barrier(count + 1)

    def work(worker: Worker) -> None:
        begun.wait(_SOON)
        assert go.wait(_SOON)

    tasks = [scheduler.submit(Placement(), work) for _ in range(count)]
    begun.wait(_SOON)
    return go, tasks


def test_each_thread_runs_a_job_in_a_worker_of_its_own() -> None:
    launched = Launched()
    meeting = threading.Barrier(3, timeout=_SOON)

    def meet(worker: Worker) -> Worker:
        meeting.wait()
        return worker

    with scheduler_of(3, launched) as scheduler:
        tasks = [scheduler.submit(Placement(), meet) for _ in range(6)]
        served = [scheduler.wait(task) for task in tasks]
    assert len(launched) == 3
    assert set(served) == set(launched)
    assert all(worker.ended.is_set() for worker in launched)


def test_one_lane_runs_one_at_a_time_in_order() -> None:
    ran: list[int] = []
    with scheduler_of(1, Launched()) as scheduler:
        tasks = [scheduler.submit(Placement(), noting(ran, n)) for n in range(20)]
        for task in tasks:
            scheduler.wait(task)
    assert ran == list(range(20))


def test_sequential_jobs_use_one_worker() -> None:
    launched = Launched()
    with scheduler_of(4, launched) as scheduler:
        for _ in range(200):
            scheduler.wait(scheduler.submit(Placement(), itself))
    assert len(launched) == 1


def test_awaited_job_runs_next() -> None:
    ran: list[int] = []
    with scheduler_of(1, Launched()) as scheduler:
        go, _ = held(scheduler, 1)
        tasks = [scheduler.submit(Placement(), noting(ran, n)) for n in range(5)]
        waiter = threading.Thread(target=scheduler.wait, args=(tasks[3],))
        waiter.start()
        while scheduler._queue[0] is not tasks[3]:
            pass
        go.set()
        waiter.join(_SOON)
        scheduler.wait(tasks[4])
    assert ran[0] == 3


def test_a_dropped_job_never_begins() -> None:
    ran: list[str] = []
    with scheduler_of(1, Launched()) as scheduler:
        go, (running,) = held(scheduler, 1)
        waiting = scheduler.submit(Placement(), lambda worker: ran.append("dropped"))
        assert not scheduler.cancel(running)
        assert scheduler.cancel(waiting)
        go.set()
        scheduler.wait(scheduler.submit(Placement(), lambda worker: ran.append("last")))
    assert ran == ["last"]


def test_jobs_with_one_home_share_a_worker() -> None:
    with scheduler_of(3, Launched()) as scheduler:
        tasks = [scheduler.submit(Placement(group=bytes([n % 5])), itself) for n in range(200)]
        served = [scheduler.wait(task) for task in tasks]
    for home in range(5):
        assert len(set(served[home::5])) == 1


def test_jobs_apart_share_one_worker_for_each_hash_seed_and_never_an_ordinary_one() -> None:
    launched = Launched()
    with scheduler_of(3, launched) as scheduler:
        ordinary = [scheduler.submit(Placement(), itself) for _ in range(50)]
        apart = [scheduler.submit(Placement(hash_seed, separate=True), itself) for hash_seed in (0, 7) * 25]
        usual = {scheduler.wait(task) for task in ordinary}
        served = [scheduler.wait(task) for task in apart]
    assert len(set(served)) == 2
    assert [worker.hash_seed for worker in served] == [0, 7] * 25
    assert not usual & set(served)


def test_a_worker_of_its_own_ends_with_the_job() -> None:
    launched = Launched()
    with scheduler_of(2, launched) as scheduler:
        usual = scheduler.wait(scheduler.submit(Placement(), itself))
        own = [scheduler.wait(scheduler.submit(Placement(own=True), itself)) for _ in range(3)]
        assert len({usual, *own}) == 4
        assert all(worker.ended.is_set() for worker in own)
        assert not usual.ended.is_set()


@pytest.mark.parametrize("placement", [Placement(), Placement(7, separate=True), Placement(own=True)])
def test_a_lost_worker_raises_where_the_job_is_waited_for_and_is_replaced(placement: Placement) -> None:
    launched = Launched()

    def lose(worker: Worker) -> None:
        raise WorkerLost("gone")

    with scheduler_of(1, launched) as scheduler:
        lost = scheduler.submit(placement, lose)
        assert isinstance(lost.future.exception(_SOON), WorkerLost)
        assert launched[0].ended.is_set()
        assert scheduler.wait(scheduler.submit(placement, itself)) is launched[1]
        with pytest.raises(WorkerLost, match="gone"):
            scheduler.wait(lost)


def test_a_launch_that_fails_is_the_job_s_failure_only() -> None:
    launched = Launched()
    failures = iter([True, False])

    def launch(placement: Placement) -> Worker:
        if next(failures):
            raise WorkerLost("no room")
        return launched(placement)

    with scheduler_of(1, launch) as scheduler:
        with pytest.raises(WorkerLost, match="no room"):
            scheduler.wait(scheduler.submit(Placement(), itself))
        assert scheduler.wait(scheduler.submit(Placement(), itself)) is launched[0]


@pytest.mark.parametrize("placement", [Placement(), Placement(7, separate=True), Placement(own=True)])
def test_closing_ends_the_job_that_runs_and_all_that_wait(placement: Placement) -> None:
    launched = Launched()
    begun = threading.Event()

    def hang(worker: Worker) -> None:
        assert isinstance(worker, StubWorker)
        begun.set()
        assert worker.ended.wait(_SOON)
        raise WorkerLost("hung up")

    before = threading.active_count()
    scheduler = JobScheduler(launched, 1)
    running, waiting = scheduler.submit(placement, hang), scheduler.submit(placement, itself)
    assert begun.wait(_SOON)
    scheduler.close()
    assert threading.active_count() == before
    assert all(worker.ended.is_set() for worker in launched)
    for task in (running, waiting):
        with pytest.raises(WorkerLost):
            task.future.result(0)
    with pytest.raises(WorkerLost):
        scheduler.submit(placement, itself)


def test_a_worker_that_is_launched_while_the_lanes_close_is_ended() -> None:
    launched = Launched()
    launching, go = threading.Event(), threading.Event()

    def launch(placement: Placement) -> Worker:
        launching.set()
        assert go.wait(_SOON)
        return launched(placement)

    scheduler = JobScheduler(launch, 1)
    task = scheduler.submit(Placement(), itself)
    assert launching.wait(_SOON)
    closer = threading.Thread(target=scheduler.close)
    closer.start()
    go.set()
    closer.join(_SOON)
    assert not closer.is_alive()
    assert all(worker.ended.is_set() for worker in launched)
    # It either came before the end or after it, and hangs in neither case.
    assert task.future.done()
