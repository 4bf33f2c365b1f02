"""The ``nice`` driver: the process sandbox at the lowest priority, for long runs beside other work."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable

from envcraft_sandbox import launch, leftovers

from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Worker
from envcraft.judging.installed import Installed


class NiceDriver(Driver):
    name = "nice"
    isolation = Isolation.PROCESS
    #: Below that of every built-in driver: ``auto`` never takes it.
    rank = 5

    def __init__(self, found: Installed = Installed()) -> None:  # noqa: B008 (it is immutable)
        self._found = found

    def with_installed(self, packages: Installed) -> NiceDriver:
        return NiceDriver(packages)

    def probe(self) -> Availability:
        if shutil.which("nice") is None:
            return Availability(False, "there is no program nice", "install the package coreutils")
        return Availability(True, layers=["own process", "scrubbed environment", "lowest priority"])

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self.start(hash_seed=hash_seed, limits=limits)()

    def start(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        folder = leftovers.folder() / f"job-{secrets.token_hex(8)}"
        variables = launch.environment(hash_seed, str(folder))
        variables["PYTHONPATH"] = os.pathsep.join(launch.module_paths(self._found))
        argv = [shutil.which("nice") or "nice", "-n", "19", *launch.command(str(folder), self._found.folders)]
        return launch.start(argv, variables, limits, self.name, folder)
