"""The executor ``dask``: the cluster that ``--scheduler`` names, or worker processes on this machine."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.corpus.executors import ExecutorPlugin, Opened
from envcraft.errors import EnvCraftError, UsageError
from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from distributed import Client

_CONNECT_SECONDS = 20.0


class DaskExecutor(ExecutorPlugin):
    """Runs tasks on Dask, which reruns the task of a worker that was killed."""

    name = "dask"

    def ensure(self) -> None:
        # A cluster on this machine needs certificates, which cryptography makes.
        if not all(map(importlib.util.find_spec, ("distributed", "cryptography"))):
            raise UsageError("--executor dask needs Dask; install it with `pip install 'envcraft-rl[dask]'`")

    @contextlib.contextmanager
    def open(self, workers: int | None, scheduler: str | None) -> Iterator[Opened]:
        self.ensure()
        from distributed import Client, LocalCluster

        with contextlib.ExitStack() as stack:
            if scheduler is None:
                cluster = stack.enter_context(
                    LocalCluster(
                        n_workers=workers or _cores(),
                        threads_per_worker=1,
                        dashboard_address=None,
                        # A scheduler runs the code of every client, and all users of a machine can reach its loopback
                        # interface. Temporary certificates admit only this client.
                        security=True,
                        silence_logs=logging.CRITICAL,
                        # The sandbox limits the memory of environments; a worker itself uses little.
                        memory_limit=0,
                        preload=["envcraft_dask.worker"],
                    )
                )
                client = stack.enter_context(Client(cluster, set_as_default=False))
            else:
                client = stack.enter_context(_connected(scheduler))
            # With pure=True, Dask would answer the retry of a task with the first result.
            yield Opened(client.get_executor(pure=False), lambda: sum(client.nthreads().values()))


def _connected(scheduler: str) -> Client:
    """Connect to a scheduler. Raises UsageError for an invalid address, EnvCraftError if no scheduler answers."""
    from distributed import Client
    from distributed.comm.addressing import resolve_address

    try:
        # A client with an invalid address would delay the exit of the command.
        resolve_address(scheduler)
        return Client(scheduler, timeout=_CONNECT_SECONDS, set_as_default=False)
    except ValueError as error:
        raise UsageError(
            f"--scheduler {scheduler} is not the address of a Dask scheduler, such as tcp://10.0.0.1:8786: {error}"
        ) from None
    except OSError as error:
        raise EnvCraftError(
            f"no Dask scheduler answers at --scheduler {scheduler} within {_CONNECT_SECONDS:.0f} s: {error}"
        ) from None


def _cores() -> int:
    from envcraft.judging.engine import cores

    return cores()


@hookimpl
def envcraft_executors() -> list[ExecutorPlugin]:
    return [DaskExecutor()]
