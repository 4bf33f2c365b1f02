"""The ``process`` driver: a child with a scrubbed environment and resource limits, and what the kernel adds to that.

The weakest of the three: it holds against accidents, not against malice.
"""

from __future__ import annotations

import os
import sys

from envcraft.sandbox import Availability, Driver, Isolation, Limits, Worker

from . import launch


class ProcessDriver(Driver):
    name = "process"
    isolation = Isolation.PROCESS
    rank = 10

    def probe(self) -> Availability:
        if os.name != "posix":
            return Availability(False, "it needs a POSIX system", "use the docker sandbox")
        layers = ["own process", "rlimits", "scrubbed environment"]
        return Availability(True, layers=[*layers, "no new privileges"] if sys.platform == "linux" else layers)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        variables = launch.environment(hash_seed)
        variables["PYTHONPATH"] = os.pathsep.join(launch.module_paths())
        return launch.start(launch.command(), variables, limits, self.name)
