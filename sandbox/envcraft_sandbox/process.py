"""The ``process`` driver: a child process that gives up what the kernel lets it give up.

It is the weakest of the three. It sees the machine's processes and network interfaces. Without Landlock and the system
call filter it protects against accidents but not against malice.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Worker
from envcraft.judging.installed import Installed

from . import launch, leftovers
from .zygote import Started, ZygoteDriver


class ProcessDriver(Driver):
    name = "process"
    isolation = Isolation.PROCESS
    rank = 10
    packages = ("envcraft_sandbox.worker",)

    def __init__(self, found: Installed = Installed()) -> None:  # noqa: B008 (it is immutable)
        self._found = found

    def with_installed(self, packages: Installed) -> ProcessDriver:
        return ProcessDriver(packages)

    def probe(self) -> Availability:
        if os.name != "posix":
            return Availability(
                False, "it needs a POSIX system", "run EnvCraft in a Linux container or virtual machine"
            )
        return Availability(True, layers=["own process", "scrubbed environment"])

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self.start(hash_seed=hash_seed, limits=limits)()

    def start(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        folder = leftovers.job_folder()
        argv = launch.command(str(folder), self._found.folders)
        return launch.start(argv, self._variables(hash_seed, str(folder)), limits, self.name, folder)

    def shared_layout(self) -> Driver:
        # Only Linux has the descriptors by which this process ends what a zygote forked.
        if sys.platform != "linux":
            return self
        return ZygoteDriver(self, self._zygote)

    def _zygote(self, hash_seed: int) -> Started:
        nowhere = str(leftovers.job_folder())
        argv = [*launch.command(nowhere, self._found.folders), "--zygote", "0"]
        return Started(*launch.spawn(argv, self._variables(hash_seed, nowhere), self.name))

    def _variables(self, hash_seed: int, folder: str) -> dict[str, str]:
        paths = os.pathsep.join(launch.module_paths(self._found))
        return launch.environment(hash_seed, folder) | {"PYTHONPATH": paths}
