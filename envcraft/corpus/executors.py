"""Executors, which plugins provide to judge environments outside of this process.

The interface is :class:`concurrent.futures.Executor`, which every engine can provide. A task is one module-level
function with bytes as its argument, and its result is bytes (:mod:`envcraft.corpus.tasks`). Only the process that
audits writes to the corpus.
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


#: The name for the threads of this process, which no plugin provides.
LOCAL = "local"


@dataclass(frozen=True)
class Opened:
    """An open executor.

    Attributes:
        executor: accepts tasks.
        slots: returns the number of tasks that the executor can run at the same time at present.
    """

    executor: Executor
    slots: Callable[[], int]


class ExecutorPlugin(ABC):
    """Provides an executor. Its constructor must not start anything.

    Attributes:
        name: the value of ``--executor``.
    """

    name: str

    def ensure(self) -> None:
        """Check that the plugin's requirements are installed. It is called before anything is read.

        Raises:
            UsageError: a requirement is missing; the message says what to install.
        """
        return

    @abstractmethod
    def open(self, workers: int | None, scheduler: str | None) -> AbstractContextManager[Opened]:
        """Open the executor.

        If a worker is lost, the executor may run its task again, or cancel the future (the task is submitted again), or
        let the future raise BrokenExecutor (the context is left and opened again). Any other exception of a future
        means that one environment could not be judged.

        The exit of the context ends what this method started. After an exception, including KeyboardInterrupt, it does
        not wait for running tasks.

        Args:
            workers: the number of local processes if there is no `scheduler`; None for the number of cores. They must
                not run the main module again, and must ignore Ctrl-C.
            scheduler: the value of ``--scheduler``, such as an address.

        Raises:
            UsageError: `scheduler` is invalid.
            EnvCraftError: the executor cannot be opened.
        """


def executor_named(name: str) -> ExecutorPlugin | None:
    """Return the executor plugin with this name, or None for :data:`LOCAL`.

    Raises:
        UsageError: there is none; the message names the nearest.
    """
    if name == LOCAL:
        return None
    known = {executor.name: executor for executor in offered("envcraft_executors")}
    plugin: ExecutorPlugin | None = lookup("executor", name, {LOCAL: None, **known})
    return plugin
