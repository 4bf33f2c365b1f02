"""``kill -9`` at moments that are spread over all that a program does, and a program that is begun again each time."""

from __future__ import annotations

import random
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Callable

#: Of these kills so many hit while the program starts; the others while it works, and a few at its end.
TIMES, STARTING, ENDING = 20, 5, 3
#: No start, and no rest of the work, takes so many seconds.
_PATIENCE = 300.0
#: So often a program that was too quick is begun once more.
_AGAIN = 5


class Killed:
    """A program that is killed `TIMES` times, each time begun anew.

    Args:
        start: begins it, with its standard output in a pipe.
        working: whether the process with this number has begun its work.
        seconds: that moments lie after the begin of the work, at most.
        then: called after each kill.

    Attributes:
        moments: how many kills hit at the start, in the work, and at the end, when the first line was printed.
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
        #: How long the last start took that was not cut off.
        self._starting = 0.3
        self.moments: Counter[str] = Counter()

    def run(self) -> None:
        """Kill it so often. What has nothing left to do is killed while it starts."""
        kinds = ["start"] * STARTING + ["work"] * (TIMES - STARTING - ENDING)
        self._random.shuffle(kinds)
        # Some of those in the work have to find it unfinished.
        for kind in [*kinds, *["end"] * ENDING]:
            hit = next((hit for hit in (kind, *["start"] * _AGAIN) if self._once(hit)), None)
            assert hit is not None, f"it has come to its end {_AGAIN + 1} times before it could be killed"
            self.moments[hit] += 1
            self._then()

    def _once(self, kind: str) -> bool:
        """Begin it and kill it; give whether it had not yet come to its end."""
        began = time.monotonic()
        with self._start() as process:
            if kind == "start":
                self._wait(process, self._random.uniform(0.0, self._starting))
            elif kind == "work":
                while process.poll() is None and not self._working(process.pid):
                    assert time.monotonic() - began < _PATIENCE, "the work does not begin"
                    time.sleep(0.005)
                self._starting = time.monotonic() - began
                # More of them soon after the begin, so that the work is not done before the kills are.
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
