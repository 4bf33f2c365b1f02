"""The workers of a run: started before subjects need them, leased to one subject at a time, ended in one call.

Each worker serves one subject and is destroyed. Workers that are started ahead start in one thread that lives as long
as the pool, because some sandboxes end with the thread that started them.
"""

from __future__ import annotations

import contextlib
import threading
import weakref
from collections import Counter
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.judging.driver import Driver, Limits, Worker, ensure

if TYPE_CHECKING:
    from concurrent.futures import Future

#: The most workers that are idle, or starting, at a time.
_WARM = 3


class WorkerPool:
    """The workers of one run.

    The pool starts one worker ahead for each subject, and those that leases reserve, a few at a time. For several
    subjects they share their memory layout where the driver can do that, because they start faster then. Use it as a
    context manager, or close it.

    Args:
        driver: launches the workers. The pool does not close it.
        limits: what each job may use.
        subjects: how many subjects will be judged; 0 starts no worker ahead.

    Attributes:
        closed: no worker is launched any more.
    """

    def __init__(self, driver: Driver, limits: Limits | None = None, subjects: int = 0) -> None:
        self.driver = driver
        self.limits = limits or Limits()
        self.closed = False
        self._shared = driver.shared_layout() if subjects >= driver.shares_from else driver
        self._reserved = Counter({0: subjects})
        self._warm: list[tuple[int, Future[Worker]]] = []
        self._workers: weakref.WeakSet[Worker] = weakref.WeakSet()
        self._lock = threading.Lock()
        first = self._start_first() if subjects else None
        # Slow to import: the first worker is starting by now.
        from concurrent.futures import ThreadPoolExecutor

        self._background = ThreadPoolExecutor(1, "envcraft-pool")
        if first is not None:
            self._warm.append((0, self._background.submit(self._wait_for, first)))
        self._restock()

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def ensure(self) -> None:
        """Wait until the first worker has started or failed, after which a driver knows without a trial whether it
        works.

        Raises:
            SandboxUnavailable: the driver does not work here; the message has the reason and the next step.
        """
        for _, starting in self._warm[:1]:
            starting.exception()
        ensure(self.driver)

    def lease(self, ahead: bool = True) -> Lease:
        """The workers of the next subject. Release the lease, or use it as a context manager.

        Args:
            ahead: its first worker is one that was started ahead.
        """
        return Lease(self, ahead)

    def close(self) -> None:
        """End every worker, whichever thread it serves, and launch no more. May be called twice."""
        with self._lock:
            self.closed = True
            workers = list(self._workers)
            for _, starting in self._warm:
                starting.cancel()
        for worker in workers:
            worker.close()
        # A worker that is still starting closes itself.
        self._background.shutdown()
        if self._shared is not self.driver:
            self._shared.close()

    # What leases call

    def launch(self, hash_seed: int, fresh: bool = False) -> Worker:
        """Launch a worker in this thread: with `fresh` one that shares its memory layout with no other.

        Raises:
            SandboxUnavailable: the driver cannot launch it.
            WorkerLost: the pool is closed.
        """
        if self.closed:
            raise _closed()
        driver = self.driver if fresh else self._shared
        return self._wait_for(driver.start(hash_seed=hash_seed, limits=self.limits))

    def take(self, hash_seed: int) -> Worker:
        """Hand out a worker that was started ahead; launch it here if its start is still queued. Raises as
        :meth:`launch` does.
        """
        with self._lock:
            self._reserved[hash_seed] -= 1
            ahead = next((item for item in self._warm if item[0] == hash_seed), None)
            if ahead is not None:
                self._warm.remove(ahead)
        try:
            if ahead is None or ahead[1].cancel():
                return self.launch(hash_seed)
            return ahead[1].result()
        finally:
            self._restock()

    def reserve(self, hash_seeds: Iterable[int]) -> None:
        """Start workers with these hash seeds ahead, too."""
        with self._lock:
            self._reserved.update(hash_seeds)
        self._restock()

    def release(self, hash_seeds: Iterable[int]) -> None:
        """End workers with these hash seeds that no other subject reserved."""
        unneeded: list[Future[Worker]] = []
        with self._lock:
            for seed in hash_seeds:
                self._reserved[seed] -= 1
                of_seed = [item for item in self._warm if item[0] == seed]
                for item in of_seed[max(self._reserved[seed], 0) :]:
                    self._warm.remove(item)
                    unneeded.append(item[1])
        for starting in unneeded:
            if not starting.cancel():
                with contextlib.suppress(Exception):
                    starting.result().close()

    def _start_first(self) -> Callable[[], Worker] | None:
        """Start the first worker from this thread, which is about to import what the judging needs: another thread
        would wait for that.
        """
        try:
            return self._shared.start(hash_seed=0, limits=self.limits)
        except SandboxUnavailable:
            # Launching it again raises this where the worker is taken.
            return None

    def _wait_for(self, started: Callable[[], Worker]) -> Worker:
        worker = started()
        with self._lock:
            self._workers.add(worker)
        if self.closed:
            worker.close()
            raise _closed()
        return worker

    def _restock(self) -> None:
        with self._lock:
            while len(self._warm) < _WARM and not self.closed:
                stock = Counter(seed for seed, _ in self._warm)
                lacking = [seed for seed, reserved in self._reserved.items() if stock[seed] < reserved]
                if not lacking:
                    return
                seed = min(lacking, key=stock.__getitem__)
                self._warm.append((seed, self._background.submit(self.launch, seed)))


class Lease:
    """The workers of one subject: the first ordinary one, and one for each hash seed that it reserves, are started
    ahead.

    Args:
        pool: launches the workers.
        ahead: whether the pool was told to start the first one ahead.

    Attributes:
        reserved: the hash seeds of the workers that it has not taken yet.
    """

    def __init__(self, pool: WorkerPool, ahead: bool = True) -> None:
        self.pool = pool
        self.reserved: set[int] = {0} if ahead else set()

    def __enter__(self) -> Lease:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def reserve(self, hash_seeds: Iterable[int]) -> None:
        """Have workers with these hash seeds started ahead, because the subject is nearly sure to need them."""
        more = set(hash_seeds) - self.reserved
        self.reserved |= more
        self.pool.reserve(more)

    def launch(self, hash_seed: int, fresh: bool = False) -> Worker:
        """Launch a worker with this PYTHONHASHSEED, or take the one that was started ahead.

        Args:
            hash_seed: PYTHONHASHSEED of the worker.
            fresh: the worker shares its memory layout with no other, so it is launched now.

        Raises:
            SandboxUnavailable: the driver cannot launch it.
            WorkerLost: the pool is closed.
        """
        if fresh or hash_seed not in self.reserved:
            return self.pool.launch(hash_seed, fresh)
        self.reserved.discard(hash_seed)
        return self.pool.take(hash_seed)

    def release(self) -> None:
        """End the workers that the subject reserved and never took. May be called twice."""
        reserved, self.reserved = self.reserved, set()
        self.pool.release(reserved)


def _closed() -> WorkerLost:
    return WorkerLost("the validation was ended")
