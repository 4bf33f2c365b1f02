"""The ``process`` driver: a child process, and what the kernel lets it give up.

The weakest of the three: it sees the machine's processes and network interfaces, and without Landlock and the system
call filter it holds against accidents, not against malice.
"""

from __future__ import annotations

import os
from collections.abc import Callable

from envcraft.installed import Installed
from envcraft.sandbox import Availability, Driver, Isolation, Limits, Worker

from . import launch, leftovers
from .zygote import Nursery, Started


class ProcessDriver(Driver):
    name = "process"
    isolation = Isolation.PROCESS
    rank = 10

    def __init__(self, found: Installed = Installed()) -> None:  # noqa: B008 (it is immutable)
        self._found = found

    def seeing(self, found: Installed) -> ProcessDriver:
        return ProcessDriver(found)

    def probe(self) -> Availability:
        if os.name != "posix":
            return Availability(False, "it needs a POSIX system", "use the docker sandbox")
        return Availability(True, layers=["own process", "scrubbed environment"])

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self.begin(hash_seed=hash_seed, limits=limits)()

    def begin(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        folder = leftovers.job_folder()
        argv = launch.command(str(folder), self._found.folders)
        return launch.start(argv, self._variables(hash_seed, str(folder)), limits, self.name, folder)

    def nursery(self) -> Driver:
        return Nursery(self, self._zygote)

    def _zygote(self, hash_seed: int) -> Started:
        nowhere = str(leftovers.job_folder())
        argv = [*launch.command(nowhere, self._found.folders), "--zygote", "0"]
        return Started(*launch.spawn(argv, self._variables(hash_seed, nowhere), self.name))

    def _variables(self, hash_seed: int, folder: str) -> dict[str, str]:
        paths = os.pathsep.join(launch.module_paths(self._found))
        return launch.environment(hash_seed, folder) | {"PYTHONPATH": paths}
