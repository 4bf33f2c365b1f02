"""The executor ``processes``: worker processes of this machine, by the standard library alone."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor

from envcraft.corpus.executors import ExecutorPlugin, Opened
from envcraft.errors import UsageError


class ProcessesExecutor(ExecutorPlugin):
    name = "processes"

    @contextlib.contextmanager
    def open(self, workers: int | None, scheduler: str | None) -> Iterator[Opened]:
        if scheduler is not None:
            raise UsageError(
                f"--scheduler {scheduler} leads to a cluster, and processes are of this machine: leave it out"
            )
        count = workers or os.cpu_count() or 1
        # Forked ones would hold on to what the process that audits has open, the corpus among it.
        spawn = multiprocessing.get_context("spawn")
        executor = ProcessPoolExecutor(count, spawn, signal.signal, (signal.SIGINT, signal.SIG_IGN))
        try:
            yield Opened(executor, lambda: count)
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise
        executor.shutdown()
