"""Jobs side by side: which worker serves which, and what is left when it ends."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from envcraft.errors import WorkerLost
from envcraft.lanes import Lanes, Place, Task
from envcraft.sandbox import JobEnd, Limits, Player, Recorder, Worker

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

    def run(self, job: dict[str, Any], recorder: Recorder, limits: Limits, player: Player | None = None) -> JobEnd:
        raise NotImplementedError

    def close(self) -> None:
        self.ended.set()


class Launched(list[StubWorker]):
    """Launches workers, and remembers them."""

    def __call__(self, place: Place) -> StubWorker:
        self.append(StubWorker(place.hash_seed))
        return self[-1]


@contextmanager
def lanes_of(count: int, launch: Callable[[Place], Worker]) -> Iterator[Lanes]:
    lanes = Lanes(launch, count)
    try:
        yield lanes
    finally:
        lanes.close()


def itself(worker: Worker) -> Worker:
    return worker


def noting(ran: list[int], number: int) -> Callable[[Worker], None]:
    return lambda worker: ran.append(number)


def held(lanes: Lanes, count: int) -> tuple[threading.Event, list[Task]]:
    """Keep `count` lanes busy until the event is set."""
    go, begun = threading.Event(), threading.Barrier(count + 1)

    def work(worker: Worker) -> None:
        begun.wait(_SOON)
        assert go.wait(_SOON)

    tasks = [lanes.submit(Place(), work) for _ in range(count)]
    begun.wait(_SOON)
    return go, tasks


def test_as_many_jobs_as_lanes_run_side_by_side_each_in_a_worker_of_its_own() -> None:
    launched = Launched()
    meeting = threading.Barrier(3, timeout=_SOON)

    def meet(worker: Worker) -> Worker:
        meeting.wait()
        return worker

    with lanes_of(3, launched) as lanes:
        tasks = [lanes.submit(Place(), meet) for _ in range(6)]
        served = [lanes.wait(task) for task in tasks]
    assert len(launched) == 3
    assert set(served) == set(launched)
    assert all(worker.ended.is_set() for worker in launched)


def test_one_lane_runs_one_at_a_time_in_order() -> None:
    ran: list[int] = []
    with lanes_of(1, Launched()) as lanes:
        tasks = [lanes.submit(Place(), noting(ran, n)) for n in range(20)]
        for task in tasks:
            lanes.wait(task)
    assert ran == list(range(20))


def test_no_other_lane_is_begun_for_jobs_that_are_asked_for_one_by_one() -> None:
    launched = Launched()
    with lanes_of(4, launched) as lanes:
        for _ in range(200):
            lanes.wait(lanes.submit(Place(), itself))
    assert len(launched) == 1


def test_what_is_waited_for_is_next() -> None:
    ran: list[int] = []
    with lanes_of(1, Launched()) as lanes:
        go, _ = held(lanes, 1)
        tasks = [lanes.submit(Place(), noting(ran, n)) for n in range(5)]
        waiter = threading.Thread(target=lanes.wait, args=(tasks[3],))
        waiter.start()
        while lanes._queue[0] is not tasks[3]:
            pass
        go.set()
        waiter.join(_SOON)
        lanes.wait(tasks[4])
    assert ran[0] == 3


def test_a_dropped_job_never_begins() -> None:
    ran: list[str] = []
    with lanes_of(1, Launched()) as lanes:
        go, (running,) = held(lanes, 1)
        waiting = lanes.submit(Place(), lambda worker: ran.append("dropped"))
        assert not lanes.drop(running)
        assert lanes.drop(waiting)
        go.set()
        lanes.wait(lanes.submit(Place(), lambda worker: ran.append("last")))
    assert ran == ["last"]


def test_jobs_with_one_home_share_a_worker() -> None:
    with lanes_of(3, Launched()) as lanes:
        tasks = [lanes.submit(Place(home=bytes([n % 5])), itself) for n in range(200)]
        served = [lanes.wait(task) for task in tasks]
    for home in range(5):
        assert len(set(served[home::5])) == 1


def test_jobs_apart_share_one_worker_for_each_hash_seed_and_never_an_ordinary_one() -> None:
    launched = Launched()
    with lanes_of(3, launched) as lanes:
        ordinary = [lanes.submit(Place(), itself) for _ in range(50)]
        apart = [lanes.submit(Place(hash_seed, apart=True), itself) for hash_seed in (0, 7) * 25]
        usual = {lanes.wait(task) for task in ordinary}
        served = [lanes.wait(task) for task in apart]
    assert len(set(served)) == 2
    assert [worker.hash_seed for worker in served] == [0, 7] * 25
    assert not usual & set(served)


def test_a_worker_of_its_own_ends_with_the_job() -> None:
    launched = Launched()
    with lanes_of(2, launched) as lanes:
        usual = lanes.wait(lanes.submit(Place(), itself))
        own = [lanes.wait(lanes.submit(Place(own=True), itself)) for _ in range(3)]
        assert len({usual, *own}) == 4
        assert all(worker.ended.is_set() for worker in own)
        assert not usual.ended.is_set()


@pytest.mark.parametrize("place", [Place(), Place(7, apart=True), Place(own=True)])
def test_a_lost_worker_is_told_to_who_waits_and_is_replaced(place: Place) -> None:
    launched = Launched()

    def lose(worker: Worker) -> None:
        raise WorkerLost("gone")

    with lanes_of(1, launched) as lanes:
        lost = lanes.submit(place, lose)
        assert isinstance(lost.future.exception(_SOON), WorkerLost)
        assert launched[0].ended.is_set()
        assert lanes.wait(lanes.submit(place, itself)) is launched[1]
        with pytest.raises(WorkerLost, match="gone"):
            lanes.wait(lost)


def test_a_launch_that_fails_is_the_job_s_failure_only() -> None:
    launched = Launched()
    failures = iter([True, False])

    def launch(place: Place) -> Worker:
        if next(failures):
            raise WorkerLost("no room")
        return launched(place)

    with lanes_of(1, launch) as lanes:
        with pytest.raises(WorkerLost, match="no room"):
            lanes.wait(lanes.submit(Place(), itself))
        assert lanes.wait(lanes.submit(Place(), itself)) is launched[0]


@pytest.mark.parametrize("place", [Place(), Place(7, apart=True), Place(own=True)])
def test_closing_ends_the_job_that_runs_and_all_that_wait(place: Place) -> None:
    launched = Launched()
    begun = threading.Event()

    def hang(worker: Worker) -> None:
        assert isinstance(worker, StubWorker)
        begun.set()
        assert worker.ended.wait(_SOON)
        raise WorkerLost("hung up")

    before = threading.active_count()
    lanes = Lanes(launched, 1)
    running, waiting = lanes.submit(place, hang), lanes.submit(place, itself)
    assert begun.wait(_SOON)
    lanes.close()
    assert threading.active_count() == before
    assert all(worker.ended.is_set() for worker in launched)
    for task in (running, waiting):
        with pytest.raises(WorkerLost):
            task.future.result(0)
    with pytest.raises(WorkerLost):
        lanes.submit(place, itself)


def test_a_worker_that_is_launched_while_the_lanes_close_is_ended() -> None:
    launched = Launched()
    launching, go = threading.Event(), threading.Event()

    def launch(place: Place) -> Worker:
        launching.set()
        assert go.wait(_SOON)
        return launched(place)

    lanes = Lanes(launch, 1)
    task = lanes.submit(Place(), itself)
    assert launching.wait(_SOON)
    closer = threading.Thread(target=lanes.close)
    closer.start()
    go.set()
    closer.join(_SOON)
    assert not closer.is_alive()
    assert all(worker.ended.is_set() for worker in launched)
    # It either came before the end or after it, and hangs in neither case.
    assert task.future.done()
