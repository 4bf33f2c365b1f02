"""An executor for tasks on this machine: in worker processes, or in this process."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from typing import Any

from envcraft.corpus.executors import ExecutorPlugin, Opened

_PR_SET_PDEATHSIG = 1


class LocalExecutor(ExecutorPlugin):
    """Runs tasks in worker processes, or with 0 workers in this process."""

    name = "local"

    @contextlib.contextmanager
    def open(self, workers: int | None, scheduler: str | None = None) -> Iterator[Opened]:
        """Start the workers; by default, one per core."""
        if workers == 0:
            yield Opened(_SerialExecutor(), lambda: 1)
            return
        from envcraft.judging.engine import cores

        count = workers or cores()
        before = set(multiprocessing.active_children())
        pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _initialise_worker)
        try:
            yield Opened(pool, lambda: count)
        finally:
            # Tasks can run again, and trainings resume from their checkpoints.
            for child in set(multiprocessing.active_children()) - before:
                child.kill()
            pool.shutdown(wait=True, cancel_futures=True)


class _SerialExecutor(Executor):
    """Runs a task on submission."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def _initialise_worker() -> None:
    """Leave Ctrl-C to the parent process, and end with it even if it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
