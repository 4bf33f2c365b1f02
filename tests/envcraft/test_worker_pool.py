"""How many workers the pool starts ahead, who gets them, and that all of them end."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Worker
from envcraft.judging.worker_pool import WorkerPool

from .test_job_scheduler import StubWorker

LIMITS = Limits()
_SOON = 120.0


class StubDriver(Driver):
    name = "stub"
    isolation = Isolation.PROCESS
    rank = 1

    def __init__(self) -> None:
        self.workers: list[StubWorker] = []
        self.started = 0
        self.shares = False
        self.shared: list[SharedLayout] = []
        self.room = threading.Event()
        self.room.set()

    def probe(self) -> Availability:
        return Availability(True)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        self.started += 1
        assert self.room.wait(_SOON)
        self.workers.append(StubWorker(hash_seed))
        return self.workers[-1]

    def shared_layout(self) -> Driver:
        self.shared.append(SharedLayout())
        return self.shared[-1] if self.shares else self

    @property
    def seeds(self) -> list[int]:
        return sorted(worker.hash_seed for worker in self.workers)


class SharedLayout(StubDriver):
    """The driver whose workers may share their memory layout."""

    closed = False

    def close(self) -> None:
        assert all(worker.ended.is_set() for worker in self.workers)
        self.closed = True


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + _SOON
    while not holds():
        assert time.monotonic() < deadline, "the condition does not hold in time"
        time.sleep(0.001)


def settled(driver: StubDriver, seeds: list[int]) -> None:
    """Wait until the driver has launched workers with these hash seeds, and check that it launches no more."""
    until(lambda: len(driver.workers) >= len(seeds))
    time.sleep(0.05)
    assert driver.seeds == seeds


def test_the_pool_keeps_few_workers_warm() -> None:
    driver = StubDriver()
    with WorkerPool(driver, LIMITS, subjects=50):
        settled(driver, [0, 0, 0])
    assert all(worker.ended.is_set() for worker in driver.workers)


def test_the_pool_starts_no_more_workers_than_there_are_subjects() -> None:
    driver = StubDriver()
    with WorkerPool(driver, LIMITS, subjects=2) as pool:
        settled(driver, [0, 0])
        for _ in range(2):
            with pool.lease() as lease:
                lease.launch(0)
        settled(driver, [0, 0])


def test_a_warm_worker_is_handed_out_once_and_further_ones_are_launched() -> None:
    driver = StubDriver()
    with WorkerPool(driver, LIMITS, subjects=1) as pool:
        settled(driver, [0])
        with pool.lease() as lease:
            taken = [lease.launch(0) for _ in range(3)]
    assert taken[0] is driver.workers[0]
    assert len(set(taken)) == 3
    assert len(driver.workers) == 3


def test_a_lease_reserves_workers_by_hash_seed() -> None:
    driver = StubDriver()
    with WorkerPool(driver, LIMITS, subjects=1) as pool, pool.lease() as lease:
        first = lease.launch(0)
        settled(driver, [0])
        lease.reserve([7])
        settled(driver, [0, 7])
        assert lease.launch(7) is driver.workers[1]
        assert lease.launch(7) is driver.workers[2]
        assert first is driver.workers[0]


def test_for_several_subjects_workers_share_a_layout_except_fresh_ones() -> None:
    driver = StubDriver()
    driver.shares = True
    with WorkerPool(driver, LIMITS, subjects=2) as pool, pool.lease() as lease:
        (shared,) = driver.shared
        lease.reserve([7])
        settled(shared, [0, 0, 7])
        for hash_seed in (0, 7):
            assert lease.launch(hash_seed) in shared.workers
        # The worker of a second thread, or one in place of a lost worker.
        assert lease.launch(0) in shared.workers
        assert [lease.launch(seed, fresh=True) for seed in (0, 7)] == driver.workers
        assert not shared.closed
    assert shared.closed


def test_one_subject_needs_no_shared_layout() -> None:
    driver = StubDriver()
    with WorkerPool(driver, LIMITS, subjects=1):
        settled(driver, [0])
    assert driver.shared == []


def test_a_fresh_worker_is_not_one_that_was_started_ahead() -> None:
    driver = StubDriver()
    with WorkerPool(driver, LIMITS, subjects=1) as pool, pool.lease() as lease:
        settled(driver, [0])
        assert lease.launch(0, fresh=True) is driver.workers[1]
        assert lease.launch(0) is driver.workers[0]


def test_workers_that_were_reserved_and_never_taken_end_with_the_lease() -> None:
    driver = StubDriver()
    with WorkerPool(driver, LIMITS, subjects=2) as pool:
        with pool.lease() as lease:
            lease.launch(0)
            lease.reserve([7])
            settled(driver, [0, 0, 7])
        (other,) = (worker for worker in driver.workers if worker.hash_seed == 7)
        assert other.ended.is_set()
        # The next subject's is still warm.
        assert sum(not worker.ended.is_set() for worker in driver.workers if worker.hash_seed == 0) == 2
        with pool.lease():
            pass
        assert all(worker.ended.is_set() for worker in driver.workers[1:])


def test_a_worker_whose_start_is_queued_is_launched_at_once() -> None:
    driver = StubDriver()
    driver.room.clear()
    with WorkerPool(driver, LIMITS, subjects=3) as pool:
        taken: list[Worker] = []

        def take() -> None:
            with pool.lease() as lease:
                taken.append(lease.launch(0))

        threads = [threading.Thread(target=take) for _ in range(3)]
        for thread in threads:
            thread.start()
        driver.room.set()
        for thread in threads:
            thread.join(_SOON)
        assert len(set(taken)) == 3
        settled(driver, [0, 0, 0])


def test_a_failed_launch_raises_where_the_worker_is_taken() -> None:
    class Broken(StubDriver):
        def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
            raise SandboxUnavailable("no room")

    with WorkerPool(Broken(), LIMITS, subjects=2) as pool:
        for _ in range(2):
            with pool.lease() as lease, pytest.raises(SandboxUnavailable, match="no room"):
                lease.launch(0)


def test_a_driver_is_probed_once() -> None:
    class Counted(StubDriver):
        probes = 0

        def probe(self) -> Availability:
            self.probes += 1
            return Availability(self.probes == 1, "it broke", "mend it")

    driver = Counted()
    with WorkerPool(driver, LIMITS, subjects=1) as pool:
        pool.ensure()
        pool.ensure()
    assert driver.probes == 1


def test_nothing_is_launched_after_the_end() -> None:
    pool = WorkerPool(StubDriver(), LIMITS)
    with pool.lease() as lease:
        pool.close()
        for fresh in (False, True):
            with pytest.raises(WorkerLost):
                lease.launch(0, fresh)


def test_an_interruption_ends_warm_workers_those_in_use_and_those_that_start() -> None:
    driver = StubDriver()
    in_use: list[Worker] = []

    def judge() -> None:
        with WorkerPool(driver, LIMITS, subjects=9) as pool, pool.lease() as lease:
            in_use.append(lease.launch(0))
            until(lambda: len(driver.workers) == 4)
            driver.room.clear()
            pool.take(0)
            until(lambda: driver.started == 5)
            threading.Timer(0.1, driver.room.set).start()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        judge()
    assert in_use
    assert len(driver.workers) == 5
    assert all(worker.ended.is_set() for worker in driver.workers)
