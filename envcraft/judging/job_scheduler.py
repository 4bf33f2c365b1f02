"""The job queue of one subject: threads that each run one job at a time, on workers launched when they are needed.

Each thread has an ordinary worker of its own. There is also one separate worker for each hash seed, for jobs that must
not share a worker with ordinary ones; any idle thread serves it. Threads live as long as the workers that they
launched, because some sandboxes end with the thread that started them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from envcraft.errors import WorkerLost
from envcraft.judging.driver import Worker


@dataclass(frozen=True)
class Placement:
    """The worker that a job needs: by default the ordinary worker of any thread.

    Attributes:
        hash_seed: PYTHONHASHSEED of the worker; ordinary workers have 0.
        separate: the job runs in the worker with that hash seed in which no ordinary job runs.
        own: the job runs in a worker that is launched for it and ends with it.
        group: jobs of one group share a worker, so that they have the same memory layout; empty for no group.
    """

    hash_seed: int = 0
    separate: bool = False
    own: bool = False
    group: bytes = b""

    @property
    def fresh(self) -> bool:
        """Whether the worker must not share the memory layout of the one that ordinary jobs run in."""
        return self.own or (self.separate and not self.hash_seed)


@dataclass(eq=False)
class Task:
    """A submitted job; `future` has the result of `work`."""

    placement: Placement
    work: Callable[[Worker], Any]
    future: Future[Any] = field(default_factory=Future)


#: A worker of the subject: "thread" and its number, "separate" and a hash seed, or "own" and the thread's number.
_Slot = tuple[str, int]


class JobScheduler:
    """Runs jobs in the order in which they were submitted, several at a time.

    Args:
        launch: launches the worker for a placement, in the thread that will use it.
        threads: the most jobs that run at a time.
    """

    def __init__(self, launch: Callable[[Placement], Worker], threads: int) -> None:
        self._launch = launch
        self._most = threads
        self._queue: list[Task] = []
        self._threads: list[threading.Thread] = []
        self._idle: set[int] = set()
        self._workers: dict[_Slot, Worker] = {}
        self._busy: set[_Slot] = set()
        self._groups: dict[bytes, int] = {}
        self._closed = self._ended = False
        self._changed = threading.Condition()

    def submit(self, placement: Placement, work: Callable[[Worker], Any]) -> Task:
        """Put a job at the end of the queue.

        Raises:
            WorkerLost: the scheduler is closed.
        """
        task = Task(placement, work)
        with self._changed:
            if self._closed:
                raise _closed()
            self._queue.append(task)
            if len(self._queue) > len(self._idle) and len(self._threads) < self._most:
                self._add_thread()
            self._changed.notify_all()
        return task

    def wait(self, task: Task) -> Any:
        """Return the result of a job, or raise its exception. A job that has not started moves to the front."""
        with self._changed:
            if task in self._queue:
                self._queue.remove(task)
                self._queue.insert(0, task)
        return task.future.result()

    def cancel(self, task: Task) -> bool:
        """Remove a job from the queue; False if it has started."""
        with self._changed:
            if task not in self._queue:
                return False
            self._queue.remove(task)
            return True

    def close(self) -> None:
        """End every worker, and with it the job that it runs. Jobs in the queue fail with WorkerLost."""
        with self._changed:
            self._closed = True
            for task in self._queue:
                task.future.set_exception(_closed())
            self._queue.clear()
            workers = list(self._workers.values())
        for worker in workers:
            worker.close()
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _add_thread(self) -> None:
        number = len(self._threads)
        self._idle.add(number)
        self._threads.append(
            threading.Thread(target=self._serve, args=(number,), name=f"envcraft-jobs-{number}", daemon=True)
        )
        self._threads[-1].start()

    def _serve(self, thread: int) -> None:
        while (taken := self._next(thread)) is not None:
            task, slot = taken
            result, error = None, None
            try:
                result = self._run(task, slot)
            except BaseException as raised:
                error = raised
            with self._changed:
                # Idle before the future is done, so that the job submitted next starts no other thread.
                self._idle.add(thread)
                self._busy.discard(slot)
                self._changed.notify_all()
            if error is None:
                task.future.set_result(result)
            else:
                task.future.set_exception(error)

    def _next(self, thread: int) -> tuple[Task, _Slot] | None:
        """Wait for a job that this thread may run; None once the workers are ended."""
        with self._changed:
            while not self._ended:
                for task in self._queue:
                    slot = self._slot(task.placement, thread)
                    if slot is not None:
                        self._queue.remove(task)
                        self._idle.discard(thread)
                        self._busy.add(slot)
                        if task.placement.group:
                            self._groups[task.placement.group] = thread
                        self._changed.notify_all()
                        return task, slot
                self._changed.wait()
            return None

    def _slot(self, placement: Placement, thread: int) -> _Slot | None:
        """The worker that would serve a job on this thread, or None if the thread cannot run it now."""
        if placement.own:
            return "own", thread
        if placement.separate:
            separate = ("separate", placement.hash_seed)
            return None if separate in self._busy else separate
        if self._groups.get(placement.group, thread) != thread:
            return None
        if placement.group in self._groups or ("thread", thread) in self._workers:
            return "thread", thread
        # An idle thread that has a worker already takes the job instead.
        return None if any(("thread", idle) in self._workers for idle in self._idle) else ("thread", thread)

    def _run(self, task: Task, slot: _Slot) -> Any:
        reusable = False
        try:
            result = task.work(self._worker(slot, task.placement))
            reusable = not task.placement.own
            return result
        finally:
            # After any exception, the next job starts in a worker in which nothing went wrong.
            if not reusable:
                self._end(slot)

    def _worker(self, slot: _Slot, placement: Placement) -> Worker:
        if slot not in self._workers:
            worker = self._launch(placement)
            with self._changed:
                self._workers[slot] = worker
                closed = self._closed
            if closed:
                raise _closed()
        return self._workers[slot]

    def _end(self, slot: _Slot) -> None:
        with self._changed:
            worker = self._workers.pop(slot, None)
        if worker is not None:
            worker.close()


def _closed() -> WorkerLost:
    return WorkerLost("the subject's workers were ended")
