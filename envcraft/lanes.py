"""Jobs of one subject side by side, on workers that are launched when there is work for them.

A lane is a thread with a worker of its own, which serves one job at a time. Beside the lanes' workers there is one for
each hash seed that no ordinary job ever runs in; whichever lane is free serves it. Threads live as long as the workers
that they launched: some sandboxes end with the thread that started them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from envcraft.errors import WorkerLost
from envcraft.sandbox import Worker


@dataclass(frozen=True)
class Place:
    """Where a job may run: by default on any lane, in its ordinary worker.

    Attributes:
        hash_seed: PYTHONHASHSEED of the worker; the lanes' own have 0.
        apart: in the worker with that hash seed that no ordinary job runs in.
        own: in a worker that is launched for this job and ends with it.
        home: jobs with the same home share a worker, so that its memory layout is no difference between them.
    """

    hash_seed: int = 0
    apart: bool = False
    own: bool = False
    home: bytes = b""

    @property
    def fresh(self) -> bool:
        """Whether its worker may not have the memory layout of the one that ordinary jobs run in."""
        return self.own or (self.apart and not self.hash_seed)


@dataclass(eq=False)
class Task:
    """A job that waits for its turn, runs or is done: then `future` has what `work` gave."""

    place: Place
    work: Callable[[Worker], Any]
    future: Future[Any] = field(default_factory=Future)


#: A worker's place among those of a subject: "lane" and its number, "apart" and its hash seed, "own" and its lane.
_Slot = tuple[str, int]


class Lanes:
    """Up to `count` jobs at a time. `launch` makes a worker for a place, in the thread that will use it."""

    def __init__(self, launch: Callable[[Place], Worker], count: int) -> None:
        self._launch = launch
        self._count = count
        self._queue: list[Task] = []
        self._threads: list[threading.Thread] = []
        self._idle: set[int] = set()
        self._workers: dict[_Slot, Worker] = {}
        self._busy: set[_Slot] = set()
        self._homes: dict[bytes, int] = {}
        self._closed = self._over = False
        self._changed = threading.Condition()

    def submit(self, place: Place, work: Callable[[Worker], Any]) -> Task:
        """Put a job at the end of the queue."""
        task = Task(place, work)
        with self._changed:
            if self._closed:
                raise _ended()
            self._queue.append(task)
            if len(self._queue) > len(self._idle) and len(self._threads) < self._count:
                self._add_lane()
            self._changed.notify_all()
        return task

    def wait(self, task: Task) -> Any:
        """Give what a job gave, or raise what it raised. If it has not begun, it is next."""
        with self._changed:
            if task in self._queue:
                self._queue.remove(task)
                self._queue.insert(0, task)
        return task.future.result()

    def drop(self, task: Task) -> bool:
        """Take a job from the queue; False if it has begun."""
        with self._changed:
            if task not in self._queue:
                return False
            self._queue.remove(task)
            return True

    def close(self) -> None:
        """End every worker, and with it the job that it runs; begin no more."""
        with self._changed:
            self._closed = True
            for task in self._queue:
                task.future.set_exception(_ended())
            self._queue.clear()
            workers = list(self._workers.values())
        for worker in workers:
            worker.close()
        with self._changed:
            self._over = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _add_lane(self) -> None:
        lane = len(self._threads)
        self._idle.add(lane)
        self._threads.append(
            threading.Thread(target=self._serve, args=(lane,), name=f"envcraft-lane-{lane}", daemon=True)
        )
        self._threads[-1].start()

    def _serve(self, lane: int) -> None:
        while (taken := self._next(lane)) is not None:
            task, slot = taken
            result, error = None, None
            try:
                result = self._run(task, slot)
            except BaseException as raised:
                error = raised
            with self._changed:
                # Idle before anybody hears of the end, so that what is asked next starts no other lane.
                self._idle.add(lane)
                self._busy.discard(slot)
                self._changed.notify_all()
            if error is None:
                task.future.set_result(result)
            else:
                task.future.set_exception(error)

    def _next(self, lane: int) -> tuple[Task, _Slot] | None:
        """Wait for a job that this lane may run; None once the workers are ended."""
        with self._changed:
            while not self._over:
                for task in self._queue:
                    slot = self._slot(task.place, lane)
                    if slot is not None:
                        self._queue.remove(task)
                        self._idle.discard(lane)
                        self._busy.add(slot)
                        if task.place.home:
                            self._homes[task.place.home] = lane
                        self._changed.notify_all()
                        return task, slot
                self._changed.wait()
            return None

    def _slot(self, place: Place, lane: int) -> _Slot | None:
        """The worker that would serve a job on this lane, or None if the lane cannot run it now."""
        if place.own:
            return "own", lane
        if place.apart:
            apart = ("apart", place.hash_seed)
            return None if apart in self._busy else apart
        home = self._homes.get(place.home, lane)
        # A lane that has no worker yet leaves a job that is at home nowhere to an idle one that has.
        needless = place.home not in self._homes and ("lane", lane) not in self._workers
        if home != lane or (needless and any(("lane", other) in self._workers for other in self._idle)):
            return None
        return "lane", lane

    def _run(self, task: Task, slot: _Slot) -> Any:
        lasts = False
        try:
            result = task.work(self._worker(slot, task.place))
            lasts = not task.place.own
            return result
        finally:
            # After an exception, whichever it is, the next job starts in a worker that nothing went wrong in.
            if not lasts:
                self._end(slot)

    def _worker(self, slot: _Slot, place: Place) -> Worker:
        if slot not in self._workers:
            worker = self._launch(place)
            with self._changed:
                self._workers[slot] = worker
                closed = self._closed
            if closed:
                raise _ended()
        return self._workers[slot]

    def _end(self, slot: _Slot) -> None:
        with self._changed:
            worker = self._workers.pop(slot, None)
        if worker is not None:
            worker.close()


def _ended() -> WorkerLost:
    return WorkerLost("the subject's workers were ended")
