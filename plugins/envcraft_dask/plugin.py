"""The executor ``dask``: a cluster that ``--scheduler`` leads to, or worker processes of this machine."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.errors import EnvCraftError, UsageError
from envcraft.executors import ExecutorPlugin, Opened
from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from distributed import Client

_CONNECT_SECONDS = 20.0


class DaskExecutor(ExecutorPlugin):
    """Dask runs a task again whose worker is gone, so a worker that is killed costs what it was doing."""

    name = "dask"

    def ensure(self) -> None:
        # Without cryptography there are no certificates for a cluster of this machine.
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
                        # Whoever reaches a scheduler has its workers run anything, and all users of a machine reach
                        # its loopback: certificates of this run's own let in nobody else.
                        security=True,
                        silence_logs=logging.CRITICAL,
                        # The sandbox holds what environments use; a worker itself has little.
                        memory_limit=0,
                        preload=["envcraft_dask.worker"],
                    )
                )
                client = stack.enter_context(Client(cluster, set_as_default=False))
            else:
                client = stack.enter_context(_connected(scheduler))
            # The same task twice is two tasks: one that could not be judged is tried again.
            yield Opened(client.get_executor(pure=False), lambda: sum(client.nthreads().values()))


def _connected(scheduler: str) -> Client:
    """Raises UsageError on what is no address, EnvCraftError where no scheduler answers there."""
    from distributed import Client
    from distributed.comm.addressing import resolve_address

    try:
        # A client that has not come to an address waits for its own end, long after the command's.
        resolve_address(scheduler)
        return Client(scheduler, timeout=_CONNECT_SECONDS, set_as_default=False)
    except ValueError as error:
        raise UsageError(
            f"--scheduler {scheduler} is no address of a Dask scheduler, such as tcp://10.0.0.1:8786: {error}"
        ) from None
    except OSError as error:
        raise EnvCraftError(
            f"no Dask scheduler answers at --scheduler {scheduler} within {_CONNECT_SECONDS:.0f} s: {error}"
        ) from None


def _cores() -> int:
    from envcraft.engine import cores

    return cores()


@hookimpl
def envcraft_executors() -> list[ExecutorPlugin]:
    return [DaskExecutor()]
