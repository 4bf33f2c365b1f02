"""Where environments are judged when not in the threads of one process: executors, which plugins open.

The seam is :class:`concurrent.futures.Executor`, which any engine can be. What is handed over is one module-level
function and bytes, what comes back is bytes (:mod:`envcraft.corpus.tasks`); only the process that audits writes to the
corpus.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from envcraft.registry import lookup, offered

if TYPE_CHECKING:
    from concurrent.futures import Executor


#: The executor that is no plugin's: the threads of the process that judges.
LOCAL = "local"


@dataclass(frozen=True)
class Opened:
    """An executor that takes tasks. `slots` says how many of them it can run at the same time, as of now."""

    executor: Executor
    slots: Callable[[], int]


class ExecutorPlugin(ABC):
    """A way to run tasks elsewhere; making one must not start anything. `name` is how ``--executor`` names it."""

    name: str

    def ensure(self) -> None:
        """Look whether what it needs is installed, before anything is read. Raises UsageError, with what to install."""
        return

    @abstractmethod
    def open(self, workers: int | None, scheduler: str | None) -> AbstractContextManager[Opened]:
        """Open what `scheduler` leads to, the value of ``--scheduler``; without it, `workers` processes of this machine
        (None: as many as there are cores), whose main module is not run again and which Ctrl-C is not for.

        Of a future that is lost with its worker is expected: that the executor runs its task again itself, that it ends
        as cancelled (its task is submitted again), or that it raises BrokenExecutor (the executor is left, and opened
        again). Any other exception counts as one environment that could not be judged.

        Leaving the context ends what was opened here; after an exception, KeyboardInterrupt included, without waiting
        for tasks that are running.

        Raises UsageError where `scheduler` cannot be used, EnvCraftError where nothing could be opened.
        """


def executor_named(name: str) -> ExecutorPlugin | None:
    """None for this process itself. Raises UsageError, naming the nearest."""
    if name == LOCAL:
        return None
    known = {executor.name: executor for executor in offered("envcraft_executors")}
    found: ExecutorPlugin | None = lookup("executor", name, {LOCAL: None, **known})
    return found
