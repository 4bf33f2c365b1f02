"""Warm workers: how many, for whom, and that none survives."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.pool import Pool
from envcraft.sandbox import Availability, Driver, Isolation, Limits, Worker

from .test_lanes import StubWorker

LIMITS = Limits()
_SOON = 120.0


class StubDriver(Driver):
    name = "stub"
    isolation = Isolation.PROCESS
    rank = 1

    def __init__(self) -> None:
        self.workers: list[StubWorker] = []
        self.begun = 0
        self.nurses = False
        self.nurseries: list[Nursery] = []
        self.room = threading.Event()
        self.room.set()

    def probe(self) -> Availability:
        return Availability(True)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        self.begun += 1
        assert self.room.wait(_SOON)
        self.workers.append(StubWorker(hash_seed))
        return self.workers[-1]

    def nursery(self) -> Driver:
        self.nurseries.append(Nursery())
        return self.nurseries[-1] if self.nurses else self

    @property
    def seeds(self) -> list[int]:
        return sorted(worker.hash_seed for worker in self.workers)


class Nursery(StubDriver):
    """Where the workers come from that may be alike."""

    closed = False

    def close(self) -> None:
        assert all(worker.ended.is_set() for worker in self.workers)
        self.closed = True


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + _SOON
    while not holds():
        assert time.monotonic() < deadline, "it never came to it"
        time.sleep(0.001)


def settled(driver: StubDriver, seeds: list[int]) -> None:
    """Wait for the launches that there should be, and see that there are no more."""
    until(lambda: len(driver.workers) >= len(seeds))
    time.sleep(0.05)
    assert driver.seeds == seeds


def test_few_are_kept_warm() -> None:
    driver = StubDriver()
    with Pool(driver, LIMITS, subjects=50):
        settled(driver, [0, 0, 0])
    assert all(worker.ended.is_set() for worker in driver.workers)


def test_no_more_than_the_subjects_to_come_will_want() -> None:
    driver = StubDriver()
    with Pool(driver, LIMITS, subjects=2) as pool:
        settled(driver, [0, 0])
        for _ in range(2):
            with pool.turn() as turn:
                turn.sibling(hash_seed=0, limits=LIMITS)
        settled(driver, [0, 0])


def test_a_warm_worker_is_handed_out_once_and_further_ones_are_launched() -> None:
    driver = StubDriver()
    with Pool(driver, LIMITS, subjects=1) as pool:
        settled(driver, [0])
        with pool.turn() as turn:
            taken = [turn.sibling(hash_seed=0, limits=LIMITS) for _ in range(3)]
    assert taken[0] is driver.workers[0]
    assert len(set(taken)) == 3
    assert len(driver.workers) == 3


def test_a_subject_says_what_it_expects() -> None:
    driver = StubDriver()
    with Pool(driver, LIMITS, subjects=1) as pool, pool.turn() as turn:
        first = turn.sibling(hash_seed=0, limits=LIMITS)
        settled(driver, [0])
        turn.expect([7])
        settled(driver, [0, 7])
        assert turn.sibling(hash_seed=7, limits=LIMITS) is driver.workers[1]
        assert turn.sibling(hash_seed=7, limits=LIMITS) is driver.workers[2]
        assert first is driver.workers[0]


def test_for_several_subjects_workers_come_from_the_nursery_but_for_fresh_ones() -> None:
    driver = StubDriver()
    driver.nurses = True
    with Pool(driver, LIMITS, subjects=2) as pool, pool.turn() as turn:
        (nursery,) = driver.nurseries
        turn.expect([7])
        settled(nursery, [0, 0, 7])
        for hash_seed in (0, 7):
            assert turn.sibling(hash_seed=hash_seed, limits=LIMITS) in nursery.workers
        # A second lane's, and one in place of a worker that was lost.
        assert turn.sibling(hash_seed=0, limits=LIMITS) in nursery.workers
        assert [turn.launch(hash_seed=seed, limits=LIMITS) for seed in (0, 7)] == driver.workers
        assert not nursery.closed
    assert nursery.closed


def test_one_subject_needs_no_nursery() -> None:
    driver = StubDriver()
    with Pool(driver, LIMITS, subjects=1):
        settled(driver, [0])
    assert driver.nurseries == []


def test_a_fresh_worker_is_none_of_those_that_were_launched_ahead() -> None:
    driver = StubDriver()
    with Pool(driver, LIMITS, subjects=1) as pool, pool.turn() as turn:
        settled(driver, [0])
        assert turn.launch(hash_seed=0, limits=LIMITS) is driver.workers[1]
        assert turn.sibling(hash_seed=0, limits=LIMITS) is driver.workers[0]


def test_what_a_subject_expected_and_never_took_is_ended_with_its_turn() -> None:
    driver = StubDriver()
    with Pool(driver, LIMITS, subjects=2) as pool:
        with pool.turn() as turn:
            turn.sibling(hash_seed=0, limits=LIMITS)
            turn.expect([7])
            settled(driver, [0, 0, 7])
        (other,) = (worker for worker in driver.workers if worker.hash_seed == 7)
        assert other.ended.is_set()
        # The next subject's is still warm.
        assert sum(not worker.ended.is_set() for worker in driver.workers if worker.hash_seed == 0) == 2
        with pool.turn():
            pass
        assert all(worker.ended.is_set() for worker in driver.workers[1:])


def test_one_that_is_not_under_way_yet_is_not_waited_for() -> None:
    driver = StubDriver()
    driver.room.clear()
    with Pool(driver, LIMITS, subjects=3) as pool:
        taken: list[Worker] = []

        def take() -> None:
            with pool.turn() as turn:
                taken.append(turn.sibling(hash_seed=0, limits=LIMITS))

        threads = [threading.Thread(target=take) for _ in range(3)]
        for thread in threads:
            thread.start()
        driver.room.set()
        for thread in threads:
            thread.join(_SOON)
        assert len(set(taken)) == 3
        settled(driver, [0, 0, 0])


def test_a_launch_that_fails_is_told_to_who_wants_the_worker() -> None:
    class Broken(StubDriver):
        def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
            raise SandboxUnavailable("no room")

    with Pool(Broken(), LIMITS, subjects=2) as pool:
        for _ in range(2):
            with pool.turn() as turn, pytest.raises(SandboxUnavailable, match="no room"):
                turn.sibling(hash_seed=0, limits=LIMITS)


def test_nothing_is_launched_after_the_end() -> None:
    pool = Pool(StubDriver(), LIMITS)
    with pool.turn() as turn:
        pool.end()
        for driver in (pool, turn):
            with pytest.raises(WorkerLost):
                driver.launch(hash_seed=0, limits=LIMITS)


def test_an_interruption_ends_warm_workers_those_in_use_and_those_on_the_way() -> None:
    driver = StubDriver()
    in_use: list[Worker] = []

    def judge() -> None:
        with Pool(driver, LIMITS, subjects=9) as pool, pool.turn() as turn:
            in_use.append(turn.sibling(hash_seed=0, limits=LIMITS))
            until(lambda: len(driver.workers) == 4)
            driver.room.clear()
            pool.take(0)
            until(lambda: driver.begun == 5)
            threading.Timer(0.1, driver.room.set).start()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        judge()
    assert in_use
    assert len(driver.workers) == 5
    assert all(worker.ended.is_set() for worker in driver.workers)
