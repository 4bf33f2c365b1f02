"""``kill -9`` a program at moments spread over its whole run, and start it again each time."""

from __future__ import annotations

import random
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable

#: The number of kills; how many of them hit the start and the end of the program. The others hit its work.
TIMES, STARTING, ENDING = 20, 5, 3
#: Neither the start nor the work takes this many seconds.
_PATIENCE = 300.0
#: How often to start a program again that ended before its kill.
_AGAIN = 5


class Killed:
    """A program that is killed `TIMES` times and started again each time.

    Args:
        start: Starts the program with its standard output in a pipe.
        working: Whether the process with this id has started its work.
        seconds: The latest kill after the start of the work, in seconds.
        then: Called after each kill.

    Attributes:
        moments: The number of kills during the start, during the work, and at the end, after the first line of output.
    """

    def __init__(
        self,
        start: Callable[[], subprocess.Popen[str]],
        working: Callable[[int], bool],
        seconds: float,
        then: Callable[[], None] = lambda: None,
        seed: int = 0,
    ) -> None:
        self._start, self._working, self._seconds, self._then = start, working, seconds, then
        self._random = random.Random(seed)
        #: The duration of the last complete start, in seconds.
        self._starting = 0.3
        self.moments: Counter[str] = Counter()

    def run(self) -> None:
        """Kill the program `TIMES` times. A program that has no work left is killed during its start."""
        kinds = ["start"] * STARTING + ["work"] * (TIMES - STARTING - ENDING)
        self._random.shuffle(kinds)
        # The kills at the end come last, so that the earlier ones hit unfinished work.
        for kind in [*kinds, *["end"] * ENDING]:
            hit = next((hit for hit in (kind, *["start"] * _AGAIN) if self._once(hit)), None)
            assert hit is not None, f"the program ended {_AGAIN + 1} times before the kill"
            self.moments[hit] += 1
            self._then()

    def _once(self, kind: str) -> bool:
        """Start the program and kill it; return whether it was still running."""
        started = time.monotonic()
        with self._start() as process:
            if kind == "start":
                self._wait(process, self._random.uniform(0.0, self._starting))
            elif kind == "work":
                while process.poll() is None and not self._working(process.pid):
                    assert time.monotonic() - started < _PATIENCE, "the work does not start"
                    time.sleep(0.005)
                self._starting = time.monotonic() - started
                # Early moments are more likely, so that the work does not end before the kills.
                self._wait(process, self._seconds * self._random.random() ** 2)
            else:
                assert process.stdout is not None
                process.stdout.readline()
            alive = process.poll() is None
            process.send_signal(signal.SIGKILL)
        return alive

    @staticmethod
    def _wait(process: subprocess.Popen[str], seconds: float) -> None:
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            return
