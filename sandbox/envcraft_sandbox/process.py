"""The ``process`` driver: a child process, and what the kernel lets it give up.

The weakest of the three: it sees the machine's processes and network interfaces, and without Landlock and the system
call filter it holds against accidents, not against malice.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable

from envcraft.installed import Installed
from envcraft.sandbox import Availability, Driver, Isolation, Limits, Worker

from . import launch, leftovers


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
        folder = leftovers.folder() / f"job-{secrets.token_hex(8)}"
        variables = launch.environment(hash_seed, str(folder))
        variables["PYTHONPATH"] = os.pathsep.join(launch.module_paths(self._found))
        argv = launch.command(str(folder), self._found.folders)
        return launch.start(argv, variables, limits, self.name, folder)
