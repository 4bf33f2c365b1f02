"""Where tasks run on this machine: in this process, or in some of their own."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from typing import Any

from envcraft.executors import ExecutorPlugin, Opened

_PR_SET_PDEATHSIG = 1


class LocalExecutor(ExecutorPlugin):
    """So many worker processes; with none, tasks run in this process, one after the other."""

    name = "local"

    @contextlib.contextmanager
    def open(self, workers: int | None, scheduler: str | None = None) -> Iterator[Opened]:
        if workers == 0:
            yield Opened(_Here(), lambda: 1)
            return
        from envcraft.engine import cores

        count = workers or cores()
        before = set(multiprocessing.active_children())
        pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _begin)
        try:
            yield Opened(pool, lambda: count)
        finally:
            # Each task can be done again, and a training goes on from its checkpoint.
            for child in set(multiprocessing.active_children()) - before:
                child.kill()
            pool.shutdown(wait=True, cancel_futures=True)


class _Here(Executor):
    """Runs a task when it is submitted."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def _begin() -> None:
    """Leave Ctrl-C to the process that gives out tasks, and end with it, by whatever it is ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
