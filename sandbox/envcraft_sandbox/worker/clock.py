"""Replacement clocks for the code under test: logical, or shifted and at another rate.

They replace Python's own readings (``time``, ``datetime``) and those of ``pygame.time``, but not those of other C code.
"""

from __future__ import annotations

import datetime
import importlib
import sys
import time
from collections.abc import Callable
from typing import Any

from envcraft_protocol.jobs import ClockShift

_NAMES = ("time", "monotonic", "perf_counter", "process_time", "thread_time")
_REAL: dict[str, Callable[[], float]] = {name: getattr(time, name) for name in _NAMES}
#: Functions of calendar time, by default of the current moment.
_CALENDAR: dict[str, Callable[[float], Any]] = {name: getattr(time, name) for name in ("localtime", "gmtime", "ctime")}
_strftime, _asctime, _clock_gettime = time.strftime, time.asctime, time.clock_gettime
_CLOCKS = {time.CLOCK_REALTIME: "time", time.CLOCK_MONOTONIC: "monotonic"}
_EPOCH = 1_800_000_000.0
_TICK = 0.001


class Clock:
    """The clocks of the module :mod:`time` under one condition.

    Rate 0 is the logical clock: it starts at a fixed moment and advances by one millisecond at each reading, so it is
    equal in all runs that read it equally often.
    """

    def __init__(self, offset: float, rate: float) -> None:
        self._offset = offset
        self._rate = rate
        self._start = {name: read() for name, read in _REAL.items()}
        self._readings = 0

    def read(self, name: str) -> float:
        if self._rate == 0:
            self._readings += 1
            return _EPOCH + self._offset + self._readings * _TICK
        start = self._start[name]
        return start + self._offset + (_REAL[name]() - start) * self._rate

    def get(self, which: int) -> float:
        """The reading of a clock by its number; the machine's reading for clocks that :meth:`read` does not know."""
        return self.read(_CLOCKS[which]) if which in _CLOCKS else _clock_gettime(which)

    @classmethod
    def install(cls, condition: ClockShift | None, source: str = "") -> None:
        """Replace the readings, unless the condition is None.

        Args:
            condition: the clock.
            source: the text that is going to run. The readings of pygame are replaced if it names pygame, or if pygame
                is imported already.
        """
        if condition is None:
            return
        clock = cls(float(condition["offset"]), float(condition["rate"]))
        for name in _NAMES:
            setattr(time, name, lambda name=name: clock.read(name))
            setattr(time, f"{name}_ns", lambda name=name: int(clock.read(name) * 1e9))
        for name, of in _CALENDAR.items():
            setattr(time, name, lambda at=None, of=of: of(clock.read("time") if at is None else at))
        time.strftime = lambda form, at=None: _strftime(form, time.localtime() if at is None else at)
        time.asctime = lambda at=None: _asctime(time.localtime() if at is None else at)
        time.clock_gettime = clock.get
        time.clock_gettime_ns = lambda which: int(clock.get(which) * 1e9)
        if clock._rate == 0:
            time.sleep = lambda seconds: None

        class Date(datetime.date):
            @classmethod
            def today(cls) -> Date:
                return cls.fromtimestamp(clock.read("time"))

        class DateTime(datetime.datetime):
            @classmethod
            def now(cls, tz: datetime.tzinfo | None = None) -> DateTime:
                return cls.fromtimestamp(clock.read("time"), tz)

            @classmethod
            def utcnow(cls) -> DateTime:
                return cls.fromtimestamp(clock.read("time"), datetime.UTC).replace(tzinfo=None)

            @classmethod
            def today(cls) -> DateTime:
                return cls.fromtimestamp(clock.read("time"))

        for name, replacement in {"date": Date, "datetime": DateTime}.items():
            setattr(datetime, name, replacement)
        if "pygame" in source or "pygame" in sys.modules:
            _replace_pygame(clock)


def _replace_pygame(clock: Clock) -> None:
    """Replace ``pygame.time``'s readings. ``Clock.tick`` does not wait but advances them by the time that it skips."""
    try:
        module: Any = importlib.import_module("pygame.time")
    except ImportError:
        return
    start, skipped = clock.read("monotonic"), 0.0

    def now() -> float:
        return clock.read("monotonic") - start + skipped

    class PygameClock:
        def __init__(self) -> None:
            self._last = now()
            self._passed = self._busy = 0.0

        def tick(self, framerate: float = 0) -> int:
            nonlocal skipped
            at = now()
            self._busy = at - self._last
            self._passed = max(self._busy, 1 / framerate if framerate > 0 else 0.0)
            skipped += self._passed - self._busy
            self._last += self._passed
            return int(self._passed * 1000)

        tick_busy_loop = tick

        def get_time(self) -> int:
            return int(self._passed * 1000)

        def get_rawtime(self) -> int:
            return int(self._busy * 1000)

        def get_fps(self) -> float:
            return 1 / self._passed if self._passed else 0.0

    module.get_ticks = lambda: int(now() * 1000)
    module.Clock = PygameClock
    if hasattr(sys.modules["pygame"], "Clock"):
        sys.modules["pygame"].Clock = PygameClock  # type: ignore[attr-defined]
