"""Warm workers: what the next subjects will want is launched while the present ones are judged.

Each worker serves one subject and is destroyed. For several subjects they come from the driver's nursery, but for
those that must share no memory layout with others, which are launched by themselves when they are wanted. Background
launches run in one thread that lives as long as the pool, since some sandboxes end with the thread that started them.
"""

from __future__ import annotations

import contextlib
import threading
import weakref
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING

from envcraft.errors import SandboxUnavailable, WorkerLost
from envcraft.sandbox import Availability, Driver, Limits, Worker

if TYPE_CHECKING:
    from concurrent.futures import Future

#: So many workers are kept warm, or on the way, at the most.
_WARM = 3
#: For more subjects than this, workers come from the driver's nursery.
_FEW = 1


class Pool(Driver):
    """A driver that remembers its workers, so that one call ends them all, whichever thread they serve.

    It launches ahead one worker for each of `subjects`, and those that a subject says it will want; never more.
    """

    def __init__(self, driver: Driver, limits: Limits, subjects: int = 0) -> None:
        self.name, self.isolation, self.rank = driver.name, driver.isolation, driver.rank
        self.ended = False
        self._driver = driver
        self._nursery = driver.nursery() if subjects > _FEW else driver
        self._limits = limits
        self._wanted = Counter({0: subjects})
        self._warm: list[tuple[int, Future[Worker]]] = []
        self._workers: weakref.WeakSet[Worker] = weakref.WeakSet()
        self._lock = threading.Lock()
        begun = self._begin_first() if subjects else None
        # Slow to import: the first worker is on its way by now.
        from concurrent.futures import ThreadPoolExecutor

        self._background = ThreadPoolExecutor(1, "envcraft-pool")
        if begun is not None:
            self._warm.append((0, self._background.submit(self._keep, begun)))
        self._restock()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def probe(self) -> Availability:
        return self._driver.probe()

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self._launch(self._driver, hash_seed, limits)

    def sibling(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self._launch(self._nursery, hash_seed, limits)

    def _launch(self, driver: Driver, hash_seed: int, limits: Limits) -> Worker:
        if self.ended:
            raise _ended()
        return self._keep(driver.begin(hash_seed=hash_seed, limits=limits))

    def _begin_first(self) -> Callable[[], Worker] | None:
        """By this thread, which would not let another one get on while it imports what the judging needs."""
        try:
            return self._nursery.begin(hash_seed=0, limits=self._limits)
        except SandboxUnavailable:
            # Said when the worker is asked for.
            return None

    def _keep(self, begun: Callable[[], Worker]) -> Worker:
        """Wait for a worker, and remember it."""
        worker = begun()
        with self._lock:
            self._workers.add(worker)
        if self.ended:
            worker.close()
            raise _ended()
        return worker

    @contextlib.contextmanager
    def turn(self) -> Iterator[Turn]:
        """The driver of one subject, for as long as it is judged."""
        turn = Turn(self)
        try:
            yield turn
        finally:
            self._release(turn.wanted)

    def settle(self) -> None:
        """Wait until the first worker has started, or has failed to: its driver then knows without a trial."""
        for _, launched in self._warm[:1]:
            launched.exception()

    def want(self, hash_seeds: Iterable[int]) -> None:
        """Launch these ahead, too."""
        with self._lock:
            self._wanted.update(hash_seeds)
        self._restock()

    def take(self, hash_seed: int) -> Worker:
        """Hand out a worker of those that were launched ahead; one that is not under way yet is launched here."""
        with self._lock:
            self._wanted[hash_seed] -= 1
            found = next((item for item in self._warm if item[0] == hash_seed), None)
            if found is not None:
                self._warm.remove(found)
        try:
            if found is None or found[1].cancel():
                return self.sibling(hash_seed=hash_seed, limits=self._limits)
            return found[1].result()
        finally:
            self._restock()

    def end(self) -> None:
        """Close every worker, and launch no more."""
        with self._lock:
            self.ended = True
            workers = list(self._workers)
            for _, launched in self._warm:
                launched.cancel()
        for worker in workers:
            worker.close()
        # One that is being launched closes itself.
        self._background.shutdown()
        if self._nursery is not self._driver:
            self._nursery.close()

    def _restock(self) -> None:
        with self._lock:
            while len(self._warm) < _WARM and not self.ended:
                stock = Counter(seed for seed, _ in self._warm)
                lacking = [seed for seed, wanted in self._wanted.items() if stock[seed] < wanted]
                if not lacking:
                    return
                seed = min(lacking, key=stock.__getitem__)
                launched = self._background.submit(self.sibling, hash_seed=seed, limits=self._limits)
                self._warm.append((seed, launched))

    def _release(self, hash_seeds: set[int]) -> None:
        """A subject is over that never took its workers with these hash seeds."""
        needless: list[Future[Worker]] = []
        with self._lock:
            for seed in hash_seeds:
                self._wanted[seed] -= 1
                of_seed = [item for item in self._warm if item[0] == seed]
                for item in of_seed[max(self._wanted[seed], 0) :]:
                    self._warm.remove(item)
                    needless.append(item[1])
        for launched in needless:
            if not launched.cancel():
                with contextlib.suppress(Exception):
                    launched.result().close()


class Turn(Driver):
    """The pool as one subject sees it: its first worker is warm, and the first with each hash seed that it expects.

    `wanted` are the hash seeds of those that it has not taken yet.
    """

    def __init__(self, pool: Pool) -> None:
        self.name, self.isolation, self.rank = pool.name, pool.isolation, pool.rank
        self.wanted = {0}
        self._pool = pool

    def expect(self, hash_seeds: Iterable[int]) -> None:
        """Say which workers the subject is nearly sure to need."""
        more = set(hash_seeds) - self.wanted
        self.wanted |= more
        self._pool.want(more)

    def probe(self) -> Availability:
        return self._pool.probe()

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self._pool.launch(hash_seed=hash_seed, limits=limits)

    def sibling(self, *, hash_seed: int, limits: Limits) -> Worker:
        if hash_seed in self.wanted:
            self.wanted.discard(hash_seed)
            return self._pool.take(hash_seed)
        return self._pool.sibling(hash_seed=hash_seed, limits=limits)


def _ended() -> WorkerLost:
    return WorkerLost("the validation was ended")
